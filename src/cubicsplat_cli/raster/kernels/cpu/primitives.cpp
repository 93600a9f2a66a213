// Whole loops that are circles, ellipses or boxes. How they are told is said in artwork/geometry/fitting.py.
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "abi.h"
#include "cubic.h"
#include "primitives.h"

namespace cs {
namespace {

constexpr int kRounds = 10;
constexpr double kWorst = 9.0;  // mean squared residual, in sigmas, above which a primitive is out of the question
constexpr int64_t kFew = 120;   // points suffice for the first fit
constexpr int64_t kFewest = 6;
// Area over the root of the determinant of the second moments: 12 for rectangles, 4 pi for ellipses, less for the rest.
constexpr double kLeastFullness = 11.7;
constexpr double kMostHidden = 0.03;  // share of the loop's length above which its area tells nothing
// px from a sharp corner in which points are biased, and by how much.
constexpr double kSharpReach = 1.5, kSharpWeight = 1.0 / (0.3 * 0.3);
constexpr double kFar = 3.0;  // sigmas that no point of a rectangle may be off, near its corners either
constexpr double kRadii[] = {0.15, 0.3, 0.5, 0.75, 1.0};  // of round corners to begin with, of half of the shorter side
// px; half of the shortest side, the least radius, and half of the straight part of a rounded box's longer side, below
// which it is nothing but round corners: a circle has half the parameters.
constexpr double kThinnest = 0.25, kLeastRadius = 0.5, kLeastSide = 0.25;
constexpr double kMostBack =
    0.25;  // share of the way around a primitive's middle that a loop may run against its sense
constexpr double kLeastTurn = 2.0943951023931953;  // around the middle of a circle or an ellipse: a third of a turn
constexpr double kQuarter = 0.7853981633974483;    // half a right angle
constexpr double kFine[2] = {0.03490658503988659, 0.003490658503988659};  // radians: 2 and 0.2 degrees

Point rotated(Point p, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {p.x * c - p.y * s, p.x * s + p.y * c};
}

// The box around points that are turned back by an angle: its middle, where it is, and half sides.
std::array<double, 4> box_around(const std::vector<Point>& points, double angle) {
  const double c = std::cos(angle), s = std::sin(angle), far = std::numeric_limits<double>::infinity();
  Point low{far, far}, high{-far, -far};
  for (const Point& p : points) {
    const double x = p.x * c + p.y * s, y = p.y * c - p.x * s;
    low = {std::min(low.x, x), std::min(low.y, y)}, high = {std::max(high.x, x), std::max(high.y, y)};
  }
  const Point middle = rotated({0.5 * (low.x + high.x), 0.5 * (low.y + high.y)}, angle);
  return {middle.x, middle.y, 0.5 * (high.x - low.x), 0.5 * (high.y - low.y)};
}

// Angle, at most half a right one, of the smallest box around points.
double box_angle(const std::vector<Point>& points) {
  double best = 0.0, centre = 0.0, step = 2.0 * kQuarter / 45.0;
  for (int round = 0; round < 2; round++) {
    const int from = round ? -10 : -22, to = round ? 10 : 22;
    double least = std::numeric_limits<double>::infinity();
    for (int k = from; k <= to; k++) {
      const double angle = round ? centre + k * kFine[0] / 10.0 : (k + 0.5) * step;
      const auto box = box_around(points, angle);
      if (box[2] * box[3] < least) least = box[2] * box[3], best = angle;
    }
    centre = best;
  }
  return best;
}

// Of a polygon: its middle, variances along its main axes, the larger first, the angle of the first, and fullness.
struct Solid {
  Point middle;
  double spread[2] = {1.0, 1.0}, turn = 0.0, fullness = 0.0;

