// Stage spikes: the gradient of the penalty on spikes and slivers, whose formulas stand in spikes.h.
#pragma once

#include "warp.cuh"

namespace cs {

#ifdef CS_SIDE_BYTES
static_assert(sizeof(Side) == CS_SIDE_BYTES, "frame.py differs from spikes.h");
#endif

// The turns of one curve. Each control point belongs to one join alone, so that no two threads write to the same.
CS_INLINE void add_turns(const Frame& f, const Rings& rings, const Blunting& penalty, const float* points, float* out,
                         float loss) {
  for (int m = threadIdx.x + (kClosed ? 0 : 1); m < rings.total(); m += kSmallThreads) {
    const int r = rings.ring_of(m), before = 3 * (m == rings.begin(r) ? rings.end(r) - 1 : m - 1) + 2;
    const float* join = points + 6 * m;
    if (!on_canvas(join[0], join[1], f.width, f.height)) continue;
    add_turn(points + 2 * before, join, join + 2, penalty.turn, out + 2 * before, out + 6 * m, out + 6 * m + 2);
  }
  __syncthreads();
  const float weight = float(penalty.turns) * loss;
  for (int k = threadIdx.x; k < f.points_per_curve; k += kSmallThreads) {
    float* g = out + 2 * k;
    const float factor = held_back(g, weight, penalty.arm);
    g[0] *= factor;
    g[1] *= factor;
  }
}

// Vertex s of the polyline of segment m.
CS_INLINE void vertex_of(const Rings& rings, const float* points, int m, float t, float* at) {
  float w[4];
  bernstein(t, w);
  const int end_point = rings.end_point(rings.ring_of(m), m, true);
  for (int axis = 0; axis < 2; axis++)
    at[axis] = w[0] * points[6 * m + axis] + w[1] * points[6 * m + 2 + axis] + w[2] * points[6 * m + 4 + axis] +
               w[3] * points[2 * end_point + axis];
}

// Finds the winding numbers of all edges, each by a warp.
CS_INLINE void find_windings(const Side* all, int count) {
  const int lane = threadIdx.x % kWarp;
  for (int i = threadIdx.x / kWarp; i < count; i += kSmallThreads / kWarp) {
    int wound = 0;
    for (int j = lane; j < count; j += kWarp) wound += wound_by(all[j], all[i]);
    const float sum = warp_sum(float(wound));
    if (lane == 0) all[i].left = int(sum);
  }
}

// Adds what close edges do to one another to the gradients of their ends. A warp takes the edges that one is close to.
CS_INLINE void push_all(const Frame& f, const Blunting& penalty, Side* all, int count) {
  const auto left = [](const Side& side) { return side.left; };
  const int lane = threadIdx.x % kWarp;
  for (int i = threadIdx.x / kWarp; i < count; i += kSmallThreads / kWarp) {
    float by[2] = {0.0f, 0.0f};
    for (int j = lane; j < count; j += kWarp) {
      Push push;
      if (!runs_against(penalty, all[i], all[j]) || !pushes(all[i], all[j], f.width, f.height, left, &push)) continue;
      for (int c = 0; c < 2; c++) {
        by[c] += push.by[c];
        atomicAdd(&all[j].of_start[c], (push.share - 1.0f) * push.by[c]);
        atomicAdd(&all[j].of_end[c], -push.share * push.by[c]);
      }
    }
    for (int c = 0; c < 2; c++) {
      const float sum = 0.5f * warp_sum(by[c]);
      if (lane != 0 || sum == 0.0f) continue;
      atomicAdd(&all[i].of_start[c], sum);
      atomicAdd(&all[i].of_end[c], sum);
    }
  }
}

// What coordinate i of the control points has of the gradients of the polyline's vertices.
CS_INLINE float of_vertices(const Rings& rings, const Side* all, int edges, int i) {
  const int point = i >> 1, axis = i & 1, m = point / 3, j = point - 3 * m, r = rings.ring_of(m);
  const int before = m == rings.begin(r) ? rings.end(r) - 1 : m - 1;
  float sum = 0.0f;
  for (int s = 0; s < edges; s++) {
    float first[4], second[4];
    bernstein(float(s) / float(edges), first);
    bernstein(float(s + 1) / float(edges), second);
    const Side& own = all[m * edges + s];
    for (int k = 0; k < 3; k++)
      if (k == j) sum += first[k] * own.of_start[axis] + second[k] * own.of_end[axis];
    if (j > 0) continue;
    // An anchor is the end of the segment before, too.
    const Side& earlier = all[before * edges + s];
    sum += first[3] * earlier.of_start[axis] + second[3] * earlier.of_end[axis];
  }
  return sum;
}

CS_INLINE void add_slivers(const Frame& f, const Rings& rings, const Blunting& penalty, const float* points, float* out,
                           float loss, Side* all) {
  const int edges = penalty.edges, count = rings.total() * edges;
  for (int i = threadIdx.x; i < count; i += kSmallThreads) {
    const int m = i / edges, s = i - m * edges;
    float a[2], b[2];
    vertex_of(rings, points, m, float(s) / float(edges), a);
    vertex_of(rings, points, m, float(s + 1) / float(edges), b);
    all[i] = side_between(a, b);
  }
  __syncthreads();
  find_windings(all, count);
  __syncthreads();
  push_all(f, penalty, all, count);
  __syncthreads();
  const float weight = float(penalty.slivers) * loss;
  for (int i = threadIdx.x; i < 6 * rings.total(); i += kSmallThreads)
    out[i] += weight * of_vertices(rings, all, edges, i);
}

// A block for each curve; memory: room for all edges of the longest one.
CS_INLINE void blunt_curve(const Frame& f, unsigned char* memory) {
  const Blunting& penalty = f.step->blunting;
  const int curve = blockIdx.x, coordinates = 2 * f.points_per_curve;
  if (!penalty.gradient || penalty.left > 0 || curve >= f.curves) return;
  const Rings rings = f.rings_of(curve);
  const float* points = f.points + size_t(curve) * coordinates;
  float* out = penalty.gradient + size_t(curve) * coordinates;
  const float loss = float(penalty.loss_at ? *penalty.loss_at : penalty.loss);
  for (int i = threadIdx.x; i < coordinates; i += kSmallThreads) out[i] = 0.0f;
  __syncthreads();
  add_turns(f, rings, penalty, points, out, loss);
  __syncthreads();
  if (kClosed) add_slivers(f, rings, penalty, points, out, loss, reinterpret_cast<Side*>(memory));
}

}  // namespace cs
