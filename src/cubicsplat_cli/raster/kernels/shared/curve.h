// The mathematics of one curve's parameters, written once for both devices: activations, Bernstein weights, Adan.
#pragma once

#ifndef __CUDACC__
#include <cmath>
#endif

#include "pixel.h"

namespace cs {

constexpr float kLogitLimit = 9.0f;      // logits are kept within +-9: beyond, the sigmoid's gradient is dead
constexpr float kMinHalfWidth = 0.1f;    // px; a thinner stroke is seen as a fainter one
constexpr float kMinEdgeWidth = 0.5f;    // px, of a learned edge
constexpr float kMaxEdgeWidth = 64.0f;

// Hyper-parameters of one update (Adan: Xie et al., 2022, arXiv:2208.06677; betas are the kept fractions).
struct AdanRates {
  float points, colours, opacities, half_widths, edge_widths;  // step sizes; 0 freezes the group
  float keep1, keep2, keep3, epsilon;
};

// Moments of one scalar parameter: gradient mean, difference mean, second moment, previous gradient.
struct AdanMoments {
  float mean, change, square, previous;
};

// Bias corrections of one curve, from the number of updates it has had, this one included.
struct AdanBias {
  float mean, change, square;
  bool first;
};

CS_INLINE float root(float x) { return sqrtf(x); }

// Returns the amount to subtract from the parameter.
CS_INLINE float adan(float g, AdanMoments& m, const AdanRates& r, const AdanBias& b, float rate) {
  float difference = b.first ? 0.0f : g - m.previous;
  m.previous = g;
  m.mean = r.keep1 * m.mean + (1.0f - r.keep1) * g;
  m.change = r.keep2 * m.change + (1.0f - r.keep2) * difference;
  float look_ahead = g + r.keep2 * difference;
  m.square = r.keep3 * m.square + (1.0f - r.keep3) * look_ahead * look_ahead;
  return rate * (m.mean / b.mean + r.keep2 * m.change / b.change) / (root(m.square) / b.square + r.epsilon);
}

CS_INLINE float limit(float x, float low, float high) { return x < low ? low : (x > high ? high : x); }

// Bernstein weights of a cubic at parameter t.
CS_INLINE void bernstein(float t, float* w) {
  float s = 1.0f - t;
  w[0] = s * s * s;
  w[1] = 3.0f * t * s * s;
  w[2] = 3.0f * t * t * s;
  w[3] = t * t * t;
}

}  // namespace cs
