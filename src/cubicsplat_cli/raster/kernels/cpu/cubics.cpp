// Cubics fitted to runs of points, and the feet of points on cubics. What is minimised is in artwork/tracing/cubics.py.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "abi.h"
#include "cubic.h"

namespace cs {
namespace {

constexpr int kValues = 6;    // of a cubic: see `Run`

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

// Fits as many runs of `count` points each, by `rounds` Gauss-Newton steps from the expected values. limits: runs x 2, of
// the handle lengths. u: the parameters to start from, brought up to date. values and control: written.
CS_EXPORT void cs_fit_cubics(int64_t runs, int32_t count, int32_t rounds, const double* base, const double* directions,
                             const double* expected, const double* stiffness, const double* limits,
                             const double* points, const double* weights, double* u, double* values, double* control) {
  using namespace cs;
  for (int64_t n = 0; n < runs; n++) {
    const Run run{base + 8 * n, directions + 48 * n, expected + 6 * n, stiffness + 6 * n, limits[2 * n], limits[2 * n + 1]};
    double *own = values + 6 * n, *cubic = control + 8 * n, *at = u + count * n;
    std::copy(run.expected, run.expected + kValues, own);
    for (int round = 0; round <= rounds; round++) {
      if (round > 0) run.improve(cubic, count, points + 2 * count * n, weights + count * n, at, own);
      run.cubic(own, cubic);
      for (int i = 0; i < count; i++)
        at[i] = std::clamp(nearer(cubic, points + 2 * (count * n + i), at[i]), 0.0, 1.0);
    }
  }
}
}
