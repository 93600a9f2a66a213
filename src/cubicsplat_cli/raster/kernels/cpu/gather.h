// What a tile knows of its primitives before it looks at pixels: the edges near each block, and the winding numbers there.
#pragma once

#include "../shared/arc.h"
#include "edges.h"

namespace cs {
namespace CS_ISA {

// Of a pair, on the way back: sums over the blocks so far, pixel by pixel of a block, since only the tile's are wanted.
struct PairSums {
  Lanes colour[3], opacity, half_width;

  void clear() { colour[0] = colour[1] = colour[2] = opacity = half_width = Lanes(0.0f); }

  void add_to(PairGradient& g) const {
    const Four paint = sum_of_four(colour[0], colour[1], colour[2], opacity);
    for (int c = 0; c < 3; c++) g.colour[c] += paint.v[c];
    g.opacity += paint.v[3];
    g.half_width += sum(half_width);
  }
};

// A pair in the tile's coordinates.
struct Outline {
  const Primitive* primitive;
  Pair* pair;
  PairSums* sums;           // this and the next on the way back only
  EdgeGradient* gradients;  // of its edges
  EdgeGroup* groups;
  uint32_t group_count;
  Lanes* crossings;      // scratch for exact fills, twice as many as edges; shared by the tile's pairs
  bool arc;              // fills to be covered exactly: all the edges together are a single arc
  uint16_t full, mixed;  // blocks that the primitive covers altogether, and those near its outline
  // Fills: winding number at the left side of each block's rows, from all edges but those near the block.
  float winding[kBlock][kBlocks];

  TileEdge edge(uint32_t n) const { return groups[n / kLanes].edge(n % kLanes); }

  // Calls visit(number, edge) for the edges within reach of a block's pixel centres, in their order.
  template <class Visit>
  CS_INLINE void each_near(const Block& block, Visit&& visit) const {
    for (uint32_t g = 0; g < group_count; g++)
      for (unsigned m = having_bit(groups[g].near, block.number); m; m &= m - 1) {
        const unsigned i = lowest_bit(m);
        visit(g * kLanes + i, groups[g].edge(i));
      }
  }
};

// The tile's pairs, front to back.
struct Outlines {
  Outline* list;
  uint32_t count;
  uint16_t* visible;  // the blocks in which each of them shows; as many as make whole vectors

  // Calls visit(outline) for the pairs that show in a block, until it returns false.
  template <class Visit>
  CS_INLINE void each_visible(const Block& block, Visit&& visit) const {
    for (uint32_t first = 0; first < count; first += kLanes)
      for (unsigned m = having_bit(visible + first, block.number); m; m &= m - 1)
        if (!visit(list[first + lowest_bit(m)])) return;
  }
};

constexpr uint32_t groups_for(uint32_t count) { return (count + kLanes - 1) / kLanes; }

// Gathers the pairs of a tile.
class Gatherer {
 public:
  Gatherer(const TileTask& task, Arena& arena)
      : task_(task), arena_(arena), x0_(float(task.tile_x * kTile)), y0_(float(task.tile_y * kTile)) {}

  Outlines run() {
    const uint32_t count = task_.pairs.count, padded = groups_for(count) * kLanes;
    Outlines all{arena_.take<Outline>(count), count, arena_.take<uint16_t>(padded)};
    uint32_t most = 0;
    for (const Pair* pair : task_.pairs) most = pair->edge_count > most ? pair->edge_count : most;
    ask_for_next();
    crossings_ = arena_.take<Lanes>(2 * most);
    for (uint32_t i = 0; i < count; i++) {
      gather(*task_.pairs.first[i], all.list[i]);
      all.visible[i] = all.list[i].full | all.list[i].mixed;
    }
    for (uint32_t i = count; i < padded; i++) all.visible[i] = 0;
    return all;
  }

  static size_t scratch(const TileTask& task) {
    size_t bytes = aligned(task.pairs.count * sizeof(Outline)) + task.pairs.count * aligned(sizeof(PairSums)) +
                   aligned(groups_for(task.pairs.count) * kLanes * sizeof(uint16_t));
    uint32_t most = 0;
    for (const Pair* pair : task.pairs) {
      most = pair->edge_count > most ? pair->edge_count : most;
      bytes += aligned(groups_for(pair->edge_count) * sizeof(EdgeGroup));
    }
    return bytes + aligned(2 * most * sizeof(Lanes));
  }

 private:
  const TileTask& task_;
  Arena& arena_;
  float x0_, y0_;
  Lanes* crossings_ = nullptr;

