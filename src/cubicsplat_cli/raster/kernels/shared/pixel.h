// The mathematics of one pixel, written once for both devices.
//
// Every function is a template over F, a float or a row of floats (lanes.h on the CPU, plain float in CUDA), so that
// a machine without a GPU tests the formulas that the GPU runs. Masks come from the comparisons of F.
// Formulas: CubicSplat (ECCV 2026) with a compact smoothstep edge; the numbers stand beside their twins in settings.py.
#pragma once

#if defined(__CUDACC__)
#define CS_INLINE __device__ __forceinline__
#elif defined(__GNUC__)
#define CS_INLINE inline __attribute__((always_inline))
#else
#define CS_INLINE inline
#endif

namespace cs {

#if defined(__CUDACC__)
CS_INLINE float minimum(float a, float b) { return fminf(a, b); }
CS_INLINE float maximum(float a, float b) { return fmaxf(a, b); }
CS_INLINE float fused(float a, float b, float c) { return fmaf(a, b, c); }
CS_INLINE float square_root(float a) { return sqrtf(a); }
CS_INLINE float select(bool m, float a, float b) { return m ? a : b; }
// Within 2 ulp for divisors up to 2^126; a / b would be scaled first, for the sake of larger ones.
CS_INLINE float quotient(float a, float b) { return __fdividef(a, b); }
#else
template <class F>
CS_INLINE F quotient(F a, F b) {
  return a / b;
}
#endif

constexpr float kMaxAlpha = 0.9995f;          // alpha stays below one: the backward pass divides by 1 - alpha
constexpr float kMinTransmittance = 5.1e-4f;  // a pixel is finished below this
constexpr float kHalfSupport = 0.75f;         // half the support of the relaxed edge, in edge widths
constexpr float kTouching = 1e-6f;            // px; nearer than this the outline's normal replaces (c - x) / d
constexpr float kMinSquaredLength = 1e-12f;   // px^2; keeps the projection on a degenerate edge finite
constexpr int kExactRows = 16;                // sub-scanlines per pixel row in exact coverage of fills
constexpr int kExactSubsamples = 4;           // sub-samples per axis in exact coverage of strokes

// One edge of a polyline, ready for many pixels: start a, direction v and v / |v|^2.
struct Edge {
  float ax, ay, vx, vy, ux, uy;
};

CS_INLINE Edge make_edge(float ax, float ay, float bx, float by) {
  Edge e;
  e.ax = ax;
  e.ay = ay;
  e.vx = bx - ax;
  e.vy = by - ay;
  float q = e.vx * e.vx + e.vy * e.vy;
  float inverse = quotient(1.0f, q > kMinSquaredLength ? q : kMinSquaredLength);
  e.ux = e.vx * inverse;
  e.uy = e.vy * inverse;
  return e;
}

// The nearest edge of the polyline seen so far from one pixel: squared distance, parameter on the edge, edge number.
template <class F>
struct Nearest {
  F squared, t, edge;
};

// Looks at one more edge. (wx, wy) is the pixel centre minus the edge's start.
template <class F>
CS_INLINE void nearest_update(Nearest<F>& best, const Edge& e, F wx, F wy, float number) {
  F t = minimum(maximum(fused(wx, F(e.ux), wy * F(e.uy)), F(0.0f)), F(1.0f));
  F dx = fused(t, F(-e.vx), wx);
  F dy = fused(t, F(-e.vy), wy);
  F q = fused(dx, dx, dy * dy);
  auto closer = q < best.squared;
  best.squared = select(closer, q, best.squared);
  best.t = select(closer, t, best.t);
  best.edge = select(closer, F(number), best.edge);
}

// Relaxed step phi(u) for an edge of width w = 1 / slope, and its derivative. support = 1 / (1.5 w).
template <class F>
CS_INLINE void relaxed_step(F u, float support, F& phi, F& slope) {
  F z = minimum(maximum(fused(u, F(support), F(0.5f)), F(0.0f)), F(1.0f));
  F zz = z * z;
  phi = zz * fused(z, F(-2.0f), F(3.0f));
  slope = (z - zz) * F(6.0f * support);
}

// What a pixel keeps of one curve between the forward and the backward pass.
// coverage: 0..1. pull: d coverage / d (nearest point) is pull * (c - x). widening: d coverage / d half-width.
// softening: d coverage / d edge width, times the edge width.
template <class F>
struct Coverage {
  F coverage, pull, widening, softening;
};

// Fill: phi(s d), s = +1 inside. The sign is a constant of the backward pass.
template <class F, class M>
CS_INLINE Coverage<F> cover_fill(F squared, M inside, float support) {
  F d = square_root(squared);
  F phi, slope, u = select(inside, d, F(0.0f) - d);
  relaxed_step(u, support, phi, slope);
  F away = quotient(slope, maximum(d, F(kTouching)));
  return {phi, select(inside, away, F(0.0f) - away), F(0.0f), F(0.0f) - slope * u};
}

// Stroke of half-width r: phi(r - d) - phi(-r - d), right also for strokes thinner than a pixel.
template <class F>
CS_INLINE Coverage<F> cover_stroke(F squared, float half_width, float support) {
  F d = square_root(squared);
  F outer, outer_slope, inner, inner_slope, out = F(half_width) - d, in = F(-half_width) - d;
  relaxed_step(out, support, outer, outer_slope);
  relaxed_step(in, support, inner, inner_slope);
  F pull = quotient(inner_slope - outer_slope, maximum(d, F(kTouching)));
  return {outer - inner, select(d < F(kTouching), F(0.0f), pull), outer_slope + inner_slope,
          inner_slope * in - outer_slope * out};
}

// Box-filtered stroke at one sub-sample: a ramp as wide as the sub-sample.
template <class F>
CS_INLINE F box_stroke(F squared, float half_width) {
  const float scale = float(kExactSubsamples);
  F d = square_root(squared);
  F outer = fused(F(half_width) - d, F(scale), F(0.5f));
  F inner = fused(F(-half_width) - d, F(scale), F(0.5f));
  return minimum(maximum(outer, F(0.0f)), F(1.0f)) - minimum(maximum(inner, F(0.0f)), F(1.0f));
}

// What an error e of one channel costs: squares e^2 + robust m (2 |e| - m) with m = min(|e|, knee), whose second part is
// a square up to the knee and a straight line from there on. Mirrored in cpu.py and frame.py.
struct Penalty {
  float squares, robust, knee;
};

template <class F>
CS_INLINE F penalty_of(F e, const Penalty& p) {
  F size = maximum(e, F(0.0f) - e), bent = minimum(size, F(p.knee));
  return fused(F(p.robust) * bent, size + size - bent, F(p.squares) * e * e);
}

template <class F>
CS_INLINE F penalty_slope(F e, const Penalty& p) {
  F bent = maximum(minimum(e, F(p.knee)), F(-p.knee)), half = fused(F(p.squares), e, F(p.robust) * bent);
  return half + half;
}

// Loss of one pixel from its error e = F - target, and the gradient dL/dF. Three channels: the sum of their penalties.
// Four (premultiplied RGBA): the mean of those over black and over white, since over white the error is e_c - e_a.
template <int C, class F>
CS_INLINE F pixel_loss(const F* e, const Penalty& p) {
  F sum = F(0.0f);
  for (int c = 0; c < 3; c++) {
    sum = sum + penalty_of(e[c], p);
    if (C == 4) sum = sum + penalty_of(e[c] - e[C - 1], p);
  }
  return C == 4 ? sum * F(0.5f) : sum;
}

template <int C, class F>
CS_INLINE void pixel_loss_gradient(const F* e, const Penalty& p, F* g) {
  F alpha = F(0.0f);
  for (int c = 0; c < 3; c++) {
    g[c] = penalty_slope(e[c], p);
    if (C == 3) continue;
    F white = F(0.5f) * penalty_slope(e[c] - e[C - 1], p);
    g[c] = fused(F(0.5f), g[c], white);
    alpha = alpha - white;
  }
  if (C == 4) g[C - 1] = alpha;
}

// In place of a penalty of each channel: the error's square in a metric of the pixel's own, e' M e. M is symmetric, in
// two rows of three: what lies on its diagonal, then (0, 1), (0, 2) and (1, 2).
template <class F>
struct Metric {
  F rows[6];

