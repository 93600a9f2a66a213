// Boundaries of masks, and local fits along chains of points: the loops over pixels and points of the artwork style's
// tracing. What is computed is said in artwork/regions/cracks.py and artwork/tracing/.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <utility>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

// East, south, west, north; and the pixels to the right and left of a crack from vertex (x, y), relative to it.
constexpr int kStep[4][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
constexpr int kRight[4][2] = {{0, 0}, {-1, 0}, {-1, -1}, {0, -1}};
constexpr int kLeft[4][2] = {{0, -1}, {0, 0}, {-1, 0}, {-1, -1}};

struct Mask {
  const uint8_t* pixels;
  int64_t height, width;
  bool at(int64_t x, int64_t y) const {
    return x >= 0 && y >= 0 && x < width && y < height && pixels[y * width + x] != 0;
  }
};

// A polynomial in arc length through a run of points, by weighted least squares.
struct Polynomial {
  int terms;           // its degree plus 1, at most 3
  double of[3][2];     // coefficients, x and y
  double variance[3];  // of the coefficients

  Polynomial(int degree) : terms(degree + 1), of{}, variance{} {}

  void value(double at, double* x, double* y) const {
    *x = *y = 0.0;
    double power = 1.0;
    for (int k = 0; k < terms; k++, power *= at) *x += of[k][0] * power, *y += of[k][1] * power;
  }
};

// One point of a run: where along it, its weight, and its place relative to the origin of the fit.
struct Sample {
  double at, weight, x, y;
};

constexpr double kRidge = 1e-9;  // of the trace of the normal equations, so that they always have a solution
constexpr double kSlow = 1e-12;

// Fits a polynomial; returns the sum of the squared distances across it, weighted.
double fit(const std::vector<Sample>& run, Polynomial& out) {
  const int n = out.terms;
  double gram[3][3] = {}, right[3][2] = {};
  for (const Sample& p : run) {
    const double powers[3] = {1.0, p.at, p.at * p.at};
    for (int i = 0; i < n; i++) {
      const double weighted = powers[i] * p.weight;
      for (int j = 0; j <= i; j++) gram[i][j] += weighted * powers[j];
      right[i][0] += weighted * p.x, right[i][1] += weighted * p.y;
    }
  }
  double ridge = 0.0;
  for (int i = 0; i < n; i++) ridge += kRidge * gram[i][i];
  for (int i = 0; i < n; i++) gram[i][i] += ridge;
  // Cholesky's decomposition, the inverse of its factor, and with that the inverse.
  double factor[3][3] = {};
  for (int i = 0; i < n; i++) {
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
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) {
      double inverse = 0.0;
      for (int k = std::max(i, j); k < n; k++) inverse += factor[k][i] * factor[k][j];
      if (i == j) out.variance[i] = inverse;
      for (int c = 0; c < 2; c++) out.of[i][c] += inverse * right[j][c];
    }
  const double speed = std::max(std::hypot(out.of[1][0], out.of[1][1]), kSlow);
  const double ux = out.of[1][0] / speed, uy = out.of[1][1] / speed;
  double misfit = 0.0;
  for (const Sample& p : run) {
    double x, y;
    out.value(p.at, &x, &y);
    const double across = (p.x - x) * uy - (p.y - y) * ux;
    misfit += p.weight * across * across;
  }
  return misfit;
}

}  // namespace
}  // namespace cs

