// Runs of pieces of a ring for which one line or one cubic stands as well. What they save is said in
// artwork/finish/merges.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "abi.h"
#include "cubic.h"
#include "damped.h"

namespace cs {
namespace {

constexpr double kFar = 1e-6;      // px, of points that have a direction from each other
constexpr double kDamped = 1e-12;  // so that what no point tells stays
constexpr int kFits = 3;

// The unit direction in which a cubic starts whose control points are `step` numbers apart.
Point tangent(const double* p, int step) {
  for (int k = 1; k < 4; k++) {
    const Point way{p[step * k] - p[0], p[step * k + 1] - p[1]};
    const double size = way.length();
    if (size > kFar) return way / size;
  }
  return {1.0, 0.0};
}

// Sums of the weights of points, and of these times x, y, x^2, x y and y^2.
struct Moments {
  double sums[6] = {};

  void add(double weight, double x, double y) {
    const double terms[6] = {1.0, x, y, x * x, x * y, y * y};
    for (int k = 0; k < 6; k++) sums[k] += weight * terms[k];
  }
  void add(const Moments& other) {
    for (int k = 0; k < 6; k++) sums[k] += other.sums[k];
  }
  // Half of chi^2 of the points from the straight line nearest to them.
  double line_cost() const {
    const double x = sums[1] / sums[0], y = sums[2] / sums[0];
    const double xx = sums[3] - x * sums[1], xy = sums[4] - x * sums[2], yy = sums[5] - y * sums[2];
    return std::max(0.25 * (xx + yy - std::hypot(xx - yy, 2.0 * xy)), 0.0);
  }
};

// Points in their order, with weights, and the cubic from one end to the other that is nearest to them.
class CubicFit {
 public:
  std::vector<Point> points;
  std::vector<double> weights;

  // smooth: at the ends, where the directions `ahead` and `back` stay. Writes the control points; returns half of chi^2.
  double fit(Point a, Point b, Point ahead, Point back, bool smooth_a, bool smooth_b, double* cubic) {
    spread(a, b);
    const int at_a = smooth_a ? 1 : 2, unknowns = at_a + (smooth_b ? 1 : 2);
    const Point axes[2] = {{1.0, 0.0}, {0.0, 1.0}};
    std::vector<double> derivatives(2 * size_t(unknowns)), found;
    const auto way = [&](int k) {
      if (k < at_a) return smooth_a ? ahead : axes[k];
      return smooth_b ? back : axes[k - at_a];
    };
    Point handles[2];
    for (int round = 0; round < kFits; round++) {
      equations_.clear(unknowns);
      for (size_t n = 0; n < points.size(); n++) {
        const double t = t_[n], s = 1.0 - t, w[4] = {s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t};
        const double rest[2] = {(w[0] + w[1]) * a.x + (w[2] + w[3]) * b.x - points[n].x,
                                (w[0] + w[1]) * a.y + (w[2] + w[3]) * b.y - points[n].y};
        for (int k = 0; k < unknowns; k++) {
          const Point own = way(k);
          derivatives[2 * k] = w[k < at_a ? 1 : 2] * own.x, derivatives[2 * k + 1] = w[k < at_a ? 1 : 2] * own.y;
        }
        equations_.add<2>(weights[n], derivatives.data(), rest);
      }
      if (!equations_.step(kDamped, found)) return std::numeric_limits<double>::infinity();
      handles[0] = handles[1] = {0.0, 0.0};
      for (int k = 0; k < unknowns; k++) {
        Point& handle = handles[k < at_a ? 0 : 1];
        handle = handle + way(k) * found[k];
      }
      const double control[8] = {
          a.x, a.y, a.x + handles[0].x, a.y + handles[0].y, b.x + handles[1].x, b.y + handles[1].y, b.x, b.y};
      std::copy(control, control + 8, cubic);
      for (size_t n = 0; n < points.size(); n++) t_[n] = std::clamp(nearer(cubic, &points[n].x, t_[n]), 0.0, 1.0);
    }
    if (dot(handles[0], ahead) <= 0.0 || dot(handles[1], back) <= 0.0) return std::numeric_limits<double>::infinity();
    double sum = 0.0;
    for (size_t n = 0; n < points.size(); n++) {
      const Point off = points[n] - Place(cubic, t_[n]).at;
      sum += weights[n] * dot(off, off);
    }
    return 0.5 * sum;
  }

 private:
  std::vector<double> t_;
  NormalEquations equations_;

  // The parameters by the way from point to point.
  void spread(Point a, Point b) {
    t_.resize(points.size());
    double way = 0.0;
    for (size_t n = 0; n < points.size(); n++) {
      const Point step = points[n] - (n == 0 ? a : points[n - 1]);
      t_[n] = way += step.length();
    }
    way += (b - points.back()).length();
    for (double& t : t_) t /= way;
  }
};

struct Ring {
  int64_t pieces;
  const double* cubics;  // pieces x 8
  const uint8_t *lines, *smooth;
  const int64_t* ends;  // pieces: where the samples of each end
  const double *points, *weights;

