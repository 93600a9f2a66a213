// Steps of one polygon of a stack on a grid: other outlines in other colours, and how the picture's squared error would
// change.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "abi.h"
#include "parallel.h"
#include "polygon_place.h"

namespace cs {
namespace {

constexpr int kFewest = 3;           // vertices
constexpr int64_t kLeastTurns = 32;  // outlines that are worth a thread
// Of a compressed file: bytes of a character of a path, and of a colour that no other polygon has.
constexpr double kCharacter = 0.55, kColour = 3.0;
// Units by which to move: to those nearby, of which a new vertex takes two along an axis too, and further along an axis.
constexpr int kWays = 16, kInserted = 12;
constexpr int kWay[kWays][2] = {{-1, -1}, {-1, 0}, {-1, 1}, {0, -1}, {0, 1}, {1, -1}, {1, 0}, {1, 1},
                                {2, 0},   {-2, 0}, {0, 2},  {0, -2}, {4, 0}, {-4, 0}, {0, 4}, {0, -4}};

Outline without(const Outline& outline, int vertex) {
  Outline less = outline;
  less.erase(less.begin() + 2 * vertex, less.begin() + 2 * vertex + 2);
  return less;
}

// An outline, then the same with a vertex, or all, in another place, and with a vertex less or more.
std::vector<Outline> changed(const Outline& own, int most) {
  std::vector<Outline> all{own};
  const int n = int(own.size()) / 2;
  for (int way = 0; way < kWays; ++way) {
    Outline whole = own;
    for (int j = 0; j < n; ++j) {
      Outline one = own;
      for (int axis = 0; axis < 2; ++axis) one[2 * j + axis] += kWay[way][axis], whole[2 * j + axis] += kWay[way][axis];
      all.push_back(one);
      if (n >= most || way >= kInserted) continue;
      int32_t middle[2];
      for (int axis = 0; axis < 2; ++axis)
        middle[axis] = (own[2 * j + axis] + own[2 * ((j + 1) % n) + axis]) / 2 + kWay[way][axis];
      one = own;
      one.insert(one.begin() + 2 * j + 2, middle, middle + 2);
      all.push_back(one);
    }
    all.push_back(whole);
  }
  for (int j = 0; n > kFewest && j < n; ++j) all.push_back(without(own, j));
  return all;
}

// Of the path with an outline, whose numbers are differences: a digit or two and what is before them.
int characters(const Outline& outline) {
  int sum = 0;
  for (size_t i = 0; i < outline.size(); ++i) {
    sum += std::abs(outline[i] - (i < 2 ? 0 : outline[i - 2])) < 10 ? 2 : 3;
  }
  return sum;
}

struct Step {
  double score, rise;
  size_t outline;
  Paint paint;
};

}  // namespace
}  // namespace cs

using namespace cs;

