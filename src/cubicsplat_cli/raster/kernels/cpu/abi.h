// The C interface of the CPU engine: plain structs of numbers and pointers, mirrored field by field in cpu.py.
#pragma once

#include <cstdint>
#include <exception>

#if defined(_WIN32)
#define CS_EXPORT extern "C" __declspec(dllexport)
#else
#define CS_EXPORT extern "C" __attribute__((visibility("default")))
#endif

namespace cs {
struct Blunting;

// Runs the body of an exported function: 1 where it throws, for lack of memory, else 0.
template <class Body>
int32_t failed(const Body& body) {
  try {
    body();
    return 0;
  } catch (const std::exception&) {
    return 1;
  }
}

// The same of a body with a result: returns that, or -1 where it throws.
template <class Body>
auto counted(const Body& body) -> decltype(body()) {
  try {
    return body();
  } catch (const std::exception&) {
    return -1;
  }
}
}  // namespace cs

extern "C" {

// What to draw: N primitives, front to back.
struct CsScene {
  int32_t curves, segments, closed, width, height;
  int32_t channels;          // 3, or 4 for premultiplied RGBA
  int32_t rings;             // R, columns of ring_ends
  const int32_t* ring_ends;  // N x R, or null where every curve is one ring of all segments: see Rings in curve.h
  const float* points;       // N x K x 2, px; K = 3 segments (closed) or 3 segments + 1, of the longest curve
  const float* colours;      // N x 3, values or logits
  const float* opacities;    // N, values or logits
  const float* half_widths;  // N, px; ignored when closed
  const float* edge_widths;  // N, px, or null: each curve's own relaxed edge instead of the settings' one
  int32_t logits;            // colours and opacities are logits
  float background[4];
  // Gradient fills, or null where all are flat: see Paints in paint.h. Their stops are values even where `logits` is set.
  const int32_t* kinds;   // N
  const int32_t* counts;  // N, 1 .. most_stops where not flat
  const float* frames;    // N x 2 x 4
  const float* offsets;   // N x most_stops
  const float* stops;     // N x most_stops x 4
  int32_t most_stops;
};

struct CsSettings {
  int32_t exact;                // 1: area coverage in the forward pass
  int32_t samples;              // edges per cubic, or their upper bound when tolerance > 0
  float tolerance;              // px; > 0: each primitive gets as many edges as this flatness needs
  int32_t subdivide;            // 1: adaptive de Casteljau subdivision to the tolerance instead of uniform parameters
  float edge_width;             // px
  int32_t importance;           // 0 none, 1 visibility, 2 leave-one-out
  float squares, robust, knee;  // of the loss: see Penalty in pixel.h
};

// What the raster stage reads and writes beside the scene. Null pointers are skipped.
struct CsImages {
  const float* target;    // H x W x C: fused step, whose loss is a penalty of each pixel's error
  const float* weights;   // H x W, at least 0, or null for 1: factors of the pixels' losses and importances
  const float* gradient;  // H x W x C: incoming dL/dF of any loss (instead of the target's)
  float* image;           // H x W x C
  double* loss;           // 1: sum over the pixels
  const float* ground;    // H x W x C: what lies behind all curves, in place of the scene's background
  const float* metric;    // 2 x H x W x 3: of three channels, what errors cost in place of the penalty, see Measure
};

// Gradients of the parameters as given (values, or logits where scene.logits is set). Null pointers are skipped.
struct CsGradients {
  float* points;
  float* colours;
  float* opacities;
  float* half_widths;
  float* edge_widths;
  float* importance;  // N
  float* background;  // C
  float* frames;      // N x 2 x 4; like the next only where the scene has gradients
  float* stops;       // N x most_stops x 4
};

// What the control points follow from: points (K x 2) = map (K x count) values (count x 2) of each curve.
struct CsTied {
  float* values;   // N x count x 2, which the optimiser moves in place of the points
  float* moments;  // N x 2 count x 4
  int32_t* ages;   // N
  const float* map;
  int32_t count;
};

// State of the optimiser: parameters changed in place.
struct CsTraining {
  float* points;
  float* colours;
  float* opacities;
  float* half_widths;
  float* edge_widths;            // null: fixed
  float* moments;                // N x (2K + kPaints) x 4: see curve.h; mean, change, square, previous gradient
  float* edge_moments;           // N x 4, for edge_widths
  int32_t* ages;                 // N: updates each curve has had
  const float* points_gradient;  // N x K x 2, or null: gradient of a further loss term, added to the picture's
  const float* rate_scale;  // N x 5, or null: each curve's factors of the five rates below; where 0, nothing is written
  float rate_points, rate_colours, rate_opacities, rate_half_widths, rate_edge_widths;
  float keep1, keep2, keep3, epsilon;
  cs::Blunting* blunting;  // spikes.h, or null: a penalty whose gradient is added to the picture's
  const CsTied* tied;      // or null
  int32_t shared_opacity;  // 1: after a step all curves have the mean of their opacities
};

// Steps in a row, and the best curves that they meet.
struct CsRun {
  int32_t count;
  const float* paces;  // count x 6: the edge width and the five rates of each step
  double seconds;      // after which no other step begins
  double* losses;      // count: before each step
  int32_t done;        // set: less than `count` where the time is up, or a value ceases to be finite
  double least;        // the best curves' loss, and the curves, where they are not null
  float *points, *colours, *opacities, *half_widths, *edge_widths;
};

// Numbers of N curves over F frames, linear between knots: see motion/tracks.py.
struct CsKnotTrack {
  int64_t numbers;                  // C, of a curve
  const int64_t *before, *after;    // F x N: the knots around each frame, numbers of frames
  const float* share;               // F x N: of the latter
  const double* steps;              // C: to whose multiples knots are rounded, or null
  const uint8_t* held;              // F x N: knots that stay as they are, or null
  int64_t bounded;                  // 1: values stay in [0, 1]
  float *values, *means, *squares;  // F x N x C: of knots, and Adam's moments of their gradients
  int32_t* ages;                    // F x N: updates of each
};

// Adam's steps of the knots of moving curves by the gradients of frames, one after the other.
struct CsFrameSteps {
  int64_t curves;               // N
  const CsKnotTrack* tracks;    // of shapes, offsets, colours and opacities
  int64_t count;                // of steps
  const int64_t* frames;        // count
  const float* const* targets;  // count, each H x W x C
  const double* rates;          // count x 2: px of shapes and offsets, and of colours and opacities
  double keep_mean, keep_square, epsilon;
};

struct CsEngine;

CS_EXPORT int32_t cs_abi_version();
CS_EXPORT const char* cs_isa_names();  // those this machine can run, best first, separated by commas
// threads >= 1; isa: a name from cs_isa_names() or null for the best. Null result: unknown isa or no memory.
CS_EXPORT CsEngine* cs_create(int32_t threads, const char* isa);
CS_EXPORT void cs_destroy(CsEngine*);
CS_EXPORT const char* cs_error(const CsEngine*);  // text of the last failure
CS_EXPORT const char* cs_isa(const CsEngine*);
// Each returns 0, or 1 with cs_error() set.
CS_EXPORT int32_t cs_render(CsEngine*, const CsScene*, const CsSettings*, const CsImages*);
CS_EXPORT int32_t cs_gradients(CsEngine*, const CsScene*, const CsSettings*, const CsImages*, const CsGradients*);
CS_EXPORT int32_t cs_run(CsEngine*, const CsScene*, const CsSettings*, const CsImages*, const CsGradients*,
                         const CsTraining*, CsRun*);
// canvas: its curves do not count.
CS_EXPORT int32_t cs_step_frames(CsEngine*, const CsScene* canvas, const CsSettings*, const CsImages*,
                                 const CsFrameSteps*);
// Seconds spent in flatten, bin, raster and update by the last call.
CS_EXPORT void cs_timings(const CsEngine*, double* seconds);
// Pairs of the last call: outside (skipped), inside, boundary, and edges in the boundary pairs.
CS_EXPORT void cs_counts(const CsEngine*, int64_t* counts);
}
