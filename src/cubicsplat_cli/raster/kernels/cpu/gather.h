// What a tile knows of a primitive before it looks at pixels: the edges near each block, and the winding numbers there.
#pragma once

#include "block.h"

namespace cs {
namespace CS_ISA {

// An edge from the tile's corner, with both of its ends: an end computed as start + direction could round to the other
// side of a row than the next edge's start, and the winding number would leak along the whole row.
struct TileEdge : Edge {
  float bx, by;
};

// A pair in the tile's coordinates.
struct Outline {
  const Primitive* primitive;
  Pair* pair;
  EdgeGradient* gradients;  // of its edges
  TileEdge* edges;
  uint64_t* near;           // for each block, the set of the edges within reach of its pixel centres
  uint32_t words;           // of each of these sets
  Lanes* crossings;         // scratch for exact fills, twice as many as edges; shared by the tile's pairs
  bool arc;                 // fills to be covered exactly: all the edges together are a single arc
  uint16_t full, mixed;     // blocks that the primitive covers altogether, and those near its outline
  // Fills: winding number at the left side of each block's rows, from all edges but those near the block.
  float winding[kBlock][kBlocks];

  const uint64_t* near_block(int block) const { return near + size_t(block) * words; }
  template <class Visit>
  CS_INLINE void each_near(const Block& block, Visit&& visit) const {
    each_member(near_block(block.number), words, visit);
  }
};

// Collects the edges of a chain and says whether they form a single arc: each begins where the one before ends, and their
// directions lie within less than half a turn, so that the chain cannot cross itself. It may run over the end of the list,
// as rings do.
class ArcTest {
 public:
  CS_INLINE void add(const TileEdge& e) {
    if (last_)
      gaps_ += last_->bx != e.ax || last_->by != e.ay;
    else
      first_ = &e;
    last_ = &e;
    if (e.vx == 0.0f && e.vy == 0.0f) return;
    if (!left_) left_ = right_ = &e;
    const bool before = cross(*left_, e) < 0.0f, behind = cross(*right_, e) > 0.0f;
    if (before) left_ = &e;
    if (behind) right_ = &e;
    within_ &= !(before && behind) && (left_ == right_ || cross(*left_, *right_) > 0.0f);
  }

  CS_INLINE bool passed() const {
    return within_ && gaps_ + (last_->bx != first_->ax || last_->by != first_->ay) == 1;
  }

 private:
  const TileEdge *first_ = nullptr, *last_ = nullptr;
  const TileEdge *left_ = nullptr, *right_ = nullptr;  // the outermost directions
  int gaps_ = 0;
  bool within_ = true;

  static CS_INLINE float cross(const TileEdge& a, const TileEdge& b) { return a.vx * b.vy - a.vy * b.vx; }
};

// The tile's pairs, front to back, and for each block the set of those that show in it.
struct Outlines {
  Outline* list;
  uint32_t count, words;
  uint64_t* visible;

  const uint64_t* in_block(int block) const { return visible + size_t(block) * words; }
};

// An edge as the sixteen blocks see it, one a lane.
struct Sight {
  Lanes side;  // positive where a block's middle is right of an edge that goes down
  Mask near;

  static CS_INLINE Lanes middles_x() { return (columns() - Lanes(0.5f)) * Lanes(kBlock) + Lanes(0.5f * kBlock); }
  static CS_INLINE Lanes middles_y() { return (rows() - Lanes(0.5f)) * Lanes(kBlock) + Lanes(0.5f * kBlock); }

  // Within reach of a block's pixel centres? By the edge's box, then by its line; an edge too many does no harm.
  CS_INLINE Sight(const TileEdge& e, float reach) {
    constexpr float half = 0.5f * (kBlock - 1);
    const Lanes x = middles_x(), y = middles_y();
    const float margin = half + reach, u = std::fabs(e.vx), v = std::fabs(e.vy);
    const float x0 = (e.bx < e.ax ? e.bx : e.ax) - margin, x1 = (e.bx < e.ax ? e.ax : e.bx) + margin;
    const float y0 = (e.by < e.ay ? e.by : e.ay) - margin, y1 = (e.by < e.ay ? e.ay : e.by) + margin;
    const float spread = half * (u + v) + reach * std::sqrt(u * u + v * v);
    side = (x - Lanes(e.ax)) * Lanes(e.vy) - (y - Lanes(e.ay)) * Lanes(e.vx);
    near = (x >= Lanes(x0)) & (x <= Lanes(x1)) & (y >= Lanes(y0)) & (y <= Lanes(y1)) & (absolute(side) <= Lanes(spread));
  }

  // Of an edge that is not near a block but shares rows with it: does it pass left of the block?
  CS_INLINE Mask left(const TileEdge& e) const {
    constexpr float half = 0.5f * (kBlock - 1);
    const Lanes x = middles_x();
    const float x0 = e.bx < e.ax ? e.bx : e.ax, x1 = e.bx < e.ax ? e.ax : e.bx;
    const float down = e.by > e.ay ? 1.0f : -1.0f;
    return (Lanes(x1 + half) <= x) | ((Lanes(x0 - half) < x) & (side * Lanes(down) > Lanes(0.0f)));
  }
};

// Gathers the pairs of a tile.
class Gatherer {
 public:
  Gatherer(const TileTask& task, Arena& arena)
      : task_(task), arena_(arena), x0_(float(task.tile_x * kTile)), y0_(float(task.tile_y * kTile)) {}

