// Chains of edges that cannot cross themselves: the outlines whose area needs no search.
#pragma once

#include "pixel.h"

namespace cs {

// Collects the edges of a chain and says whether they form a single arc: each begins where the one before ends, and their
// directions lie within less than half a turn, so that the chain cannot cross itself. It may run over the end of the list,
// as rings do.
class ArcTest {
 public:
  // An edge from (ax, ay) to (bx, by), with the difference (vx, vy).
  template <class E>
  CS_INLINE void add(const E& e) {
    if (any_)
      gaps_ += end_x_ != e.ax || end_y_ != e.ay;
    else
      start_x_ = e.ax, start_y_ = e.ay;
    any_ = true;
    end_x_ = e.bx, end_y_ = e.by;
    turn({e.vx, e.vy});
  }

  CS_INLINE bool none() const { return !any_; }
  CS_INLINE bool failed() const { return !within_ || gaps_ > 1; }
  CS_INLINE bool passed() const { return within_ && gaps_ + (end_x_ != start_x_ || end_y_ != start_y_) == 1; }

 private:
  struct Direction {
    float x, y;
  };
  float start_x_ = 0.0f, start_y_ = 0.0f, end_x_ = 0.0f, end_y_ = 0.0f;
  Direction left_{0.0f, 0.0f}, right_{0.0f, 0.0f};  // the outermost directions
  int gaps_ = 0;
  bool any_ = false, within_ = true;

  static CS_INLINE float cross(Direction a, Direction b) { return a.x * b.y - a.y * b.x; }
  static CS_INLINE bool opposed(Direction a, Direction b) { return a.x * b.x + a.y * b.y < 0.0f; }

  CS_INLINE void turn(Direction d) {
    if (left_.x == 0.0f && left_.y == 0.0f) left_ = right_ = d;
    const bool before = cross(left_, d) < 0.0f, behind = cross(right_, d) > 0.0f;
    // Beyond both of them: half a turn, or rounding on a straight line.
    if (before && behind) within_ &= !opposed(left_, d) && !opposed(right_, d);
    if (before) left_ = d;
    if (behind) right_ = d;
  }
};

}  // namespace cs
