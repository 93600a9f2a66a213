// Cubics fitted to runs of points, and the feet of points on cubics. What is minimised is in artwork/tracing/cubics.py.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "abi.h"

namespace {

constexpr int kValues = 6;       // of a cubic: see `Run`
constexpr double kConvex = 0.3;  // of the squared speed: the least curvature of the distance that Newton's step trusts
constexpr double kLeast = 1e-12;
constexpr double kStill = 1e-9;  // px per parameter, below which a curve has no direction

struct Point {
  double x, y;
};

// A cubic of control points p[8] near a parameter.
struct Place {
  double basis[4];
  Point at{0.0, 0.0}, first{0.0, 0.0}, second{0.0, 0.0};  // the point and the derivatives

  Place(const double* p, double u) {
    const double v = 1.0 - u, b[4] = {v * v * v, 3.0 * v * v * u, 3.0 * v * u * u, u * u * u};
    const double slopes[3] = {3.0 * v * v, 6.0 * v * u, 3.0 * u * u}, bends[2] = {6.0 * v, 6.0 * u};
    std::copy(b, b + 4, basis);
    for (int k = 0; k < 4; k++) at.x += b[k] * p[2 * k], at.y += b[k] * p[2 * k + 1];
    double step[6];
    for (int k = 0; k < 6; k++) step[k] = p[k + 2] - p[k];
    for (int k = 0; k < 3; k++) first.x += slopes[k] * step[2 * k], first.y += slopes[k] * step[2 * k + 1];
    for (int k = 0; k < 2; k++) {
      second.x += bends[k] * (step[2 * k + 2] - step[2 * k]);
      second.y += bends[k] * (step[2 * k + 3] - step[2 * k + 1]);
    }
  }
};

// One Newton step towards the foot of a point. Where the distance is not convex, the Gauss-Newton step still leads downhill.
double nearer(const double* cubic, const double* point, double u) {
  const Place place(cubic, u);
  const Point rest{place.at.x - point[0], place.at.y - point[1]};
  const double along = rest.x * place.first.x + rest.y * place.first.y;
  const double speed = place.first.x * place.first.x + place.first.y * place.first.y;
  const double bend = speed + rest.x * place.second.x + rest.y * place.second.y;
  return u - along / std::max(bend > kConvex * speed ? bend : speed, kLeast);
}

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

extern "C" {

// out: cubics x count parameters, one Newton step from u towards the feet of the points (x 2) on the cubics (x 8).
CS_EXPORT void cs_nearer(int64_t cubics, int64_t count, const double* control, const double* points, const double* u,
                         double* out) {
  for (int64_t n = 0; n < cubics; n++)
    for (int64_t i = n * count; i < (n + 1) * count; i++) out[i] = nearer(control + 8 * n, points + 2 * i, u[i]);
}

// Fits as many runs of `count` points each, by `rounds` Gauss-Newton steps from the expected values. limits: runs x 2, of
// the handle lengths. u: the parameters to start from, brought up to date. values and control: written.
CS_EXPORT void cs_fit_cubics(int64_t runs, int32_t count, int32_t rounds, const double* base, const double* directions,
                             const double* expected, const double* stiffness, const double* limits,
                             const double* points, const double* weights, double* u, double* values, double* control) {
  for (int64_t n = 0; n < runs; n++) {
    const Run run{base + 8 * n,      directions + 48 * n, expected + 6 * n,
                  stiffness + 6 * n, limits[2 * n],       limits[2 * n + 1]};
    double *own = values + 6 * n, *cubic = control + 8 * n, *at = u + count * n;
    std::copy(run.expected, run.expected + kValues, own);
    for (int round = 0; round <= rounds; round++) {
      if (round > 0) run.improve(cubic, count, points + 2 * count * n, weights + count * n, at, own);
      run.cubic(own, cubic);
      for (int i = 0; i < count; i++) at[i] = std::clamp(nearer(cubic, points + 2 * (count * n + i), at[i]), 0.0, 1.0);
    }
  }
}

// Brings points (x 2) nearer to their feet on the pieces (x 8) of an outline, `rounds` times: those beyond the end of
// their piece pass on to the next one, or before its start to the last one, where the joint is smooth. ends: pieces, the
// joint at the end of each. piece, u: brought up to date. rest, normals (x 2): written, by how far each foot is off its
// point along the normal, and that.
CS_EXPORT void cs_settle(int64_t count, int64_t pieces, int32_t rounds, const double* control, const int64_t* ends,
                         const uint8_t* smooth, const double* points, int64_t* piece, double* u, double* rest,
                         double* normals) {
  for (int64_t i = 0; i < count; i++) {
    for (int round = 0; round < rounds; round++) {
      const int64_t own = piece[i];
      const double at = nearer(control + 8 * own, points + 2 * i, u[i]);
      const bool on = at > 1.0 && smooth[ends[own]], back = at < 0.0 && smooth[own];
      piece[i] = (own + on - back + pieces) % pieces;
      u[i] = on ? 0.0 : back ? 1.0 : std::clamp(at, 0.0, 1.0);
    }
    const Place place(control + 8 * piece[i], u[i]);
    const double speed = std::max(std::hypot(place.first.x, place.first.y), kStill);
    const double x = -place.first.y / speed, y = place.first.x / speed;
    normals[2 * i] = x, normals[2 * i + 1] = y;
    rest[i] = (place.at.x - points[2 * i]) * x + (place.at.y - points[2 * i + 1]) * y;
  }
}

// The normal equations of the distances `rest` of points along the normals over the control points of each piece: gram
// (x 8 x 8) and slope (x 8), which are zero to begin with. weights: of the squares.
CS_EXPORT void cs_piece_equations(int64_t count, const int64_t* piece, const double* u, const double* rest,
                                  const double* normals, const double* weights, double* gram, double* slope) {
  for (int64_t i = 0; i < count; i++) {
    const double t = u[i], v = 1.0 - t, b[4] = {v * v * v, 3.0 * v * v * t, 3.0 * v * t * t, t * t * t};
    double row[8];
    for (int k = 0; k < 8; k++) row[k] = b[k / 2] * normals[2 * i + k % 2];
    double *own = gram + 64 * piece[i], *pull = slope + 8 * piece[i];
    for (int p = 0; p < 8; p++) {
      pull[p] += weights[i] * rest[i] * row[p];
      for (int q = 0; q < 8; q++) own[8 * p + q] += weights[i] * row[p] * row[q];
    }
  }
}
}
