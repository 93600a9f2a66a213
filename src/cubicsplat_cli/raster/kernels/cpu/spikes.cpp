// The gradient of a penalty on spikes, joins at which an outline turns back, and on slivers, places where two sides of
// an outline run closely against each other, with the shape between them. The formulas are those of photo/geometric.py,
// which does the same with arrays for a GPU.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "frame.h"

namespace cs {
namespace {

constexpr int kUnknown = -1000;

struct Edge {
  float ax, ay, by, ux, uy, length, mx, my;  // start, the end's y, direction, length, middle
  float fx = 0, fy = 0, gx = 0, gy = 0;      // gradients of its start and end
  int left = kUnknown;                       // the winding number to the left of its middle
};

struct Canvas {
  float width, height;
  bool has(float x, float y) const { return x >= 0 && y >= 0 && x <= width && y <= height; }
};

struct Box {
  float left, top, right, bottom;
  bool near(float x, float y, float distance) const {
    return left - distance <= x && x <= right + distance && top - distance <= y && y <= bottom + distance;
  }
};

struct Basis {
  std::vector<float> of;  // (edges + 1) x 4
  explicit Basis(int edges) : of(4 * (edges + 1)) {
    for (int s = 0; s <= edges; ++s) {
      const float t = float(s) / float(edges), r = 1.0f - t;
      const float values[4] = {r * r * r, 3 * r * r * t, 3 * r * t * t, t * t * t};
      std::copy(values, values + 4, &of[4 * s]);
    }
  }
};

// What tells most pairs apart, of all edges, each in an array of its own for vector instructions.
struct Lines {
  std::vector<float> ax, ay, ux, uy;
  std::vector<uint8_t> close;
  explicit Lines(size_t count) : ax(count), ay(count), ux(count), uy(count), close(count) {}
  void set(const Edge* all, int count) {
    for (int i = 0; i < count; ++i) ax[i] = all[i].ax, ay[i] = all[i].ay, ux[i] = all[i].ux, uy[i] = all[i].uy;
  }
};

constexpr float kLeastLength = 1e-6f;

// The edges of the segment with the control points p[c[0]] .. p[c[3]], and the box around them.
Box flatten(const Basis& basis, int edges, const float* points, const int* corners, Edge* out) {
  float x[2] = {0, 0};
  Box box{};
  for (int s = 0; s <= edges; ++s) {
    float y[2] = {0, 0};
    for (int k = 0; k < 4; ++k)
      for (int axis = 0; axis < 2; ++axis) y[axis] += basis.of[4 * s + k] * points[2 * corners[k] + axis];
    if (s == 0) {
      box = {y[0], y[1], y[0], y[1]};
    } else {
      const float dx = y[0] - x[0], dy = y[1] - x[1];
      const float length = std::max(std::sqrt(dx * dx + dy * dy), kLeastLength);
      out[s - 1] = {x[0], x[1], y[1], dx / length, dy / length, length, 0.5f * (x[0] + y[0]), 0.5f * (x[1] + y[1])};
      box = {std::min(box.left, y[0]), std::min(box.top, y[1]), std::max(box.right, y[0]), std::max(box.bottom, y[1])};
    }
    std::copy(y, y + 2, x);
  }
  return box;
}

// The distance in px of the point x, y from the edge's line, to its left positive.
float beside(const Edge& edge, float x, float y) { return edge.ux * (y - edge.ay) - edge.uy * (x - edge.ax); }

// By the edges that a ray from the middle towards +x crosses; the ray begins just left of the edge itself.
int winding_left(const Edge* all, int count, Edge& edge) {
  if (edge.left != kUnknown) return edge.left;
  int winding = edge.uy > 0 ? 1 : 0;
  for (const Edge* other = all; other != all + count; ++other) {
    if (other == &edge || (other->ay <= edge.my) == (other->by <= edge.my)) continue;
    const float side = beside(*other, edge.mx, edge.my);
    if (other->uy > 0 && side > 0) ++winding;
    if (other->uy < 0 && side < 0) --winding;
  }
  return edge.left = winding;
}

struct Sliver {
  float thinnest, opposite;
  Canvas canvas;
};

// Whether the line of any edge from begin to end runs against the one edge and is close to its middle; which: close.
bool any_close(const Sliver& penalty, Lines& lines, const Edge& one, int begin, int end) {
  const float *ax = lines.ax.data(), *ay = lines.ay.data(), *ux = lines.ux.data(), *uy = lines.uy.data();
  uint8_t* close = lines.close.data();
  unsigned any = 0;
  for (int j = begin; j < end; ++j) {
    const float distance = std::fabs(ux[j] * (one.my - ay[j]) - uy[j] * (one.mx - ax[j]));
    const bool is = (distance < penalty.thinnest) & (one.ux * ux[j] + one.uy * uy[j] < penalty.opposite);
    close[j] = is;
    any |= is;
  }
  return any != 0;
}

// What the middle of the one edge and the other edge, close to it, do to each other.
void push(const Sliver& penalty, const Edge* all, int count, Edge& one, Edge& other) {
  const float across = one.mx - other.ax, down = one.my - other.ay;
  const float distance = beside(other, one.mx, one.my);
  if (distance == 0.0f || !penalty.canvas.has(one.mx, one.my)) return;
  const float share = (across * other.ux + down * other.uy) / other.length;
  if (share < 0.0f || share > 1.0f) return;
  // Inside between them and outside beyond both: elsewhere it is a gap, or lies within the shape.
  const int within = distance > 0 ? 1 : 0;
  if (winding_left(all, count, one) != within || winding_left(all, count, other) != within) return;
  const float force = distance > 0 ? -one.length : one.length;
  const float x = -other.uy * force, y = other.ux * force;
  one.fx += 0.5f * x, one.fy += 0.5f * y, one.gx += 0.5f * x, one.gy += 0.5f * y;
  other.fx -= (1.0f - share) * x, other.fy -= (1.0f - share) * y, other.gx -= share * x, other.gy -= share * y;
}

// Adds the derivatives of the turn at a join of p[0], p[1] and p[2], if it is too far; to: those of the three points.
void turn_back(const float* before, const float* join, const float* after, float turn, float* to_before, float* to_join,
               float* to_after) {
  const float ux = join[0] - before[0], uy = join[1] - before[1], vx = after[0] - join[0], vy = after[1] - join[1];
  const float turned = ux * vy - uy * vx, along = ux * vx + uy * vy, across = std::fabs(turned) + 1e-6f;
  if (!(std::atan2(across, along) > turn)) return;
  const float squared = across * across + along * along;
  const float by_cross = (turned > 0 ? along : (turned < 0 ? -along : 0.0f)) / squared, by_along = -across / squared;
  const float of_u[2] = {by_cross * vy + by_along * vx, by_along * vy - by_cross * vx};
  const float of_v[2] = {by_along * ux - by_cross * uy, by_cross * ux + by_along * uy};
  for (int c = 0; c < 2; c++) to_before[c] -= of_u[c], to_join[c] += of_u[c] - of_v[c], to_after[c] += of_v[c];
}

// The gradient of the turns of one curve, at most weight / arm a point.
void add_turns(const Rings& rings, bool closed, const CsBlunting& penalty, const Canvas& canvas, const float* points,
               float* out) {
  const float weight = float(penalty.turns * penalty.loss);
  for (int r = 0; r < rings.count; r++)
    for (int m = rings.begin(r) + (closed ? 0 : 1); m < rings.end(r); m++) {
      const int before = 3 * (m == rings.begin(r) ? rings.end(r) - 1 : m - 1) + 2;
      const float* join = points + 6 * m;
      if (!canvas.has(join[0], join[1])) continue;
      turn_back(points + 2 * before, join, join + 2, penalty.turn, out + 2 * before, out + 6 * m, out + 6 * m + 2);
    }
  for (float* g = out; g < out + 6 * rings.total(); g += 2) {
    const float long_ = std::max(std::sqrt(g[0] * g[0] + g[1] * g[1]), 1e-9f);
    for (int c = 0; c < 2; c++) g[c] *= weight * std::min(1.0f / (penalty.arm * long_), 1.0f);
  }
}

// Finds those of slivers, of one curve after the other.
class Slivers {
 public:
  Slivers(const CsBlunting& of, const Canvas& canvas, int segments)
      : edges_(of.edges), basis_(of.edges), penalty_{of.thinnest, of.opposite, canvas},
        weight_(float(of.slivers * of.loss)), all_(size_t(segments) * of.edges), lines_(all_.size()), boxes_(segments),
        corners_(4 * size_t(segments)) {}

