// Which of many points lie near a place, by a k-d tree (J. Bentley, "Multidimensional Binary Search Trees Used for
// Associative Searching", 1975). raster/point_tree.py says what each function means.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

constexpr int64_t kLeaf = 8;  // points that are tried one after the other

struct Point {
  double at[2];
};

double square(const Point& a, const Point& b) {
  const double x = a.at[0] - b.at[0], y = a.at[1] - b.at[1];
  return x * x + y * y;
}

// A range of points is a leaf or is halved at its middle point, those before which lie on the one side of it along an
// axis and those after it on the other.
struct Tree {
  int64_t count;
  const Point* points;   // in the order of the tree
  const int64_t* order;  // their indices
  const uint8_t* axes;   // of middle points

  // The nearest point, the first of several that are as near.
  struct Nearest {
    double square = std::numeric_limits<double>::infinity();
    int64_t index = -1;
  };

  void nearest(const Point& place, int64_t low, int64_t high, Nearest& best) const {
    if (high - low <= kLeaf) {
      for (int64_t k = low; k < high; k++) closer(place, k, best);
      return;
    }
    const int64_t middle = low + (high - low) / 2;
    const double off = place.at[axes[middle]] - points[middle].at[axes[middle]];
    closer(place, middle, best);
    off < 0.0 ? nearest(place, low, middle, best) : nearest(place, middle + 1, high, best);
    if (off * off > best.square) return;
    off < 0.0 ? nearest(place, middle + 1, high, best) : nearest(place, low, middle, best);
  }

  void within(const Point& place, double reach, int64_t low, int64_t high, std::vector<int64_t>& found) const {
    if (high - low <= kLeaf) {
      for (int64_t k = low; k < high; k++)
        if (square(place, points[k]) <= reach * reach) found.push_back(order[k]);
      return;
    }
    const int64_t middle = low + (high - low) / 2;
    const double off = place.at[axes[middle]] - points[middle].at[axes[middle]];
    if (square(place, points[middle]) <= reach * reach) found.push_back(order[middle]);
    if (off <= reach) within(place, reach, low, middle, found);
    if (-off <= reach) within(place, reach, middle + 1, high, found);
  }

 private:
  void closer(const Point& place, int64_t k, Nearest& best) const {
    const double found = square(place, points[k]);
    if (found < best.square || (found == best.square && order[k] < best.index)) best = {found, order[k]};
  }
};

// The closed line through points, in their own order, and a tree of these. on_it: px within which a place is on it.
struct Line {
  Tree tree;
  const Point* points;
  double on_it;

  // How far a place is off the line, and the unit direction in which it is, across the line where it is on it.
  std::pair<double, Point> off(const Point& place) const {
    Tree::Nearest best;
    tree.nearest(place, 0, tree.count, best);
    std::pair<double, Point> out{std::numeric_limits<double>::infinity(), {}};
    // The nearest point of the line lies on one of the two edges at the nearest of its points.
    for (const int64_t first : {(best.index + tree.count - 1) % tree.count, best.index}) {
      const Point &a = points[first], &b = points[(first + 1) % tree.count];
      const double x = b.at[0] - a.at[0], y = b.at[1] - a.at[1], squares = std::max(x * x + y * y, 1e-24);
      const double dx = place.at[0] - a.at[0], dy = place.at[1] - a.at[1];
      const double share = std::clamp((dx * x + dy * y) / squares, 0.0, 1.0);
      const double gx = dx - share * x, gy = dy - share * y, size = std::sqrt(gx * gx + gy * gy);
      if (!(size < out.first)) continue;
      const double length = std::sqrt(squares);
      out = {size, size > on_it ? Point{{gx / size, gy / size}} : Point{{-y / length, x / length}}};
    }
    return out;
  }
};

// The same as raster/point_tree.py gives it, with the points of it that show.
struct Outline {
  int64_t count;
  const Point* sorted;
  const int64_t* order;
  const uint8_t* axes;
  const Point* points;
  int64_t shown;
  const Point* seen;

  Line line(double on_it) const { return {{count, sorted, order, axes}, points, on_it}; }
};

// Puts the indices of a range of points in the order of the tree.
void sort(const Point* points, int64_t low, int64_t high, int64_t* order, uint8_t* axes) {
  if (high - low <= kLeaf) return;
  double least[2], most[2];
  for (int a = 0; a < 2; a++) {
    least[a] = most[a] = points[order[low]].at[a];
    for (int64_t k = low; k < high; k++) {
      least[a] = std::min(least[a], points[order[k]].at[a]);
      most[a] = std::max(most[a], points[order[k]].at[a]);
    }
  }
  const int axis = most[1] - least[1] > most[0] - least[0];
  const int64_t middle = low + (high - low) / 2;
  // Ties by index, so that the order is the same everywhere.
  std::nth_element(order + low, order + middle, order + high, [&](int64_t a, int64_t b) {
    const double x = points[a].at[axis], y = points[b].at[axis];
    return x != y ? x < y : a < b;
  });
  axes[middle] = uint8_t(axis);
  sort(points, low, middle, order, axes);
  sort(points, middle + 1, high, order, axes);
}

