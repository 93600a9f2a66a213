// Whole loops of points divided into lines and cubics: which corners are real, and the runs between them. What is meant is
// said in tests/outline_loops.py (`laid_out`).
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "abi.h"
#include "divide.h"

namespace cs {
namespace {

constexpr double kCornerReach = 1.4;  // px around a corner in which points are biased; up to twice that they count less
constexpr double kTipWidth = 0.6;     // px between the flanks of a thin tip below which its points are biased
constexpr double kSharpestTip = 0.12;  // sine of half of the angle of a tip, below which its points are not more biased
constexpr int64_t kFewestKnown = 4;    // points of a run that is more than a straight line
// A corner is doubted, and kept only if it pays, when it turns less, or is nearer to another, than this: 45 degrees, px.
constexpr double kDoubtfulTurn = 0.7853981633974483, kDoubtfulSpacing = 6.0;
constexpr int kCornerParameters = 2;
constexpr double kRoundingTurn = 1.3962634015954636;  // of a false corner along a rounding, at most: 80 degrees
constexpr double kRoundingStep = 12.0;                // px between false corners along one rounding, at most
constexpr Errors kCornerErrors = {0.15, 0.3};  // px and radians: how well the ends at corners are known beforehand
constexpr double kMostTurned = 0.5;            // radians by which a tangent is carried on to the corner
constexpr int64_t kPadding = 20;               // points beyond either end of a loop, as many as the widest window has
constexpr int64_t kBlock = 32;                 // points with one box around them

// A place where two flanks of a loop meet at an angle; sure: nothing may take it away; index: of the point after it.
struct Corner {
  int64_t index;
  Point at;
  double turn;
  bool sure;

  double reach() const {
    const double sine = std::sin(0.5 * (3.141592653589793 - std::fabs(turn)));
    return std::max(kTipWidth / std::max(sine, kSharpestTip), kCornerReach);
  }

  // By how much a point is clear of the corner: 0 within its reach, 1 from twice that on.
  double clear(Point point, double reach) const {
    const double share = std::clamp((point - at).length() / reach - 1.0, 0.0, 1.0);
    return share * share;
  }
};

// A closed loop of points (x 2) with their weights, its runs between corners divided, each once.
class Loop {
 public:
  Loop(int64_t count, const double* points, const double* weights, double price)
      : count_(count), points_(count), weights_(weights, weights + count), price_(price) {
    for (int64_t i = 0; i < count; i++) points_[i] = {points[2 * i], points[2 * i + 1]};
  }

  // The corners less those that cost more than doing without: first groups in a row, then each, faintest first.
  void drop_doubtful(std::vector<Corner>& corners) {
    for (const std::vector<int64_t>& group : groups(corners)) drop_if_cheaper(corners, group);
    std::vector<Corner> faintest = corners;
    std::stable_sort(faintest.begin(), faintest.end(),
                     [](const Corner& a, const Corner& b) { return std::fabs(a.turn) < std::fabs(b.turn); });
    for (const Corner& corner : faintest)
      if (doubtful(corners, corner)) drop_if_cheaper(corners, {corner.index});
  }

  // How many points there are from one corner on to another.
  int64_t size(const Corner& from, const Corner& to) const { return (to.index - from.index - 1 + count_) % count_ + 1; }

  // The run from corner i on to corner j, both modulo their number, divided.
  const Division& between(const std::vector<Corner>& corners, int64_t i, int64_t j) {
    const int64_t count = int64_t(corners.size());
    const Corner &from = corners[(i + count) % count], &to = corners[j % count];
    const auto found = known_.find({from.index, to.index});
    if (found != known_.end()) return found->second;
    return known_[{from.index, to.index}] = divided(run(from, to), price_);
  }

  // The whole loop without corners, divided from two starting points; the cheaper one. *start: its first point.
  const Division& whole(int64_t* start) {
    if (whole_.pieces.empty()) {
      Section all = loop_section();
      int64_t first = 0;
      for (int64_t i = 1; i < count_; i++)
        if (all.sure(i) && (!all.sure(first) || all.at[i].x < all.at[first].x)) first = i;
      whole_ = divided(turned(all, first), price_), start_ = first;
      if (const size_t many = whole_.pieces.size(); many > 1) {
        const int64_t other = (first + whole_.pieces[1 + (many - 1) / 2].first) % count_;
        Division again = divided(turned(all, other), price_);
        if (again.cost < whole_.cost) whole_ = std::move(again), start_ = other;
      }
    }
    *start = start_;
    return whole_;
  }