  explicit Solid(const std::vector<Point>& points) {
    const size_t n = points.size();
    Point origin{0.0, 0.0}, sum{0.0, 0.0};
    for (const Point& p : points) origin = {origin.x + p.x / double(n), origin.y + p.y / double(n)};
    double area = 0.0, xx = 0.0, yy = 0.0, xy = 0.0;
    for (size_t i = 0; i < n; i++) {
      const Point a = points[i] - origin, b = points[(i + 1) % n] - origin;
      const double cross = a.x * b.y - a.y * b.x;
      area += 0.5 * cross, sum = {sum.x + (a.x + b.x) * cross, sum.y + (a.y + b.y) * cross};
      xx += (a.x * a.x + b.x * b.x + a.x * b.x) * cross, yy += (a.y * a.y + b.y * b.y + a.y * b.y) * cross;
      xy += (a.x * a.y + b.x * b.y + 0.5 * (a.x * b.y + a.y * b.x)) * cross;
    }
    middle = origin;
    if (std::fabs(area) < 1e-6) return;
    const Point off{sum.x / (6.0 * area), sum.y / (6.0 * area)};
    middle = {origin.x + off.x, origin.y + off.y};
    xx = xx / (12.0 * area) - off.x * off.x, yy = yy / (12.0 * area) - off.y * off.y;
    xy = xy / (12.0 * area) - off.x * off.y;
    const double half = 0.5 * (xx + yy), root = std::hypot(0.5 * (xx - yy), xy);
    spread[0] = std::max(half + root, 1e-9), spread[1] = std::max(half - root, 1e-9);
    turn = 0.5 * std::atan2(2.0 * xy, xx - yy);
    fullness = std::fabs(area) / std::sqrt(spread[0] * spread[1]);
  }
};

struct Nearest {
  Primitive shape;
  std::array<double, kMost> values;
  double cost, mean;  // nats; mean squared residual in sigmas
};

class Search {
 public:
  Search(int64_t count, const double* points, const double* weights, double price) : price_(price), known_(count) {
    for (int64_t i = 0; i < count; i++) {
      all_.push_back({points[2 * i], points[2 * i + 1]});
      known_[i] = weights[i] > 0.0;
      if (known_[i]) at_.push_back(all_.back()), sure_.push_back(weights[i]);
    }
    const int64_t n = int64_t(at_.size());
    for (int64_t k = 0; k < kFew; k++) {
      const auto i = int64_t(double(n - 1) * (double(k) / double(kFew - 1)));
      if (n > 0 && (few_.empty() || few_.back() != i)) few_.push_back(i);
    }
  }

  // The cheapest primitive, null where none comes near.
  const Nearest* nearest() {
    const auto n = double(all_.size());
    if (int64_t(at_.size()) < kFewest) return nullptr;
    Solid solid(all_);
    const bool whole = (n - double(at_.size())) / n <= kMostHidden;
    if (whole && solid.fullness < kLeastFullness) return nullptr;
    const auto box = box_around(at_, 0.0);
    span_ = 2.0 * std::hypot(box[2], box[3]);
    if (!whole) {
      solid.middle = {box[0], box[1]}, solid.turn = 0.0;
      for (int c = 0; c < 2; c++) solid.spread[c] = 4.0 * box[2 + c] * box[2 + c] / 14.0;
    }
    const double tilt = box_angle(at_), x = solid.middle.x, y = solid.middle.y;
    const double sizes[2] = {2.0 * std::sqrt(solid.spread[0]), 2.0 * std::sqrt(solid.spread[1])};
    const auto tilted = box_around(at_, tilt);
    const auto level = [&](double last) { return std::array<double, kMost>{box[0], box[1], box[2], box[3], last}; };
    attempt({Primitive::circle, false, false}, {x, y, 0.5 * (sizes[0] + sizes[1])});
    attempt({Primitive::ellipse, false, false}, level(0.0));
    attempt({Primitive::ellipse, false, true}, {x, y, sizes[0], sizes[1], solid.turn});
    attempt({Primitive::box, false, false}, level(0.0));
    attempt({Primitive::box, true, false}, level(first_radius(box, 0.0)));
    attempt({Primitive::box, false, true}, {tilted[0], tilted[1], tilted[2], tilted[3], tilt});
    attempt({Primitive::box, true, true},
            {tilted[0], tilted[1], tilted[2], tilted[3], first_radius(tilted, tilt), tilt});
    return found_ ? &best_ : nullptr;
  }

 private:
  double price_;
  std::vector<uint8_t> known_;
  std::vector<Point> all_, at_;  // all points, and those that are known
  std::vector<double> sure_;
  std::vector<int64_t> few_;
  double span_ = 0.0;  // px, the diagonal of the box around the known points
  bool found_ = false;
  Nearest best_{{Primitive::circle, false, false}, {}, 0.0, 0.0};

  // The points of `few_` with their weights.
  void take_few(const std::vector<double>& weights, std::vector<Point>& at, std::vector<double>& own) const {
    for (const int64_t i : few_) at.push_back(at_[i]), own.push_back(weights[i]);
  }

  // The radius, of a few, with which a box has its points nearest: what a corner leaves out says nothing of the radius as
  // long as that is much too small, so least squares would not find it from there.
  double first_radius(const std::array<double, 4>& box, double angle) const {
    const Primitive shape{Primitive::box, true, true};
    std::vector<Point> at;
    std::vector<double> weights, rest(few_.size());
    take_few(sure_, at, weights);
    double least = std::numeric_limits<double>::infinity(), best = 0.0;
    for (const double share : kRadii) {
      const double values[] = {box[0], box[1], box[2], box[3], share * std::min(box[2], box[3]), angle};
      shape.distances(values, int64_t(at.size()), &at[0].x, rest.data());
      if (const double found = loss(rest, weights.data()); found < least) least = found, best = values[4];
    }
    return best;
  }

