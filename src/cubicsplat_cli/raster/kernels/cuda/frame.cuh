// What passes between the CUDA kernels, and their sizes: mirrored field by field in frame.py.
#pragma once

#include "paint.h"
#include "spikes.h"

// What the picture is made of is fixed when the text is compiled: one small program per mode and number of channels.
#ifndef CS_CLOSED
#error "CS_CLOSED must be 1 for fills or 0 for strokes"
#endif
#ifndef CS_CHANNELS
#error "CS_CHANNELS must be 3 (RGB) or 4 (premultiplied RGBA)"
#endif
#ifndef CS_PAINTED
#error "CS_PAINTED must be 1 for curves with gradients or 0 for flat ones"
#endif

namespace cs {

constexpr bool kClosed = CS_CLOSED != 0;
constexpr int kChannels = CS_CHANNELS;

constexpr int kWarp = 32;
constexpr int kTile = 16;       // pixels per side of a tile; one block draws one tile
constexpr int kThreads = 256;   // of the raster kernel: one per pixel
constexpr int kStripWidth = 8;  // a warp draws a strip of 8 x 4 pixels: nearly square, so few outlines pass it
constexpr int kStripHeight = 4;
constexpr int kStrips = 8;                         // strips of a tile, two columns of four
constexpr int kListed = 512;                       // primitives of a tile listed at a time
constexpr int kBatch = 32;                         // pairs classified at a time: one bit each in a strip's word
constexpr int kMaskWords = 1024;                   // words of edge masks of a batch
constexpr int kMaskPlaces = kMaskWords / kStrips;  // the same for each strip
constexpr int kMostSlots = 16;  // boundary pairs per strip whose nearest edges are kept for the backward pass
constexpr int kSumStride = kStrips * 8 + 8;  // floats per pair; the padding spreads the pairs over the banks
constexpr float kFar = 3e38f;                // px; farther than anything drawn
constexpr int kSmallThreads = 128;           // of the kernels that give each curve a warp
constexpr int kCosts = 16;     // classes of tiles by their time, a factor of sqrt(2) apart, the longest last
constexpr int kCheapest = 22;  // twice the binary logarithm of the clocks below which a tile is in the first class

// The flattened form of one curve: 12 floats. kSupport: 1 / (1.5 edge widths).
enum Attribute {
  kRed,
  kGreen,
  kBlue,
  kOpacity,
  kHalfWidth,
  kReach,
  kOrientation,
  kEdges,
  kEdgeWidth,
  kSupport,
  kSamples,
  kAttributes = 12
};

// What a curve's pixels add up to: 8 floats.
enum Sum { kSumRed, kSumGreen, kSumBlue, kSumOpacity, kSumHalfWidth, kSumImportance, kSumEdgeWidth, kSums = 8 };

// What may change from step to step: lives in device memory, so that a captured graph reads the values of its replay.
struct Step {
  float edge_width, tolerance;  // px
  float background[4];
  AdanRates rates;
  Penalty penalty;               // of a pixel's error
  int importance_kind;           // 0 none, 1 visibility, 2 leave-one-out
  int number;                    // of the step, for messages
  float* image;                  // H x W x C, or null; needed for leave-one-out importance
  float* importance;             // N, or null
  float* background_gradient;    // C, or null
  const float* points_gradient;  // N x K x 2, or null: of a further loss term
  const float* rate_scale;       // N x 5, or null: each curve's factors of the step sizes
  double* loss;                  // 1, or null
  Blunting blunting;             // of spikes and slivers; without a gradient there is no such penalty
};

// What stays the same while a captured graph lives; passed to every kernel by value.
struct Frame {
  int curves, segments, points_per_curve;  // what the longest curve has
  int rings;                               // R, columns of ring_ends
  int samples;                             // edges per cubic, or their upper bound where step->tolerance > 0
  int edge_stride;                         // edges a curve has room for
  int width, height, tiles_x, tiles_y;
  int super_shift;  // a super-tile has 2^super_shift tiles per side
  int supers_x, supers_y;
  int words;  // of a super-tile's set of curves, one bit each
  int slots;  // of a warp
  int logits, backward, exact;
  int most_stops;  // of a gradient
  // parameters of the curves; changed in place where moments are given
  float *points, *colours, *opacities, *half_widths;
  float* edge_widths;    // N, or null: each curve's own relaxed edge instead of step->edge_width
  const int* ring_ends;  // N x R, or null where every curve is one ring of all segments: see Rings in curve.h
  // gradient fills, in programs for them: see Paints in paint.h
  const int *kinds, *counts;              // N
  const float *frames, *offsets, *stops;  // N x 2 x 4, N x most_stops, N x most_stops x 4
  // the flattened curves
  float4* bounds;         // N: left, top, right, bottom, reach included
  float4* edges;          // N x edge_stride: start and end
  float2* inverses;       // N x edge_stride: v / |v|^2
  float* attributes;      // N x 12
  unsigned* super_masks;  // super-tiles x words, or null where every tile looks at all curves
  // pictures
  const float *target, *gradient;  // H x W x C; see cuda.py
  const float* weights;            // H x W, or null for 1: factors of the pixels' losses and importances
  // gradients on their way
  float* vertex_gradients;  // N x (edge_stride + 1) x 2
  float* sums;              // N x 8
  float* tile_sums;         // tiles x 8: loss, gradient of the background
  int* order;               // 2 x kCosts x (1 + tiles), or null: see order.cuh
  // gradients of the parameters as given; null where not wanted
  float *out_points, *out_colours, *out_opacities, *out_half_widths, *out_edge_widths;
  float *out_frames, *out_stops;
  // optimiser; null without a training step
  float4* moments;       // N x (2K + kPaints): mean, change, square, previous gradient
  float4* edge_moments;  // N, for edge_widths
  int* ages;             // N
  int* status;           // 1 + the first curve with a value that is not finite, 0 for none; number of that step
  const Step* step;

