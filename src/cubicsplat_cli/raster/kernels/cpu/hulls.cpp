// Convex hulls of pixels, and what they hold. What they are for is said in artwork/layers/stacking.py.
#include <algorithm>
#include <cstdint>
#include <exception>
#include <vector>

#include "abi.h"
#include "stack_trace.h"

namespace cs::stack {
namespace {

// Adds a corner to one side of a convex hull, by the monotone chain.
void extend(std::vector<Point>& chain, size_t start, Point p) {
  const auto turn = [](Point a, Point b, Point c) { return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x); };
  while (chain.size() >= start + 2 && turn(chain[chain.size() - 2], chain.back(), p) <= 0.0) chain.pop_back();
  chain.push_back(p);
}

// The pixels that lie by half or more in the hull of some pixels of a window.
template <class Own>
std::vector<uint8_t> hull_of(int height, int width, const Own& own) {
  struct Row {
    int y, left, right;
  };
  std::vector<Row> rows;
  for (int y = 0; y < height; y++) {
    int left = 0, right = width;
    while (left < width && !own(y, left)) left++;
    while (right > left && !own(y, right - 1)) right--;
    if (left < right) rows.push_back({y, left, right});
  }
  std::vector<uint8_t> out(size_t(height) * width, 0);
  if (rows.empty()) return out;
  std::vector<Point> corners;
  for (const Row& row : rows)
    for (int k = 0; k < 2; k++) extend(corners, 0, {double(row.right), double(row.y + k)});
  const size_t other = corners.size();
  for (auto row = rows.rbegin(); row != rows.rend(); row++)
    for (int k = 1; k >= 0; k--) extend(corners, other, {double(row->left), double(row->y + k)});
  Window window{0, 0, width, height, {}};
  Trace none;
  Crossings crossings(none, 0, 0);
  Tracer tracer(window, crossings, 0);
  for (size_t n = 0; n < corners.size(); n++) {
    const Point a = corners[n], b = corners[(n + 1) % corners.size()];
    const Point p[4] = {a, between(a, b, 1.0 / 3.0), between(a, b, 2.0 / 3.0), b};
    tracer.piece(&p[0].x, true, 1.0);
  }
  std::vector<double> covered(out.size());
  window.finish(covered.data());
  for (int y = 0; y < height; y++)
    for (int x = 0; x < width; x++) {
      const size_t at = size_t(y) * width + x;
      out[at] = covered[at] >= 0.5 || own(y, x);
    }
  return out;
}

}  // namespace
}  // namespace cs::stack

extern "C" {

// out: height x width, the pixels that lie by half or more in the hull of a mask. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_hull(const uint8_t* mask, int64_t height, int64_t width, uint8_t* out) {
  try {
    const auto found = cs::stack::hull_of(int(height), int(width),
                                          [&](int y, int x) { return mask[int64_t(y) * width + x] != 0; });
    std::copy(found.begin(), found.end(), out);
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}

// Of a window of labels, its rows `stride` apart: of how many pixels of each label, that is none of those marked as own,
// the hull of the own ones holds half or more, and how many of them have no neighbour along rows and columns beyond the
// hull or the window. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_hull_holds(const int32_t* labels, int64_t stride, int64_t height, int64_t width,
                                const uint8_t* own, int64_t* held, int64_t* inner) {
  try {
    const auto is_own = [&](int y, int x) { return own[labels[y * stride + x]] != 0; };
    const auto hull = cs::stack::hull_of(int(height), int(width), is_own);
    const auto in = [&](int y, int x) {
      return y >= 0 && x >= 0 && y < height && x < width && hull[size_t(y) * width + x] != 0;
    };
    for (int y = 0; y < height; y++)
      for (int x = 0; x < width; x++) {
        if (!in(y, x) || is_own(y, x)) continue;
        const int32_t label = labels[y * stride + x];
        held[label]++;
        inner[label] += in(y - 1, x) && in(y + 1, x) && in(y, x - 1) && in(y, x + 1);
      }
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}
}
