// Stage raster, one tile: coverage and compositing front to back, the loss, and the backward pass, all in cache.
//
// Compiled once per instruction set (CS_ISA names the namespace); no standard containers here, see tile.h.

#include "exact.h"
#include "lanes.h"
#include "tile.h"

#ifndef CS_ISA
#error "CS_ISA must name the instruction set this file is compiled for"
#endif

namespace cs {
namespace CS_ISA {
namespace {

constexpr int kPixels = kTile * kTile;
static_assert(kTile == kLanes, "a row of a tile is one row of lanes");

enum RowKind : uint8_t { kNone, kFull, kMixed };  // coverage of a tile's row: 0, 1, or per pixel

// What a boundary pair keeps for the backward pass.
struct Record {
  float coverage[kPixels], pull[kPixels], widening[kPixels], softening[kPixels], t[kPixels], edge[kPixels];
};

struct PairState {
  RowKind rows[kTile];
  uint16_t touching[kTile];  // lanes whose centre lies on the outline; there `widening` holds the slope
  Record* record;
};

// Planes of the tile's pixels.
struct Pixels {
  float transmittance[kPixels], behind[kPixels];
  float accumulated[4][kPixels], colour[4][kPixels], error[4][kPixels], gradient[4][kPixels];
};

struct LaneSums {
  Lanes start_x, start_y, end_x, end_y;
};

size_t align(size_t bytes) { return (bytes + 63) & ~size_t(63); }

// Hands out pieces of the tile's scratch memory.
struct Arena {
  char* at;
  template <class T>
  T* take(size_t count) {
    T* result = reinterpret_cast<T*>(at);
    at += align(count * sizeof(T));
    return result;
  }
};

template <int C>
class Tile {
 public:
  explicit Tile(const TileTask& task) : task_(task), arena_{task.scratch} {
    x0_ = float(task.tile_x * kTile);
    y0_ = float(task.tile_y * kTile);
    columns_ = task.scene->width - task.tile_x * kTile;
    if (columns_ > kTile) columns_ = kTile;
    rows_ = task.scene->height - task.tile_y * kTile;
    if (rows_ > kTile) rows_ = kTile;
    edge_capacity_ = 0;
    for (uint32_t i = 0; i < task.pair_count; i++) {
      uint32_t edges = uint32_t(task.primitives[task.pairs[i]->primitive].edges);
      if (edges > edge_capacity_) edge_capacity_ = edges;
    }
    pixels_ = arena_.take<Pixels>(1);
    states_ = arena_.take<PairState>(task.pair_count);
    edges_ = arena_.take<Edge>(edge_capacity_);
    sums_ = arena_.take<LaneSums>(edge_capacity_);
    words_ = (edge_capacity_ + 63) / 64;
    reached_ = arena_.take<uint64_t>(size_t(words_) * kTile);
    band_ = arena_.take<BandEdge>(edge_capacity_);
    for (SubRow& s : fill_.rows) {
      s.x = arena_.take<float>(edge_capacity_);
      s.direction = arena_.take<float>(edge_capacity_);
    }
  }

  void run() {
    start();
    uint32_t visited = forward();
    finish_forward();
    if (!task_.backward) return;
    start_backward();
    for (uint32_t i = 0; i < visited; i++) backward(*task_.pairs[i], states_[i]);
  }

 private:
  const TileTask& task_;
  Arena arena_;
  float x0_, y0_;
  int columns_, rows_;
  Pixels* pixels_;
  PairState* states_;
  uint32_t edge_capacity_, words_;
  Edge* edges_;         // of the current pair, relative to the tile's corner
  LaneSums* sums_;      // their gradients, lane by lane
  uint64_t* reached_;   // for each row, a bit for each edge within reach
  BandEdge* band_;      // edges of the current primitive in the tile's rows (exact fills)
  uint32_t band_count_ = 0;
  FillArea fill_;

