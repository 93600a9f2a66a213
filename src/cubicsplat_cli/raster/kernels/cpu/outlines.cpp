// Boundaries of masks, and local fits along chains of points: the loops over pixels and points of the artwork style's
// tracing. What is computed is said in artwork/regions/cracks.py and artwork/tracing/.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <utility>
#include <vector>

#include "abi.h"
#include "local_fits.h"

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

}  // namespace
}  // namespace cs

extern "C" {

// Parabolas along a chain, about every point, over the longest of the half-windows that is believed: see `parabolas` in
// raster/outlines.py.
CS_EXPORT void cs_parabolas(int64_t count, const double* points, const double* weights, const double* along,
                            int64_t kinds, const int64_t* halves, const double* most, double* terms, double* errors,
                            int64_t* windows) {
  using namespace cs;
  for (int64_t i = 0; i < count; i++)
    windows[i] = parabola(count, points, weights, along, i, {kinds, halves, most}, terms + 6 * i, errors + 2 * i);
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