// The steps of the polygon `index` that promise most, the best first.
// goal: height x width x channels (3, or 4 with alpha), weights: height x width, or null; scale: 2, px per unit.
// vertices: of polygons from front to back, x and y, units; ends: of each; levels: x 3, 0..15; ground: channels, behind
// all. most: vertices of a polygon. price: loss that a byte is worth; slack: bytes that a file may turn out to be smaller
// than is guessed. found: at most so many steps. scores, rises: of each, of loss + price x bytes as guessed, and of the
// loss alone; outlines: x most x 2, corners: of each, paints: x 3. Returns how many there are, or -1 without memory.
CS_EXPORT int64_t cs_polygon_steps(const float* goal, const float* weights, int64_t height, int64_t width,
                                   int64_t channels, const double* scale, const int32_t* vertices, const int32_t* ends,
                                   const int32_t* levels, int64_t count, const float* ground, double opacity,
                                   int64_t index, int64_t most, double price, double slack, int64_t threads,
                                   int64_t found, double* scores, double* rises, int32_t* outlines, int32_t* corners,
                                   int32_t* paints) {
  return counted([&] {
    const Stack stack{goal,     weights, int(height), int(width), int(channels), scale,
                      vertices, ends,    levels,      count,      ground,        float(opacity)};
    const Outline own = stack.outline(index);
    const Paint paint = stack.paint(index);
    const std::vector<Outline> all = changed(own, int(most));
    const Place place(stack, index, all);
    std::vector<Cost> costs(all.size());
    each_index(int64_t(all.size()), worth_starting(threads, int64_t(all.size()), kLeastTurns),
               [&](int64_t i) { costs[i] = place.cost(all[i]); });
    std::vector<Paint> shared;
    for (int64_t i = 0; i < count; ++i)
      if (i != index) shared.push_back(stack.paint(i));
    std::sort(shared.begin(), shared.end());
    shared.erase(std::unique(shared.begin(), shared.end()), shared.end());
    const auto bytes = [&](const Paint& one) {
      return std::binary_search(shared.begin(), shared.end(), one) ? 0.0 : kColour;
    };
    std::vector<Paint> tried{paint};
    for (int k = 0; k < 2 * kColours; ++k) {
      tried.push_back(paint);
      int32_t& level = tried.back()[k / 2];
      level = std::clamp(level + (k % 2 ? 1 : -1), 0, kLevels);
    }
    tried.insert(tried.end(), shared.begin(), shared.end());
    std::vector<double> prices(tried.size() + 1);
    for (size_t k = 0; k < tried.size(); ++k) prices[k] = bytes(tried[k]) - bytes(paint);
    tried.push_back(paint);  // in place of which each outline has its best one
    std::vector<Step> steps;
    const double before = costs[0].of(paint);
    for (size_t i = 0; i < all.size(); ++i) {
      tried.back() = costs[i].best(), prices.back() = bytes(tried.back()) - bytes(paint);
      const double text = kCharacter * (characters(all[i]) - characters(own));
      for (size_t k = i ? 0 : 1; k < tried.size(); ++k) {
        const double rise = costs[i].of(tried[k]) - before, score = rise + price * (text + prices[k]);
        if (score < price * slack) steps.push_back({score, rise, i, tried[k]});
      }
    }
    const size_t kept = std::min(steps.size(), size_t(found));
    std::partial_sort(steps.begin(), steps.begin() + kept, steps.end(), [](const Step& a, const Step& b) {
      return a.score != b.score       ? a.score < b.score
             : a.outline != b.outline ? a.outline < b.outline
                                      : a.paint < b.paint;
    });
    for (size_t k = 0; k < kept; ++k) {
      const Outline& outline = all[steps[k].outline];
      scores[k] = steps[k].score, rises[k] = steps[k].rise, corners[k] = int32_t(outline.size() / 2);
      std::copy(outline.begin(), outline.end(), outlines + 2 * most * k);
      std::copy(steps[k].paint.begin(), steps[k].paint.end(), paints + kColours * k);
    }
    return int64_t(kept);
  });
}

// By how much the loss rises without each vertex of a polygon that has more than the fewest, and then without all of it:
// rises; the rest as above. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_polygon_removals(const float* goal, const float* weights, int64_t height, int64_t width,
                                      int64_t channels, const double* scale, const int32_t* vertices,
                                      const int32_t* ends, const int32_t* levels, int64_t count, const float* ground,
                                      double opacity, int64_t index, double* rises) {
  return failed([&] {
    const Stack stack{goal,     weights, int(height), int(width), int(channels), scale,
                      vertices, ends,    levels,      count,      ground,        float(opacity)};
    const Outline own = stack.outline(index);
    const Place place(stack, index, {own});
    const Paint paint = stack.paint(index);
    const double with = place.cost(own).of(paint);
    const int n = int(own.size()) / 2;
    for (int j = 0; n > kFewest && j < n; ++j) *rises++ = place.cost(without(own, j)).of(paint) - with;
    *rises = -with;
  });
}
