// Cubics fitted to runs of points, and the feet of points on cubics. What they cost is in artwork/tracing/sections.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <vector>

#include "abi.h"
#include "cubic.h"

namespace cs {
namespace {

constexpr int kValues = 6;  // of a cubic: see `Run`

// Solves a x = b for a symmetric positive definite matrix, by Cholesky's decomposition in place of `a`.
void solve(double (*a)[kValues], double* x) {
  for (int i = 0; i < kValues; i++) {
    for (int j = 0; j <= i; j++) {
      double sum = a[i][j];
      for (int k = 0; k < j; k++) sum -= a[i][k] * a[j][k];
      a[i][j] = i == j ? std::sqrt(sum) : sum / a[j][j];
    }
    for (int k = 0; k < i; k++) x[i] -= a[i][k] * x[k];
    x[i] /= a[i][i];
  }
  for (int i = kValues - 1; i >= 0; i--) {
    for (int k = i + 1; k < kValues; k++) x[i] -= a[k][i] * x[k];
    x[i] /= a[i][i];
  }
}

// A cubic whose control points are base (8) + values (6) times directions (6 x 8). The first two values, the handle
// lengths, stay from least to most; all are pulled towards `expected` with `stiffness`.
struct Run {
  const double *base, *directions, *expected, *stiffness;
  double least, most;

  void cubic(const double* values, double* out) const {
    std::copy(base, base + 8, out);
    for (int v = 0; v < kValues; v++)
      for (int k = 0; k < 8; k++) out[k] += values[v] * directions[8 * v + k];
  }

  // One Gauss-Newton step of the values, for the distances of points along the normal.
  void improve(const double* cubic, int count, const double* points, const double* weights, const double* u,
               double* values) const {
    double gram[kValues][kValues] = {}, slope[kValues];
    for (int v = 0; v < kValues; v++) gram[v][v] = stiffness[v], slope[v] = stiffness[v] * (expected[v] - values[v]);
    for (int i = 0; i < count; i++) {
      const Place place(cubic, u[i]);
      const double speed = std::max(std::hypot(place.first.x, place.first.y), kLeast);
      const Point normal{-place.first.y / speed, place.first.x / speed};
      const double rest = (points[2 * i] - place.at.x) * normal.x + (points[2 * i + 1] - place.at.y) * normal.y;
      double column[kValues];
      for (int v = 0; v < kValues; v++) {
        const double* way = directions + 8 * v;
        column[v] = 0.0;
        for (int k = 0; k < 4; k++) column[v] += place.basis[k] * (normal.x * way[2 * k] + normal.y * way[2 * k + 1]);
      }
      for (int v = 0; v < kValues; v++) {
        const double weighted = weights[i] * column[v];
        slope[v] += weighted * rest;
        for (int w = 0; w <= v; w++) gram[v][w] += weighted * column[w];
      }
    }
    solve(gram, slope);
    for (int v = 0; v < kValues; v++) values[v] += slope[v];
    for (int v = 0; v < 2; v++) values[v] = std::clamp(values[v], least, most);
  }
};

constexpr int kSamples = 20, kRounds = 3;
constexpr double kShortest = 0.03, kLongest = 1.0;  // handles, of the run's length
constexpr double kOutlying = 3.0;                   // standard errors beyond which a distance counts linearly
constexpr double kHopeless =
    400.0;  // misfit, per price of a parameter and per point, of a rough cubic without a future
constexpr double kLineSlack = 0.00872664625997165;  // radians, between a line and the tangent where it meets a cubic
constexpr double kSteepest = 30.0;                  // such slacks, beyond which the angle counts no more

double huber(double size) { return size <= kOutlying ? size * size : kOutlying * (2.0 * size - kOutlying); }

double dot(Point a, Point b) { return a.x * b.x + a.y * b.y; }

// Nats for the angle between a line along `way` and the tangent where it meets a smooth run, known to `error` radians.
double strain(Point way, Point tangent, double error) {
  const double angle = std::atan2(way.x * tangent.y - way.y * tangent.x, dot(way, tangent));
  const double size = std::min(std::fabs(angle) / (kLineSlack + error), kSteepest);
  return 0.5 * size * size;
}

// A run of points between two ends that are known only roughly: `errors`, px across it and radians. Each point counts
// `share` times.
struct Sampled {
  Point ends[2], tangents[2];
  double errors[2][2], share;
  double points[2 * kSamples], single[kSamples], weights[kSamples], u[kSamples], length;

