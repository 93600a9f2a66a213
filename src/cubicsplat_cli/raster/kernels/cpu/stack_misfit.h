// How a picture is compared with another one: through a blur, pixel by pixel.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "stack.h"

namespace cs {

// Blurs a picture of four channels in place, along rows and then columns; beyond its border it goes on as it ends.
// transposed: spreads what each pixel holds instead, which is what derivatives do.
inline void blur(const CsFit& fit, double* image, int width, int height, bool transposed) {
  std::vector<double> line(4 * size_t(std::max(width, height)));
  const auto pass = [&](int lines, int64_t next, int length, int64_t step) {
    for (int j = 0; j < lines; j++) {
      double* start = image + 4 * (next * j);
      std::fill(line.begin(), line.end(), 0.0);
      for (int i = 0; i < length; i++)
        for (int d = -fit.reach; d <= fit.reach; d++) {
          const int other = std::clamp(i + d, 0, length - 1);
          const int to = transposed ? other : i, from = transposed ? i : other;
          for (int k = 0; k < 4; k++) line[4 * to + k] += fit.taps[std::abs(d)] * start[4 * step * from + k];
        }
      for (int i = 0; i < length; i++)
        for (int k = 0; k < 4; k++) start[4 * step * i + k] = line[4 * i + k];
    }
  };
  pass(height, width, width, 1);
  pass(width, 1, height, width);
}

// The residual of a pixel, each channel weighted, and its length.
inline double residual(const CsFit& f, const double* image, int64_t pixel, double* rest) {
  double squares = 0.0;
  for (int k = 0; k < 4; k++) {
    rest[k] = (image[4 * pixel + k] - f.target[4 * pixel + k]) * f.channels[k];
    squares += rest[k] * rest[k];
  }
  return std::sqrt(squares);
}

}  // namespace cs
