// Stage update: vertex gradients -> control-point gradients -> parameters; and the picture's loss.
#pragma once

#include "warp.cuh"

namespace cs {

CS_INLINE float bernstein_weight(int j, float t) {
  float w[4];
  bernstein(t, w);
  return j == 0 ? w[0] : (j == 1 ? w[1] : (j == 2 ? w[2] : w[3]));
}

// Gradient of coordinate i of a curve's control points: the transpose of the polyline's matrix of Bernstein weights.
CS_INLINE float point_gradient(const Rings& rings, const float* vertices, int i, int samples) {
  const int point = i >> 1, axis = i & 1, segment = point / 3, j = point - 3 * segment;
  const float step = 1.0f / float(samples);
  float g = 0.0f;
  if (segment < rings.total())
    for (int s = 0; s < samples; s++)
      g = fmaf(bernstein_weight(j, float(s) * step), vertices[2 * (segment * samples + s) + axis], g);
  if (j != 0) return g;
  // An anchor is the end of the segment before, too.
  const int r = rings.ring_of(segment);
  const int before = kClosed && segment == rings.begin(r) ? rings.end(r) - 1 : segment - 1;
  if (before >= 0)
    for (int s = 1; s < samples; s++)
      g = fmaf(bernstein_weight(3, float(s) * step), vertices[2 * (before * samples + s) + axis], g);
  if (!kClosed && segment == rings.total()) g += vertices[2 * (segment * samples) + axis];
  return g;
}

// A parameter of a curve: where it lies, the derivative of its activation, and how the optimiser treats it.
struct Parameter {
  float *value, *gradient_out;
  float slope, rate, low, high;
};

CS_INLINE Parameter point_parameter(const Frame& f, int curve, int i, const AdanRates& r) {
  const size_t at = size_t(curve) * f.points_per_curve * 2 + i;
  return {f.points + at, f.out_points ? f.out_points + at : nullptr, 1.0f, r.points, -kFar, kFar};
}

// i: 0-2 colour, 3 opacity, 4 half-width, 5 edge width.
CS_INLINE Parameter paint_parameter(const Frame& f, int curve, int i, const AdanRates& r) {
  if (i == kPaints)
    return {f.edge_widths + curve,
            f.out_edge_widths ? f.out_edge_widths + curve : nullptr,
            1.0f / f.attributes[size_t(curve) * kAttributes + kEdgeWidth],
            r.edge_widths,
            kMinEdgeWidth,
            kMaxEdgeWidth};
  const float active = f.attributes[size_t(curve) * kAttributes + i];
  const float slope = f.logits ? active * (1.0f - active) : 1.0f;
  const size_t colour = 3 * size_t(curve) + i;
  if (i < kSumOpacity)
    return {f.colours + colour, f.out_colours ? f.out_colours + colour : nullptr, slope, r.colours, -kLogitLimit,
            kLogitLimit};
  if (i == kSumOpacity)
    return {f.opacities + curve, f.out_opacities ? f.out_opacities + curve : nullptr, slope, r.opacities, -kLogitLimit,
            kLogitLimit};
  return {f.half_widths + curve,
          f.out_half_widths ? f.out_half_widths + curve : nullptr,
          1.0f,
          r.half_widths,
          kMinHalfWidth,
          kFar};
}

// Bias corrections of a curve: its lanes share the powers out.
CS_INLINE AdanBias bias_of(const AdanRates& r, int age, int lane) {
  const float keep = lane == 0 ? r.keep1 : (lane == 1 ? r.keep2 : r.keep3);
  const float left = 1.0f - powf(keep, float(age));
  return {__shfl_sync(kFullWarp, left, 0), __shfl_sync(kFullWarp, left, 1), sqrtf(__shfl_sync(kFullWarp, left, 2)),
          age == 1};
}

CS_INLINE void train(const Frame& f, int curve, const Parameter& p, float gradient, float4& kept, const AdanRates& r,
                     const AdanBias& bias) {
  AdanMoments moments{kept.x, kept.y, kept.z, kept.w};
  const float next = *p.value - adan(gradient, moments, r, bias, p.rate);
  kept = make_float4(moments.mean, moments.change, moments.square, moments.previous);
  *p.value = limit(next, p.low, p.high);
  // Comparisons with NaN are false, and an infinity is no smaller than itself.
  if (!(fabsf(next) < kFar) && atomicCAS(f.status, 0, curve + 1) == 0) f.status[1] = f.step->number;
}

CS_INLINE float coordinate_gradient(const Frame& f, int curve, int i, const float* attributes) {
  const float* vertices = f.vertex_gradients + size_t(curve) * (f.edge_stride + 1) * 2;
  const size_t at = size_t(curve) * f.points_per_curve * 2 + i;
  const float *further = f.step->points_gradient, *of_spikes = f.step->blunting.gradient;
  const float g = point_gradient(f.rings_of(curve), vertices, i, int(attributes[kSamples]));
  return g + (further ? further[at] : 0.0f) + (of_spikes ? of_spikes[at] : 0.0f);
}

// One warp per curve, one parameter per lane.
CS_INLINE void update_curve(const Frame& f, int curve, int lane) {
  const float* attributes = f.attributes + size_t(curve) * kAttributes;
  const float* sums = f.sums + size_t(curve) * kSums;
  const int coordinates = 2 * f.points_per_curve, paints = f.edge_widths ? kPaints + 1 : kPaints;
  const int used = 2 * (3 * f.rings_of(curve).total() + (kClosed ? 0 : 1));  // coordinates that are no padding
  const float* scale = f.step->rate_scale;
  const AdanRates rates = scaled(f.step->rates, scale ? scale + 5 * size_t(curve) : nullptr);
  const int age = f.moments ? f.ages[curve] + 1 : 0;
  const AdanBias bias = bias_of(rates, age, lane);
  for (int i = lane; i < coordinates + paints; i += kWarp) {
    const int paint = i - coordinates;
    if ((kClosed && paint == kSumHalfWidth) || (paint < 0 && i >= used)) continue;
    const Parameter p = paint < 0 ? point_parameter(f, curve, i, rates) : paint_parameter(f, curve, paint, rates);
    const float gradient = p.slope * (paint < 0 ? coordinate_gradient(f, curve, i, attributes)
                                                : sums[paint == kPaints ? kSumEdgeWidth : paint]);
    if (p.gradient_out) *p.gradient_out = gradient;
    if (!f.moments || p.rate == 0.0f) continue;
    float4& kept = paint == kPaints ? f.edge_moments[curve] : f.moments[size_t(curve) * (coordinates + kPaints) + i];
    train(f, curve, p, gradient, kept, rates, bias);
  }
  if (f.step->importance && lane == 0) f.step->importance[curve] = sums[kSumImportance];
  __syncwarp();
  if (f.moments && lane == 0) f.ages[curve] = age;
}

// Loss and background gradient of the whole picture: the tiles' sums, added in a fixed order by one block.
CS_INLINE void total_tiles(const Frame& f) {
  __shared__ double partial[kSmallThreads / kWarp][8];
  const int thread = threadIdx.x, kind = thread % 8, tiles = f.tiles_x * f.tiles_y;
  double sum = 0.0;
  for (int tile = thread / 8; tile < tiles; tile += kSmallThreads / 8) sum += f.tile_sums[size_t(tile) * 8 + kind];
  for (int step = 8; step < kWarp; step <<= 1) sum += __shfl_xor_sync(kFullWarp, sum, step);
  if (thread % kWarp < 8) partial[thread / kWarp][kind] = sum;
  __syncthreads();
  if (thread > kChannels) return;
  sum = 0.0;
  for (int warp = 0; warp < kSmallThreads / kWarp; warp++) sum += partial[warp][thread];
  if (thread == 0 && f.step->loss) *f.step->loss = sum;
  if (thread > 0 && f.step->background_gradient) f.step->background_gradient[thread - 1] = float(sum);
}

// The first block adds up the tiles, the others take a curve a warp.
CS_INLINE void update_or_total(const Frame& f) {
  if (blockIdx.x == 0) {
    total_tiles(f);
    return;
  }
  const int curve = (blockIdx.x - 1) * (kSmallThreads / kWarp) + threadIdx.x / kWarp;
  if (curve < f.curves) update_curve(f, curve, threadIdx.x % kWarp);
}

}  // namespace cs
