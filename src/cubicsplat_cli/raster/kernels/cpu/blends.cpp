// Which paints of a picture an edge pixel blends, and what it has where they are replaced by others.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "abi.h"
#include "colours.h"

namespace cs {
namespace {

constexpr double kThree = 3.0;      // levels that two paints leave of a pixel where three are tried
constexpr double kLeastSine = 0.2;  // of the angle between the colours of three paints, for shares of them to be told

// A pixel's value as a blend of its paints: what is left of it, and what it has with other colours in their place.
struct Replaced {
  double cost, left, flat[4];
};

// colours, flats: (slots x 4) what paints have at a pixel, and what stands for them there.
struct Pixel {
  const double *value, *colours, *flats;

  void two(int i, int j, Replaced& best) const {
    const Colour base = colour(colours + 4 * j), span = colour(colours + 4 * i) - base, over = colour(value) - base;
    const Blend found = between(over, span);
    const double cost = found.residual + kFarther * (i + j);
    if (!(cost < best.cost)) return;
    best.cost = cost, best.left = found.residual;
    for (int k = 0; k < 4; k++) {
      const double flat = flats[4 * j + k];
      best.flat[k] = flat + found.share * (flats[4 * i + k] - flat) + (over.of[k] - found.share * span.of[k]);
    }
  }

  void three(int i, int j, int l, Replaced& best) const {
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

// Values (n x 4) of pixels as blends of two of their paints (n x slots), nearest first, -1 for none; or, where `three`, of
// three. colours, flats (n x slots x 4): what these have there, and what stands for it. flat (n x 4): the pixels with that;
// left (n): levels that no blend explains, infinite without paints.
CS_EXPORT void cs_blends(int64_t n, int64_t slots, const double* values, const int32_t* paints, const double* colours,
                         const double* flats, int64_t three, double* flat, double* left) {
  for (int64_t i = 0; i < n; i++) {
    const int32_t* own = paints + i * slots;
    const int used = int(std::find(own, own + slots, -1) - own);
    const cs::Pixel pixel{values + 4 * i, colours + 4 * slots * i, flats + 4 * slots * i};
    const double none = std::numeric_limits<double>::infinity();
    cs::Replaced best{none, none, {}};
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