  CS_INLINE void times(const F* e, F* out) const {
    out[0] = fused(rows[0], e[0], fused(rows[3], e[1], rows[4] * e[2]));
    out[1] = fused(rows[3], e[0], fused(rows[1], e[1], rows[5] * e[2]));
    out[2] = fused(rows[4], e[0], fused(rows[5], e[1], rows[2] * e[2]));
  }
};

template <int C, class F>
CS_INLINE F pixel_loss(const F* e, const Metric<F>& metric) {
  F product[3];
  metric.times(e, product);
  return fused(e[0], product[0], fused(e[1], product[1], e[2] * product[2]));
}

template <int C, class F>
CS_INLINE void pixel_loss_gradient(const F* e, const Metric<F>& metric, F* g) {
  metric.times(e, g);
  for (int c = 0; c < 3; c++) g[c] = g[c] + g[c];
}

// Colour channel c of a curve; the fourth channel of a premultiplied picture is the coverage itself.
template <class K>
CS_INLINE K channel(const K* colour, int c) {
  return c < 3 ? colour[c] : K(1.0f);
}

// One compositing step, front to back. Returns the weight T alpha that the curve has in the pixel. K, here and below: float
// where all of a row of pixels sees one colour, or F.
template <int C, class F, class K>
CS_INLINE F composite(F alpha, const K* colour, F& transmittance, F* accumulated) {
  F live = select(transmittance < F(kMinTransmittance), F(0.0f), alpha);
  F weight = transmittance * live;
  for (int c = 0; c < C; c++) accumulated[c] = fused(weight, F(channel(colour, c)), accumulated[c]);
  transmittance = transmittance - weight;
  return weight;
}

// State of a pixel in the backward pass, which runs front to back too, since the final colour is known:
// behind = <F - acc_i, g>, what the curves not yet visited and the background contribute to <F, g>.
template <class F>
struct Backward {
  F transmittance, behind;
};

// dL/dalpha = T <c, g> - <F - acc_i, g> / (1 - alpha); returns it with the weight T alpha.
template <int C, class F, class K>
CS_INLINE F composite_backward(F alpha, const K* colour, const F* g, Backward<F>& state, F& weight) {
  auto finished = state.transmittance < F(kMinTransmittance);
  F live = select(finished, F(0.0f), alpha);
  F along = F(0.0f);
  for (int c = 0; c < C; c++) along = fused(F(channel(colour, c)), g[c], along);
  weight = state.transmittance * live;
  state.behind = state.behind - weight * along;
  F d = state.transmittance * along - quotient(state.behind, F(1.0f) - live);
  state.transmittance = state.transmittance - weight;
  return select(finished, F(0.0f), d);
}

// Leave-one-out importance: the rise of the pixel's loss if the curve were deleted now. The picture without it is
// acc_{i-1} + (F - acc_i) / (1 - alpha). `before` is acc_{i-1} and becomes acc_i; e = F - target.
template <int C, class F, class K, class Costs>
CS_INLINE F leave_one_out(F alpha, F weight, const K* colour, const F* final_colour, const F* e, const Costs& p,
                          F* before) {
  F inverse = quotient(F(1.0f), F(1.0f) - select(weight > F(0.0f), alpha, F(0.0f)));
  F without[C];
  for (int c = 0; c < C; c++) {
    F after = fused(weight, F(channel(colour, c)), before[c]);
    without[c] = before[c] + (final_colour[c] - after) * inverse - final_colour[c] + e[c];
    before[c] = after;
  }
  return pixel_loss<C>(without, p) - pixel_loss<C>(e, p);
}

}  // namespace cs
