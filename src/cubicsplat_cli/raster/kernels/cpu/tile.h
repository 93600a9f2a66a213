// What one tile needs to know: the interface between the stages and tile.cpp.
//
// Free of standard containers on purpose: tile.cpp is compiled once per instruction set, and a library template
// instantiated there could be linked into code that runs on a lesser machine.
#pragma once

#include <cstddef>
#include <cstdint>

#include "abi.h"

namespace cs {

constexpr int kTile = 16;  // pixels per side; a row of a tile is one row of lanes

// Winding: an edge crosses the line through the centres of a pixel row at x, upwards or downwards (direction +-1).
struct Crossing {
  float x, direction;
};

// Gradient of the loss with respect to the two ends of an edge.
struct EdgeGradient {
  float start_x, start_y, end_x, end_y;
};

enum class PairKind : int32_t { inside, boundary };

// One primitive in one tile: which of its edges are within reach there, and what the tile found out about it.
struct Pair {
  int32_t primitive, tile;
  PairKind kind;
  uint32_t edge_begin, edge_count;  // into the chunk's edges and edge_gradients
  float colour[3], opacity, half_width, edge_width, importance;
};

// The flattened form of one primitive.
struct Primitive {
  int32_t edges, samples;
  float colour[3], opacity, half_width;
  float edge_width;             // px, of the relaxed edge
  float orientation;            // sign of the polyline's signed area (fills)
  float reach;                  // px; farther from the outline nothing depends on its place
  int32_t row_begin, row_end;   // pixel rows whose crossings are listed
  uint32_t row_index;           // into row_starts, of row_begin
  int32_t band_begin, band_end;  // tile rows whose edges are listed (exact fills)
  uint32_t band_index;          // into band_starts, of band_begin
  uint32_t pair_begin, pair_end;
};

// Where the lists of a chunk of primitives lie.
struct ChunkView {
  const uint16_t* edges;
  EdgeGradient* edge_gradients;
  const Crossing* crossings;
  const uint32_t* row_starts;
  const uint16_t* band_edges;
  const uint32_t* band_starts;
};

struct TileTask {
  const CsScene* scene;
  const CsSettings* settings;
  const CsImages* images;
  int tile_x, tile_y;
  bool backward;
  Pair* const* pairs;  // front to back
  uint32_t pair_count;
  const Primitive* primitives;
  const float* vertices;  // N x vertex_stride x 2
  int vertex_stride;
  const ChunkView* chunks;
  int chunk_size;
  double* loss;
  float* background;  // 4: dL/d background
  char* scratch;      // scratch_bytes(...) bytes, aligned to 64
};

using TileFunction = void (*)(const TileTask&);
using ScratchFunction = size_t (*)(uint32_t pairs, uint32_t boundary_pairs, uint32_t edges_of_a_pair);

}  // namespace cs
