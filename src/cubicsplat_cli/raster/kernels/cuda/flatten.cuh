// Stage flatten: parameters -> activated values, polylines and bounds; then the curves of each super-tile.
#pragma once

#include "order.cuh"
#include "warp.cuh"

namespace cs {

// The same for all lanes of the warp.
CS_INLINE int choose_samples(const Frame& f, const Rings& rings, const float* points, int lane) {
  const float tolerance = f.step->tolerance;
  if (!(tolerance > 0.0f)) return f.samples;
  float worst = 0.0f;
  for (int i = lane; i < 2 * rings.total(); i += kWarp) {
    const int m = i >> 1, first = 3 * m + (i & 1);
    const int last = i & 1 ? rings.end_point(rings.ring_of(m), m, kClosed) : first + 2;
    const float *a = points + 2 * first, *b = a + 2, *c = points + 2 * last;
    worst = fmaxf(worst, bend(a, b, c));
  }
  return samples_for(warp_most(worst), tolerance, f.samples);
}

// Box of a curve's polyline, and twice its signed area seen from its first vertex.
struct Outline {
  float left, top, right, bottom, area;
};

CS_INLINE void add_edge(float2 a, float2 b, float2 origin, float2& inverse, Outline& o) {
  const Edge edge = make_edge(a.x, a.y, b.x, b.y);
  inverse = make_float2(edge.ux, edge.uy);
  o.left = fminf(o.left, fminf(a.x, b.x));
  o.right = fmaxf(o.right, fmaxf(a.x, b.x));
  o.top = fminf(o.top, fminf(a.y, b.y));
  o.bottom = fmaxf(o.bottom, fmaxf(a.y, b.y));
  o.area += (a.x - origin.x) * edge.vy - (a.y - origin.y) * edge.vx;
}

// Start of edge `index` of the polyline.
CS_INLINE float2 vertex(const Rings& rings, const float* points, int index, int samples) {
  const int segment = index / samples, s = index - segment * samples;
  const float* p = points + 6 * segment;
  const float* end = points + 2 * rings.end_point(rings.ring_of(segment), segment, kClosed);
  float w[4];
  bernstein(float(s) / float(samples), w);
  float2 v;
  v.x = fmaf(w[3], end[0], fmaf(w[2], p[4], fmaf(w[1], p[2], w[0] * p[0])));
  v.y = fmaf(w[3], end[1], fmaf(w[2], p[5], fmaf(w[1], p[3], w[0] * p[1])));
  return v;
}

// Polyline at uniform parameters. Every vertex is computed once and read back by the two edges that meet in it, so that
// they have it bit by bit: a winding number depends on it.
CS_INLINE void sample_curve(const Frame& f, const Rings& rings, const float* points, int curve, int samples, int lane,
                            Outline& o) {
  const size_t at = size_t(curve) * f.edge_stride;
  const int edges = rings.total() * samples;
  float2* ends = reinterpret_cast<float2*>(f.edges + at);  // start and end of each edge
  for (int e = lane; e < edges; e += kWarp) ends[2 * e] = vertex(rings, points, e, samples);
  __syncwarp();
  const float2 origin = ends[0];
  const float* tip = points + 6 * rings.total();  // of a stroke
  for (int e = lane; e < edges; e += kWarp) {
    const int next = rings.end_vertex(e, samples, kClosed);
    const float2 end = kClosed || next < edges ? ends[2 * next] : make_float2(tip[0], tip[1]);
    ends[2 * e + 1] = end;
    add_edge(ends[2 * e], end, origin, f.inverses[at + e], o);
  }
}

CS_INLINE Outline combined(Outline o) {
  o.left = warp_least(o.left);
  o.right = warp_most(o.right);
  o.top = warp_least(o.top);
  o.bottom = warp_most(o.bottom);
  o.area = warp_sum(o.area);
  return o;
}

CS_INLINE void write_attributes(const Frame& f, int curve, int edges, int samples, const Outline& o, int lane) {
  float colour[3], opacity = f.opacities[curve];
  for (int c = 0; c < 3; c++) colour[c] = f.colours[3 * size_t(curve) + c];
  if (f.logits) {
    for (int c = 0; c < 3; c++) colour[c] = sigmoid(colour[c]);
    opacity = sigmoid(opacity);
  }
  const float half_width = kClosed ? 0.0f : f.half_widths[curve];
  const float edge_width = f.edge_widths ? f.edge_widths[curve] : f.step->edge_width;
  const float reach = reach_of(half_width, edge_width, f.exact);
  if (lane != 0) return;
  float* a = f.attributes + size_t(curve) * kAttributes;
  for (int c = 0; c < 3; c++) a[c] = colour[c];
  a[kOpacity] = opacity;
  a[kHalfWidth] = half_width;
  a[kReach] = reach;
  a[kOrientation] = o.area > 0.0f ? 1.0f : (o.area < 0.0f ? -1.0f : 0.0f);
  a[kEdges] = float(edges);
  a[kEdgeWidth] = edge_width;
  a[kSupport] = 1.0f / (2.0f * kHalfSupport * edge_width);
  a[kSamples] = float(samples);
  f.bounds[curve] = make_float4(o.left - reach, o.top - reach, o.right + reach, o.bottom + reach);
}

// One warp per curve.
CS_INLINE void flatten_curve(const Frame& f) {
  clear_order(f);
  const int lane = threadIdx.x % kWarp, curve = blockIdx.x * (kSmallThreads / kWarp) + threadIdx.x / kWarp;
  if (curve >= f.curves) return;
  const float* points = f.points + size_t(curve) * f.points_per_curve * 2;
  Outline outline{kFar, kFar, -kFar, -kFar, 0.0f};
  const Rings rings = f.rings_of(curve);
  const int samples = choose_samples(f, rings, points, lane), edges = rings.total() * samples;
  sample_curve(f, rings, points, curve, samples, lane, outline);
  write_attributes(f, curve, edges, samples, combined(outline), lane);
  if (!f.backward) return;
  float* gradients = f.vertex_gradients + size_t(curve) * (f.edge_stride + 1) * 2;
  for (int i = lane; i < 2 * (edges + 1); i += kWarp) gradients[i] = 0.0f;
  if (lane < kSums) f.sums[size_t(curve) * kSums + lane] = 0.0f;
#if CS_PAINTED
  if (f.out_frames && lane < kFrameValues) f.out_frames[size_t(curve) * kFrameValues + lane] = 0.0f;
  const int stops = f.out_stops ? kStopValues * f.most_stops : 0;
  for (int i = lane; i < stops; i += kWarp) f.out_stops[size_t(curve) * stops + i] = 0.0f;
#endif
}

CS_INLINE bool touches(const float4& box, float left, float top, float right, float bottom) {
  return box.x < right && box.z > left && box.y < bottom && box.w > top;
}

// One warp per 32 curves and 32 super-tiles: a word of each super-tile's set. A set of bits needs no sort, keeps the
// order of the curves, and has a fixed size, so it cannot overflow.
CS_INLINE void bin_curves(const Frame& f) {
  const int lane = threadIdx.x % kWarp, word = blockIdx.x * (kSmallThreads / kWarp) + threadIdx.x / kWarp;
  if (word >= f.words) return;
  const int curve = word * kWarp + lane, supers = f.supers_x * f.supers_y;
  const float4 box = curve < f.curves ? f.bounds[curve] : make_float4(kFar, kFar, -kFar, -kFar);
  const float side = float(kTile << f.super_shift);
  const int first = blockIdx.y * kWarp, last = least(first + kWarp, supers);
  unsigned kept = 0;
  for (int super = first; super < last; super++) {
    float left = float(super % f.supers_x) * side, top = float(super / f.supers_x) * side;
    unsigned hits = ballot(touches(box, left, top, left + side, top + side));
    if (super - first == lane) kept = hits;
  }
  if (first + lane < last) f.super_masks[size_t(first + lane) * f.words + word] = kept;
}

}  // namespace cs
