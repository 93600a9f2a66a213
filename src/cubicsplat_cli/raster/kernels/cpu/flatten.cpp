// Stage flatten: parameters -> activated values, polylines and (primitive, tile) pairs.

#include <algorithm>
#include <cmath>
#include <cstring>

#include "frame.h"

namespace cs {

void Chunk::clear() {
  pairs.clear();
  edges.clear();
  ring_starts.clear();
  parameters.clear();
  skipped = 0;
}

ChunkView Chunk::view() { return {lines.data(), edge_gradients.data(), pairs.data(), paint_gradients.data()}; }

void prepare(Frame& f, const CsScene& scene, const CsSettings& settings, const CsImages& images, bool backward) {
  f.scene = scene;
  f.settings = settings;
  f.images = images;
  f.backward = backward;
  f.tiles_x = (scene.width + kTile - 1) / kTile;
  f.tiles_y = (scene.height + kTile - 1) / kTile;
  f.points_per_curve = 3 * scene.segments + (scene.closed ? 0 : 1);
  if (!scene.ring_ends) f.scene.rings = 1;
  f.primitives.resize(scene.curves);
  f.cubic_samples.resize(size_t(scene.curves) * scene.segments);
  f.chunks.resize(f.chunk_count());
  f.views.resize(f.chunk_count());
  f.tile_loss.resize(f.tiles());
  f.tile_background.resize(size_t(f.tiles()) * 4);
  if (f.basis.empty()) {
    for (int samples = 1; samples <= kMaxSamples; samples++)
      for (int s = 0; s < samples; s++) {
        float w[4];
        bernstein(float(s) / float(samples), w);
        f.basis.insert(f.basis.end(), w, w + 4);
      }
  }
}

namespace {

void activate(const CsScene& scene, float edge_width, int p, Primitive& q) {
  for (int c = 0; c < 3; c++) q.colour[c] = scene.colours[3 * p + c];
  q.opacity = scene.opacities[p];
  if (scene.logits) {
    for (int c = 0; c < 3; c++) q.colour[c] = sigmoid(q.colour[c]);
    q.opacity = sigmoid(q.opacity);
  }
  q.half_width = scene.closed ? 0.0f : scene.half_widths[p];
  q.edge_width = scene.edge_widths ? scene.edge_widths[p] : edge_width;
}

// Edges of one cubic.
int choose_samples(const CsSettings& s, const float* a, const float* b, const float* c, const float* d) {
  if (!(s.tolerance > 0.0f)) return s.samples;
  return samples_for(std::max(bend(a, b, c), bend(b, c, d)), s.tolerance, s.samples);
}

// Vertices of one ring but the last, at uniform parameters of each cubic; returns where the last one goes. Notes how many
// edges each cubic has.
float* evaluate_ring(const Frame& f, const Rings& rings, int r, const float* points, uint8_t* samples, float* out) {
  for (int m = rings.begin(r); m < rings.end(r); m++) {
    const float *p0 = points + 6 * m, *p3 = points + 2 * rings.end_point(r, m, f.scene.closed);
    const int count = choose_samples(f.settings, p0, p0 + 2, p0 + 4, p3);
    const float* w = f.weights(count);
    samples[m] = uint8_t(count);
    for (const float* end = w + 4 * count; w < end; w += 4, out += 2)
      for (int c = 0; c < 2; c++) out[c] = w[0] * p0[c] + w[1] * p0[2 + c] + w[2] * p0[4 + c] + w[3] * p3[c];
  }
  return out;
}

// The polyline of a primitive: its rings one after the other, each with a last vertex, which is its first one again where
// it is closed. Returns the number of vertices.
int evaluate_polyline(const Frame& f, const Rings& rings, const float* points, uint8_t* samples, float* out,
                      std::vector<uint32_t>& ring_starts) {
  float* const begin = out;
  for (int r = 0; r < rings.count; r++) {
    if (rings.begin(r) == rings.end(r)) continue;
    const float* first = out;
    ring_starts.push_back(uint32_t((first - begin) / 2));
    out = evaluate_ring(f, rings, r, points, samples, out);
    std::memcpy(out, f.scene.closed ? first : points + 6 * rings.end(r), 2 * sizeof(float));
    out += 2;
  }
  return int(out - begin) / 2;
}

// Adaptive de Casteljau subdivision of one primitive: a cubic is halved until its inner control points lie within the
// tolerance of its chord, or until the primitive's share of vertices is used up.
struct Subdivider {
  const Frame& f;
  const float* points;
  float* out;                      // vertices, x and y
  std::vector<float>& parameters;  // segment + t of each vertex, added
  int count = 0;