  Outlines run() {
    Outlines all{arena_.take<Outline>(task_.pair_count), task_.pair_count, words_for(task_.pair_count), nullptr};
    uint32_t most = 0;
    for (uint32_t i = 0; i < all.count; i++) most = task_.pairs[i]->edge_count > most ? task_.pairs[i]->edge_count : most;
    crossings_ = arena_.take<Lanes>(2 * most);
    all.visible = arena_.take<uint64_t>(size_t(all.words) * kBlocks);
    for (uint32_t i = 0; i < all.words * kBlocks; i++) all.visible[i] = 0;
    for (uint32_t i = 0; i < all.count; i++) {
      gather(*task_.pairs[i], all.list[i]);
      for (unsigned m = unsigned(all.list[i].full | all.list[i].mixed); m; m &= m - 1)
        all.visible[lowest_bit(m) * all.words + i / 64] |= uint64_t(1) << (i % 64);
    }
    return all;
  }

  static size_t scratch(const TileTask& task) {
    size_t bytes = aligned(task.pair_count * sizeof(Outline)) +
                   aligned(size_t(words_for(task.pair_count)) * kBlocks * sizeof(uint64_t));
    uint32_t most = 0;
    for (uint32_t i = 0; i < task.pair_count; i++) {
      const uint32_t edges = task.pairs[i]->edge_count;
      most = edges > most ? edges : most;
      bytes += aligned(edges * sizeof(TileEdge)) + aligned(size_t(words_for(edges)) * kBlocks * sizeof(uint64_t));
    }
    return bytes + aligned(2 * most * sizeof(Lanes));
  }

 private:
  const TileTask& task_;
  Arena& arena_;
  float x0_, y0_;
  Lanes* crossings_ = nullptr;

  TileEdge edge(const Primitive& q, int primitive, int number) const {
    const float* v = task_.vertices + size_t(primitive) * task_.vertex_stride * 2;
    const float* a = v + 2 * number;
    const float* b = task_.scene->closed && number + 1 == q.edges ? v : a + 2;
    const float ax = a[0] - x0_, ay = a[1] - y0_, bx = b[0] - x0_, by = b[1] - y0_;
    return {make_edge(ax, ay, bx, by), bx, by};
  }

  void gather(Pair& pair, Outline& o) {
    const ChunkView& chunk = task_.chunks[pair.primitive / task_.chunk_size];
    o.primitive = &task_.primitives[pair.primitive];
    o.pair = &pair;
    o.full = pair.kind == PairKind::inside ? 0xffffu : 0u;
    o.mixed = 0;
    if (pair.kind == PairKind::inside) return;
    o.gradients = task_.backward ? chunk.edge_gradients + pair.edge_begin : nullptr;
    o.crossings = crossings_;
    o.words = words_for(pair.edge_count);
    o.edges = arena_.take<TileEdge>(pair.edge_count);
    o.near = arena_.take<uint64_t>(size_t(o.words) * kBlocks);
    for (uint32_t i = 0; i < o.words * kBlocks; i++) o.near[i] = 0;
    const uint16_t* numbers = chunk.edges + pair.edge_begin;
    Lanes winding[kBlock] = {Lanes(0.0f), Lanes(0.0f), Lanes(0.0f), Lanes(0.0f)};
    for (uint32_t i = 0; i < pair.edge_count; i++) {
      const TileEdge& e = o.edges[i] = edge(*o.primitive, pair.primitive, numbers[i]);
      const Sight sight(e, o.primitive->reach);
      const unsigned near = bits(sight.near);
      o.mixed |= uint16_t(near);
      for (unsigned m = near; m; m &= m - 1) o.near[lowest_bit(m) * o.words + i / 64] |= uint64_t(1) << (i % 64);
      if (task_.scene->closed) pass(e, sight, winding);
    }
    if (!task_.scene->closed) return;
    settle(pair, winding, o);
    ArcTest test;
    if (task_.settings->exact)
      for (uint32_t i = 0; i < pair.edge_count; i++) test.add(o.edges[i]);
    o.arc = task_.settings->exact && test.passed();
  }

  // Adds an edge to the winding numbers of the blocks that it passes on their left.
  static CS_INLINE void pass(const TileEdge& e, const Sight& sight, Lanes* winding) {
    const Mask passes = without(sight.left(e), sight.near);
    if (!any(passes)) return;
    const float low = e.by < e.ay ? e.by : e.ay, high = e.by < e.ay ? e.ay : e.by;
    const Lanes direction(e.by > e.ay ? 1.0f : -1.0f), first = Sight::middles_y() - Lanes(0.5f * (kBlock - 1));
    for (int j = 0; j < kBlock; j++) {
      const Lanes y = first + Lanes(float(j));
      const Mask crosses = passes & (y >= Lanes(low)) & (y < Lanes(high));
      winding[j] = winding[j] + select(crosses, direction, Lanes(0.0f));
    }
  }

  static CS_INLINE void settle(const Pair& pair, const Lanes* winding, Outline& o) {
    const int16_t* b = pair.backdrop;
    for (int j = 0; j < kBlock; j++) {
      const Lanes row = repeat_each(float(b[j]), float(b[4 + j]), float(b[8 + j]), float(b[12 + j]));
      (winding[j] + row).store(o.winding[j]);
    }
    const unsigned inside = bits(Lanes::load(o.winding[0]) != Lanes(0.0f));
    o.full = uint16_t(inside & ~unsigned(o.mixed));
  }
};

}  // namespace CS_ISA
}  // namespace cs
