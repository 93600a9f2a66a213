// Minimum-link paths: the fewest straight lines between places that stay within masks. Which places and masks these are is
// said in artwork/layers/ways.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "cubic.h"

namespace cs {
namespace {

constexpr double kCorner = 1e3;   // px of length that a corner less is worth
constexpr int kSamples = 32;      // of a line, before all of it is looked at
constexpr int kMostRepairs = 60;  // times that lines which show between the samples are given up

// Where lines may run: the pixels of `mask`, those of `hidden` within `near` px of an end, and those of `allowed` within
// `at_end` px. All are windows at (left, top), beyond the canvas as on its border, elsewhere empty.
struct Hiding {
  int64_t top, left, height, width, canvas_height, canvas_width;
  const uint8_t *mask, *hidden, *allowed;
  Point ends[2];
  double near, at_end;

  bool passes(Point point) const {
    const int64_t column = std::clamp(int64_t(std::floor(point.x)), int64_t(0), canvas_width - 1) - left;
    const int64_t row = std::clamp(int64_t(std::floor(point.y)), int64_t(0), canvas_height - 1) - top;
    if (row < 0 || row >= height || column < 0 || column >= width) return false;
    const int64_t pixel = row * width + column;
    if (mask[pixel]) return true;
    if (!allowed[pixel]) return false;
    double away = INFINITY;
    for (const Point& end : ends) away = std::min(away, (point - end).length());
    return (away < near && hidden[pixel]) || away < at_end;
  }

  static Point between(Point a, Point b, double t) { return a * (1.0 - t) + b * t; }

  // Whether a line passes at samples; its ends, which most often do, come last.
  bool at_samples(Point a, Point b) const {
    for (int stride = kSamples / 2; stride > 0; stride /= 2)
      for (int k = stride; k < kSamples; k += 2 * stride)
        if (!passes(between(a, b, (k + 0.5) / kSamples))) return false;
    return passes(between(a, b, 0.5 / kSamples));
  }

  // Whether a line passes all the way.
  bool all_along(Point a, Point b) const {
    const int64_t steps = 2 * int64_t((b - a).length()) + 1;
    for (int64_t k = 0; k <= steps; k++)
      if (!passes(between(a, b, double(k) / double(steps)))) return false;
    return true;
  }
};

// The nodes of the path with the fewest, then the shortest lines from one of the first to one of the last nodes, which
// come in the order in which lines may go; empty where there is none. length: nodes x nodes, px of the lines, infinite
// where they show. before, after: px that starting at one of the first, or ending at one of the last, adds.
std::vector<int64_t> fewest(int64_t count, const std::vector<double>& length, int64_t starts, const double* before,
                            int64_t stops, const double* after) {
  std::vector<double> cost(count, INFINITY);
  std::vector<int64_t> via(count, -1), out;
  std::copy(before, before + starts, cost.begin());
  for (int64_t b = starts; b < count; b++)
    for (int64_t a = 0; a < b; a++)
      if (const double total = cost[a] + length[a * count + b] + kCorner; total < cost[b]) cost[b] = total, via[b] = a;
  double best = INFINITY;
  int64_t last = -1;
  for (int64_t k = 0; k < stops; k++)
    if (const double total = cost[count - stops + k] + after[k]; total < best) best = total, last = count - stops + k;
  for (; last >= 0; last = via[last]) out.push_back(last);
  std::reverse(out.begin(), out.end());
  return out;
}

}  // namespace
}  // namespace cs

extern "C" {

// The path of the fewest lines through nodes (x 2) ordered by `place`: see `fewest_links` in raster/outlines.py. box: top,
// left, height and width of the masks, height and width of the canvas; ends: 2 x 2, near an end, and at it. path: room for
// count. Returns how many nodes it has, 0 where there is none, -1 where there is no memory.
CS_EXPORT int64_t cs_fewest_links(int64_t count, const double* nodes, const double* place, int64_t starts,
                                  const double* before, int64_t stops, const double* after, const int64_t* box,
                                  const uint8_t* mask, const uint8_t* hidden, const uint8_t* allowed,
                                  const double* ends, double near, double at_end, int64_t* path) {
  using namespace cs;
  return counted([&] {
    const Hiding hiding{box[0], box[1], box[2], box[3],  box[4],
                        box[5], mask,   hidden, allowed, {{ends[0], ends[1]}, {ends[2], ends[3]}},
                        near,   at_end};
    std::vector<int64_t> order(count);
    for (int64_t i = 0; i < count; i++) order[i] = i;
    std::stable_sort(order.begin(), order.end(), [&](int64_t a, int64_t b) { return place[a] < place[b]; });
    std::vector<Point> at(count);
    for (int64_t i = 0; i < count; i++) at[i] = {nodes[2 * order[i]], nodes[2 * order[i] + 1]};
    std::vector<double> length(count * count, INFINITY);
    for (int64_t a = 0; a < count; a++)
      for (int64_t b = a + 1; b < count; b++)
        if (place[order[a]] < place[order[b]] && hiding.at_samples(at[a], at[b]))
          length[a * count + b] = (at[b] - at[a]).length();
    for (int repair = 0; repair < kMostRepairs; repair++) {
      const std::vector<int64_t> found = fewest(count, length, starts, before, stops, after);
      bool whole = true;
      for (size_t k = 0; k + 1 < found.size(); k++)
        if (!hiding.all_along(at[found[k]], at[found[k + 1]]))
          whole = false, length[found[k] * count + found[k + 1]] = INFINITY;
      if (!whole) continue;
      for (size_t k = 0; k < found.size(); k++) path[k] = order[found[k]];
      return int64_t(found.size());
    }
    return int64_t(0);
  });
}
}
