// Corners of a loop of boundary points: where two flanks meet at an angle, and exactly where. How they are told is said in
// artwork/geometry/fitting.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "abi.h"
#include "local_fits.h"

namespace cs {
namespace {

constexpr double kSureSigma = 0.3;                    // px: less certain points take no part
constexpr double kGap = 1.0;                          // px to either side of a place that are not looked at
constexpr double kFarthest = 4.5;                     // px from the place to the nearest point of a flank
constexpr double kWidestGap = 14.0;                   // px of unknown points in which a thin tip may lie
constexpr double kFirstMisfit = 4.0;                  // of the shortest flank
constexpr double kSmallestTurn = 0.3490658503988659;  // radians: 20 degrees
constexpr double kSureTurn = 5.0;                     // standard errors
constexpr double kBluntTurn =
    2.6179938779914944;            // radians, above which a tip may end before its flanks meet: 150 degrees
constexpr double kSpacing = 2.0;   // px between corners
constexpr double kRounding = 0.3;  // px that points near a sharp corner may stay away from its flanks
constexpr double kHalfTurn = 3.141592653589793;
constexpr int64_t kLongest = 12, kMargin = 6;  // points of the longest flank less one; more beyond either end of a loop
constexpr int kBetween = 7;                    // points between two flanks that may contradict a corner, at most

// Flanks from the shortest on: their points less one, the degree of their polynomial, and the mean squared residual in
// squared sigmas up to which they are believed.
struct Kind {
  int64_t length;
  int degree;
  double most() const { return length == 2 ? kFirstMisfit : 1.0 + 2.0 * std::sqrt(2.0 / double(length - degree)); }
};
using Kinds = std::vector<Kind>;
// Lines alone, and parabolas where there are enough points.
const Kinds kStraight = {{2, 1}, {3, 1}, {5, 1}, {8, 1}}, kBent = {{2, 1}, {3, 1}, {5, 2}, {8, 2}, {12, 2}};

// The run on one side of a place, extrapolated to it: where, which way along the loop, the standard error of that in
// radians, infinite where there is no run, and its point nearest to the place.
struct Flank {
  Point at, tangent;
  double error;
  int64_t first;
};

// How a loop turns at a place, and where its flanks meet; a score of 0 is no corner.
struct Judgement {
  double turn, score;
  Point meet;
};

double size(Point a) { return std::sqrt(dot(a, a)); }

class Chain {
 public:
  // The points (x 2) of a closed loop that are known well, with some more of them beyond either end.
  Chain(int64_t count, const double* points, const double* weights) {
    std::vector<int64_t> known;
    std::vector<double> length(count + 1, 0.0);
    for (int64_t i = 0; i < count; i++) {
      if (weights[i] > 1.0 / (kSureSigma * kSureSigma)) known.push_back(i);
      const double *a = points + 2 * i, *b = points + 2 * ((i + 1) % count);
      length[i + 1] = length[i] + std::hypot(b[0] - a[0], b[1] - a[1]);
    }
    this->known = int64_t(known.size());
    if (this->known < 6) return;
    pad = std::min(this->known, kLongest + kMargin);
    for (int64_t n = -pad; n < this->known + pad; n++) {
      const int64_t around = (n + this->known) / this->known - 1, own = known[n - around * this->known];
      index.push_back(own), at.push_back({points[2 * own], points[2 * own + 1]}), weight.push_back(weights[own]);
      s.push_back(length[own] + length[count] * double(around));
    }
  }

  int64_t known, pad = 0;
  std::vector<int64_t> index;
  std::vector<Point> at;
  std::vector<double> weight, s;

  // The flank after (step 1) or before (-1) the place between point i and the next one, by the widest believed fit.
  Flank flank(int64_t i, int64_t step, const Kinds& kinds) const {
    const int64_t count = int64_t(at.size());
    const double place = 0.5 * (s[i] + s[i + 1]), spread = s[i + 1] - s[i];
    const double farthest = spread < kWidestGap ? std::max(kFarthest, 0.5 * spread + 2.0) : kFarthest;
    int64_t start = step > 0 ? i + 1 : i;
    while (start >= 0 && start < count && double(step) * (s[start] - place) < kGap) start += step;
    const int64_t near = std::clamp<int64_t>(start, 0, count - 1);
    const Point origin = at[near];
    Flank out{origin, {double(step), 0.0}, INFINITY, near};
    if (start < 0 || start >= count || double(step) * (s[near] - place) > farthest) return out;
    Moments sums;
    int64_t next = start;
    for (const Kind& kind : kinds) {
      const int64_t last = start + step * kind.length;
      if (last < 0 || last >= count || std::fabs(s[last] - s[near]) > 2.0 * double(kind.length)) break;
      for (; next != last + step; next += step)
        sums.add(s[next] - place, weight[next], at[next].x - origin.x, at[next].y - origin.y);
      Polynomial curve(kind.degree);
      if (!(curve.fit(sums) / double(kind.length - kind.degree) <= kind.most())) break;
      const Point way{curve.of[1][0], curve.of[1][1]};
      const double speed = std::max(size(way), kSlow);
      out.error = std::sqrt(curve.variance[1]);
      out.at = {origin.x + curve.of[0][0], origin.y + curve.of[0][1]}, out.tangent = way / speed;
    }
    return out;
  }