  void emit(float x, float y, float parameter) {
    out[2 * count] = x;
    out[2 * count + 1] = y;
    parameters.push_back(parameter);
    count++;
  }

  bool flat(const float* c) const {
    float vx = c[6] - c[0], vy = c[7] - c[1], length = std::sqrt(vx * vx + vy * vy), far = 0.0f;
    for (int j = 2; j < 6; j += 2) {
      float x = c[j] - c[0], y = c[j + 1] - c[1];
      float cross = std::fabs(x * vy - y * vx), along = x * vx + y * vy;
      bool beyond = along < 0.0f || along > length * length || !(length > 0.0f);
      far = std::max(far, beyond ? std::sqrt(x * x + y * y) : cross / length);
    }
    return far <= f.settings.tolerance;
  }

  // depth: how many times the cubic may still be halved; each halving doubles the edges.
  void cubic(const float* c, float from, float to, int depth) {
    if (depth == 0 || flat(c)) {
      emit(c[0], c[1], from);
      return;
    }
    float left[8], right[8], middle = 0.5f * (from + to);
    for (int k = 0; k < 2; k++) {
      float a = c[k], b = c[2 + k], d = c[4 + k], e = c[6 + k];
      float ab = 0.5f * (a + b), bd = 0.5f * (b + d), de = 0.5f * (d + e);
      float abd = 0.5f * (ab + bd), bde = 0.5f * (bd + de), mid = 0.5f * (abd + bde);
      left[k] = a, left[2 + k] = ab, left[4 + k] = abd, left[6 + k] = mid;
      right[k] = mid, right[2 + k] = bde, right[4 + k] = de, right[6 + k] = e;
    }
    cubic(left, from, middle, depth - 1);
    cubic(right, middle, to, depth - 1);
  }

  void ring(const Rings& rings, int r, int depth) {
    const int begin = rings.begin(r), end = rings.end(r);
    for (int m = begin; m < end; m++) {
      float c[8];
      std::memcpy(c, points + 6 * m, 6 * sizeof(float));
      std::memcpy(c + 6, points + 2 * rings.end_point(r, m, f.scene.closed), 2 * sizeof(float));
      cubic(c, float(m), float(m + 1), depth);
    }
    const float* last = points + 2 * rings.end_point(r, end - 1, f.scene.closed);
    emit(last[0], last[1], float(end));
  }

  // Returns the number of vertices; like evaluate_polyline otherwise.
  int run(const Rings& rings, std::vector<uint32_t>& ring_starts) {
    int depth = 0;
    while ((2 << depth) <= f.settings.samples) depth++;
    for (int r = 0; r < rings.count; r++) {
      if (rings.begin(r) == rings.end(r)) continue;
      ring_starts.push_back(uint32_t(count));
      ring(rings, r, depth);
    }
    return count;
  }
};

struct Box {
  float x0, y0, x1, y1;
};

Box bounds(const float* v, int count) {
  Box b{v[0], v[1], v[0], v[1]};
  for (int i = 1; i < count; i++) {
    b.x0 = std::min(b.x0, v[2 * i]);
    b.x1 = std::max(b.x1, v[2 * i]);
    b.y0 = std::min(b.y0, v[2 * i + 1]);
    b.y1 = std::max(b.y1, v[2 * i + 1]);
  }
  return b;
}

// floor(x / kTile) clamped to [0, most], safe for any float including NaN. Conversion rounds down what is positive, and is
// no call of a library function.
int cell(float x, int most) {
  float c = x * (1.0f / kTile);
  if (!(c > 0.0f)) return 0;
  return c < float(most) ? int(c) : most;
}

struct Columns {
  int begin, end;
};

struct PixelRows {
  int begin, end;
};

// Works on one primitive: its polyline and the lists it adds to the chunk.
struct Flattener {
  Frame& f;
  Chunk& chunk;
  Primitive& q;
  const float* v;
  int p;
  int tile_x0 = 0, tile_x1 = 0, tile_y0 = 0, tile_y1 = 0;  // tiles within reach of the bounds

  const float* start(int e) const { return v + 2 * e; }
  const float* end(int e) const { return v + 2 * (e + 1); }

  template <typename Visit>
  void each_edge(Visit&& visit) const {
    const uint32_t* starts = chunk.ring_starts.data() + q.ring_index;
    for (; int(*starts) < q.edges; starts++)
      for (int e = int(starts[0]); e + 1 < int(starts[1]); e++) visit(e);
  }

  // First pixel row whose centre lies at y or below it. An edge owns the rows from that of its upper end to that of its
  // lower one: half-open in y, min(y) <= centre < max(y).
  int row_at(float y, int low, int high) const {
    float r = y - 0.5f;
    if (!(r > float(low))) return low;
    if (!(r < float(high))) return high;
    return int(r) + (float(int(r)) < r);
  }

