// The area of fills in closed form: what an edge adds to the integral of the winding number over a pixel.
#pragma once

#include "pixel.h"

namespace cs {

#if defined(__CUDACC__)
CS_INLINE float absolute(float a) { return fabsf(a); }
#endif

constexpr float kThin = 1e-5f;  // px; half the least width of an edge in a row: upright ones are made that slanted

// Mean of clamp(u, 0, 1) over low <= u <= high, at least 2 kThin apart: the difference of its antiderivative. Finite also
// for limits so large that they round to the same value.
template <class F>
CS_INLINE F mean_of_ramp(F low, F high) {
  const F zero(0.0f), one(1.0f);
  const F from = minimum(maximum(low, zero), one), to = minimum(maximum(high, zero), one);
  const F beyond = maximum(high, one) - maximum(low, one);
  return quotient(fused((to - from) * F(0.5f), to + from, beyond), maximum(high - low, F(kThin)));
}

// dx / dy of an edge; 0 for one so level that it bounds no area.
CS_INLINE float slope_of(float vx, float vy) { return vy > 1e-12f || vy < -1e-12f ? vx / vy : 0.0f; }

// The part of an edge in a pixel row: px from the row's top to its start and its end, 0 to 1.
template <class F>
struct Span {
  F start, end;
};

template <class F>
CS_INLINE Span<F> span_in_row(float ay, float by, F top) {
  const F zero(0.0f), one(1.0f);
  return {minimum(maximum(F(ay) - top, zero), one), minimum(maximum(F(by) - top, zero), one)};
}

// Adds the signed area, within the pixel, of what lies right of an edge that starts in (ax, ay).
template <class F>
CS_INLINE void add_area(F& area, float ax, float ay, float slope, const Span<F>& span, F top, F right) {
  const F height = span.end - span.start, y = fused(span.start + span.end, F(0.5f), top - F(ay));
  const F half = maximum(absolute(height) * F(0.5f * (slope < 0.0f ? -slope : slope)), F(kThin));
  const F beyond = fused(y, F(-slope), right - F(ax));
  area = fused(height, mean_of_ramp(beyond - half, beyond + half), area);
}

}  // namespace cs