  Judgement judge(const Flank& a, const Flank& b) const {
    const double sine = cross(a.tangent, b.tangent);
    Judgement out{std::atan2(sine, dot(a.tangent, b.tangent)), 0.0, {}};
    const double turn = std::fabs(out.turn);
    if (turn < std::max(kSmallestTurn, kSureTurn * std::hypot(a.error, b.error))) return out;
    const double t = std::fabs(sine) > 1e-6 ? cross(b.at - a.at, b.tangent) / sine : 0.0;
    out.meet = a.at + a.tangent * t;
    const double reach = dot(out.meet - at[a.first], a.tangent);
    const double onward = dot(at[b.first] - out.meet, b.tangent), far = std::max(reach, onward);
    if (!(std::min(reach, onward) > -0.5)) return out;
    // A tip is drawn to where it is half a pixel wide; much farther on there is none, wherever the flanks would meet.
    const double most = kFarthest + 0.5 / std::max(std::tan(0.5 * (kHalfTurn - turn)), 0.15);
    if (far > most) {
      if (turn <= kBluntTurn) return out;
      out.meet = (at[a.first] + at[b.first] + (a.tangent - b.tangent) * most) * 0.5;
    }
    if (contradiction(out.meet, a, b) <= kRounding) out.score = 2.0 + turn - 0.15 * std::fabs(reach - onward);
    return out;
  }

 private:
  // Largest distance from the two flanks, extended to where they meet, of the points between them.
  double contradiction(Point meet, const Flank& a, const Flank& b) const {
    double worst = 0.0;
    for (int64_t i = a.first + 1; i < b.first && i <= a.first + kBetween; i++) {
      const Point p = at[i] - meet, back{-a.tangent.x, -a.tangent.y};
      double nearest = INFINITY;
      for (const Point way : {back, b.tangent}) {
        const double on = std::max(dot(p, way), 0.0);
        nearest = std::min(nearest, size(p - way * on));
      }
      worst = std::max(worst, nearest);
    }
    return worst;
  }
};

struct Found {
  double score, turn;
  Point meet;
  int64_t before, after;  // points of the loop next to the flanks' ends
};

// The strongest corners, none within kSpacing of a stronger one, in order along the loop.
std::vector<Found> strongest(const std::vector<Found>& able) {
  std::vector<size_t> order(able.size()), chosen;
  for (size_t k = 0; k < order.size(); k++) order[k] = k;
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return able[a].score > able[b].score; });
  std::map<std::pair<int64_t, int64_t>, std::vector<Point>> cells;
  for (const size_t k : order) {
    const Point own = able[k].meet;
    const auto column = int64_t(std::floor(own.x / kSpacing)), row = int64_t(std::floor(own.y / kSpacing));
    bool free = true;
    for (int64_t cell = 0; cell < 9 && free; cell++) {
      const auto near = cells.find({column + cell % 3 - 1, row + cell / 3 - 1});
      if (near == cells.end()) continue;
      for (const Point& other : near->second) free = free && size(own - other) > kSpacing;
    }
    if (free) chosen.push_back(k), cells[{column, row}].push_back(own);
  }
  std::sort(chosen.begin(), chosen.end());
  std::vector<Found> out;
  for (const size_t k : chosen) out.push_back(able[k]);
  return out;
}

// Which point of a loop (x 2) is the first one after a corner that lies between two of them.
int64_t first_after(int64_t count, const double* points, const Found& corner) {
  const auto away = [&](int64_t i) { return size(Point{points[2 * i], points[2 * i + 1]} - corner.meet); };
  double least = INFINITY;
  int64_t out = corner.after;
  for (int64_t i = corner.before; i != corner.after; i = (i + 1) % count) {
    const int64_t next = (i + 1) % count;
    if (const double both = away(i) + away(next); both < least) least = both, out = next;
  }
  return out;
}

}  // namespace
}  // namespace cs

extern "C" {

// The corners of a closed loop of points (x 2) with weights: the index of the first point after each, ascending, positions
// (x 2) and turns, room for count each. Returns how many there are, -1 where there is no memory.
CS_EXPORT int64_t cs_corners(int64_t count, const double* points, const double* weights, int64_t* indices,
                             double* positions, double* turns) {
  using namespace cs;
  return counted([&] {
    const Chain chain(count, points, weights);
    if (chain.known < 6) return int64_t(0);
    std::vector<Found> able;
    for (int64_t i = chain.pad; i < chain.pad + chain.known; i++) {
      const Flank before = chain.flank(i, -1, kStraight), after = chain.flank(i, 1, kStraight);
      Judgement found = chain.judge(before, after);
      if (std::fabs(found.turn) < kSmallestTurn) continue;
      // A corner is one by lines and by parabolas; the smaller turn is the better founded one.
      const Judgement bent = chain.judge(chain.flank(i, -1, kBent), chain.flank(i, 1, kBent));
      if (std::fabs(bent.turn) < std::fabs(found.turn)) found = bent;
      if (!(found.score > 0.0) || !std::isfinite(found.meet.x) || !std::isfinite(found.meet.y)) continue;
      able.push_back({found.score, found.turn, found.meet, chain.index[before.first], chain.index[after.first]});
    }
    std::map<int64_t, Found> by_index;
    for (const Found& corner : strongest(able)) by_index.insert({first_after(count, points, corner), corner});
    int64_t n = 0;
    for (const auto& [index, corner] : by_index) {
      indices[n] = index, turns[n] = corner.turn;
      positions[2 * n] = corner.meet.x, positions[2 * n + 1] = corner.meet.y, n++;
    }
    return n;
  });
}
}
