// A penalty on spikes, joins at which an outline turns back, and on slivers, places where two sides of an outline run
// closely against each other, with the shape between them. Written once for both devices.
//
// Spikes: the sum over all joins on the canvas of relu(t - turn), t the angle in radians from the handle before the join
// to the one after it. Slivers, of closed curves: each cubic is a polyline; the sum over all pairs of opposite edges of
// l relu(thinnest - |d|), d the distance in px of the middle of the one, of length l, from the other, if its foot lies
// on that and the shape lies between them and not beyond either. Lengths count as constants.
#pragma once

#include "curve.h"

namespace cs {

struct Blunting {
  double turns, slivers;     // weights, times the loss
  double loss;               // of the step before
  const double* loss_at;     // or where that lies on a GPU; null on the CPU
  float turn, arm;           // radians, beyond which a join is a spike; px, of the shortest handles
  float thinnest, opposite;  // px, below which it is a sliver; cosine between two edges that are two sides
  int edges;                 // of a cubic's polyline
  int every, left;           // steps for which a gradient is good, and for how many more the present one is
  float* gradient;           // N x K x 2
};

constexpr float kShortestSide = 1e-6f;  // px, as a divisor
constexpr int kUnknown = -1000;         // winding number that nobody has asked for yet

// An edge of the polylines, and the gradients of its ends.
struct Side {
  float ax, ay, by, ux, uy, length, mx, my;  // start, the end's y, direction, length, middle
  float of_start[2], of_end[2];
  mutable int left;  // the winding number to the left of the middle
};

CS_INLINE Side side_between(const float* a, const float* b) {
  const float x = b[0] - a[0], y = b[1] - a[1], length = fmaxf(root(x * x + y * y), kShortestSide);
  return {a[0],   a[1],   b[1],    x / length, y / length, length, 0.5f * (a[0] + b[0]), 0.5f * (a[1] + b[1]),
          {0, 0}, {0, 0}, kUnknown};
}

CS_INLINE bool on_canvas(float x, float y, int width, int height) {
  return x >= 0 && y >= 0 && x <= float(width) && y <= float(height);
}

// The distance in px of the point x, y from an edge's line, positive to the left of it.
CS_INLINE float beside(const Side& edge, float x, float y) { return edge.ux * (y - edge.ay) - edge.uy * (x - edge.ax); }

// What an edge adds to the winding number to the left of the middle of an edge, as one that a ray from there towards +x
// may cross. The ray begins just left of the edge itself.
CS_INLINE int wound_by(const Side& other, const Side& edge) {
  if (&other == &edge) return edge.uy > 0 ? 1 : 0;
  if ((other.ay <= edge.my) == (other.by <= edge.my)) return 0;
  const float side = beside(other, edge.mx, edge.my);
  return other.uy > 0 && side > 0 ? 1 : (other.uy < 0 && side < 0 ? -1 : 0);
}

// True if the line of the other edge runs against the one and is close to its middle.
CS_INLINE bool runs_against(const Blunting& penalty, const Side& one, const Side& other) {
  return fabsf(beside(other, one.mx, one.my)) < penalty.thinnest &&
         one.ux * other.ux + one.uy * other.uy < penalty.opposite;
}

// The place of the foot of the middle of the one edge on the other, 0 to 1; outside that, it lies beyond its ends.
CS_INLINE float foot(const Side& one, const Side& other) {
  return ((one.mx - other.ax) * other.ux + (one.my - other.ay) * other.uy) / other.length;
}

// What the middle of one edge and another edge, close to it, do to each other: the derivative by the middle, and by the
// other edge's foot the opposite, at a share of its length.
struct Push {
  float share, by[2];
};

// True if two edges `runs_against` each other on the canvas as the sides of a sliver. left: the winding number to the
// left of an edge.
template <class Left>
CS_INLINE bool pushes(const Side& one, const Side& other, int width, int height, const Left& left, Push* out) {
  const float distance = beside(other, one.mx, one.my), share = foot(one, other);
  if (distance == 0.0f || !on_canvas(one.mx, one.my, width, height)) return false;
  if (!(share >= 0.0f && share <= 1.0f)) return false;
  // Inside between them and outside beyond both: elsewhere it is a gap, or lies within the shape.
  const int within = distance > 0.0f ? 1 : 0;
  if (left(one) != within || left(other) != within) return false;
  const float force = distance > 0.0f ? -one.length : one.length;
  *out = {share, {-other.uy * force, other.ux * force}};
  return true;
}

// Adds the derivatives of the turn at a join, if it is too far, to those of the three points around it.
CS_INLINE void add_turn(const float* before, const float* join, const float* after, float turn, float* to_before,
                        float* to_join, float* to_after) {
  const float ux = join[0] - before[0], uy = join[1] - before[1], vx = after[0] - join[0], vy = after[1] - join[1];
  const float turned = ux * vy - uy * vx, along = ux * vx + uy * vy, across = fabsf(turned) + 1e-6f;
  if (!(atan2f(across, along) > turn)) return;
  const float squared = across * across + along * along;
  const float by_cross = (turned > 0 ? along : (turned < 0 ? -along : 0.0f)) / squared, by_along = -across / squared;
  const float of_u[2] = {by_cross * vy + by_along * vx, by_along * vy - by_cross * vx};
  const float of_v[2] = {by_along * ux - by_cross * uy, by_cross * ux + by_along * uy};
  for (int c = 0; c < 2; c++) to_before[c] -= of_u[c], to_join[c] += of_u[c] - of_v[c], to_after[c] += of_v[c];
}

// The factor of the derivatives g (2) of a point's turns: the angle at a handle of no length may change at any rate, so
// a point gets at most weight / arm.
CS_INLINE float held_back(const float* g, float weight, float arm) {
  return weight * fminf(1.0f / (arm * fmaxf(root(g[0] * g[0] + g[1] * g[1]), 1e-9f)), 1.0f);
}

}  // namespace cs
