// The gradient of a penalty on slivers: places where two sides of an outline run closely against each other, with the
// shape between them. The formula is that of photo/geometric.py, which does the same with arrays.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "abi.h"

namespace {

constexpr int kUnknown = -1000;

struct Edge {
  float ax, ay, by, ux, uy, length, mx, my;  // start, the end's y, direction, length, middle
  float fx = 0, fy = 0, gx = 0, gy = 0;      // gradients of its start and end
  int left = kUnknown;                       // the winding number to the left of its middle
};

struct Canvas {
  float width, height;
  bool has(const Edge& edge) const { return edge.mx >= 0 && edge.my >= 0 && edge.mx <= width && edge.my <= height; }
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

struct Penalty {
  float thinnest, opposite;
  Canvas canvas;
};

// Whether the line of any edge from begin to end runs against the one edge and is close to its middle; which: close.
bool any_close(const Penalty& penalty, Lines& lines, const Edge& one, int begin, int end) {
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
void push(const Penalty& penalty, const Edge* all, int count, Edge& one, Edge& other) {
  const float across = one.mx - other.ax, down = one.my - other.ay;
  const float distance = beside(other, one.mx, one.my);
  if (distance == 0.0f || !penalty.canvas.has(one)) return;
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

}  // namespace

// points: curves x 3 segments x 2, closed; ring_ends: curves x rings, as in CsScene, or null. width, height: of the
// canvas, px. gradient: as points.
CS_EXPORT void cs_slivers(const float* points, int64_t curves, int64_t segments, const int32_t* ring_ends,
                          int64_t rings, int64_t edges, double thinnest, double opposite, double width, double height,
                          float* gradient) {
  const Basis basis(edges);
  const Penalty penalty{float(thinnest), float(opposite), {float(width), float(height)}};
  std::vector<Edge> all(size_t(segments) * edges);
  Lines lines(all.size());
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
    lines.set(all.data(), count * edges);
    for (int q = 0; q < count; ++q)
      for (int i = 0; i < count * edges; ++i) {
        const int first = q * edges, last = first + edges;
        if (!boxes[q].near(all[i].mx, all[i].my, thinnest) || !any_close(penalty, lines, all[i], first, last)) continue;
        for (int j = first; j < last; ++j)
          if (lines.close[j]) push(penalty, all.data(), count * edges, all[i], all[j]);
      }
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