  void orientation() {
    double area = 0.0;
    each_edge([&](int e) {
      const float *a = start(e), *b = end(e);
      area += double(a[0]) * b[1] - double(b[0]) * a[1];
    });
    q.orientation = area > 0.0 ? 1.0f : (area < 0.0 ? -1.0f : 0.0f);
  }

  int width() const { return tile_x1 - tile_x0; }
  size_t tile(int tx, int ty) const { return size_t(ty - tile_y0) * width() + (tx - tile_x0); }

  // Tile columns that an edge between two x comes within reach of. It is left of the columns from the end on.
  Columns columns(float ax, float bx) const {
    const float low = std::min(ax, bx) - q.reach, high = std::max(ax, bx) + q.reach;
    if (low > float(tile_x1 * kTile)) return {tile_x1, tile_x1};
    const int begin = std::max(cell(low, tile_x1), tile_x0);
    if (high < float(tile_x0 * kTile)) return {begin, begin};
    return {begin, std::min(cell(high, tile_x1 - 1) + 1, tile_x1)};
  }

  // The same for the part of an edge within reach of one tile row.
  Columns columns_in_row(const float* a, const float* b, int ty) const {
    const float top = float(ty * kTile) - q.reach, bottom = float((ty + 1) * kTile) + q.reach;
    const float slope = (b[0] - a[0]) / (b[1] - a[1]);
    return columns(a[0] + (limit(a[1], top, bottom) - a[1]) * slope, a[0] + (limit(b[1], top, bottom) - a[1]) * slope);
  }

  // The part in tile row ty of an edge that goes down (1) or up (-1) through pixel rows adds to the winding numbers of the
  // tiles from column tx on, which have it on their left: noted in the first of them.
  void pass(const PixelRows& rows, int direction, int tx, int ty) {
    if (tx >= tile_x1) return;
    const int top = ty * kTile, end = std::min(rows.end, top + kTile);
    int16_t* windings = chunk.windings.data() + tile(tx, ty) * kTile - top;
    for (int r = std::max(rows.begin, top); r < end; r++) windings[r] = int16_t(windings[r] + direction);
  }

  // Where an edge is near, and how it winds around what is right of it.
  void list_edge(int e) {
    const float *a = start(e), *b = end(e);
    const float low = std::min(a[1], b[1]), high = std::max(a[1], b[1]);
    if (high + q.reach < float(tile_y0 * kTile) || low - q.reach > float(tile_y1 * kTile)) return;
    const int y0 = std::max(cell(low - q.reach, tile_y1), tile_y0);
    const int y1 = std::min(cell(high + q.reach, tile_y1 - 1) + 1, tile_y1);
    const int first = row_at(low, tile_y0 * kTile, tile_y1 * kTile);
    const PixelRows rows{first, row_at(high, first, tile_y1 * kTile)};
    const bool tall = high - low > float(kTile);
    Columns near = columns(a[0], b[0]);
    for (int ty = y0; ty < y1; ty++) {
      if (tall) near = columns_in_row(a, b, ty);
      if (f.scene.closed) pass(rows, b[1] > a[1] ? 1 : -1, near.end, ty);
      if (near.begin < near.end) chunk.spans.push_back({e, ty, near.begin, near.end});
      for (int tx = near.begin; tx < near.end; tx++) chunk.cursor[tile(tx, ty)]++;
    }
  }

  void list_spans() {
    chunk.cursor.assign(size_t(width()) * (tile_y1 - tile_y0), 0);
    chunk.spans.clear();
    if (f.scene.closed) chunk.windings.assign(chunk.cursor.size() * kTile, 0);
    each_edge([&](int e) { list_edge(e); });
  }

  // Adds the pair of a tile, or counts it as skipped. backdrop: the winding numbers at its left side.
  void list_pair(int tx, int ty, uint32_t first_edge, uint32_t edges, const int16_t* backdrop) {
    // Without edges all rows are alike.
    if (edges == 0 && backdrop[0] == 0) {
      chunk.skipped++;
      return;
    }
    chunk.pairs.emplace_back();
    Pair& pair = chunk.pairs.back();
    pair.primitive = p;
    pair.tile = ty * f.tiles_x + tx;
    pair.kind = edges ? PairKind::boundary : PairKind::inside;
    pair.edge_begin = first_edge;
    pair.edge_count = edges;
    std::copy(backdrop, backdrop + kTile, pair.backdrop);
  }

