// Boundaries of masks, and local fits along chains of points: the loops over pixels and points of the artwork style's
// tracing. What is computed is said in artwork/regions/cracks.py and artwork/tracing/.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
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

}  // namespace
}  // namespace cs

extern "C" {

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
          if (!mask.at(x + kRight[d][0], y + kRight[d][1])) d = (d + 1) % 4;
          else if (mask.at(x + kLeft[d][0], y + kLeft[d][1])) d = (d + 3) % 4;
        } while (x != left || y != top || d != 0);
        if (loops < room) ends[loops] = *count;
        loops++;
      }
  } catch (const std::exception&) {
    return -1;
  }
  return loops;
}
}