extern "C" {

// Of every place along a chain the run after it, `gap` or more away, by the longest of the kinds of runs that is
// believed: see `flanks` in raster/outlines.py.
CS_EXPORT void cs_flanks(int64_t count, const double* points, const double* weights, const double* along,
                         int64_t places, const double* place, const double* farthest, double gap, int64_t kinds,
                         const int64_t* lengths, const int64_t* degrees, const double* most, double* at,
                         double* tangent, double* error, int64_t* first) {
  using namespace cs;
  std::vector<Sample> run;
  for (int64_t i = 0; i < places; i++) {
    const int64_t start = std::lower_bound(along, along + count, place[i] + gap) - along;
    const int64_t near = std::min(start, count - 1);
    const double* origin = points + 2 * near;
    double best[2] = {origin[0], origin[1]}, way[2] = {1.0, 0.0};
    error[i] = INFINITY;
    first[i] = near;
    if (start < count && along[near] - place[i] <= farthest[i])
      for (int64_t kind = 0; kind < kinds; kind++) {
        const int64_t last = start + lengths[kind];
        if (last >= count || along[last] - along[near] > 2.0 * double(lengths[kind])) break;
        run.clear();
        for (int64_t n = start; n <= last; n++)
          run.push_back({along[n] - place[i], weights[n], points[2 * n] - origin[0], points[2 * n + 1] - origin[1]});
        Polynomial curve(int(degrees[kind]));
        if (!(fit(run, curve) / double(lengths[kind] - degrees[kind]) <= most[kind])) break;
        error[i] = std::sqrt(curve.variance[1]);
        for (int c = 0; c < 2; c++) best[c] = origin[c] + curve.of[0][c], way[c] = curve.of[1][c];
      }
    const double speed = std::max(std::hypot(way[0], way[1]), kSlow);
    for (int c = 0; c < 2; c++) at[2 * i + c] = best[c], tangent[2 * i + c] = way[c] / speed;
  }
}

// Parabolas along a chain, about every point, over the longest of the half-windows that is believed: see `parabolas` in
// raster/outlines.py.
CS_EXPORT void cs_parabolas(int64_t count, const double* points, const double* weights, const double* along,
                            int64_t kinds, const int64_t* halves, const double* most, double* terms, double* errors,
                            int64_t* windows) {
  using namespace cs;
  constexpr double unknown = 1e-6, counts = 1e-4;  // what hidden points weigh, and what known ones weigh at least
  std::vector<Sample> run;
  for (int64_t i = 0; i < count; i++) {
    const double* origin = points + 2 * i;
    for (int64_t kind = 0; kind < kinds; kind++) {
      const int64_t half = halves[kind];
      run.clear();
      int64_t known = 0;
      for (int64_t n = std::max<int64_t>(0, i - half); n <= std::min(count - 1, i + half); n++) {
        const double weight = weights[n] + unknown;
        known += weight > counts;
        run.push_back(
            {(along[n] - along[i]) / double(half), weight, points[2 * n] - origin[0], points[2 * n + 1] - origin[1]});
      }
      Polynomial curve(2);
      const double misfit = fit(run, curve) / double(std::max<int64_t>(known - 3, 1));
      if (kind > 0 && !(misfit <= most[kind])) break;
      windows[i] = half;
      errors[2 * i] = std::sqrt(curve.variance[0]), errors[2 * i + 1] = std::sqrt(curve.variance[1]) / double(half);
      double scale = 1.0;
      for (int k = 0; k < 3; k++, scale *= double(half))
        for (int c = 0; c < 2; c++) terms[6 * i + 2 * k + c] = curve.of[k][c] / scale + (k == 0 ? origin[c] : 0.0);
    }
  }
}

// The loops around a mask (height x width bytes). cracks: room x 3, x, y and direction of each; ends: room, where each
// loop ends among them. Returns the number of loops; *count: of the cracks, of which those beyond the room are missing.
// -1 where there is no memory.
CS_EXPORT int64_t cs_trace(const uint8_t* pixels, int64_t height, int64_t width, int64_t room, int64_t* cracks,
                           int64_t* ends, int64_t* count) {
  using namespace cs;
  const Mask mask{pixels, height, width};
  int64_t loops = 0;
  *count = 0;
  try {
    // Every loop has a crack that runs east.
    std::vector<uint8_t> seen(height * width, 0);
    for (int64_t top = 0; top < height; top++)
      for (int64_t left = 0; left < width; left++) {
        if (!mask.at(left, top) || mask.at(left, top - 1) || seen[top * width + left]) continue;
        int64_t x = left, y = top;
        int d = 0;
        do {
          if (d == 0) seen[y * width + x] = 1;
          if (*count < room) {
            int64_t* out = cracks + 3 * *count;
            out[0] = x, out[1] = y, out[2] = d;
          }
          ++*count;
          x += kStep[d][0], y += kStep[d][1];
          // Right where the mask ends ahead, else straight, else left.
          if (!mask.at(x + kRight[d][0], y + kRight[d][1]))
            d = (d + 1) % 4;
          else if (mask.at(x + kLeft[d][0], y + kLeft[d][1]))
            d = (d + 3) % 4;
        } while (x != left || y != top || d != 0);
        if (loops < room) ends[loops] = *count;
        loops++;
      }
  } catch (const std::exception&) {
    return -1;
  }
  return loops;
}

// The method of Ramer, Douglas and Peucker: kept (count) is set at the first and last point of a chain (x 2), and where
// another one is more than `tolerance` off the straight line between those kept. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_fewer_points(int64_t count, const double* points, double tolerance, uint8_t* kept) {
  try {
    std::vector<std::pair<int64_t, int64_t>> left{{0, count - 1}};
    kept[0] = kept[count - 1] = 1;
    while (!left.empty()) {
      const auto [first, last] = left.back();
      left.pop_back();
      const double *a = points + 2 * first, *b = points + 2 * last;
      const double x = b[0] - a[0], y = b[1] - a[1], length = std::hypot(x, y), square = length * length;
      double most = -1.0;
      int64_t farthest = first;
      for (int64_t n = first + 1; n < last; n++) {
        const double u = points[2 * n] - a[0], v = points[2 * n + 1] - a[1], along = u * x + v * y;
        // From the line where a point lies beside it, from the nearer one of its ends elsewhere.
        const bool beside = along > 0.0 && along < square;
        const double gap = beside ? std::fabs(v * x - u * y) / std::max(length, 1e-300)
                                  : std::min(std::hypot(u, v), std::hypot(u - x, v - y));
        if (gap > most) most = gap, farthest = n;
      }
      if (most > tolerance) {
        kept[farthest] = 1;
        left.push_back({first, farthest}), left.push_back({farthest, last});
      }
    }
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}
}
