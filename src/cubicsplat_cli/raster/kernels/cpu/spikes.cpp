// The gradient of the penalty on spikes and slivers, whose formulas stand in shared/spikes.h.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "frame.h"

namespace cs {
namespace {

struct Box {
  float left, top, right, bottom;
  bool near(float x, float y, float distance) const {
    return left - distance <= x && x <= right + distance && top - distance <= y && y <= bottom + distance;
  }
};

// What tells most pairs of edges apart, each in an array of its own for vector instructions.
struct Lines {
  std::vector<float> ax, ay, ux, uy;
  std::vector<uint8_t> close;
  explicit Lines(size_t count) : ax(count), ay(count), ux(count), uy(count), close(count) {}
  void set(const Side* all, int count) {
    for (int i = 0; i < count; ++i) ax[i] = all[i].ax, ay[i] = all[i].ay, ux[i] = all[i].ux, uy[i] = all[i].uy;
  }
};

// The gradient of the turns of one curve.
void add_turns(const Frame& f, const Rings& rings, const Blunting& penalty, const float* points, float* out) {
  for (int r = 0; r < rings.count; r++)
    for (int m = rings.begin(r) + (f.scene.closed ? 0 : 1); m < rings.end(r); m++) {
      const int before = 3 * (m == rings.begin(r) ? rings.end(r) - 1 : m - 1) + 2;
      const float* join = points + 6 * m;
      if (!on_canvas(join[0], join[1], f.scene.width, f.scene.height)) continue;
      add_turn(points + 2 * before, join, join + 2, penalty.turn, out + 2 * before, out + 6 * m, out + 6 * m + 2);
    }
  for (float* g = out; g < out + 6 * rings.total(); g += 2) {
    const float factor = held_back(g, float(penalty.turns * penalty.loss), penalty.arm);
    for (int c = 0; c < 2; c++) g[c] *= factor;
  }
}

// Finds the gradient of slivers, of one curve after the other.
class Slivers {
 public:
  Slivers(const Frame& frame, const Blunting& penalty)
      : frame_(frame), penalty_(penalty), basis_(4 * (penalty.edges + 1)),
        all_(size_t(frame.scene.segments) * penalty.edges), lines_(all_.size()), boxes_(frame.scene.segments) {
    for (int s = 0; s <= penalty.edges; ++s) bernstein(float(s) / float(penalty.edges), &basis_[4 * s]);
  }

  void add(const Rings& rings, const float* points, float* out) {
    const int edges = penalty_.edges;
    count_ = rings.total() * edges;
    for (int r = 0; r < rings.count; ++r)
      for (int m = rings.begin(r); m < rings.end(r); ++m) flatten(m, rings.end_point(r, m, true), points);
    lines_.set(all_.data(), count_);
    bool any = false;
    for (int first = 0; first < count_; first += edges)
      for (int i = 0; i < count_; ++i) {
        if (!boxes_[first / edges].near(all_[i].mx, all_[i].my, penalty_.thinnest)) continue;
        if (!any_close(all_[i], first, first + edges)) continue;
        any = true;
        for (int j = first; j < first + edges; ++j)
          if (lines_.close[j]) push(all_[i], all_[j]);
      }
    if (!any) return;
    for (int r = 0; r < rings.count; ++r)
      for (int m = rings.begin(r); m < rings.end(r); ++m) give(m, rings.end_point(r, m, true), out);
  }

 private:
  // The edges of segment m, which ends in that control point, and the box around them.
  void flatten(int m, int end_point, const float* points) {
    float before[2] = {0, 0};
    Box box{};
    for (int s = 0; s <= penalty_.edges; ++s) {
      float at[2] = {0, 0};
      for (int k = 0; k < 4; ++k)
        for (int axis = 0; axis < 2; ++axis)
          at[axis] += basis_[4 * s + k] * points[2 * (k < 3 ? 3 * m + k : end_point) + axis];
      box = s == 0 ? Box{at[0], at[1], at[0], at[1]}
                   : Box{std::min(box.left, at[0]), std::min(box.top, at[1]), std::max(box.right, at[0]),
                         std::max(box.bottom, at[1])};
      if (s > 0) all_[size_t(m) * penalty_.edges + s - 1] = side_between(before, at);
      std::copy(at, at + 2, before);
    }
    boxes_[m] = box;
  }

  // True if any edge from begin to end `runs_against` the one; lines_.close tells which.
  bool any_close(const Side& one, int begin, int end) {
    const float *ax = lines_.ax.data(), *ay = lines_.ay.data(), *ux = lines_.ux.data(), *uy = lines_.uy.data();
    uint8_t* close = lines_.close.data();
    unsigned any = 0;
    for (int j = begin; j < end; ++j) {
      const float distance = std::fabs(ux[j] * (one.my - ay[j]) - uy[j] * (one.mx - ax[j]));
      const bool is = (distance < penalty_.thinnest) & (one.ux * ux[j] + one.uy * uy[j] < penalty_.opposite);
      close[j] = is;
      any |= is;
    }
    return any != 0;
  }

  // Adds what two close edges do to each other to the gradients of their ends.
  void push(Side& one, Side& other) {
    const auto left = [&](const Side& side) {
      if (side.left != kUnknown) return side.left;
      side.left = 0;
      for (int i = 0; i < count_; ++i) side.left += wound_by(all_[i], side);
      return side.left;
    };
    Push push;
    if (!pushes(one, other, frame_.scene.width, frame_.scene.height, left, &push)) return;
    for (int c = 0; c < 2; ++c) {
      one.of_start[c] += 0.5f * push.by[c], one.of_end[c] += 0.5f * push.by[c];
      other.of_start[c] -= (1.0f - push.share) * push.by[c], other.of_end[c] -= push.share * push.by[c];
    }
  }

  // Brings the gradients of the vertices of segment m to its control points.
  void give(int m, int end_point, float* out) const {
    const float weight = float(penalty_.slivers * penalty_.loss);
    for (int s = 0; s < penalty_.edges; ++s) {
      const Side& edge = all_[size_t(m) * penalty_.edges + s];
      for (int k = 0; k < 4; ++k)
        for (int c = 0; c < 2; ++c)
          out[2 * (k < 3 ? 3 * m + k : end_point) + c] += weight * basis_[4 * s + k] * edge.of_start[c] +
                                                          weight * basis_[4 * (s + 1) + k] * edge.of_end[c];
    }
  }

  const Frame& frame_;
  const Blunting& penalty_;
  std::vector<float> basis_;  // (edges + 1) x 4
  std::vector<Side> all_;
  int count_ = 0;  // edges of the present curve
  Lines lines_;
  std::vector<Box> boxes_;  // of the segments
};

}  // namespace

void blunt(const Frame& f, int index, const Blunting& penalty) {
  const CsScene& s = f.scene;
  Slivers slivers(f, penalty);
  const size_t stride = 2 * size_t(f.points_per_curve);
  for (int p = index * kChunk, last = std::min(s.curves, p + kChunk); p < last; p++) {
    const float* points = s.points + p * stride;
    float* out = penalty.gradient + p * stride;
    std::fill(out, out + stride, 0.0f);
    add_turns(f, f.rings(p), penalty, points, out);
    if (s.closed) slivers.add(f.rings(p), points, out);
  }
}

}  // namespace cs