  const Primitive& primitive(const Pair& pair) const { return task_.primitives[pair.primitive]; }
  const ChunkView& chunk(const Pair& pair) const { return task_.chunks[pair.primitive / task_.chunk_size]; }

  BandEdge local_ends(const Pair& pair, int e) const {
    const Primitive& q = primitive(pair);
    const float* v = task_.vertices + size_t(pair.primitive) * task_.vertex_stride * 2;
    const float *a = v + 2 * e, *b = v + 2 * (task_.scene->closed && e + 1 == q.edges ? 0 : e + 1);
    return {a[0] - x0_, a[1] - y0_, b[0] - x0_, b[1] - y0_};
  }

  void start() {
    for (int i = 0; i < kPixels; i++)
      pixels_->transmittance[i] = (i % kTile < columns_ && i / kTile < rows_) ? 1.0f : 0.0f;
    for (int c = 0; c < C; c++)
      for (int i = 0; i < kPixels; i++) pixels_->accumulated[c][i] = 0.0f;
  }

  // Fetches the pair's edges and notes for each row which of them are within reach.
  void gather(const Pair& pair) {
    const uint16_t* numbers = chunk(pair).edges + pair.edge_begin;
    float reach = primitive(pair).reach;
    words_ = (pair.edge_count + 63) / 64;
    for (uint32_t i = 0; i < words_ * kTile; i++) reached_[i] = 0;
    for (uint32_t i = 0; i < pair.edge_count; i++) {
      const BandEdge ends = local_ends(pair, numbers[i]);
      const Edge e = edges_[i] = make_edge(ends.ax, ends.ay, ends.bx, ends.by);
      float low = (e.vy < 0.0f ? e.ay + e.vy : e.ay) - reach - 0.5f, high = (e.vy < 0.0f ? e.ay : e.ay + e.vy) + reach - 0.5f;
      int first = low > 0.0f ? int(low) : 0, last = high < float(rows_) ? int(high) + 1 : rows_;
      for (int row = first; row < last; row++) reached_[row * words_ + i / 64] |= uint64_t(1) << (i % 64);
    }
  }

  template <class Visit>
  CS_INLINE void each_edge(int row, Visit&& visit) const {
    for (uint32_t w = 0; w < words_; w++)
      for (uint64_t m = reached_[row * words_ + w]; m; m &= m - 1) visit(w * 64 + lowest_bit(m));
  }

  static CS_INLINE uint32_t lowest_bit(uint64_t m) {
#if defined(__GNUC__)
    return uint32_t(__builtin_ctzll(m));
#else
    uint32_t n = 0;
    while (!(m >> n & 1)) n++;
    return n;
#endif
  }

  static CS_INLINE Lanes centres() { return lane_numbers() + Lanes(0.5f); }

  CS_INLINE Nearest<Lanes> nearest(int row, float reach, Lanes px, float y) const {
    Nearest<Lanes> best{Lanes(reach * reach), Lanes(0.0f), Lanes(-1.0f)};
    each_edge(row, [&](uint32_t e) {
      const Edge& edge = edges_[e];
      nearest_update(best, edge, px - Lanes(edge.ax), Lanes(y - edge.ay), float(e));
    });
    return best;
  }

  // Winding number at the centres of a row, from the crossings that flatten listed.
  CS_INLINE Mask winding(const Pair& pair, int row, Lanes px) const {
    const Primitive& q = primitive(pair);
    int y = task_.tile_y * kTile + row;
    float left = 0.0f;
    Lanes number(0.0f);
    if (y >= q.row_begin && y < q.row_end) {
      const ChunkView& lists = chunk(pair);
      const uint32_t* starts = lists.row_starts + q.row_index + (y - q.row_begin);
      for (uint32_t i = starts[0]; i < starts[1]; i++) {
        float x = lists.crossings[i].x - x0_, direction = lists.crossings[i].direction;
        if (x <= 0.5f)
          left += direction;
        else if (x < float(kTile))
          number = number + select(px >= Lanes(x), Lanes(direction), Lanes(0.0f));
      }
    }
    return (number + Lanes(left)) != Lanes(0.0f);
  }