  int64_t begin(int64_t piece) const { return piece == 0 ? 0 : ends[piece - 1]; }
};

// What may stand for a run, found where that looks worth it. nats: that a parameter is worth before it is settled.
struct Merge {
  int64_t first, count, line, saved;
  double cubic[8], net;
};

class Merges {
 public:
  Merges(const Ring& ring, double nats, double hopeful, double most_turn)
      : ring_(ring), nats_(nats), hopeful_(hopeful), most_turn_(most_turn), moments_(ring.pieces) {
    for (int64_t piece = 0; piece < ring.pieces; piece++)
      for (int64_t n = ring.begin(piece); n < ring.ends[piece]; n++)
        moments_[piece].add(ring.weights[n], ring.points[2 * n] - ring.cubics[0],
                            ring.points[2 * n + 1] - ring.cubics[1]);
  }

  // Whether one piece may stand for a run of `count` from `first` on.
  bool find(int64_t first, int64_t count, Merge& out) {
    const int64_t last = (first + count - 1) % ring_.pieces;
    const double *start = ring_.cubics + 8 * first, *stop = ring_.cubics + 8 * last;
    const Point a{start[0], start[1]}, b{stop[6], stop[7]}, chord = b - a;
    const Point ahead = tangent(start, 2), back = tangent(stop + 6, -2);
    if (chord.length() < kFar || -dot(ahead, back) < most_turn_) return false;
    int64_t saved = 2 * (count - 1);
    bool curved = false;
    Moments moments;
    for (int64_t k = 0; k < count; k++) {
      const int64_t piece = (first + k) % ring_.pieces;
      moments.add(moments_[piece]);
      if (!ring_.lines[piece]) saved += 4, curved = true;
      if (k > 0 && ring_.smooth[piece]) saved--;
    }
    if (count == 1 && !curved) return false;
    out = {first, count, 1, saved, {}, nats_ * double(saved) - hopeful_ * moments.line_cost()};
    for (int k = 0; k < 4; k++)
      out.cubic[2 * k] = a.x + chord.x * k / 3.0, out.cubic[2 * k + 1] = a.y + chord.y * k / 3.0;
    if (out.net > 0.0) return true;
    out.line = 0, out.saved -= 4;
    if (count == 1 || out.saved <= 0) return false;
    gather(first, count);
    const bool smooth_b = ring_.smooth[(last + 1) % ring_.pieces] != 0;
    out.net = nats_ * double(out.saved) -
              hopeful_ * fit_.fit(a, b, ahead, back, ring_.smooth[first] != 0, smooth_b, out.cubic);
    return out.net > 0.0;
  }

 private:
  const Ring& ring_;
  double nats_, hopeful_, most_turn_;
  std::vector<Moments> moments_;
  CubicFit fit_;

  void gather(int64_t first, int64_t count) {
    fit_.points.clear(), fit_.weights.clear();
    for (int64_t k = 0; k < count; k++) {
      const int64_t piece = (first + k) % ring_.pieces;
      for (int64_t n = ring_.begin(piece); n < ring_.ends[piece]; n++)
        fit_.points.push_back({ring_.points[2 * n], ring_.points[2 * n + 1]}), fit_.weights.push_back(ring_.weights[n]);
    }
  }
};

}  // namespace
}  // namespace cs

extern "C" {

// The merges of a ring that look worth a trial: see `merges` in raster/cubics.py. cubics: pieces x 8; fixed: pieces, whether
// their starts stay; shows: pieces, whether any of a piece shows; ends: pieces, where the samples of each end; points: x 2;
// runs: the longest ones where they show and where they do not, and the fewest pieces that are left. numbers: room x 4, the
// first piece, how many, whether a line stands for them, and the parameters saved; nets: room; found: room x 8, the room
// pieces times the longest run. Returns how many there are, -1 where there is no memory.
CS_EXPORT int64_t cs_find_merges(int64_t pieces, const double* cubics, const uint8_t* lines, const uint8_t* smooth,
                                 const uint8_t* fixed, const uint8_t* shows, const int64_t* ends, const double* points,
                                 const double* weights, double nats, double hopeful, double most_turn,
                                 const int64_t* runs, int64_t* numbers, double* nets, double* found) {
  using namespace cs;
  return counted([&] {
    const Ring ring{pieces, cubics, lines, smooth, ends, points, weights};
    Merges merges(ring, nats, hopeful, most_turn);
    int64_t count = 0;
    for (int64_t first = 0; first < pieces; first++)
      for (int64_t length = 1; length <= std::min(runs[1], pieces - runs[2]); length++) {
        const int64_t last = (first + length - 1) % pieces;
        if ((length > 1 && fixed[last]) || (length > runs[0] && (shows[last] || shows[first]))) break;
        Merge merge;
        if (!merges.find(first, length, merge)) continue;
        const int64_t own[4] = {merge.first, merge.count, merge.line, merge.saved};
        std::copy(own, own + 4, numbers + 4 * count);
        std::copy(merge.cubic, merge.cubic + 8, found + 8 * count);
        nets[count++] = merge.net;
      }
    return count;
  });
}
}
