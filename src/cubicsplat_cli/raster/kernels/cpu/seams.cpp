// The shares of two fills in pixels in which what lies beneath shines through between them: see `seam_shares` in
// raster/unmix.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "abi.h"

namespace cs {
namespace {

// The largest of the channels of how far two colours are apart.
template <class T>
double apart(const double* a, const T* b) {
  double most = 0.0;
  for (int c = 0; c < 4; c++) most = std::max(most, std::fabs(a[c] - double(b[c])));
  return most;
}

struct Seam {
  int64_t step;
  double gap;
};

// The share, in steps, with which a seam of two fills over a ground is nearest to a value.
Seam nearest(const float* value, const double* front, const double* back, const double* ground, int64_t steps) {
  Seam best{0, std::numeric_limits<double>::infinity()};
  for (int64_t k = 0; k <= steps; k++) {
    const double a = double(k) / double(steps), left = 1.0 - a;
    double seam[4];
    for (int c = 0; c < 4; c++) seam[c] = a * front[c] + left * left * back[c] + a * left * ground[c];
    if (const double gap = apart(seam, value); gap < best.gap) best = {k, gap};
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
  for (int64_t i = 0; i < count; i++, values += 4, own += 4, beside += 4) {
    share[i] = 0.0, rest[i] = std::numeric_limits<double>::infinity();
    for (int64_t g = 0; g < grounds; g++) {
      const double* beneath = ground + 4 * g;
      if (!(std::min(apart(own, beneath), apart(beside, beneath)) > odd)) continue;
      for (const bool forward : {true, false}) {
        const Seam found = nearest(values, forward ? beside : own, forward ? own : beside, beneath, steps);
        if (found.gap + better >= rest[i]) continue;
        const double part = double(found.step) / double(steps);
        share[i] = forward ? part : 1.0 - part, rest[i] = found.gap;
      }
    }
  }
}