// Brings the shift of a line to where it lies nearest to another one, and tells whether that is near enough: see
// `cs_lay_on`. limits: at first, at last, in the mean at last.
bool laid_on(const Outline& first, const Outline& second, const Point& sign, const double* limits, int64_t look,
             int64_t tries, double on_it, Point& shift, Point& told) {
  const Line one = first.line(on_it), other = second.line(on_it);
  const auto moved = [&](const Point& p) {
    return Point{{p.at[0] * sign.at[0] + shift.at[0], p.at[1] * sign.at[1] + shift.at[1]}};
  };
  // Most lines are not alike, which a few points tell.
  for (int64_t i = 0; i < first.shown; i += first.shown / look + 1)
    if (other.off(moved(first.seen[i])).first > limits[0]) return false;
  for (int64_t left = tries;; left--) {
    double gram[3] = {1e-6, 0.0, 1e-6}, pull[2] = {0.0, 0.0}, farthest = 0.0, squares = 0.0;
    const auto add = [&](double size, const Point& way) {
      gram[0] += way.at[0] * way.at[0], gram[1] += way.at[0] * way.at[1], gram[2] += way.at[1] * way.at[1];
      for (int c = 0; c < 2; c++) pull[c] += way.at[c] * size;
      farthest = std::max(farthest, size), squares += size * size;
      return size <= limits[0];
    };
    for (int64_t i = 0; i < first.shown; i++) {
      const auto [size, way] = other.off(moved(first.seen[i]));
      if (!add(size, way)) return false;
    }
    for (int64_t i = 0; i < second.shown; i++) {
      const Point& p = second.seen[i];
      const auto [size, way] = one.off({{(p.at[0] - shift.at[0]) * sign.at[0], (p.at[1] - shift.at[1]) * sign.at[1]}});
      add(size, {{-way.at[0] * sign.at[0], -way.at[1] * sign.at[1]}});
    }
    if (farthest > limits[0]) return false;
    if (left == 0) {
      told = {{gram[0], gram[2]}};
      return farthest <= limits[1] && std::sqrt(squares / double(first.shown + second.shown)) <= limits[2];
    }
    const double area = gram[0] * gram[2] - gram[1] * gram[1];
    shift.at[0] -= (gram[2] * pull[0] - gram[1] * pull[1]) / area;
    shift.at[1] -= (gram[0] * pull[1] - gram[1] * pull[0]) / area;
  }
}

}  // namespace
}  // namespace cs

using namespace cs;

extern "C" {
CS_EXPORT void cs_tree(int64_t count, const Point* points, int64_t* order, uint8_t* axes) {
  std::iota(order, order + count, int64_t(0));
  sort(points, 0, count, order, axes);
}

CS_EXPORT void cs_nearest(int64_t count, const Point* points, const int64_t* order, const uint8_t* axes, int64_t places,
                          const Point* at, double* squares, int64_t* indices) {
  const Tree tree{count, points, order, axes};
  for (int64_t i = 0; i < places; i++) {
    Tree::Nearest best;
    tree.nearest(at[i], 0, count, best);
    squares[i] = best.square, indices[i] = best.index;
  }
}

// Finds the first of `models` that, mirrored as one of the `flips`, lies on the line `own`, by least squares of how far
// points that show of either lie off the other; first with the middles of both boxes on each other. lines: all of them;
// boxes: their least and greatest coordinates. limits: px that a point is off at most at the beginning and at last, and
// all in the root mean square at last. look: points that are tried before all are.
// shift: where the model comes to lie; told: what the points tell of that, 1/px^2 with errors of 1 px. Returns
// flips x the place among the models + the flip; flips x count where none lies on it.
CS_EXPORT int64_t cs_lay_on(const Outline* lines, const Point* boxes, int64_t own, int64_t count, const int64_t* models,
                            int64_t flips, const Point* signs, const double* limits, int64_t look, int64_t tries,
                            double on_it, Point* shift, Point* told) {
  const Point &start = boxes[2 * own], &end = boxes[2 * own + 1];
  for (int64_t k = 0; k < count * flips; k++) {
    const int64_t model = models[k / flips];
    const Point &low = boxes[2 * model], &high = boxes[2 * model + 1], &sign = signs[k % flips];
    for (int c = 0; c < 2; c++)
      shift->at[c] = 0.5 * (start.at[c] + end.at[c]) - 0.5 * sign.at[c] * (low.at[c] + high.at[c]);
    if (laid_on(lines[model], lines[own], sign, limits, look, tries, on_it, *shift, *told)) return k;
  }
  return count * flips;
}

// The indices of the points within reach of each place, ascending, as far as there is room; ends: (places,) of their
// parts. Returns how many there are, or -1 without memory.
CS_EXPORT int64_t cs_within(int64_t count, const Point* points, const int64_t* order, const uint8_t* axes,
                            int64_t places, const Point* at, const double* reaches, int64_t room, int64_t* ends,
                            int64_t* out) {
  return counted([&] {
    const Tree tree{count, points, order, axes};
    std::vector<int64_t> found;
    int64_t total = 0;
    for (int64_t i = 0; i < places; i++) {
      found.clear();
      tree.within(at[i], reaches[i], 0, count, found);
      std::sort(found.begin(), found.end());
      if (total + int64_t(found.size()) <= room) std::copy(found.begin(), found.end(), out + total);
      total += int64_t(found.size());
      ends[i] = total;
    }
    return total;
  });
}
}