  // Counting sort of the spans by tile.
  void list_pairs() {
    list_spans();
    uint32_t total = uint32_t(chunk.edges.size());
    for (int ty = tile_y0; ty < tile_y1; ty++) {
      int16_t backdrop[kTile] = {};
      for (int tx = tile_x0; tx < tile_x1; tx++) {
        if (f.scene.closed)
          for (int r = 0; r < kTile; r++) backdrop[r] = int16_t(backdrop[r] + chunk.windings[tile(tx, ty) * kTile + r]);
        uint32_t& slot = chunk.cursor[tile(tx, ty)];
        uint32_t count = slot;
        slot = total;
        list_pair(tx, ty, total, count, backdrop);
        total += count;
      }
    }
    chunk.edges.resize(total);
    if (chunk.lines.size() < total + kSpareLines) chunk.lines.resize(total + kSpareLines);
    for (const Span& s : chunk.spans)
      for (int tx = s.begin; tx < s.end; tx++) {
        const uint32_t place = chunk.cursor[tile(tx, s.row)]++;
        chunk.edges[place] = uint32_t(s.edge);
        std::memcpy(&chunk.lines[place], start(s.edge), sizeof(Line));
      }
  }

  void run() {
    Box b = bounds(v, q.edges);
    float w = float(f.scene.width), h = float(f.scene.height);
    bool visible = b.x1 + q.reach > 0.0f && b.y1 + q.reach > 0.0f && b.x0 - q.reach < w && b.y0 - q.reach < h;
    q.pair_begin = uint32_t(chunk.pairs.size());
    if (visible) {
      tile_x0 = cell(b.x0 - q.reach, f.tiles_x - 1);
      tile_x1 = cell(b.x1 + q.reach, f.tiles_x - 1) + 1;
      tile_y0 = cell(b.y0 - q.reach, f.tiles_y - 1);
      tile_y1 = cell(b.y1 + q.reach, f.tiles_y - 1) + 1;
      if (f.scene.closed) orientation();
      list_pairs();
    }
    q.pair_end = uint32_t(chunk.pairs.size());
  }
};

}  // namespace

void flatten(Frame& f, int index) {
  Chunk& chunk = f.chunks[index];
  chunk.clear();
  int last = std::min(f.scene.curves, (index + 1) * kChunk);
  for (int p = index * kChunk; p < last; p++) {
    Primitive& q = f.primitives[p] = Primitive{};
    const float* points = f.scene.points + size_t(p) * f.points_per_curve * 2;
    activate(f.scene, f.settings.edge_width, p, q);
    const Rings rings = f.rings(p);
    const size_t most = (size_t(rings.total()) * f.settings.samples + rings.count) * 2;
    if (chunk.vertices.size() < most) chunk.vertices.resize(most);
    float* v = chunk.vertices.data();
    q.ring_index = uint32_t(chunk.ring_starts.size());
    if (f.settings.subdivide) {
      q.edges = Subdivider{f, points, v, chunk.parameters}.run(rings, chunk.ring_starts);
    } else {
      uint8_t* samples = f.cubic_samples.data() + size_t(p) * f.scene.segments;
      q.edges = evaluate_polyline(f, rings, points, samples, v, chunk.ring_starts);
    }
    chunk.ring_starts.push_back(uint32_t(q.edges));
    q.reach = reach_of(q.half_width, q.edge_width, f.settings.exact);
    Flattener{f, chunk, q, v, p}.run();
  }
  if (f.backward) chunk.edge_gradients.resize(chunk.edges.size());
  if (f.backward && f.scene.kinds)
    chunk.paint_gradients.assign(chunk.pairs.size() * paint_stride(f.scene.most_stops), 0.0f);
}

void bin(Frame& f) {
  f.tile_starts.assign(size_t(f.tiles()) + 1, 0);
  size_t total = 0;
  for (Chunk& c : f.chunks) {
    for (const Pair& pair : c.pairs) f.tile_starts[pair.tile + 1]++;
    total += c.pairs.size();
  }
  for (int t = 0; t < f.tiles(); t++) f.tile_starts[t + 1] += f.tile_starts[t];
  f.tile_pairs.resize(total);
  // Each start moves to its tile's end, which is the next tile's start: shifted back afterwards.
  for (Chunk& c : f.chunks)
    for (Pair& pair : c.pairs) f.tile_pairs[f.tile_starts[pair.tile]++] = &pair;
  for (int t = f.tiles(); t > 0; t--) f.tile_starts[t] = f.tile_starts[t - 1];
  f.tile_starts[0] = 0;
  for (size_t i = 0; i < f.chunks.size(); i++) f.views[i] = f.chunks[i].view();
}

}  // namespace cs