  // The weights, with those of points near sharp corners no more than their bias allows.
  std::vector<double> weights_of(const Primitive& shape, const double* v) const {
    std::vector<double> out = sure_;
    if (shape.kind != Primitive::box || shape.rounded) return out;
    const double c = std::cos(shape.angle(v)), s = std::sin(shape.angle(v));
    for (size_t i = 0; i < out.size(); i++) {
      const double dx = at_[i].x - v[0], dy = at_[i].y - v[1];
      const double x = std::fabs(dx * c + dy * s) - v[2], y = std::fabs(dy * c - dx * s) - v[3];
      if (x * x + y * y < kSharpReach * kSharpReach) out[i] = std::min(out[i], kSharpWeight);
    }
    return out;
  }

  void attempt(const Primitive& shape, std::array<double, kMost> values) {
    std::vector<Point> at;
    std::vector<double> few;
    take_few(weights_of(shape, values.data()), at, few);
    const auto first = double(few.size());
    if (fitted(shape, kRounds, int64_t(at.size()), &at[0].x, few.data(), values.data()) > 2.0 * kWorst * first) return;
    const std::vector<double> weights = weights_of(shape, values.data());
    const auto count = int64_t(at_.size());
    const double misfit = fitted(shape, kRounds, count, &at_[0].x, weights.data(), values.data());
    const double mean = misfit / double(count);
    if (!(mean <= kWorst) || !possible(shape, values.data()) || !runs_around(shape, values.data())) return;
    const double angle = shape.angle(values.data());
    const int parameters = (shape.kind == Primitive::circle ? 3 : 4) + (shape.radius(values.data()) > 0.0) +
                           (angle != 0.0);
    const double cost = 0.5 * misfit + price_ * parameters;
    if (!found_ || cost < best_.cost) found_ = true, best_ = {shape, values, cost, mean};
  }

  // Whether values are those of a primitive that may be one: not those of one whose ends lie far beyond its points, as
  // near to both sides of a sliver as that is long.
  bool possible(const Primitive& shape, const double* v) const {
    const double longest = shape.kind == Primitive::circle ? v[2] : std::max(v[2], v[3]);
    if (longest > span_) return false;
    if (shape.kind == Primitive::circle) return true;
    if (shape.kind == Primitive::ellipse) return v[2] > 0.0 && v[3] > 0.0;
    const double radius = shape.radius(v);
    if (std::min(v[2], v[3]) <= kThinnest || (shape.rounded && radius < kLeastRadius)) return false;
    if (std::max(v[2], v[3]) - radius < kLeastSide) return false;
    // A round or slanted end of a thin bar is all corner, and hardly a point among those of its sides. What is known no
    // better than near corners may be a guess at what is hidden.
    std::vector<double> rest(at_.size());
    shape.distances(v, int64_t(at_.size()), &at_[0].x, rest.data());
    for (size_t i = 0; i < rest.size(); i++)
      if (sure_[i] > kSharpWeight && std::fabs(rest[i]) * std::sqrt(sure_[i]) > kFar) return false;
    return true;
  }

  // Whether the known points of a loop run around a primitive as the loop does, rather than there and back along it, and
  // far enough around a circle or an ellipse for it to be one. The two sides of a thin sliver lie as near to a huge circle
  // that touches them as to anything, but enclose nothing like it; and so does a short arc of anything lie near to some
  // circle.
  bool runs_around(const Primitive& shape, const double* v) const {
    double onward = 0.0, back = 0.0, area = 0.0;
    for (size_t i = 0; i < all_.size(); i++) {
      const size_t next = (i + 1) % all_.size();
      const Point a{all_[i].x - v[0], all_[i].y - v[1]}, b{all_[next].x - v[0], all_[next].y - v[1]};
      const double cross = a.x * b.y - a.y * b.x;
      area += cross;
      if (!known_[i] || !known_[next]) continue;
      const double turn = std::atan2(cross, a.x * b.x + a.y * b.y);
      (turn > 0.0 ? onward : back) += std::fabs(turn);
    }
    if (shape.kind != Primitive::box && std::fabs(onward - back) < kLeastTurn) return false;
    return (area > 0.0 ? back : onward) <= kMostBack * (onward + back);
  }
};

}  // namespace
}  // namespace cs

extern "C" {

// The cheapest primitive through a closed loop of points (x 2) with weights. form: kind, rounded and turned; values: 6;
// told: cost and mean squared residual. 0 where none comes near, -1 where there is no memory, else 1.
CS_EXPORT int64_t cs_nearest_primitive(int64_t count, const double* points, const double* weights, double price,
                                       int32_t* form, double* values, double* told) {
  return cs::counted([&] {
    cs::Search search(count, points, weights, price);
    const cs::Nearest* found = search.nearest();
    if (!found) return 0;
    const double *v = found->values.data(), radius = found->shape.radius(v), angle = found->shape.angle(v);
    const double out[6] = {v[0], v[1], v[2], v[3], radius, angle};
    form[0] = found->shape.kind, form[1] = found->shape.rounded, form[2] = found->shape.turned;
    std::copy(out, out + 6, values), told[0] = found->cost, told[1] = found->mean;
    return 1;
  });
}
}