  CS_INLINE Paint paint_of(unsigned curve) const {
    return Paints{kinds, counts, frames, offsets, stops, most_stops}.of(curve);
  }
  CS_INLINE Rings rings_of(int curve) const {
    return {ring_ends ? ring_ends + size_t(curve) * rings : nullptr, rings, segments};
  }
};

#ifdef CS_FRAME_BYTES
static_assert(sizeof(Frame) == CS_FRAME_BYTES && sizeof(Step) == CS_STEP_BYTES, "frame.py differs from frame.cuh");
#endif

CS_INLINE int least(int a, int b) { return a < b ? a : b; }
CS_INLINE int most(int a, int b) { return a > b ? a : b; }

// Places of a block's lists in its dynamic shared memory, in bytes. frame.py counts the same.
constexpr int kListAt = 0;
constexpr int kAttributesAt = kListAt + kListed * 4;
constexpr int kMasksAt = kAttributesAt + kBatch * kAttributes * 4;
constexpr int kBackdropsAt = kMasksAt + kMaskWords * 4;
constexpr int kFlagsAt = kBackdropsAt + kBatch * kStrips * 4;
constexpr int kScanAt = kFlagsAt + kBatch * 4;
constexpr int kSumsAt = kScanAt + 2 * kStrips * 4;
constexpr int kSlotsAt = kSumsAt + kBatch * kSumStride * 4;
#ifdef CS_SHARED_BYTES
static_assert(kSlotsAt == CS_SHARED_BYTES && kCosts == CS_COSTS, "frame.py differs from frame.cuh");
#endif
constexpr int kCodeBytes = kThreads * 2;   // of one slot: the nearest edge and the side of every pixel
constexpr int kExactBytes = kThreads * 4;  // of one slot more in exact mode: its coverage

}  // namespace cs