  // The weights with the points next to the corners left out.
  void clear(const std::vector<Corner>& corners, double* out) const {
    std::copy(weights_.begin(), weights_.end(), out);
    for (int64_t low = 0; low < count_; low += kBlock) {
      const int64_t high = std::min(low + kBlock, count_);
      Point least = points_[low], most = least;
      for (int64_t i = low; i < high; i++) {
        least = {std::min(least.x, points_[i].x), std::min(least.y, points_[i].y)};
        most = {std::max(most.x, points_[i].x), std::max(most.y, points_[i].y)};
      }
      for (const Corner& corner : corners) {
        const double reach = corner.reach(), far = 2.0 * reach;
        if (corner.at.x < least.x - far || corner.at.y < least.y - far) continue;
        if (corner.at.x > most.x + far || corner.at.y > most.y + far) continue;
        for (int64_t i = low; i < high; i++) out[i] *= corner.clear(points_[i], reach);
      }
    }
  }

 private:
  int64_t count_;
  std::vector<Point> points_;
  std::vector<double> weights_;
  double price_;
  std::map<std::pair<int64_t, int64_t>, Division> known_;
  Division whole_{{}, 0.0};
  int64_t start_ = 0;

  // The points from one corner on to another.
  Section run(const Corner& from, const Corner& to) const {
    Section out;
    const int64_t size = this->size(from, to);
    std::vector<Point> points(size);
    out.weights.resize(size);
    const Corner* corners[2] = {&from, &to};
    const double reaches[2] = {from.reach(), to.reach()};
    int64_t known = 0, first = 0, last = 0;
    for (int64_t i = 0; i < size; i++) {
      const int64_t own = (from.index + i) % count_;
      points[i] = points_[own], out.weights[i] = weights_[own];
      for (int e = 0; e < 2; e++) out.weights[i] *= corners[e]->clear(points[i], reaches[e]);
      if (out.sure(i)) last = i, first = known++ ? first : i;
    }
    out.ends[0] = from.at, out.ends[1] = to.at, out.errors[0] = out.errors[1] = kCornerErrors, out.corners = true;
    if (known < kFewestKnown) {
      out.weights.assign(size, 0.0);
      straighten(out, size);
      return out;
    }
    out.fit(points);
    out.tangents[0] = towards(out, first, from.at), out.tangents[1] = towards(out, last, to.at);
    return out;
  }

  static void straighten(Section& run, int64_t size) {
    const Point a = run.ends[0], b = run.ends[1], way = (b - a) / std::max((b - a).length(), 1e-9);
    run.tangents[0] = run.tangents[1] = way;
    run.at.resize(size), run.along.assign(size, way), run.bend.assign(size, 0.0), run.known_to.assign(size, {1.0, 1.0});
    for (int64_t i = 0; i < size; i++) {
      const double t = (double(i) + 0.5) / double(size);
      run.at[i] = a * (1.0 - t) + b * t;
    }
  }

  // The tangent at an end, carried there from a point by the curvature.
  static Point towards(const Section& run, int64_t i, Point end) {
    const Point t = run.along[i];
    const double turn = std::clamp(run.bend[i] * dot(end - run.at[i], t), -kMostTurned, kMostTurned);
    const double cosine = std::cos(turn), sine = std::sin(turn);
    return {cosine * t.x - sine * t.y, sine * t.x + cosine * t.y};
  }

  Section loop_section() const {
    const int64_t pad = std::min(kPadding, count_);
    Section wide;
    std::vector<Point> points(count_ + 2 * pad);
    wide.weights.resize(points.size());
    for (int64_t i = 0; i < int64_t(points.size()); i++)
      points[i] = points_[(i + count_ - pad) % count_], wide.weights[i] = weights_[(i + count_ - pad) % count_];
    wide.fit(points);
    wide.corners = false;
    return taken(wide, pad);
  }

  // `count_` points of a run from one on, which come round again.
  Section taken(const Section& run, int64_t first) const {
    Section out;
    const int64_t size = int64_t(run.at.size());
    for (int64_t n = 0; n < count_; n++) {
      const int64_t i = (first + n) % size;
      out.at.push_back(run.at[i]), out.along.push_back(run.along[i]), out.bend.push_back(run.bend[i]);
      out.weights.push_back(run.weights[i]), out.known_to.push_back(run.known_to[i]);
    }
    out.corners = run.corners;
    return out;
  }