  void add(const Rings& rings, const float* points, float* out) {
    int count = 0;
    for (int r = 0; r < rings.count; ++r) {
      for (; count < rings.end(r); ++count) {
        int* c = &corners_[4 * size_t(count)];
        for (int k = 0; k < 3; ++k) c[k] = 3 * count + k;
        c[3] = rings.end_point(r, count, true);
        boxes_[count] = flatten(basis_, edges_, points, c, &all_[size_t(count) * edges_]);
      }
    }
    lines_.set(all_.data(), count * edges_);
    bool any = false;
    for (int q = 0; q < count; ++q)
      for (int i = 0; i < count * edges_; ++i) {
        const int first = q * edges_, last = first + edges_;
        if (!boxes_[q].near(all_[i].mx, all_[i].my, penalty_.thinnest)) continue;
        if (!any_close(penalty_, lines_, all_[i], first, last)) continue;
        any = true;
        for (int j = first; j < last; ++j)
          if (lines_.close[j]) push(penalty_, all_.data(), count * edges_, all_[i], all_[j]);
      }
    if (!any) return;
    for (int p = 0; p < count; ++p)
      for (int s = 0; s < edges_; ++s) {
        const Edge& edge = all_[size_t(p) * edges_ + s];
        for (int k = 0; k < 4; ++k) {
          float* at = out + 2 * corners_[4 * size_t(p) + k];
          const float first = weight_ * basis_.of[4 * s + k], second = weight_ * basis_.of[4 * (s + 1) + k];
          at[0] += first * edge.fx + second * edge.gx;
          at[1] += first * edge.fy + second * edge.gy;
        }
      }
  }

 private:
  int edges_;
  Basis basis_;
  Sliver penalty_;
  float weight_;
  std::vector<Edge> all_;
  Lines lines_;
  std::vector<Box> boxes_;
  std::vector<int> corners_;
};

}  // namespace

void blunt(const Frame& f, int index, const CsBlunting& penalty) {
  const CsScene& s = f.scene;
  const Canvas canvas{float(s.width), float(s.height)};
  Slivers slivers(penalty, canvas, s.segments);
  const size_t stride = 2 * size_t(f.points_per_curve);
  for (int p = index * kChunk, last = std::min(s.curves, p + kChunk); p < last; p++) {
    const float* points = s.points + p * stride;
    float* out = penalty.gradient + p * stride;
    std::fill(out, out + stride, 0.0f);
    add_turns(f.rings(p), s.closed, penalty, canvas, points, out);
    if (s.closed) slivers.add(f.rings(p), points, out);
  }
}

}  // namespace cs
