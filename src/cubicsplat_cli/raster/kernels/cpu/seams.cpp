// The shares of two fills in pixels in which what lies beneath shines through between them: see `seam_shares` in
// raster/unmix.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "abi.h"
#include "colours.h"

namespace cs {
namespace {

struct Seam {
  int64_t step;
  double gap;
};

// The share, in steps, with which a seam of two fills over a ground is nearest to a value.
Seam nearest(const Colour& value, const Colour& front, const Colour& back, const Colour& ground, int64_t steps) {
  Seam best{0, std::numeric_limits<double>::infinity()};
  for (int64_t k = 0; k <= steps; k++) {
    const double a = double(k) / double(steps), left = 1.0 - a;
    Colour seam;
    for (int c = 0; c < 4; c++) seam.of[c] = a * front.of[c] + left * left * back.of[c] + a * left * ground.of[c];
    if (const double gap = seam.off(1.0, value); gap < best.gap) best = {k, gap};
  }
  return best;
}

}  // namespace
}  // namespace cs

// values, own, beside: count x 4; grounds: x 4.
CS_EXPORT void cs_seam_shares(int64_t count, const float* values, const double* own, const double* beside,
                              int64_t grounds, const double* ground, int64_t steps, double odd, double better,
                              double* share, double* rest) {
  using namespace cs;
  for (int64_t i = 0; i < count; i++) {
    const Colour value = colour(values + 4 * i), mine = colour(own + 4 * i), other = colour(beside + 4 * i);
    share[i] = 0.0, rest[i] = std::numeric_limits<double>::infinity();
    for (int64_t g = 0; g < grounds; g++) {
      const Colour beneath = colour(ground + 4 * g);
      if (!(std::min(mine.off(1.0, beneath), other.off(1.0, beneath)) > odd)) continue;
      for (const bool forward : {true, false}) {
        const Seam found = nearest(value, forward ? other : mine, forward ? mine : other, beneath, steps);
        if (found.gap + better >= rest[i]) continue;
        const double part = double(found.step) / double(steps);
        share[i] = forward ? part : 1.0 - part, rest[i] = found.gap;
      }
    }
  }
}