  Section turned(const Section& all, int64_t first) const {
    Section out = taken(all, first);
    for (int e = 0; e < 2; e++) {
      out.ends[e] = out.at[0], out.tangents[e] = out.along[0];
      for (int c = 0; c < 2; c++) out.errors[e][c] = std::max(out.known_to[0][c], kLeastError);
    }
    return out;
  }

  // The indices of doubtful corners that follow each other closely, two or more, as along a rounding.
  static std::vector<std::vector<int64_t>> groups(const std::vector<Corner>& corners) {
    const int64_t count = int64_t(corners.size());
    std::vector<uint8_t> linked(count);
    int64_t start = -1;
    for (int64_t i = 0; i < count; i++) {
      const Corner &a = corners[i], &b = corners[(i + 1) % count];
      linked[i] = std::fabs(a.turn) < kRoundingTurn && std::fabs(b.turn) < kRoundingTurn && !a.sure && !b.sure &&
                  (a.at - b.at).length() <= kRoundingStep && a.turn * b.turn > 0.0;
      if (!linked[i] && start < 0) start = i;
    }
    std::vector<std::vector<int64_t>> out;
    for (int64_t n = 1, size = 0; n <= count; n++) {
      const int64_t i = (start + n + count) % count;
      if (size == 0 && (linked[i] || start < 0)) out.push_back({}), size = 1;
      if (size > 0) out.back().push_back(corners[i].index);
      if (!linked[i]) size = 0;
    }
    if (start < 0 && count < 2) out.clear();
    return out;
  }

  static bool doubtful(const std::vector<Corner>& corners, const Corner& corner) {
    if (corner.sure) return false;
    if (std::fabs(corner.turn) < kDoubtfulTurn) return true;
    return std::any_of(corners.begin(), corners.end(), [&](const Corner& other) {
      return other.index != corner.index && (other.at - corner.at).length() <= kDoubtfulSpacing;
    });
  }

  // Drops a group of corners (their indices, in a row), if that is cheaper.
  void drop_if_cheaper(std::vector<Corner>& corners, const std::vector<int64_t>& group) {
    const int64_t count = int64_t(corners.size()), size = int64_t(group.size());
    int64_t first = 0;
    while (corners[first].index != group[0]) first++;
    double with_them = 0.0, without;
    if (size == count) {
      int64_t start;
      for (int64_t k = 0; k < count; k++) with_them += between(corners, k, k + 1).cost;
      without = whole(&start).cost;
    } else {
      for (int64_t k = first - 1; k < first + size; k++) with_them += between(corners, k, k + 1).cost;
      without = between(corners, first - 1, first + size).cost;
    }
    if (without > with_them + kCornerParameters * double(size) * price_) return;
    corners.erase(std::remove_if(corners.begin(), corners.end(),
                                 [&](const Corner& corner) {
                                   return std::find(group.begin(), group.end(), corner.index) != group.end();
                                 }),
                  corners.end());
  }
};

}  // namespace
}  // namespace cs

extern "C" {

// Divides a closed loop of points (x 2) with weights at those of its corners (index, position x 2, turn, sure) that pay:
// see `laid_out` in tests/outline_loops.py. kept: corners; chosen: count. sizes to from_corner: room for 2 x count + 2 pieces.
// Returns how many there are, -1 where there is no memory.
CS_EXPORT int64_t cs_lay_out(int64_t count, const double* points, const double* weights, int64_t corners,
                             const int64_t* index, const double* position, const double* turn, const uint8_t* sure,
                             double price, uint8_t* kept, int64_t* start, double* chosen, int64_t* sizes,
                             double* anchors, double* handles, uint8_t* lines, uint8_t* level, uint8_t* from_corner) {
  using namespace cs;
  return counted([&] {
    Loop loop(count, points, weights, price);
    std::vector<Corner> left;
    for (int64_t i = 0; i < corners; i++)
      left.push_back({index[i], {position[2 * i], position[2 * i + 1]}, turn[i], sure[i] != 0});
    loop.drop_doubtful(left);
    loop.clear(left, chosen);
    std::fill(kept, kept + corners, 0);
    for (int64_t i = 0, k = 0; i < corners && k < int64_t(left.size()); i++)
      if (left[k].index == index[i]) kept[i] = 1, k++;
    PieceArrays out{sizes, anchors, handles, lines, level, from_corner};
    if (left.empty())
      out.write(loop.whole(start), count, false);
    else
      *start = left[0].index;
    for (int64_t k = 0; k < int64_t(left.size()); k++)
      out.write(loop.between(left, k, k + 1), loop.size(left[k], left[(k + 1) % left.size()]), true);
    return out.count;
  });
}
}