  // Parameters by chord length.
  void start() {
    Point last = ends[0];
    length = 0.0;
    for (int k = 0; k < kSamples; k++) {
      length += std::hypot(points[2 * k] - last.x, points[2 * k + 1] - last.y);
      last = {points[2 * k], points[2 * k + 1]};
      u[k] = length;
    }
    length = std::max(length + std::hypot(ends[1].x - last.x, ends[1].y - last.y), 1e-9);
    for (double& at : u) at /= length;
  }

  // The misfit of a cubic at some parameters.
  double misfit(const double* cubic, const double* at) const {
    double sum = 0.0;
    for (int k = 0; k < kSamples; k++) {
      const Point found = Place(cubic, at[k]).at;
      const double x = found.x - points[2 * k], y = found.y - points[2 * k + 1];
      sum += share * huber(std::sqrt((x * x + y * y) * single[k]));
    }
    return sum;
  }

  // The cubic with the ends and tangents as given, after one step of least squares for the handle lengths.
  double rough(double* cubic) const {
    const Point first = tangents[0], last{-tangents[1].x, -tangents[1].y};
    double a11 = 0.0, a22 = 0.0, a12 = 0.0, r1 = 0.0, r2 = 0.0;
    for (int k = 0; k < kSamples; k++) {
      const double t = u[k], v = 1.0 - t, b0 = v * v * v, b1 = 3.0 * v * v * t, b2 = 3.0 * v * t * t, b3 = t * t * t;
      const Point across{points[2 * k] - (b0 + b1) * ends[0].x - (b2 + b3) * ends[1].x,
                         points[2 * k + 1] - (b0 + b1) * ends[0].y - (b2 + b3) * ends[1].y};
      a11 += weights[k] * b1 * b1, a22 += weights[k] * b2 * b2, a12 += weights[k] * b1 * b2;
      r1 += weights[k] * b1 * dot(across, first), r2 += weights[k] * b2 * dot(across, last);
    }
    a12 *= dot(first, last);
    const double ridge = 1e-3 * (a11 + a22) + 1e-9, third = length / 3.0;
    a11 += ridge, a22 += ridge, r1 += ridge * third, r2 += ridge * third;
    const double scale = a11 * a22 - a12 * a12;
    const double out = std::clamp((a22 * r1 - a12 * r2) / scale, kShortest * length, kLongest * length);
    const double in = std::clamp((a11 * r2 - a12 * r1) / scale, kShortest * length, kLongest * length);
    const Point p[4] = {ends[0],
                        {ends[0].x + out * first.x, ends[0].y + out * first.y},
                        {ends[1].x + in * last.x, ends[1].y + in * last.y},
                        ends[1]};
    for (int k = 0; k < 4; k++) cubic[2 * k] = p[k].x, cubic[2 * k + 1] = p[k].y;
    double at[kSamples];
    for (int k = 0; k < kSamples; k++) at[k] = std::clamp(nearer(cubic, points + 2 * k, u[k]), 0.0, 1.0);
    return misfit(cubic, at);
  }

