// Which paints of a picture an edge pixel blends, and what it has where they are replaced by others.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <limits>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

constexpr double kFarther = 1.5;    // levels by which the next paint must explain a pixel better
constexpr double kThree = 3.0;      // levels that two paints leave of a pixel where three are tried
constexpr double kLeastSine = 0.2;  // of the angle between the colours of three paints, for shares of them to be told

// A pixel's value as a blend of its paints: what is left of it, and what it has with other colours in their place.
struct Blend {
  double cost, left, flat[4];
};

// colours, flats: (slots x 4) what paints have at a pixel, and what stands for them there.
struct Pixel {
  int slots;
  const double *value, *colours, *flats;

  void two(int i, int j, Blend& best) const {
    const double *a = colours + 4 * i, *b = colours + 4 * j;
    double length = 0.0, along = 0.0, left[4], most = 0.0;
    for (int k = 0; k < 4; k++) {
      length += (a[k] - b[k]) * (a[k] - b[k]);
      along += (value[k] - b[k]) * (a[k] - b[k]);
    }
    const double share = std::clamp(along / std::max(length, 1e-9), 0.0, 1.0);
    for (int k = 0; k < 4; k++) {
      left[k] = value[k] - b[k] - share * (a[k] - b[k]);
      most = std::max(most, std::fabs(left[k]));
    }
    if (!(most + kFarther * (i + j) < best.cost)) return;
    best.cost = most + kFarther * (i + j), best.left = most;
    for (int k = 0; k < 4; k++)
      best.flat[k] = flats[4 * j + k] + share * (flats[4 * i + k] - flats[4 * j + k]) + left[k];
  }

  void three(int i, int j, int l, Blend& best) const {
    double aa = 0.0, bb = 0.0, ab = 0.0, av = 0.0, bv = 0.0, most = 0.0;
    double first[4], second[4], left[4];
    for (int k = 0; k < 4; k++) {
      first[k] = colours[4 * i + k] - colours[4 * l + k], second[k] = colours[4 * j + k] - colours[4 * l + k];
      left[k] = value[k] - colours[4 * l + k];
      aa += first[k] * first[k], bb += second[k] * second[k], ab += first[k] * second[k];
      av += first[k] * left[k], bv += second[k] * left[k];
    }
    const double det = aa * bb - ab * ab;
    if (!(det > kLeastSine * kLeastSine * aa * bb)) return;
    const double a = (av * bb - bv * ab) / det, b = (bv * aa - av * ab) / det;
    if (!(a >= 0.0 && b >= 0.0 && a + b <= 1.0)) return;
    for (int k = 0; k < 4; k++) {
      left[k] -= a * first[k] + b * second[k];
      most = std::max(most, std::fabs(left[k]));
    }
    if (!(most + kFarther * (i + j + l) < best.cost)) return;
    best.cost = most + kFarther * (i + j + l), best.left = most;
    for (int k = 0; k < 4; k++) {
      const double flat = flats[4 * l + k];
      best.flat[k] = flat + a * (flats[4 * i + k] - flat) + b * (flats[4 * j + k] - flat) + left[k];
    }
  }
};

}  // namespace
}  // namespace cs

extern "C" {

// The different paints of a map (height x width), at least 0, nearest to n pixels within a square of `reach` px to all
// sides: their numbers (n x slots), -1 where there are fewer, and the pixels where they are. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_nearest_paints(int64_t height, int64_t width, const int32_t* paint, int64_t reach, int64_t n,
                                    const int64_t* pixels, int32_t slots, int32_t* found, int64_t* places) {
  try {
    struct Offset {
      int64_t y, x;
    };
    std::vector<Offset> offsets;
    for (int64_t y = -reach; y <= reach; y++)
      for (int64_t x = -reach; x <= reach; x++) offsets.push_back({y, x});
    std::stable_sort(offsets.begin(), offsets.end(),
                     [](const Offset& a, const Offset& b) { return a.y * a.y + a.x * a.x < b.y * b.y + b.x * b.x; });
    for (int64_t i = 0; i < n; i++) {
      const int64_t y = pixels[i] / width, x = pixels[i] % width;
      int32_t *own = found + i * slots, used = 0;
      for (const Offset& offset : offsets) {
        const int64_t row = y + offset.y, column = x + offset.x;
        if (row < 0 || row >= height || column < 0 || column >= width) continue;
        const int32_t number = paint[row * width + column];
        if (number < 0 || std::find(own, own + used, number) != own + used) continue;
        places[i * slots + used] = row * width + column, own[used++] = number;
        if (used == slots) break;
      }
      for (; used < slots; used++) own[used] = -1, places[i * slots + used] = pixels[i];
    }
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}

// Values (n x 4) of pixels as blends of two of their paints (n x slots), nearest first, -1 for none; or, where `three`, of
// three. colours, flats (n x slots x 4): what these have there, and what stands for it. flat (n x 4): the pixels with that;
// left (n): levels that no blend explains, infinite without paints.
CS_EXPORT void cs_blends(int64_t n, int32_t slots, const double* values, const int32_t* paints, const double* colours,
                         const double* flats, int32_t three, double* flat, double* left) {
  for (int64_t i = 0; i < n; i++) {
    const int32_t* own = paints + i * slots;
    const int used = int(std::find(own, own + slots, -1) - own);
    const cs::Pixel pixel{used, values + 4 * i, colours + 4 * slots * i, flats + 4 * slots * i};
    const double none = std::numeric_limits<double>::infinity();
    cs::Blend best{none, none, {}};
    std::copy(pixel.value, pixel.value + 4, best.flat);
    for (int a = 0; a < used; a++)
      for (int b = a; b < used; b++) pixel.two(a, b, best);
    if (three && best.left > cs::kThree)
      for (int a = 0; a < used; a++)
        for (int b = a + 1; b < used; b++)
          for (int c = b + 1; c < used; c++) pixel.three(a, b, c, best);
    std::copy(best.flat, best.flat + 4, flat + 4 * i);
    left[i] = best.left;
  }
}
}
