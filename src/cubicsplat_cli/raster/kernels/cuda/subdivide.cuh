// Adaptive de Casteljau subdivision: a cubic is halved until its inner control points lie near its chord.
#pragma once

#include "warp.cuh"

namespace cs {

// Box of the edges seen so far, and twice the signed area seen from the first vertex.
struct Outline {
  float left, top, right, bottom, area;
};

CS_INLINE void add_edge(const Frame& f, size_t at, float2 a, float2 b, float2 origin, Outline& o) {
  const Edge edge = make_edge(a.x, a.y, b.x, b.y);
  f.edges[at] = make_float4(a.x, a.y, b.x, b.y);
  f.inverses[at] = make_float2(edge.ux, edge.uy);
  o.left = fminf(o.left, fminf(a.x, b.x));
  o.right = fmaxf(o.right, fmaxf(a.x, b.x));
  o.top = fminf(o.top, fminf(a.y, b.y));
  o.bottom = fmaxf(o.bottom, fmaxf(a.y, b.y));
  o.area += (a.x - origin.x) * edge.vy - (a.y - origin.y) * edge.vx;
}

// A part of a cubic, and the parameters of its ends counted in segments.
struct Part {
  float x[4], y[4], from, to;
};

// Do the inner control points lie within the tolerance of the chord?
CS_INLINE bool is_flat(const Part& c, float tolerance) {
  const float vx = c.x[3] - c.x[0], vy = c.y[3] - c.y[0], length = sqrtf(vx * vx + vy * vy);
  float far = 0.0f;
#pragma unroll
  for (int j = 1; j < 3; j++) {
    const float x = c.x[j] - c.x[0], y = c.y[j] - c.y[0];
    const float cross = fabsf(x * vy - y * vx), along = x * vx + y * vy;
    const bool beyond = along < 0.0f || along > length * length || !(length > 0.0f);
    far = fmaxf(far, beyond ? sqrtf(x * x + y * y) : cross / length);
  }
  return far <= tolerance;
}

// One coordinate's control points of a half. Multiplying by a half is exact, so fused or not the bits are the same, and
// lanes that compute the same part agree.
CS_INLINE void halve(float* p, bool right) {
  const float ab = 0.5f * (p[0] + p[1]), bc = 0.5f * (p[1] + p[2]), cd = 0.5f * (p[2] + p[3]);
  const float abc = 0.5f * (ab + bc), bcd = 0.5f * (bc + cd), middle = 0.5f * (abc + bcd);
  p[0] = right ? middle : p[0];
  p[1] = right ? bcd : ab;
  p[2] = right ? cd : abc;
  p[3] = right ? p[3] : middle;
}

// A curve has segments << depth slots, one for each of the smallest parts. Walks from a whole cubic towards the slot's
// part until a part is flat. Returns whether the slot is the first of that part's, so that each part is found once.
CS_INLINE bool find_part(const Frame& f, const float* points, int slot, int depth, Part& part) {
  const int segment = slot >> depth, within = slot & ((1 << depth) - 1);
  const float *p = points + 6 * segment, *end = kClosed && segment + 1 == f.segments ? points : p + 6;
#pragma unroll
  for (int j = 0; j < 4; j++) {
    part.x[j] = j < 3 ? p[2 * j] : end[0];
    part.y[j] = j < 3 ? p[2 * j + 1] : end[1];
  }
  part.from = float(segment);
  part.to = float(segment + 1);
  int level = depth;
  for (; level > 0 && !is_flat(part, f.step->tolerance); level--) {
    const bool right = (within >> (level - 1) & 1) != 0;
    const float middle = 0.5f * (part.from + part.to);
    halve(part.x, right);
    halve(part.y, right);
    part.from = right ? middle : part.from;
    part.to = right ? part.to : middle;
  }
  return (within & ((1 << level) - 1)) == 0;
}

// Returns the number of edges.
CS_INLINE int subdivide_curve(const Frame& f, const float* points, int curve, int lane, Outline& o) {
  int depth = 0;
  while ((2 << depth) <= f.samples) depth++;
  float4* edges = f.edges + size_t(curve) * f.edge_stride;
  float* parameters = f.parameters + size_t(curve) * (f.edge_stride + 1);
  int count = 0;
  for (int first = 0; first < f.segments << depth; first += kWarp) {
    const int slot = first + lane;
    Part part;
    const bool found = slot < f.segments << depth && find_part(f, points, slot, depth, part);
    const unsigned all_found = ballot(found);
    const int at = count + __popc(all_found & ((1u << lane) - 1u));
    if (found) {
      edges[at] = make_float4(part.x[0], part.y[0], 0.0f, 0.0f);
      parameters[at] = part.from;
    }
    count += __popc(all_found);
  }
  __syncwarp();
  if (lane == 0) parameters[count] = float(f.segments);  // the end of an open curve
  const float* last = kClosed ? points : points + 2 * (f.points_per_curve - 1);
  for (int e = lane; e < count; e += kWarp) {
    // Starts are read of this edge and the next, and written as they are: lanes do not disturb each other.
    const float2 a = make_float2(edges[e].x, edges[e].y);
    const float2 b = e + 1 < count ? make_float2(edges[e + 1].x, edges[e + 1].y) : make_float2(last[0], last[1]);
    add_edge(f, size_t(curve) * f.edge_stride + e, a, b, make_float2(points[0], points[1]), o);
  }
  return count;
}

}  // namespace cs