  // The best cubic, whose ends and tangents move as far as their errors allow. Its six values are two handle lengths, two
  // shifts of the ends and two of the handles across the run. Straight runs leave the handles open: they are pulled
  // gently towards thirds.
  double exact(double* cubic) const {
    double base[8], directions[kValues][8] = {}, expected[kValues] = {}, stiffness[kValues], at[kSamples];
    const double sizes[kValues] = {0.5 * length,
                                   0.5 * length,
                                   errors[0][0],
                                   errors[1][0],
                                   errors[0][1] * length / 3.0,
                                   errors[1][1] * length / 3.0};
    for (int v = 0; v < kValues; v++) stiffness[v] = (v < 2 ? 0.1 : 1.0) / std::pow(std::max(sizes[v], 1e-6), 2);
    expected[0] = expected[1] = length / 3.0;
    const auto set = [&](int value, int control, double x, double y) {
      directions[value][2 * control] = x, directions[value][2 * control + 1] = y;
    };
    for (int e = 0; e < 2; e++) {
      const int end = 3 * e, handle = 1 + e;
      const double sign = e ? -1.0 : 1.0, x = -tangents[e].y, y = tangents[e].x;
      base[2 * end] = base[2 * handle] = ends[e].x, base[2 * end + 1] = base[2 * handle + 1] = ends[e].y;
      set(e, handle, sign * tangents[e].x, sign * tangents[e].y);
      set(2 + e, end, x, y), set(2 + e, handle, x, y), set(4 + e, handle, x, y);
    }
    const Run run{base, directions[0], expected, stiffness, kShortest * length, kLongest * length};
    double values[kValues];
    std::copy(expected, expected + kValues, values), std::copy(u, u + kSamples, at);
    for (int round = 0; round <= kRounds; round++) {
      if (round > 0) run.improve(cubic, kSamples, points, weights, at, values);
      run.cubic(values, cubic);
      for (int k = 0; k < kSamples; k++) at[k] = std::clamp(nearer(cubic, points + 2 * k, at[k]), 0.0, 1.0);
    }
    double strained = 0.0;
    for (int v = 2; v < kValues; v++) strained += stiffness[v] * values[v] * values[v];
    return misfit(cubic, at) + strained;
  }

  // The misfit of the best line through the points and near the ends.
  double line() const {
    double x[kSamples + 2], y[kSamples + 2], one[kSamples + 2], many[kSamples + 2];
    for (int k = 0; k < kSamples; k++)
      x[k] = points[2 * k], y[k] = points[2 * k + 1], one[k] = single[k], many[k] = single[k] > 0.0 ? share : 0.0;
    for (int e = 0; e < 2; e++) {
      const int k = kSamples + e;
      x[k] = ends[e].x, y[k] = ends[e].y, one[k] = 1.0 / (errors[e][0] * errors[e][0]), many[k] = 1.0;
    }
    double total = 0.0, mx = 0.0, my = 0.0, xx = 0.0, yy = 0.0, xy = 0.0;
    for (int k = 0; k < kSamples + 2; k++) {
      const double weight = one[k] * many[k];
      total += weight, mx += weight * x[k], my += weight * y[k];
    }
    total = std::max(total, 1e-12), mx /= total, my /= total;
    for (int k = 0; k < kSamples + 2; k++) {
      const double weight = one[k] * many[k];
      x[k] -= mx, y[k] -= my;
      xx += weight * x[k] * x[k], yy += weight * y[k] * y[k], xy += weight * x[k] * y[k];
    }
    const double angle = 0.5 * std::atan2(2.0 * xy, xx - yy), sine = std::sin(angle), cosine = std::cos(angle);
    double sum = 0.0;
    for (int k = 0; k < kSamples + 2; k++)
      sum += many[k] * huber(std::fabs(x[k] * sine - y[k] * cosine) * std::sqrt(one[k]));
    return sum;
  }
};

}  // namespace
}  // namespace cs

