// What one tile needs to know: the interface between the stages and tile.cpp.
//
// Free of standard containers on purpose: tile.cpp is compiled once per instruction set, and a library template
// instantiated there could be linked into code that runs on a lesser machine.
#pragma once

#include <cstddef>
#include <cstdint>

#include "../shared/paint.h"
#include "abi.h"

namespace cs {

constexpr int kTile = 16;  // pixels per side

// The two ends of an edge, px.
struct Line {
  float ax, ay, bx, by;
};

constexpr int kSpareLines = 3;  // lie behind every list of lines, so that it can be read by whole vectors

// Gradient of the loss with respect to the two ends of an edge.
struct EdgeGradient {
  float start_x, start_y, end_x, end_y;
};

// Gradient of the loss with respect to a primitive's other parameters, and its importance.
struct PairGradient {
  float colour[3], opacity, half_width, edge_width, importance;
};

enum class PairKind : int32_t { inside, boundary };

// One primitive in one tile: which of its edges are within reach there, and what the tile found out about it.
struct Pair {
  int32_t primitive, tile;
  PairKind kind;
  uint32_t edge_begin, edge_count;  // into the chunk's lists of edges
  // Fills: winding number at the tile's left side, at the centre of each of its rows, from the edges left of the tile
  // that are not listed.
  int16_t backdrop[kTile];
  PairGradient gradient;
};

// The flattened form of one primitive.
struct Primitive {
  int32_t edges;        // vertices of its rings: edge e goes to vertex e + 1, a ring's last vertex begins none
  uint32_t ring_index;  // into ring_starts, of its first ring
  float colour[3], opacity, half_width;
  float edge_width;   // px, of the relaxed edge
  float orientation;  // sign of the polyline's signed area (fills)
  float reach;        // px; farther from the outline nothing depends on its place
  uint32_t pair_begin, pair_end;
};

// Where the lists of a chunk of primitives lie.
struct ChunkView {
  const Line* lines;
  EdgeGradient* edge_gradients;
  const Pair* pairs;
  float* paint_gradients;  // paint_stride() for each pair, only on the way back through a scene with gradient fills
};

inline size_t paint_stride(int most_stops) { return size_t(kStopValues) * most_stops + kFrameValues; }

inline Paints paints_of(const CsScene& s) { return {s.kinds, s.counts, s.frames, s.offsets, s.stops, s.most_stops}; }

// Some of a tile's pairs, front to back.
struct PairList {
  Pair* const* first;
  uint32_t count;

  Pair* const* begin() const { return first; }
  Pair* const* end() const { return first + count; }
};

struct TileTask {
  const CsScene* scene;
  const CsSettings* settings;
  const CsImages* images;
  int tile_x, tile_y;
  bool backward;
  PairList pairs;
  // What comes next on the same thread, to be asked of the memory in time: the pairs of the next tile and of the one
  // behind it, and the place of the first.
  PairList next_pairs, pairs_behind;
  int next_x, next_y;
  const Primitive* primitives;
  const ChunkView* chunks;
  int chunk_size;
  double* loss;
  float* background;  // 4: dL/d background
  char* scratch;      // as many bytes as the ScratchFunction says, aligned to 64
};

using TileFunction = void (*)(const TileTask&);
using ScratchFunction = size_t (*)(const TileTask&);

}  // namespace cs