  // The pairs of the tile after the next, and what those of the next one, which have come by now, lead to.
  void ask_for_next() const {
    for (const Pair* pair : task_.pairs_behind) ask_for(pair, sizeof(Pair));
    for (const Pair* pair : task_.next_pairs) ask_for_edges(*pair);
  }

  void ask_for_edges(const Pair& pair) const {
    if (pair.kind == PairKind::inside) return;
    const ChunkView& chunk = task_.chunks[pair.primitive / task_.chunk_size];
    ask_for(chunk.lines + pair.edge_begin, pair.edge_count * sizeof(Line));
    if (task_.backward) ask_for(chunk.edge_gradients + pair.edge_begin, pair.edge_count * sizeof(EdgeGradient));
  }

  void gather(Pair& pair, Outline& o) {
    o.primitive = &task_.primitives[pair.primitive];
    o.pair = &pair;
    if (task_.backward) {
      o.sums = arena_.take<PairSums>(1);
      o.sums->clear();
    }
    o.full = pair.kind == PairKind::inside ? 0xffffu : 0u;
    o.mixed = 0;
    o.group_count = 0;
    if (pair.kind == PairKind::inside) return;
    const ChunkView& chunk = task_.chunks[pair.primitive / task_.chunk_size];
    o.gradients = task_.backward ? chunk.edge_gradients + pair.edge_begin : nullptr;
    o.crossings = crossings_;
    o.group_count = groups_for(pair.edge_count);
    o.groups = arena_.take<EdgeGroup>(o.group_count);
    fetch(chunk.lines + pair.edge_begin, o);
    if (task_.scene->closed)
      look_from_fill(o);
    else
      look_from_stroke(o);
  }

  void fetch(const Line* lines, Outline& o) const {
    for (uint32_t g = 0; g < o.group_count; g++) {
      o.groups[g].fetch(lines + g * kLanes, o.pair->edge_count - g * kLanes, x0_, y0_);
      o.groups[g].derive(o.primitive->reach);
    }
    if (!o.gradients) return;
    for (uint32_t n = 0; n < o.pair->edge_count; n++) o.gradients[n] = EdgeGradient{};
  }

  // Calls visit(group, i) for every edge.
  template <class Visit>
  static CS_INLINE void each_edge(const Outline& o, Visit&& visit) {
    for (uint32_t n = 0; n < o.pair->edge_count; n++) visit(o.groups[n / kLanes], n % kLanes);
  }

  static void look_from_stroke(Outline& o) {
    const float reach = o.primitive->reach;
    each_edge(o, [&](EdgeGroup& g, unsigned i) { o.mixed |= g.near[i] = uint16_t(bits(Sight(g, i, reach).near)); });
  }

  void look_from_fill(Outline& o) const {
    const float reach = o.primitive->reach;
    Lanes winding[kBlock];
    start_windings(*o.pair, winding);
    each_edge(o, [&](EdgeGroup& g, unsigned i) {
      const Sight sight(g, i, reach);
      o.mixed |= g.near[i] = uint16_t(bits(sight.near));
      pass(g, i, sight, winding);
    });
    for (int j = 0; j < kBlock; j++) winding[j].store(o.winding[j]);
    // A block far from the outline is inside or outside as a whole.
    o.full = uint16_t(bits(winding[0] != Lanes(0.0f)) & ~unsigned(o.mixed));
    o.arc = task_.settings->exact && is_arc(o);
  }

  static bool is_arc(const Outline& o) {
    ArcTest test;
    for (uint32_t n = 0; n < o.pair->edge_count && !test.failed(); n++) test.add(o.edge(n));
    return test.passed();
  }

  static CS_INLINE void start_windings(const Pair& pair, Lanes* winding) {
    const int16_t* b = pair.backdrop;
    for (int j = 0; j < kBlock; j++)
      winding[j] = repeat_each(float(b[j]), float(b[4 + j]), float(b[8 + j]), float(b[12 + j]));
  }

  // Adds an edge to the winding numbers of the blocks that it passes on their left.
  static CS_INLINE void pass(const EdgeGroup& g, unsigned i, const Sight& sight, Lanes* winding) {
    const Lanes first = Sight::middles_y() - Lanes(0.5f * (kBlock - 1));
    for (int j = 0; j < kBlock; j++) {
      const Lanes y = first + Lanes(float(j));
      const Mask crosses = sight.left & (y >= Lanes(g.y0[i])) & (y < Lanes(g.y1[i]));
      winding[j] = add_where(crosses, winding[j], Lanes(g.direction[i]));
    }
  }
};

}  // namespace CS_ISA
}  // namespace cs