extern "C" {

// out: cubics x count parameters, one Newton step from u towards the feet of the points (x 2) on the cubics (x 8).
CS_EXPORT void cs_nearer(int64_t cubics, int64_t count, const double* control, const double* points, const double* u,
                         double* out) {
  using namespace cs;
  for (int64_t n = 0; n < cubics; n++)
    for (int64_t i = n * count; i < (n + 1) * count; i++) out[i] = nearer(control + 8 * n, points + 2 * i, u[i]);
}

// What pieces cost that join pairs of nodes along a run. rank: nodes, how many of the `telling` points (x 2) with their
// weights come before each; at, tangent, errors: nodes x 2; price: of a parameter, nats. cubics (x 8), cubic and line: the
// best cubic, and the misfits of that and of the best line; bends (x 2): nats for the line's angle at either end.
CS_EXPORT void cs_piece_misfits(int64_t pairs, const int64_t* first, const int64_t* last, const int64_t* rank,
                                const double* at, const double* tangent, const double* errors, int64_t telling,
                                const double* points, const double* weights, double price, double* cubics,
                                double* cubic, double* line, double* bends) {
  using namespace cs;
  Sampled run;
  for (int64_t n = 0; n < pairs; n++) {
    const int64_t nodes[2] = {first[n], last[n]}, low = rank[nodes[0]], count = rank[nodes[1]] - low;
    for (int e = 0; e < 2; e++) {
      run.ends[e] = {at[2 * nodes[e]], at[2 * nodes[e] + 1]};
      run.tangents[e] = {tangent[2 * nodes[e]], tangent[2 * nodes[e] + 1]};
      for (int k = 0; k < 2; k++) run.errors[e][k] = errors[2 * nodes[e] + k];
    }
    run.share = double(count) / kSamples;
    for (int k = 0; k < kSamples; k++) {
      const int64_t own = std::min(int64_t(double(low) + double(count) * ((k + 0.5) / kSamples)), telling - 1);
      run.points[2 * k] = points[2 * own], run.points[2 * k + 1] = points[2 * own + 1];
      run.single[k] = weights[own], run.weights[k] = weights[own] * run.share;
    }
    run.start();
    cubic[n] = run.rough(cubics + 8 * n);
    if (cubic[n] < kHopeless * (price + double(count)) || last[n] == first[n] + 1) cubic[n] = run.exact(cubics + 8 * n);
    line[n] = run.line();
    const Point way{run.ends[1].x - run.ends[0].x, run.ends[1].y - run.ends[0].y};
    for (int e = 0; e < 2; e++) bends[2 * n + e] = strain(way, run.tangents[e], run.errors[e][1]);
  }
}

// The cheapest path from the first of `count` nodes to the last one. costs: pairs x 2, of each pair, in the order of their
// first nodes, as a line (kind 0) and as a cubic (kind 1); bend: of a line after a line. path, kinds: room for count - 1
// pairs, from the last one back. Returns how many there are; 0 where there is no memory.
CS_EXPORT int64_t cs_cheapest(int64_t count, int64_t pairs, const int64_t* first, const int64_t* last,
                              const double* costs, double bend, int64_t* path, int64_t* kinds, double* cost) {
  struct Reached {
    double cost = INFINITY;
    int64_t pair = 0;
    int before = 0;  // the kind of the piece before
  };
  try {
    std::vector<Reached> best(2 * count);
    best[1].cost = 0.0;
    for (int64_t n = 0; n < pairs; n++)
      for (int kind = 0; kind < 2; kind++)
        for (int before = 0; before < 2; before++) {
          const double total = best[2 * first[n] + before].cost + (kind + before == 0 ? bend : 0.0) +
                               costs[2 * n + kind];
          Reached& reached = best[2 * last[n] + kind];
          if (total < reached.cost) reached = {total, n, before};
        }
    int64_t node = count - 1, found = 0;
    int kind = best[2 * node + 1].cost < best[2 * node].cost;
    *cost = best[2 * node + kind].cost;
    for (; node > 0; found++) {
      const Reached& reached = best[2 * node + kind];
      path[found] = reached.pair, kinds[found] = kind;
      node = first[reached.pair], kind = reached.before;
    }
    return found;
  } catch (const std::exception&) {
    return 0;
  }
}
}
