// Circles, ellipses and boxes, and the ones nearest to points. What is minimised is said in artwork/geometry/fitting.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

namespace cs {
namespace {

constexpr int kMost = 6;         // values of a primitive
constexpr double kShift = 1e-4;  // px or radians, of the differences that stand for derivatives
constexpr double kKnee = 3.0;    // standard errors beyond which a distance counts linearly
constexpr double kRidge = 1e-9;

// values: of a circle its middle and radius; of an ellipse its middle, half-axes and angle; of a box its middle, half
// sides, the radius of its corners and its angle. Angles and radii may be left out, which are 0 then.
struct Primitive {
  enum Kind { circle, ellipse, box };
  Kind kind;
  bool rounded, turned;
  int count;

  Primitive(Kind kind, bool rounded, bool turned)
      : kind(kind), rounded(rounded), turned(turned), count((kind == circle ? 3 : 4) + rounded + turned) {}

  double angle(const double* v) const { return turned ? v[count - 1] : 0.0; }

  // Least squares may step beyond the roundest of corners, half of the shorter side; there it is that.
  double radius(const double* v) const { return rounded ? std::min({v[4], std::fabs(v[2]), std::fabs(v[3])}) : 0.0; }

  // The signed distance of every point.
  void distances(const double* v, int64_t n, const double* points, double* out) const {
    const double cosine = std::cos(angle(v)), sine = std::sin(angle(v)), radius = this->radius(v);
    for (int64_t i = 0; i < n; i++) {
      const double x = points[2 * i] - v[0], y = points[2 * i + 1] - v[1];
      if (kind == circle) {
        out[i] = std::hypot(x, y) - v[2];
        continue;
      }
      const double along = x * cosine + y * sine, across = y * cosine - x * sine;
      out[i] = kind == ellipse ? from_ellipse(along, across, v) : from_box(along, across, v, radius);
    }
  }

 private:
  // To first order, exact on the ellipse and on circles.
  static double from_ellipse(double x, double y, const double* v) {
    const double a = std::max(std::fabs(v[2]), 1e-3), b = std::max(std::fabs(v[3]), 1e-3);
    const double f = std::hypot(x / a, y / b), slope = std::hypot(x / (a * a), y / (b * b));
    return (f - 1.0) * f / std::max(slope, 1e-9);
  }

  static double from_box(double x, double y, const double* v, double radius) {
    const double a = std::fabs(x) - v[2] + radius, b = std::fabs(y) - v[3] + radius;
    return std::hypot(std::max(a, 0.0), std::max(b, 0.0)) + std::min(std::max(a, b), 0.0) - radius;
  }
};

inline double loss(const std::vector<double>& rest, const double* weights) {
  double sum = 0.0;
  for (size_t i = 0; i < rest.size(); i++) {
    const double size = std::fabs(rest[i]) * std::sqrt(weights[i]);
    sum += size <= kKnee ? size * size : kKnee * (2.0 * size - kKnee);
  }
  return sum;
}

// Solves a x = b by elimination, in place of both.
inline void solve(int n, double (*a)[kMost], double* x) {
  for (int k = 0; k < n; k++) {
    int pivot = k;
    for (int i = k + 1; i < n; i++)
      if (std::fabs(a[i][k]) > std::fabs(a[pivot][k])) pivot = i;
    std::swap(a[k], a[pivot]);
    std::swap(x[k], x[pivot]);
    for (int i = k + 1; i < n; i++) {
      const double factor = a[i][k] / a[k][k];
      for (int j = k; j < n; j++) a[i][j] -= factor * a[k][j];
      x[i] -= factor * x[k];
    }
  }
  for (int i = n - 1; i >= 0; i--) {
    for (int j = i + 1; j < n; j++) x[i] -= a[i][j] * x[j];
    x[i] /= a[i][i];
  }
}

// Levenberg's and Marquardt's method with Huber's weights and differences for the derivatives. weights: of the squares.
// Brings the values up to date; returns the loss.
inline double fitted(const Primitive& shape, int rounds, int64_t n, const double* points, const double* weights,
                     double* values) {
  const int count = shape.count;
  std::vector<double> rest(n), trial_rest(n), jacobian(size_t(count) * n);
  shape.distances(values, n, points, rest.data());
  double best = loss(rest, weights), damping = 1e-3;
  for (int round = 0; round < rounds; round++) {
    double trial[kMost], gram[kMost][kMost] = {}, step[kMost] = {};
    for (int k = 0; k < count; k++) {
      std::copy(values, values + count, trial);
      trial[k] += kShift;
      double* column = &jacobian[size_t(k) * n];
      shape.distances(trial, n, points, column);
      for (int64_t i = 0; i < n; i++) column[i] = (column[i] - rest[i]) / kShift;
    }
    for (int64_t i = 0; i < n; i++) {
      const double size = std::fabs(rest[i]) * std::sqrt(weights[i]);
      const double weight = weights[i] * std::min(1.0, kKnee / std::max(size, 1e-12));
      for (int p = 0; p < count; p++) {
        const double weighted = weight * jacobian[size_t(p) * n + i];
        step[p] += weighted * rest[i];
        for (int q = 0; q < count; q++) gram[p][q] += weighted * jacobian[size_t(q) * n + i];
      }
    }
    for (int k = 0; k < count; k++) gram[k][k] += damping * gram[k][k] + kRidge;
    solve(count, gram, step);
    for (int k = 0; k < count; k++) trial[k] = values[k] - step[k];
    shape.distances(trial, n, points, trial_rest.data());
    const double found = loss(trial_rest, weights);
    if (found < best) {
      const double gain = best - found;
      best = found;
      std::copy(trial, trial + count, values);
      rest.swap(trial_rest);
      damping = std::max(damping / 10.0, 1e-8);
      if (gain < 1e-3 * best + 1e-2) break;
    } else {
      damping *= 10.0;
    }
  }
  return best;
}

}  // namespace
}  // namespace cs
