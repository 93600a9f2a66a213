// Finding and undoing dither. What is computed is said in raster/unmix.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "parallel.h"

namespace cs {
namespace {

// Whether a value is a dot of dither, where a row has so many values.
inline bool is_dot(const float* value, int64_t line, int64_t channels, float contrast) {
  const float own = *value, beside = value[-channels];
  if (value[channels] != beside || value[-line] != beside || value[line] != beside) return false;
  if (std::fabs(own - beside) < contrast) return false;
  const bool falling[2] = {value[-line - channels] == own, value[line + channels] == own};
  const bool rising[2] = {value[-line + channels] == own, value[line - channels] == own};
  const bool sinks = falling[0] && falling[1] && !rising[0] && !rising[1];
  const bool rises = rising[0] && rising[1] && !falling[0] && !falling[1];
  return !sinks && !rises;
}

}  // namespace
}  // namespace cs

// Which pixels (height x width) of levels (height x width x channels) are dots of dither.
CS_EXPORT int32_t cs_dither_dots(const float* levels, int64_t height, int64_t width, int64_t channels, double contrast,
                                 uint8_t* dots) {
  const int64_t line = width * channels;
  for (int64_t y = 1; y < height - 1; y++)
    for (int64_t x = 1; x < width - 1; x++) {
      const float* value = levels + y * line + x * channels;
      for (int64_t c = 0; c < channels && !dots[y * width + x]; c++)
        dots[y * width + x] = cs::is_dot(value + c, line, channels, float(contrast));
    }
  return 0;
}

// The means (height x width x channels) of levels around the pixels `where`; other pixels stay. Returns 1 where there is
// no memory, else 0.
CS_EXPORT int32_t cs_guided_means(const float* levels, const float* guide, int64_t height, int64_t width,
                                  int64_t channels, const uint8_t* where, double px, double range, int64_t threads,
                                  float* out) {
  return cs::failed([&] {
    std::copy(levels, levels + height * width * channels, out);
    const int64_t reach = int64_t(std::ceil(2.5 * px));
    const float near = float(-0.5 / (px * px)), alike = float(-0.5 / (range * range));
    cs::each_index(height, threads, [&](int64_t y) {
      std::vector<double> sums(channels);
      for (int64_t x = 0; x < width; x++) {
        if (!where[y * width + x]) continue;
        const float* own = guide + (y * width + x) * channels;
        double total = 0.0;
        std::fill(sums.begin(), sums.end(), 0.0);
        for (int64_t v = std::max<int64_t>(y - reach, 0); v <= std::min(y + reach, height - 1); v++)
          for (int64_t u = std::max<int64_t>(x - reach, 0); u <= std::min(x + reach, width - 1); u++) {
            const int64_t at = (v * width + u) * channels;
            float square = 0.0f;
            for (int64_t c = 0; c < channels; c++) square += (guide[at + c] - own[c]) * (guide[at + c] - own[c]);
            const double weight = std::exp(alike * square + near * float((v - y) * (v - y) + (u - x) * (u - x)));
            total += weight;
            for (int64_t c = 0; c < channels; c++) sums[c] += weight * levels[at + c];
          }
        for (int64_t c = 0; c < channels; c++) out[(y * width + x) * channels + c] = float(sums[c] / total);
      }
    });
  });
}