  static CS_INLINE float support_of(const Primitive& q) { return 1.0f / (2.0f * kHalfSupport * q.edge_width); }

  static RowKind row_kind(unsigned covered) {
    return covered == kAllLanes ? kFull : (covered == 0 ? kNone : kMixed);
  }

  void fill_row(const Pair& pair, PairState& state, int row) {
    const Lanes px = centres();
    Mask inside = winding(pair, row, px);
    Nearest<Lanes> best = nearest(row, primitive(pair).reach, px, float(row) + 0.5f);
    unsigned near = bits(best.edge >= Lanes(0.0f));
    state.touching[row] = 0;
    if (!near && row_kind(bits(inside)) != kMixed) {
      state.rows[row] = row_kind(bits(inside));
      return;
    }
    const float support = support_of(primitive(pair));
    Coverage<Lanes> cover = cover_fill(best.squared, inside, support);
    Mask touching = best.squared < Lanes(kTouching * kTouching);
    if (any(touching)) {
      state.touching[row] = uint16_t(bits(touching));
      Lanes phi, slope;
      relaxed_step(Lanes(0.0f), support, phi, slope);
      cover.widening = slope;
      cover.pull = select(touching, Lanes(0.0f), cover.pull);
    }
    if (task_.settings->exact) cover.coverage = exact_fill(float(row));
    keep(state, row, cover, best);
  }

  void stroke_row(const Pair& pair, PairState& state, int row) {
    const Primitive& q = primitive(pair);
    Nearest<Lanes> best = nearest(row, q.reach, centres(), float(row) + 0.5f);
    state.touching[row] = 0;
    state.rows[row] = kNone;
    if (!any(best.edge >= Lanes(0.0f))) return;
    Coverage<Lanes> cover = cover_stroke(best.squared, q.half_width, support_of(q));
    if (task_.settings->exact) cover.coverage = exact_stroke(row, q);
    keep(state, row, cover, best);
  }

  CS_INLINE void keep(PairState& state, int row, const Coverage<Lanes>& cover, const Nearest<Lanes>& best) const {
    state.rows[row] = kMixed;
    Record& r = *state.record;
    int at = row * kTile;
    cover.coverage.store(r.coverage + at);
    cover.pull.store(r.pull + at);
    cover.widening.store(r.widening + at);
    if (task_.scene->edge_widths) cover.softening.store(r.softening + at);
    best.t.store(r.t + at);
    best.edge.store(r.edge + at);
  }

  // The primitive's edges that can cross a sub-scanline left of the tile's right side.
  void gather_band(const Pair& pair) {
    const Primitive& q = primitive(pair);
    const ChunkView& lists = chunk(pair);
    band_count_ = 0;
    if (task_.tile_y < q.band_begin || task_.tile_y >= q.band_end) return;
    const uint32_t* starts = lists.band_starts + q.band_index + (task_.tile_y - q.band_begin);
    for (uint32_t i = starts[0]; i < starts[1]; i++) {
      const BandEdge e = local_ends(pair, lists.band_edges[i]);
      if (e.ax < float(kTile) || e.bx < float(kTile)) band_[band_count_++] = e;
    }
  }

  Lanes exact_fill(float row) {
    fill_.start();
    for (uint32_t i = 0; i < band_count_; i++) fill_.add(band_[i], row);
    return fill_.area();
  }

