// The mathematics of one curve's parameters, written once for both devices: activations, Bernstein weights, Adan.
#pragma once

#ifndef __CUDACC__
#include <cmath>
#endif

#include "pixel.h"

namespace cs {

constexpr float kLogitLimit = 9.0f;    // logits are kept within +-9: beyond, the sigmoid's gradient is dead
constexpr float kMinHalfWidth = 0.1f;  // px; a thinner stroke is seen as a fainter one
constexpr float kMinEdgeWidth = 0.5f;  // px, of a learned edge
constexpr float kMaxEdgeWidth = 64.0f;

// Values of a curve that the optimiser keeps beside its points' 2K coordinates: colour, opacity, half-width.
constexpr int kPaints = 5;

// Hyper-parameters of one update (Adan: Xie et al., 2022, arXiv:2208.06677; betas are the kept fractions).
struct AdanRates {
  float points, colours, opacities, half_widths, edge_widths;  // step sizes; 0: parameter and moments stay as they are
  float keep1, keep2, keep3, epsilon;
};

// The rates of one curve: scale holds a factor for each of the five step sizes, or is null.
CS_INLINE AdanRates scaled(AdanRates r, const float* scale) {
  if (!scale) return r;
  r.points *= scale[0];
  r.colours *= scale[1];
  r.opacities *= scale[2];
  r.half_widths *= scale[3];
  r.edge_widths *= scale[4];
  return r;
}

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

// The rings of one curve. Ring r has the segments begin(r) <= m < end(r), and segment m the control points 3m, 3m + 1,
// 3m + 2 and 3m + 3, but the last one of a closed ring ends in the ring's first point. A curve with fewer rings than
// others repeats its last end: a ring without segments is none. An open curve is one ring.
struct Rings {
  const int* ends;  // null: one ring of all segments
  int count, segments;

  // Never more than there is room for, whatever the table says: a GPU's is not looked at beforehand.
  CS_INLINE int end(int r) const {
    if (!ends) return segments;
    return ends[r] < 0 ? 0 : (ends[r] < segments ? ends[r] : segments);
  }
  CS_INLINE int begin(int r) const { return r > 0 ? end(r - 1) : 0; }
  // Segments of the curve.
  CS_INLINE int total() const { return end(count - 1); }
  CS_INLINE int ring_of(int m) const {
    int r = 0;
    while (r + 1 < count && m >= end(r)) r++;
    return r;
  }
  // The control point that ends segment m of ring r.
  CS_INLINE int end_point(int r, int m, bool closed) const {
    return 3 * (closed && m + 1 == end(r) ? begin(r) : m + 1);
  }
  // Of the polyline with as many edges per cubic, each edge numbered by the vertex that it starts from: where edge e ends.
  CS_INLINE int end_vertex(int e, int samples, bool closed) const {
    const int r = closed ? ring_of(e / samples) : 0;
    return closed && e + 1 == end(r) * samples ? begin(r) * samples : e + 1;
  }
};

CS_INLINE float sigmoid(float x) { return 1.0f / (1.0f + expf(-x)); }

// Squared length of the second difference of three control points, each x and y.
CS_INLINE float bend(const float* a, const float* b, const float* c) {
  const float x = a[0] - 2.0f * b[0] + c[0], y = a[1] - 2.0f * b[1] + c[1];
  return x * x + y * y;
}

// Edges per cubic, at most `most`, that keep a polyline within the tolerance (px, > 0), where `worst` is the largest
// bend of its cubics: the error is at most D2 / (8 S^2) with D2 = 6 sqrt(worst).
CS_INLINE int samples_for(float worst, float tolerance, int most) {
  const float need = ceilf(root(6.0f * root(worst) / (8.0f * tolerance)));
  const int low = most < 3 ? most : 3;
  // Written so that a NaN gives the lower bound.
  if (!(need > float(low))) return low;
  return need < float(most) ? int(need) : most;
}

// Farther from the outline or the stroke's line than this, px, nothing depends on its place. In exact mode a pixel up to
// half a diagonal away from the outline is partly covered.
CS_INLINE float reach_of(float half_width, float edge_width, bool exact) {
  const float support = kHalfSupport * edge_width;
  return half_width + (exact && support < 0.75f ? 0.75f : support);
}

// Bernstein weights of a cubic at parameter t.
CS_INLINE void bernstein(float t, float* w) {
  float s = 1.0f - t;
  w[0] = s * s * s;
  w[1] = 3.0f * t * s * s;
  w[2] = 3.0f * t * t * s;
  w[3] = t * t * t;
}

}  // namespace cs
