// Gradient fills: the colour of a curve that differs from pixel to pixel, and the way back to its stops and its frame.
#pragma once

#include "pixel.h"

namespace cs {

constexpr float kLeastLength = 1e-6f;  // of the way between two stops; shorter, the second takes over at once
constexpr int kStopValues = 4, kFrameValues = 8;

enum PaintKind { kFlat, kLinear, kRadial };

// How one curve is filled; see gradients.py. A flat one has nothing but its colour, which stands elsewhere.
struct Paint {
  int kind, count;       // stops
  const float* frame;    // 2 x 4: from px, as (x, y, 1), to the gradient's plane; and the lean
  const float* offsets;  // count, rising
  const float* stops;    // count x 4: sRGB, opacity

  CS_INLINE float length(int k) const { return offsets[k] - offsets[k - 1]; }
  CS_INLINE float rise(int k, int c) const { return stops[kStopValues * k + c] - stops[kStopValues * (k - 1) + c]; }
};

// The fills of a scene's curves; `kinds` is null where all are flat.
struct Paints {
  const int* kinds;
  const int* counts;
  const float *frames, *offsets, *stops;
  int room;  // stops that each has room for

  CS_INLINE Paint of(size_t curve) const {
    // Never more than there is room for, whatever the table says: a GPU's is not looked at beforehand.
    const int count = counts[curve] < room ? counts[curve] : room;
    return {kinds[curve], count, frames + kFrameValues * curve, offsets + room * curve,
            stops + size_t(kStopValues) * room * curve};
  }
};

// A pixel in the gradient's plane, its distance from the origin there, and how far it is on the way from the first stop
// to the last.
template <class F>
struct OnTheWay {
  F u, v, distance, t;
};

template <class F>
CS_INLINE OnTheWay<F> on_the_way(const Paint& p, F x, F y) {
  const F u = fused(F(p.frame[0]), x, fused(F(p.frame[1]), y, F(p.frame[2])));
  if (p.kind == kLinear) return {u, F(0.0f), u, u};
  const F v = fused(F(p.frame[4]), x, fused(F(p.frame[5]), y, F(p.frame[6])));
  const F distance = square_root(fused(u, u, v * v));
  return {u, v, distance, fused(F(p.frame[3]), u, fused(F(p.frame[7]), v, distance))};
}

// How far stop k has taken over from the one before it.
template <class F>
CS_INLINE F ramp(const Paint& p, int k, F t) {
  const float length = p.length(k);
  if (!(length > kLeastLength)) return select(t < F(p.offsets[k]), F(0.0f), F(1.0f));
  return minimum(maximum((t - F(p.offsets[k - 1])) * F(1.0f / length), F(0.0f)), F(1.0f));
}

// sRGB and opacity.
template <class F>
CS_INLINE void paint_value(const Paint& p, F t, F* value) {
  for (int c = 0; c < kStopValues; c++) value[c] = F(p.stops[c]);
  for (int k = 1; k < p.count; k++) {
    const F taken = ramp(p, k, t);
    for (int c = 0; c < kStopValues; c++) value[c] = fused(taken, F(p.rise(k, c)), value[c]);
  }
}

// dL/dt of a pixel from that of its colour and opacity, d. Calls visit(k, share) with the share that stop k has in it.
template <class F, class Visit>
CS_INLINE F paint_backward(const Paint& p, F t, const F* d, Visit&& visit) {
  F before(1.0f), d_t(0.0f);
  for (int k = 1; k < p.count; k++) {
    const F taken = ramp(p, k, t);
    visit(k - 1, before - taken);
    before = taken;
    if (!(p.length(k) > kLeastLength)) continue;
    F along(0.0f);
    for (int c = 0; c < kStopValues; c++) along = fused(d[c], F(p.rise(k, c)), along);
    const F inside = select(taken > F(0.0f), select(taken < F(1.0f), along, F(0.0f)), F(0.0f));
    d_t = fused(inside, F(1.0f / p.length(k)), d_t);
  }
  visit(p.count - 1, before);
  return d_t;
}

// dL/d of a frame's values from dL/dt at a pixel; those of the second row are 0 in a linear gradient.
template <class F>
CS_INLINE void frame_backward(const Paint& p, const OnTheWay<F>& at, F x, F y, F d_t, F* d) {
  F d_u = d_t, d_v(0.0f), d_lean(0.0f);
  if (p.kind == kRadial) {
    const F inverse = select(at.distance > F(0.0f), quotient(F(1.0f), at.distance), F(0.0f));
    d_u = fused(d_t, F(p.frame[3]), d_t * at.u * inverse);
    d_v = fused(d_t, F(p.frame[7]), d_t * at.v * inverse);
    d_lean = d_t;
  }
  const F of[kFrameValues] = {d_u * x, d_u * y, d_u, d_lean * at.u, d_v * x, d_v * y, d_v, d_lean * at.v};
  for (int i = 0; i < kFrameValues; i++) d[i] = of[i];
}

}  // namespace cs