  // Area of the stroke in each pixel of a row, from sub-samples filtered by a box of their own size.
  Lanes exact_stroke(int row, const Primitive& q) const {
    const float step = 1.0f / kExactSubsamples;
    Lanes area(0.0f);
    for (int i = 0; i < kExactSubsamples; i++)
      for (int j = 0; j < kExactSubsamples; j++) {
        Lanes px = lane_numbers() + Lanes((float(j) + 0.5f) * step);
        float y = float(row) + (float(i) + 0.5f) * step;
        Lanes squared(q.reach * q.reach);
        each_edge(row, [&](uint32_t n) {
          const Edge& e = edges_[n];
          Lanes wx = px - Lanes(e.ax), wy(y - e.ay);
          Lanes t = minimum(maximum(fused(wx, Lanes(e.ux), Lanes((y - e.ay) * e.uy)), Lanes(0.0f)), Lanes(1.0f));
          Lanes dx = fused(t, Lanes(-e.vx), wx), dy = fused(t, Lanes(-e.vy), wy);
          squared = minimum(squared, fused(dx, dx, dy * dy));
        });
        area = area + box_stroke(squared, q.half_width);
      }
    return area * Lanes(step * step);
  }

  void cover(const Pair& pair, PairState& state) {
    if (pair.kind == PairKind::inside) {
      for (int row = 0; row < kTile; row++) state.rows[row] = kFull;
      state.record = nullptr;
      return;
    }
    state.record = arena_.take<Record>(1);
    gather(pair);
    if (!task_.scene->closed) {
      for (int row = 0; row < rows_; row++) stroke_row(pair, state, row);
      return;
    }
    if (task_.settings->exact) gather_band(pair);
    for (int row = 0; row < rows_; row++) fill_row(pair, state, row);
  }

  static CS_INLINE Lanes coverage(const PairState& state, int row) {
    return state.rows[row] == kFull ? Lanes(1.0f) : Lanes::load(state.record->coverage + row * kTile);
  }

  // Returns how many pairs were visited before every pixel was finished.
  uint32_t forward() {
    for (uint32_t i = 0; i < task_.pair_count; i++) {
      const Pair& pair = *task_.pairs[i];
      const Primitive& q = primitive(pair);
      PairState& state = states_[i];
      cover(pair, state);
      bool live = false;
      for (int row = 0; row < rows_; row++) {
        int at = row * kTile;
        Lanes transmittance = Lanes::load(pixels_->transmittance + at);
        if (state.rows[row] != kNone) {
          Lanes accumulated[C];
          for (int c = 0; c < C; c++) accumulated[c] = Lanes::load(pixels_->accumulated[c] + at);
          Lanes alpha = minimum(Lanes(q.opacity) * coverage(state, row), Lanes(kMaxAlpha));
          composite<C>(alpha, q.colour, transmittance, accumulated);
          for (int c = 0; c < C; c++) accumulated[c].store(pixels_->accumulated[c] + at);
          transmittance.store(pixels_->transmittance + at);
        }
        live |= any(transmittance >= Lanes(kMinTransmittance));
      }
      if (!live) return i + 1;
    }
    return task_.pair_count;
  }

  // Final colour, the picture and the loss; T is left as it is for the background's gradient.
  void finish_forward() {
    const CsImages& images = *task_.images;
    const int width = task_.scene->width;
    for (int c = 0; c < C; c++)
      for (int i = 0; i < kPixels; i++)
        pixels_->colour[c][i] = pixels_->accumulated[c][i] + pixels_->transmittance[i] * task_.scene->background[c];
    for (int row = 0; row < rows_; row++) {
      size_t at = (size_t(task_.tile_y * kTile + row) * width + task_.tile_x * kTile) * C;
      for (int x = 0; x < kTile; x++)
        for (int c = 0; c < C; c++) {
          int i = row * kTile + x;
          bool valid = x < columns_;
          float colour = pixels_->colour[c][i];
          if (valid && images.image) images.image[at + x * C + c] = colour;
          if (images.target) pixels_->error[c][i] = valid ? colour - images.target[at + x * C + c] : 0.0f;
          if (images.gradient) pixels_->gradient[c][i] = valid ? images.gradient[at + x * C + c] : 0.0f;
        }
    }
    if (images.target) measure_loss();
  }

