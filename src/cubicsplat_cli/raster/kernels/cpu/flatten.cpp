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
  skipped = 0;
}

ChunkView Chunk::view() {
  return {edges.data(), edge_gradients.data()};
}

void prepare(Frame& f, const CsScene& scene, const CsSettings& settings, const CsImages& images, bool backward) {
  f.scene = scene;
  f.settings = settings;
  f.images = images;
  f.backward = backward;
  f.tiles_x = (scene.width + kTile - 1) / kTile;
  f.tiles_y = (scene.height + kTile - 1) / kTile;
  f.points_per_curve = 3 * scene.segments + (scene.closed ? 0 : 1);
  if (!scene.ring_ends) f.scene.rings = 1;
  f.vertex_stride = scene.segments * settings.samples + f.scene.rings;
  f.primitives.resize(scene.curves);
  f.vertices.resize(size_t(scene.curves) * f.vertex_stride * 2);
  f.chunks.resize(f.chunk_count());
  f.views.resize(f.chunk_count());
  if (settings.subdivide) f.parameters.resize(size_t(scene.curves) * f.vertex_stride);
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

int choose_samples(const Frame& f, const Rings& rings, const float* points) {
  const CsSettings& s = f.settings;
  if (!(s.tolerance > 0.0f)) return s.samples;
  float worst = 0.0f;
  for (int r = 0; r < rings.count; r++)
    for (int m = rings.begin(r); m < rings.end(r); m++)
      for (int j = 0; j < 2; j++) {
        const float *a = points + 2 * (3 * m + j), *b = a + 2;
        const float* c = j == 0 ? b + 2 : points + 2 * rings.end_point(r, m, f.scene.closed);
        worst = std::max(worst, bend(a, b, c));
      }
  return samples_for(worst, s.tolerance, s.samples);
}

// Vertices of one ring but the last, at uniform parameters; returns where the last one goes.
float* evaluate_ring(const Frame& f, const Rings& rings, int r, const float* points, int samples, float* out) {
  const float* weights = f.weights(samples);
  for (int m = rings.begin(r); m < rings.end(r); m++) {
    const float *p0 = points + 6 * m, *p3 = points + 2 * rings.end_point(r, m, f.scene.closed);
    for (int s = 0; s < samples; s++, out += 2) {
      const float* w = weights + 4 * s;
      for (int c = 0; c < 2; c++) out[c] = w[0] * p0[c] + w[1] * p0[2 + c] + w[2] * p0[4 + c] + w[3] * p3[c];
    }
  }
  return out;
}

// The polyline of a primitive: its rings one after the other, each with a last vertex, which is its first one again where
// it is closed. Returns the number of vertices.
int evaluate_polyline(const Frame& f, const Rings& rings, const float* points, int samples, float* out,
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
  float* out;         // vertices, x and y
  float* parameters;  // segment + t of each vertex
  int count = 0;

  void emit(float x, float y, float parameter) {
    out[2 * count] = x;
    out[2 * count + 1] = y;
    parameters[count++] = parameter;
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

  // First pixel row whose centre lies at y or below it.
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

  // An edge of tile row ty adds to the winding numbers of the tiles from column tx on, which have it on their left: noted
  // in the first of them. Half-open in y: an edge owns the rows min(y) <= centre < max(y).
  void pass(int e, int tx, int ty) {
    if (!f.scene.closed || tx >= tile_x1) return;
    const float ya = start(e)[1], yb = end(e)[1];
    const int top = ty * kTile, bottom = top + kTile;
    const int r0 = row_at(std::min(ya, yb), top, bottom), r1 = row_at(std::max(ya, yb), r0, bottom);
    int16_t* rows = chunk.windings.data() + tile(tx, ty) * kTile - top;
    for (int r = r0; r < r1; r++) rows[r] += yb > ya ? 1 : -1;
  }

  // Tile columns [x0, x1) of one tile row that an edge comes within reach of; a long edge is clipped to the row first.
  // It is left of the columns from x1 on.
  void columns(int e, int ty, int& x0, int& x1) const {
    const float *a = start(e), *b = end(e);
    float top = float(ty * kTile) - q.reach, bottom = float((ty + 1) * kTile) + q.reach;
    float ax = a[0], bx = b[0], ay = a[1], by = b[1];
    x0 = x1 = tile_x1;
    if (std::max(ay, by) < top || std::min(ay, by) > bottom) return;
    if (std::fabs(by - ay) > float(kTile)) {
      float slope = (bx - ax) / (by - ay);
      float xa = ax + (limit(ay, top, bottom) - ay) * slope, xb = ax + (limit(by, top, bottom) - ay) * slope;
      ax = xa;
      bx = xb;
    }
    float low = std::min(ax, bx) - q.reach, high = std::max(ax, bx) + q.reach;
    if (low > float(tile_x1 * kTile)) return;
    x0 = std::max(cell(low, tile_x1), tile_x0);
    x1 = high < float(tile_x0 * kTile) ? x0 : std::min(cell(high, tile_x1 - 1) + 1, tile_x1);
  }

  // Where each edge is near, and how it winds around what is right of it.
  void list_spans() {
    chunk.cursor.assign(size_t(tile_x1 - tile_x0) * (tile_y1 - tile_y0), 0);
    chunk.spans.clear();
    if (f.scene.closed) chunk.windings.assign(chunk.cursor.size() * kTile, 0);
    each_edge([&](int e) {
      float low = std::min(start(e)[1], end(e)[1]) - q.reach, high = std::max(start(e)[1], end(e)[1]) + q.reach;
      int y0 = std::max(cell(low, tile_y1), tile_y0), y1 = std::min(cell(high, tile_y1 - 1) + 1, tile_y1);
      for (int ty = y0; ty < y1; ty++) {
        int x0, x1;
        columns(e, ty, x0, x1);
        pass(e, x1, ty);
        if (x0 < x1) chunk.spans.insert(chunk.spans.end(), {e, ty, x0, x1});
        for (int tx = x0; tx < x1; tx++) chunk.cursor[tile(tx, ty)]++;
      }
    });
  }

  // Adds the pair of a tile, or counts it as skipped. backdrop: the winding numbers at its left side.
  void list_pair(int tx, int ty, uint32_t first_edge, uint32_t edges, const int16_t* backdrop) {
    // Without edges all rows are alike.
    if (edges == 0 && backdrop[0] == 0) {
      chunk.skipped++;
      return;
    }
    Pair pair{};
    pair.primitive = p;
    pair.tile = ty * f.tiles_x + tx;
    pair.kind = edges ? PairKind::boundary : PairKind::inside;
    pair.edge_begin = first_edge;
    pair.edge_count = edges;
    std::copy(backdrop, backdrop + kTile, pair.backdrop);
    chunk.pairs.push_back(pair);
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
    const auto& spans = chunk.spans;
    for (size_t i = 0; i < spans.size(); i += 4)
      for (int tx = spans[i + 2]; tx < spans[i + 3]; tx++)
        chunk.edges[chunk.cursor[tile(tx, spans[i + 1])]++] = uint16_t(spans[i]);
  }

  void run() {
    Box b = bounds(v, q.edges);
    float w = float(f.scene.width), h = float(f.scene.height);
    bool visible = b.x1 + q.reach > 0.0f && b.y1 + q.reach > 0.0f && b.x0 - q.reach < w &&
                   b.y0 - q.reach < h;
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
    float* v = f.vertices.data() + size_t(p) * f.vertex_stride * 2;
    const Rings rings = f.rings(p);
    q.ring_index = uint32_t(chunk.ring_starts.size());
    if (f.settings.subdivide) {
      float* parameters = f.parameters.data() + size_t(p) * f.vertex_stride;
      q.edges = Subdivider{f, points, v, parameters}.run(rings, chunk.ring_starts);
    } else {
      q.samples = choose_samples(f, rings, points);
      q.edges = evaluate_polyline(f, rings, points, q.samples, v, chunk.ring_starts);
    }
    chunk.ring_starts.push_back(uint32_t(q.edges));
    q.reach = reach_of(q.half_width, q.edge_width, f.settings.exact);
    Flattener{f, chunk, q, v, p}.run();
  }
  if (f.backward) chunk.edge_gradients.assign(chunk.edges.size(), EdgeGradient{});
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
