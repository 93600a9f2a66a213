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

// Replaces in each row of a window the pixels from the first to the last of some pixels by those whose middles lie in the
// hull of all: those of which it holds half or more, but for a few at its corners.
void fill_hull(std::vector<HullRow>& out) {
  std::vector<Point> right, left;
  const int height = int(out.size());
  int top = height, bottom = 0;
  for (int y = 0; y < height; y++) {
    const HullRow& row = out[y];
    if (row.left >= row.right) continue;
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
}

}  // namespace
}  // namespace cs::stack

extern "C" {

// out: height x width, the pixels that lie by half or more in the hull of a mask. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_hull(const uint8_t* mask, int64_t height, int64_t width, uint8_t* out) {
  return cs::failed([&] {
    std::vector<cs::stack::HullRow> rows(height);
    for (int64_t y = 0; y < height; y++) {
      cs::stack::HullRow& row = rows[y];
      row.right = int(width);
      while (row.left < row.right && !mask[y * width + row.left]) row.left++;
      while (row.right > row.left && !mask[y * width + row.right - 1]) row.right--;
    }
    cs::stack::fill_hull(rows);
    for (int64_t y = 0; y < height; y++)
      for (int64_t x = 0; x < width; x++) out[y * width + x] = rows[y].has(int(x));
  });
}

// Of runs of px of one label each, whose first px, in a picture `stride` px wide, and labels they are, rows[y] to
// rows[y + 1] those of each row: of a window (top, left, height, width), how many pixels of each label that is none of
// those marked as own the hull of the own ones holds by half or more, and how many of them have no neighbour along rows
// and columns beyond the hull or the window. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_hull_holds(const int64_t* first, const int32_t* labels, const int64_t* rows, int64_t stride,
                                int64_t top, int64_t left, int64_t height, int64_t width, const uint8_t* own,
                                int64_t* held, int64_t* inner) {
  using cs::stack::HullRow;
  return cs::failed([&] {
    std::vector<HullRow> hull(height);
    // Calls a function for the runs that reach into a row, with their label and their px there.
    const auto each_run = [&](int64_t y, int from, int to, const auto& use) {
      const int64_t start = (top + y) * stride + left, end = rows[top + y + 1];
      int64_t k = std::upper_bound(first + rows[top + y], first + end, start + from) - first - 1;
      for (; from < to && k < end && first[k] < start + to; k++)
        use(labels[k], std::max(from, int(first[k] - start)), std::min(to, int(first[k + 1] - start)));
    };
    for (int64_t y = 0; y < height; y++)
      each_run(y, 0, int(width), [&](int32_t label, int from, int to) {
        if (!own[label]) return;
        if (hull[y].right == 0) hull[y].left = from;
        hull[y].right = to;
      });
    cs::stack::fill_hull(hull);
    const HullRow none{};
    for (int64_t y = 0; y < height; y++) {
      const HullRow &above = y > 0 ? hull[y - 1] : none, &below = y + 1 < height ? hull[y + 1] : none, &row = hull[y];
      const int low = std::max({above.left, below.left, row.left + 1});
      const int high = std::min({above.right, below.right, row.right - 1});
      each_run(y, row.left, row.right, [&](int32_t label, int from, int to) {
        if (own[label]) return;
        held[label] += to - from;
        inner[label] += std::max(0, std::min(to, high) - std::max(from, low));
      });
    }
  });
}
}