  void measure_loss() {
    double loss = 0.0;
    for (int at = 0; at < rows_ * kTile; at += kTile) {
      Lanes error[C], gradient[C];
      for (int c = 0; c < C; c++) error[c] = Lanes::load(pixels_->error[c] + at);
      loss += sum(pixel_loss<C>(error));
      if (task_.images->gradient) continue;
      pixel_loss_gradient<C>(error, gradient);
      for (int c = 0; c < C; c++) gradient[c].store(pixels_->gradient[c] + at);
    }
    *task_.loss = loss;
  }

  void start_backward() {
    Lanes background[C];
    for (int c = 0; c < C; c++) background[c] = Lanes(0.0f);
    for (int at = 0; at < rows_ * kTile; at += kTile) {
      Lanes behind(0.0f), transmittance = Lanes::load(pixels_->transmittance + at);
      for (int c = 0; c < C; c++) {
        Lanes gradient = Lanes::load(pixels_->gradient[c] + at);
        behind = fused(Lanes::load(pixels_->colour[c] + at), gradient, behind);
        background[c] = fused(transmittance, gradient, background[c]);
      }
      behind.store(pixels_->behind + at);
    }
    for (int c = 0; c < C; c++) task_.background[c] = sum(background[c]);
    start();
  }

  CS_INLINE Lanes importance(int at, Lanes alpha, Lanes weight, const Primitive& q) {
    if (task_.settings->importance == 1) return weight;
    Lanes colour[C], error[C], before[C];
    for (int c = 0; c < C; c++) {
      colour[c] = Lanes::load(pixels_->colour[c] + at);
      error[c] = Lanes::load(pixels_->error[c] + at);
      before[c] = Lanes::load(pixels_->accumulated[c] + at);
    }
    Lanes rise = leave_one_out<C>(alpha, weight, q.colour, colour, error, before);
    for (int c = 0; c < C; c++) before[c].store(pixels_->accumulated[c] + at);
    return rise;
  }

  void backward(Pair& pair, PairState& state) {
    const Primitive& q = primitive(pair);
    bool boundary = pair.kind == PairKind::boundary;
    if (boundary) {
      gather(pair);
      for (uint32_t e = 0; e < pair.edge_count; e++)
        sums_[e] = {Lanes(0.0f), Lanes(0.0f), Lanes(0.0f), Lanes(0.0f)};
    }
    Lanes colour[3] = {Lanes(0.0f), Lanes(0.0f), Lanes(0.0f)}, opacity(0.0f), half_width(0.0f), edge_width(0.0f),
          important(0.0f);
    for (int row = 0; row < rows_; row++) {
      if (state.rows[row] == kNone) continue;
      int at = row * kTile;
      Lanes gradient[C];
      for (int c = 0; c < C; c++) gradient[c] = Lanes::load(pixels_->gradient[c] + at);
      Backward<Lanes> pixel{Lanes::load(pixels_->transmittance + at), Lanes::load(pixels_->behind + at)};
      Lanes covered = coverage(state, row), raw = Lanes(q.opacity) * covered, weight;
      Lanes alpha = minimum(raw, Lanes(kMaxAlpha));
      Lanes d_alpha = composite_backward<C>(alpha, q.colour, gradient, pixel, weight);
      d_alpha = select(raw > Lanes(kMaxAlpha), Lanes(0.0f), d_alpha);
      if (task_.settings->importance) important = important + importance(at, alpha, weight, q);
      pixel.transmittance.store(pixels_->transmittance + at);
      pixel.behind.store(pixels_->behind + at);
      for (int c = 0; c < 3; c++) colour[c] = fused(weight, gradient[c], colour[c]);
      opacity = fused(d_alpha, covered, opacity);
      if (state.rows[row] != kMixed) continue;
      Lanes d_coverage = d_alpha * Lanes(q.opacity);
      if (!task_.scene->closed)
        half_width = fused(d_coverage, Lanes::load(state.record->widening + at), half_width);
      if (task_.scene->edge_widths)
        edge_width = fused(d_coverage, Lanes::load(state.record->softening + at), edge_width);
      spread(*state.record, row, d_coverage);
      if (state.touching[row]) spread_touching(q, state, row, d_coverage);
    }
    for (int c = 0; c < 3; c++) pair.colour[c] = sum(colour[c]);
    pair.opacity = sum(opacity);
    pair.half_width = sum(half_width);
    pair.edge_width = sum(edge_width) / q.edge_width;
    pair.importance = sum(important);
    if (boundary) store_edges(pair);
  }

