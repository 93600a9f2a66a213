// Convex hulls of pixels, and what they hold. What they are for is said in artwork/layers/stacking.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "stack_trace.h"

namespace cs::stack {
namespace {

// Adds a corner to one side of a convex hull, by the monotone chain.
void extend(std::vector<Point>& chain, Point p) {
  const auto turn = [](Point a, Point b, Point c) { return cross(b - a, c - a); };
  while (chain.size() >= 2 && turn(chain[chain.size() - 2], chain.back(), p) <= 0.0) chain.pop_back();
  chain.push_back(p);
}

// x at a height of a chain that goes downwards, whose piece `k` is the last that began above.
double x_at(const std::vector<Point>& chain, size_t& k, double y) {
  while (k + 2 < chain.size() && chain[k + 1].y <= y) k++;
  const Point a = chain[k], b = chain[k + 1];
  return a.x + (b.x - a.x) * (y - a.y) / (b.y - a.y);
}

// The pixels of a row from `left` up to `right` that a hull holds.
struct HullRow {
  int left = 0, right = 0;

  bool has(int x) const { return x >= left && x < right; }
};

// Of each row of a window the pixels whose middles lie in the hull of some pixels: those of which it holds half or more,
// but for a few at its corners.
template <class Own>
std::vector<HullRow> hull_of(int height, int width, const Own& own) {
  std::vector<HullRow> out(height);
  std::vector<Point> right, left;
  int top = height, bottom = 0;
  for (int y = 0; y < height; y++) {
    HullRow& row = out[y];
    row.right = width;
    while (row.left < width && !own(y, row.left)) row.left++;
    while (row.right > row.left && !own(y, row.right - 1)) row.right--;
    if (row.left == row.right) continue;
    top = std::min(top, y), bottom = y + 1;
    for (int k = 0; k < 2; k++) extend(right, {double(row.right), double(y + k)});
  }
  for (int y = bottom - 1; y >= top; y--)
    for (int k = 1; k >= 0; k--)
      if (out[y].left < out[y].right) extend(left, {double(out[y].left), double(y + k)});
  std::reverse(left.begin(), left.end());
  size_t at_left = 0, at_right = 0;
  for (int y = top; y < bottom; y++)
    out[y] = {int(std::ceil(x_at(left, at_left, y + 0.5) - 0.5)),
              int(std::floor(x_at(right, at_right, y + 0.5) + 0.5))};
  return out;
}

}  // namespace
}  // namespace cs::stack

extern "C" {

// out: height x width, the pixels that lie by half or more in the hull of a mask. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_hull(const uint8_t* mask, int64_t height, int64_t width, uint8_t* out) {
  return cs::failed([&] {
    const auto rows = cs::stack::hull_of(int(height), int(width),
                                         [&](int y, int x) { return mask[int64_t(y) * width + x] != 0; });
    for (int64_t y = 0; y < height; y++)
      for (int64_t x = 0; x < width; x++) out[y * width + x] = rows[y].has(int(x));
  });
}

// Of a window of labels, its rows `stride` apart: of how many pixels of each label, that is none of those marked as own,
// the hull of the own ones holds half or more, and how many of them have no neighbour along rows and columns beyond the
// hull or the window. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_hull_holds(const int32_t* labels, int64_t stride, int64_t height, int64_t width,
                                const uint8_t* own, int64_t* held, int64_t* inner) {
  return cs::failed([&] {
    const auto is_own = [&](int y, int x) { return own[labels[y * stride + x]] != 0; };
    const auto hull = cs::stack::hull_of(int(height), int(width), is_own);
    const cs::stack::HullRow none{};
    for (int y = 0; y < height; y++) {
      const auto& above = y > 0 ? hull[y - 1] : none;
      const auto& below = y + 1 < height ? hull[y + 1] : none;
      for (int x = hull[y].left; x < hull[y].right; x++) {
        if (is_own(y, x)) continue;
        const int32_t label = labels[y * stride + x];
        held[label]++;
        inner[label] += above.has(x) && below.has(x) && hull[y].has(x - 1) && hull[y].has(x + 1);
      }
    }
  });
}
}
