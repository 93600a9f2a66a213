// The gradient of a penalty on slivers: places where two sides of an outline run closely against each other. The
// formula is that of photo/slivers.py, which does the same with arrays.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "abi.h"

namespace {

struct Edge {
  float ax, ay, ux, uy, length, mx, my;  // start, direction, length, middle
  float fx, fy, gx, gy;                  // gradients of its start and end
};

struct Box {
  float left, top, right, bottom;
  bool near(const Box& other, float distance) const {
    return left - distance <= other.right && other.left - distance <= right && top - distance <= other.bottom &&
           other.top - distance <= bottom;
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
      out[s - 1] = {x[0], x[1], dx / length, dy / length, length, 0.5f * (x[0] + y[0]), 0.5f * (x[1] + y[1]),
                    0,    0,    0,           0};
      box = {std::min(box.left, y[0]), std::min(box.top, y[1]), std::max(box.right, y[0]), std::max(box.bottom, y[1])};
    }
    std::copy(y, y + 2, x);
  }
  return box;
}

// What the middle of the one edge and the other edge do to each other.
void push(Edge& one, Edge& other, float thinnest, float opposite) {
  if (one.ux * other.ux + one.uy * other.uy >= opposite) return;
  const float across = one.mx - other.ax, down = one.my - other.ay;
  const float distance = other.ux * down - other.uy * across;
  if (std::fabs(distance) >= thinnest || distance == 0.0f) return;
  const float share = (across * other.ux + down * other.uy) / other.length;
  if (share < 0.0f || share > 1.0f) return;
  const float force = 2.0f * one.length * (distance / thinnest - (distance > 0 ? 1.0f : -1.0f));
  const float x = -other.uy * force, y = other.ux * force;
  one.fx += 0.5f * x, one.fy += 0.5f * y, one.gx += 0.5f * x, one.gy += 0.5f * y;
  other.fx -= (1.0f - share) * x, other.fy -= (1.0f - share) * y, other.gx -= share * x, other.gy -= share * y;
}

}  // namespace

// points: curves x 3 segments x 2, closed; ring_ends: curves x rings, as in CsScene, or null. gradient: as points.
CS_EXPORT void cs_slivers(const float* points, int32_t curves, int32_t segments, const int32_t* ring_ends,
                          int32_t rings, int32_t edges, float thinnest, float opposite, float* gradient) {
  const Basis basis(edges);
  std::vector<Edge> all(size_t(segments) * edges);
  std::vector<Box> boxes(segments);
  std::vector<int> corners(4 * size_t(segments));
  for (int32_t n = 0; n < curves; ++n) {
    const float* own = points + size_t(n) * 6 * segments;
    float* out = gradient + size_t(n) * 6 * segments;
    std::fill(out, out + 6 * size_t(segments), 0.0f);
    int count = 0;
    for (int r = 0; r < (ring_ends ? rings : 1); ++r) {
      const int begin = count, end = ring_ends ? ring_ends[size_t(n) * rings + r] : segments;
      for (; count < end; ++count) {
        int* c = &corners[4 * size_t(count)];
        for (int k = 0; k < 3; ++k) c[k] = 3 * count + k;
        c[3] = 3 * (count + 1 < end ? count + 1 : begin);
        boxes[count] = flatten(basis, edges, own, c, &all[size_t(count) * edges]);
      }
    }
    for (int p = 0; p < count; ++p)
      for (int q = 0; q < count; ++q)
        if (boxes[p].near(boxes[q], thinnest))
          for (int i = p * edges; i < (p + 1) * edges; ++i)
            for (int j = q * edges; j < (q + 1) * edges; ++j) push(all[i], all[j], thinnest, opposite);
    for (int p = 0; p < count; ++p)
      for (int s = 0; s < edges; ++s) {
        const Edge& edge = all[size_t(p) * edges + s];
        for (int k = 0; k < 4; ++k) {
          float* at = out + 2 * corners[4 * size_t(p) + k];
          const float first = basis.of[4 * s + k], second = basis.of[4 * (s + 1) + k];
          at[0] += first * edge.fx + second * edge.gx;
          at[1] += first * edge.fy + second * edge.gy;
        }
      }
  }
}
