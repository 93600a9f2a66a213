// Parabolas in arc length about every point of a chain: where the boundary is, where it heads and how it bends. What they
// are for is said in artwork/strokes/centre_line.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "cubic.h"

namespace cs {
namespace {

constexpr double kRidge = 1e-9;  // of the trace of the normal equations, so that they always have a solution
constexpr double kSlow = 1e-12;

// The weighted sums by which a polynomial of arc length fits points: powers of the arc length up to the fourth, those up
// to the second with the coordinates, and the coordinates with each other.
struct Moments {
  double powers[5] = {}, x[3] = {}, y[3] = {}, xx = 0.0, xy = 0.0, yy = 0.0;

  void add(double at, double weight, double px, double py) {
    const double square = at * at, wx = weight * px, wy = weight * py;
    powers[0] += weight, powers[1] += weight * at, powers[2] += weight * square;
    powers[3] += weight * square * at, powers[4] += weight * square * square;
    x[0] += wx, x[1] += wx * at, x[2] += wx * square;
    y[0] += wy, y[1] += wy * at, y[2] += wy * square;
    xx += wx * px, xy += wx * py, yy += wy * py;
  }

  // The same with arc lengths divided by a scale.
  Moments scaled(double scale) const {
    Moments out = *this;
    double factor = 1.0;
    for (int k = 0; k < 5; k++, factor /= scale) {
      out.powers[k] *= factor;
      if (k < 3) out.x[k] *= factor, out.y[k] *= factor;
    }
    return out;
  }
};

// A polynomial in arc length through a run of points, by weighted least squares.
struct Polynomial {
  int terms;                // its degree plus 1, at most 3
  double of[3][2] = {};     // coefficients, x and y
  double variance[3] = {};  // of the coefficients

  explicit Polynomial(int degree) : terms(degree + 1) {}

  // Fits; returns the sum of the squared distances across it, weighted.
  double fit(const Moments& sums) {
    double gram[3][3] = {}, ridge = 0.0;
    for (int i = 0; i < terms; i++) {
      for (int j = 0; j <= i; j++) gram[i][j] = sums.powers[i + j];
      ridge += kRidge * gram[i][i];
    }
    for (int i = 0; i < terms; i++) gram[i][i] += ridge;
    // Cholesky's decomposition, the inverse of its factor, and with that the inverse.
    double factor[3][3] = {};
    for (int i = 0; i < terms; i++) {
      for (int j = 0; j < i; j++) {
        for (int k = 0; k < j; k++) gram[i][j] -= gram[i][k] * gram[j][k];
        gram[i][j] /= gram[j][j];
        gram[i][i] -= gram[i][j] * gram[i][j];
      }
      gram[i][i] = std::sqrt(gram[i][i]);
      factor[i][i] = 1.0 / gram[i][i];
      for (int j = 0; j < i; j++) {
        for (int k = j; k < i; k++) factor[i][j] -= gram[i][k] * factor[k][j];
        factor[i][j] /= gram[i][i];
      }
    }
    for (int i = 0; i < terms; i++) {
      of[i][0] = of[i][1] = 0.0;
      for (int j = 0; j < terms; j++) {
        double inverse = 0.0;
        for (int k = std::max(i, j); k < terms; k++) inverse += factor[k][i] * factor[k][j];
        if (i == j) variance[i] = inverse;
        of[i][0] += inverse * sums.x[j], of[i][1] += inverse * sums.y[j];
      }
    }
    return across(sums);
  }

 private:
  double across(const Moments& sums) const {
    const double speed = std::max(std::hypot(of[1][0], of[1][1]), kSlow);
    const double nx = of[1][1] / speed, ny = -of[1][0] / speed;
    double out = nx * nx * sums.xx + 2.0 * nx * ny * sums.xy + ny * ny * sums.yy;
    for (int i = 0; i < terms; i++) {
      const double own = of[i][0] * nx + of[i][1] * ny;
      out -= 2.0 * own * (sums.x[i] * nx + sums.y[i] * ny);
      for (int j = 0; j < terms; j++) out += own * (of[j][0] * nx + of[j][1] * ny) * sums.powers[i + j];
    }
    return std::max(out, 0.0);
  }
};

// Windows of so many points to either side, and up to which mean squared residual, in squared sigmas, each is believed.
struct Windows {
  int64_t kinds;
  const int64_t* halves;
  const double* most;
};

constexpr double kUnknown = 1e-6, kCounts = 1e-4;  // what hidden points weigh, and what known ones weigh at least

// The parabola about point i of a chain (x 2) over the widest window that is believed: its coefficients, x and y of 1, s
// and s^2, in `terms`, and the standard errors of the first two. Returns the window.
inline int64_t parabola(int64_t count, const double* points, const double* weights, const double* along, int64_t i,
                        const Windows& windows, double* terms, double* errors) {
  const double* origin = points + 2 * i;
  Moments sums;
  int64_t low = i, high = i, known = 0, found = 0;
  const auto add = [&](int64_t n) {
    const double weight = weights[n] + kUnknown;
    known += weight > kCounts;
    sums.add(along[n] - along[i], weight, points[2 * n] - origin[0], points[2 * n + 1] - origin[1]);
  };
  add(i);
  for (int64_t kind = 0; kind < windows.kinds; kind++) {
    const int64_t half = windows.halves[kind];
    while (low > std::max<int64_t>(0, i - half)) add(--low);
    while (high < std::min(count - 1, i + half)) add(++high);
    Polynomial curve(2);
    const double misfit = curve.fit(sums.scaled(double(half))) / double(std::max<int64_t>(known - 3, 1));
    if (kind > 0 && !(misfit <= windows.most[kind])) break;
    found = half;
    errors[0] = std::sqrt(curve.variance[0]), errors[1] = std::sqrt(curve.variance[1]) / double(half);
    double scale = 1.0;
    for (int k = 0; k < 3; k++, scale *= double(half))
      for (int c = 0; c < 2; c++) terms[2 * k + c] = curve.of[k][c] / scale + (k == 0 ? origin[c] : 0.0);
  }
  return found;
}

}  // namespace
}  // namespace cs
