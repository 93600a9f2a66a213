// Everything that passes between the stages flatten, bin, raster and update within one step.
#pragma once

#include <atomic>
#include <functional>
#include <vector>

#include "../shared/spikes.h"
#include "tile.h"

namespace cs {

constexpr int kChunk = 16;  // primitives per unit of parallel work; fixed, so that results do not depend on threads
constexpr int kStrip = 8;   // tiles that a thread takes at a time: each asks the memory for what the next one needs
constexpr int kMaxSamples = 64;                   // edges per cubic
constexpr int64_t kMostVertices = (1 << 30) - 1;  // of one curve: both of their coordinates are counted in 31 bits

// The tile columns [begin, end) of a tile row that an edge is near.
struct Span {
  int edge, row, begin, end;
};

// Lists of the primitives [index * kChunk, ...): written by one task, so their order never depends on threads.
struct Chunk {
  std::vector<Pair> pairs;
  std::vector<uint32_t> edges;  // of the pairs, and for each of them:
  std::vector<Line> lines;      // and kSpareLines more
  std::vector<EdgeGradient> edge_gradients;
  std::vector<float> paint_gradients;
  std::vector<uint32_t> ring_starts;  // first vertex of each ring of a primitive, then the number of its vertices
  std::vector<float> parameters;      // segment + t of each vertex of the primitives in turn, only after subdivision
  std::vector<float> vertices;        // scratch: the polyline of one primitive, x and y; grows and never shrinks
  std::vector<uint32_t> cursor;       // scratch of the counting sorts
  std::vector<Span> spans;            // scratch: where each edge is near
  std::vector<int16_t> windings;      // scratch: for each tile of a primitive and each of its rows
  int64_t skipped;

  void clear();
  ChunkView view();
};

struct Frame {
  CsScene scene{};
  CsSettings settings{};
  CsImages images{};
  int tiles_x = 0, tiles_y = 0, points_per_curve = 0;
  bool backward = false;
  std::atomic<bool> broken{false};  // whether a step has left a parameter that is not finite
  std::vector<Primitive> primitives;
  std::vector<uint8_t> cubic_samples;  // N x segments: edges of each cubic, where they are at uniform parameters
  std::vector<float> basis;            // for each number of samples S: S x 4 Bernstein weights, at 4 * S (S - 1) / 2
  std::vector<Chunk> chunks;
  std::vector<ChunkView> views;
  std::vector<uint32_t> tile_starts;
  std::vector<Pair*> tile_pairs;
  std::vector<double> tile_loss;
  std::vector<float> tile_background;  // tiles x 4

  int tiles() const { return tiles_x * tiles_y; }
  // None for a tile past the last one.
  PairList pairs_of(int tile) const {
    if (tile >= tiles()) return {nullptr, 0};
    return {tile_pairs.data() + tile_starts[tile], tile_starts[tile + 1] - tile_starts[tile]};
  }
  int chunk_count() const { return (scene.curves + kChunk - 1) / kChunk; }
  Rings rings(int p) const {
    return {scene.ring_ends ? scene.ring_ends + size_t(p) * scene.rings : nullptr, scene.rings, scene.segments};
  }
  const float* weights(int samples) const { return basis.data() + 2 * size_t(samples) * (samples - 1); }
};

// Sizes the frame for a scene; the scene and settings must have been checked.
void prepare(Frame&, const CsScene&, const CsSettings&, const CsImages&, bool backward);
// Parameters -> activated values, polylines, row crossings and (primitive, tile) pairs of one chunk.
void flatten(Frame&, int chunk);
// Pairs -> for each tile its pairs, front to back. No sort: the order of the primitives is the order of the lists.
void bin(Frame&);
// The gradient of the penalty on spikes and slivers, of one chunk.
// Draws a scene and finds the gradients of its loss.
using Draw = std::function<void(const CsScene&, const CsImages&, const CsGradients&)>;
void step_frames(const CsScene& canvas, const CsImages&, const CsFrameSteps&, const Draw&);

void blunt(const Frame&, int chunk, const Blunting&);
// Pair gradients -> parameter gradients of one chunk, and the optimiser's step.
void update(Frame&, int chunk, const CsGradients*, const CsTraining*);

}  // namespace cs