  // Adds a row's pull on its nearest points to the ends of their edges.
  CS_INLINE void spread(const Record& r, int row, Lanes d_coverage) {
    int at = row * kTile;
    const Lanes px = centres();
    const Lanes pull = Lanes::load(r.pull + at) * d_coverage, t = Lanes::load(r.t + at), edge = Lanes::load(r.edge + at);
    each_edge(row, [&](uint32_t n) {
      Mask mine = edge == Lanes(float(n));
      if (!any(mine)) return;
      const Edge& e = edges_[n];
      Lanes strength = select(mine, pull, Lanes(0.0f));
      Lanes gx = strength * fused(t, Lanes(e.vx), Lanes(e.ax) - px);
      Lanes gy = strength * fused(t, Lanes(e.vy), Lanes(e.ay - (float(row) + 0.5f)));
      Lanes ex = gx * t, ey = gy * t;
      LaneSums& s = sums_[n];
      s.start_x = s.start_x + (gx - ex);
      s.start_y = s.start_y + (gy - ey);
      s.end_x = s.end_x + ex;
      s.end_y = s.end_y + ey;
    });
  }

  // The same for the rare pixels whose centre lies on the outline: the outward normal stands for (c - x) / d.
  void spread_touching(const Primitive& q, const PairState& state, int row, Lanes d_coverage) {
    float strength[kLanes];
    d_coverage.store(strength);
    for (int x = 0; x < kTile; x++) {
      if (!(state.touching[row] >> x & 1)) continue;
      int at = row * kTile + x, n = int(state.record->edge[at]);
      const Edge& e = edges_[n];
      float length = std::sqrt(e.vx * e.vx + e.vy * e.vy), t = state.record->t[at];
      if (!(length > 0.0f)) continue;
      float g = strength[x] * state.record->widening[at] * q.orientation / length;
      const float at_lane_zero[4] = {g * e.vy * (1.0f - t), -g * e.vx * (1.0f - t), g * e.vy * t, -g * e.vx * t};
      Lanes* sums[4] = {&sums_[n].start_x, &sums_[n].start_y, &sums_[n].end_x, &sums_[n].end_y};
      for (int i = 0; i < 4; i++)
        *sums[i] = *sums[i] + select(lane_numbers() == Lanes(0.0f), Lanes(at_lane_zero[i]), Lanes(0.0f));
    }
  }

  void store_edges(const Pair& pair) {
    EdgeGradient* out = chunk(pair).edge_gradients + pair.edge_begin;
    for (uint32_t e = 0; e < pair.edge_count; e++)
      out[e] = {sum(sums_[e].start_x), sum(sums_[e].start_y), sum(sums_[e].end_x), sum(sums_[e].end_y)};
  }
};

}  // namespace

// Scratch memory that a tile with so many pairs, and edges in its largest primitive, takes at most.
size_t tile_scratch(uint32_t pairs, uint32_t boundary_pairs, uint32_t edges) {
  return align(sizeof(Pixels)) + align(pairs * sizeof(PairState)) + 2 * align(edges * sizeof(Edge)) +
         align(edges * sizeof(LaneSums)) + align(size_t((edges + 63) / 64) * kTile * sizeof(uint64_t)) +
         2 * kExactRows * align(edges * sizeof(float)) + boundary_pairs * align(sizeof(Record)) + 64;
}

void raster_tile(const TileTask& task) {
  if (task.scene->channels == 3)
    Tile<3>(task).run();
  else
    Tile<4>(task).run();
}

}  // namespace CS_ISA
}  // namespace cs
