// The best line and the best cubic for a run of points between two nodes. What they cost is in tests/outline_loops.py (`laid_out`).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "cubic.h"

namespace cs {
namespace {

constexpr int kValues = 6;  // of a cubic: see `Sampled::exact`

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

constexpr int kSamples = 20, kRounds = 3;           // samples: a multiple of 4
constexpr double kShortest = 0.03, kLongest = 1.0;  // handles, of the run's length
constexpr double kOutlying = 3.0;                   // standard errors beyond which a distance counts linearly
constexpr double kLineSlack = 0.00872664625997165;  // radians, between a line and the tangent where it meets a cubic
constexpr double kSteepest = 30.0;                  // such slacks, beyond which the angle counts no more

// The sum of products of the samples, in four parts, which vectors hold.
inline double sum_of_products(const double* a, const double* b) {
  double sums[4] = {};
  for (int k = 0; k < kSamples; k += 4)
    for (int lane = 0; lane < 4; lane++) sums[lane] += a[k + lane] * b[k + lane];
  return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

double huber(double size) { return size <= kOutlying ? size * size : kOutlying * (2.0 * size - kOutlying); }

// Nats for the angle between a line along `way` and the tangent where it meets a smooth run, known to `error` radians.
double strain(Point way, Point tangent, double error) {
  const double angle = std::atan2(cross(way, tangent), dot(way, tangent));
  const double size = std::min(std::fabs(angle) / (kLineSlack + error), kSteepest);
  return 0.5 * size * size;
}

// A cubic by the powers of its parameter, with its derivatives.
struct Powers {
  double p[4][2];

  explicit Powers(const double* cubic) {
    for (int c = 0; c < 2; c++) {
      const double a = cubic[c], b = cubic[2 + c], d = cubic[4 + c], e = cubic[6 + c];
      p[0][c] = a, p[1][c] = 3.0 * (b - a), p[2][c] = 3.0 * (a - 2.0 * b + d), p[3][c] = e - a + 3.0 * (b - d);
    }
  }
  double x(double t) const { return at(0, t); }
  double y(double t) const { return at(1, t); }
  double first_x(double t) const { return first(0, t); }
  double first_y(double t) const { return first(1, t); }
  double second_x(double t) const { return second(0, t); }
  double second_y(double t) const { return second(1, t); }

 private:
  double at(int c, double t) const { return ((p[3][c] * t + p[2][c]) * t + p[1][c]) * t + p[0][c]; }
  double first(int c, double t) const { return (3.0 * p[3][c] * t + 2.0 * p[2][c]) * t + p[1][c]; }
  double second(int c, double t) const { return 6.0 * p[3][c] * t + 2.0 * p[2][c]; }
};

// A run of points between two ends that are known only roughly: `errors`, px across it and radians. Each point counts
// `share` times.
struct Sampled {
  Point ends[2], tangents[2];
  double errors[2][2], share;
  double x[kSamples], y[kSamples], single[kSamples], weights[kSamples], u[kSamples], length;

  // Parameters by chord length.
  void start() {
    Point last = ends[0];
    length = 0.0;
    for (int k = 0; k < kSamples; k++) {
      const Point way{x[k] - last.x, y[k] - last.y};
      length += std::sqrt(dot(way, way));
      last = {x[k], y[k]};
      u[k] = length;
    }
    length = std::max(length + (ends[1] - last).length(), 1e-9);
    for (double& at : u) at /= length;
  }

  // The misfit of a cubic at some parameters.
  double misfit(const double* cubic, const double* at) const {
    const Powers of(cubic);
    double sum = 0.0;
    for (int k = 0; k < kSamples; k++) {
      const double dx = of.x(at[k]) - x[k], dy = of.y(at[k]) - y[k];
      sum += share * huber(std::sqrt((dx * dx + dy * dy) * single[k]));
    }
    return sum;
  }

  // One Newton step from the parameters towards the feet of the points on a cubic: see `nearer` in cubic.h.
  void approach(const double* cubic, const double* from, double* to) const {
    const Powers of(cubic);
    for (int k = 0; k < kSamples; k++) {
      const double t = from[k], dx = of.x(t) - x[k], dy = of.y(t) - y[k];
      const double vx = of.first_x(t), vy = of.first_y(t), speed = vx * vx + vy * vy;
      const double bend = speed + dx * of.second_x(t) + dy * of.second_y(t);
      const double step = (dx * vx + dy * vy) / std::max(bend > kConvex * speed ? bend : speed, kLeast);
      to[k] = std::min(std::max(t - step, 0.0), 1.0);
    }
  }

  // The best cubic, whose ends and tangents move as far as their errors allow. Its six values are two handle lengths, two
  // shifts of the ends and two of the handles across the run. Straight runs leave the handles open: they are pulled
  // gently towards thirds.
  double exact(double* cubic) const {
    const double third = length / 3.0, expected[kValues] = {third, third};
    const double sizes[kValues] = {0.5 * length, 0.5 * length,         errors[0][0],
                                   errors[1][0], errors[0][1] * third, errors[1][1] * third};
    double stiffness[kValues], values[kValues], at[kSamples];
    for (int v = 0; v < kValues; v++) {
      const double size = std::max(sizes[v], 1e-6);
      stiffness[v] = (v < 2 ? 0.1 : 1.0) / (size * size), values[v] = expected[v];
    }
    std::copy(u, u + kSamples, at);
    for (int round = 0; round <= kRounds; round++) {
      if (round > 0) improve(cubic, at, expected, stiffness, values);
      place(values, cubic);
      approach(cubic, at, at);
    }
    double strained = 0.0;
    for (int v = 2; v < kValues; v++) strained += stiffness[v] * values[v] * values[v];
    return misfit(cubic, at) + strained;
  }

  // The misfit of the best line through the points and near the ends.
  double line() const {
    double dx[kSamples + 2], dy[kSamples + 2], one[kSamples + 2], many[kSamples + 2];
    for (int k = 0; k < kSamples; k++)
      dx[k] = x[k], dy[k] = y[k], one[k] = single[k], many[k] = single[k] > 0.0 ? share : 0.0;
    for (int e = 0; e < 2; e++) {
      const int k = kSamples + e;
      dx[k] = ends[e].x, dy[k] = ends[e].y, one[k] = 1.0 / (errors[e][0] * errors[e][0]), many[k] = 1.0;
    }
    double total = 0.0, mx = 0.0, my = 0.0, xx = 0.0, yy = 0.0, xy = 0.0;
    for (int k = 0; k < kSamples + 2; k++) {
      const double weight = one[k] * many[k];
      total += weight, mx += weight * dx[k], my += weight * dy[k];
    }
    total = std::max(total, 1e-12), mx /= total, my /= total;
    for (int k = 0; k < kSamples + 2; k++) {
      const double weight = one[k] * many[k];
      dx[k] -= mx, dy[k] -= my;
      xx += weight * dx[k] * dx[k], yy += weight * dy[k] * dy[k], xy += weight * dx[k] * dy[k];
    }
    const double angle = 0.5 * std::atan2(2.0 * xy, xx - yy), sine = std::sin(angle), cosine = std::cos(angle);
    double sum = 0.0;
    for (int k = 0; k < kSamples + 2; k++)
      sum += many[k] * huber(std::fabs(dx[k] * sine - dy[k] * cosine) * std::sqrt(one[k]));
    return sum;
  }

 private:
  // The cubic of six values: see `exact`.
  void place(const double* values, double* cubic) const {
    for (int e = 0; e < 2; e++) {
      const Point along = tangents[e], across{-along.y, along.x};
      const double out = e ? -values[e] : values[e], end = values[2 + e], handle = end + values[4 + e];
      double *const anchor = cubic + 6 * e, *const control = cubic + 2 + 2 * e;
      anchor[0] = ends[e].x + end * across.x, anchor[1] = ends[e].y + end * across.y;
      control[0] = ends[e].x + out * along.x + handle * across.x;
      control[1] = ends[e].y + out * along.y + handle * across.y;
    }
  }

  // One Gauss-Newton step of the values, for the distances of points along the normal; the values are pulled towards the
  // expected ones with some stiffness, and handle lengths stay within their limits.
  void improve(const double* cubic, const double* at, const double* expected, const double* stiffness,
               double* values) const {
    double gram[kValues][kValues] = {}, slope[kValues];
    const Powers of(cubic);
    // The columns of the matrix, and what is to be explained, of all samples.
    double columns[kValues][kSamples], rest[kSamples];
    for (int i = 0; i < kSamples; i++) {
      const double t = at[i], v = 1.0 - t, b[4] = {v * v * v, 3.0 * v * v * t, 3.0 * v * t * t, t * t * t};
      const double vx = of.first_x(t), vy = of.first_y(t), speed = std::max(std::sqrt(vx * vx + vy * vy), kLeast);
      const double nx = -vy / speed, ny = vx / speed;
      rest[i] = (x[i] - of.x(t)) * nx + (y[i] - of.y(t)) * ny;
      const double across[2] = {tangents[0].x * ny - tangents[0].y * nx, tangents[1].x * ny - tangents[1].y * nx};
      columns[0][i] = b[1] * (tangents[0].x * nx + tangents[0].y * ny);
      columns[1][i] = -b[2] * (tangents[1].x * nx + tangents[1].y * ny);
      columns[2][i] = (b[0] + b[1]) * across[0], columns[3][i] = (b[2] + b[3]) * across[1];
      columns[4][i] = b[1] * across[0], columns[5][i] = b[2] * across[1];
    }
    for (int v = 0; v < kValues; v++) {
      double weighted[kSamples];
      for (int i = 0; i < kSamples; i++) weighted[i] = weights[i] * columns[v][i];
      slope[v] = stiffness[v] * (expected[v] - values[v]) + sum_of_products(weighted, rest);
      for (int w = 0; w <= v; w++) gram[v][w] = sum_of_products(weighted, columns[w]);
      gram[v][v] += stiffness[v];
    }
    solve(gram, slope);
    for (int v = 0; v < kValues; v++) values[v] += slope[v];
    for (int v = 0; v < 2; v++) values[v] = std::clamp(values[v], kShortest * length, kLongest * length);
  }
};

}  // namespace
}  // namespace cs
