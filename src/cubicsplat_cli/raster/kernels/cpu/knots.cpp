// The numbers of moving curves between their knots, and Adam's steps of what the knots hold (Kingma and Ba, 2015).
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "abi.h"

namespace {

struct Grid {
  const double* steps;  // of each number, to whose multiples knots are rounded; null where they are not

  float at(float value, int64_t number) const {
    return steps ? float(std::nearbyint(double(value) / steps[number]) * steps[number]) : value;
  }
};

struct Adam {
  double rate, keep_mean, keep_square, epsilon;
};

void step_knot(const Adam& adam, int64_t numbers, const float* gradient, float part, bool bounded, float* values,
               float* means, float* squares, int32_t& age) {
  age++;
  const float keep_mean = float(adam.keep_mean), keep_square = float(adam.keep_square);
  const float rate = float(adam.rate / (1.0 - std::pow(adam.keep_mean, age)));
  const float unbiased = float(1.0 / (1.0 - std::pow(adam.keep_square, age)));
  for (int64_t i = 0; i < numbers; i++) {
    const float g = part * gradient[i];
    means[i] = keep_mean * means[i] + (1.0f - keep_mean) * g;
    squares[i] = keep_square * squares[i] + (1.0f - keep_square) * g * g;
    const float moved = values[i] - rate * means[i] / (std::sqrt(unbiased * squares[i]) + float(adam.epsilon));
    values[i] = bounded ? std::clamp(moved, 0.0f, 1.0f) : moved;
  }
}

}  // namespace

// found: curves x numbers, on the lines from values[before] to values[after], a share of the way; both are rows of
// `numbers` values.
CS_EXPORT void cs_between_knots(int64_t curves, int64_t numbers, const float* values, const int64_t* before,
                                const int64_t* after, const float* share, const double* steps, float* found) {
  const Grid grid{steps};
  for (int64_t curve = 0; curve < curves; curve++) {
    const float *first = values + numbers * before[curve], *last = values + numbers * after[curve];
    for (int64_t i = 0; i < numbers; i++, found++) {
      const float start = grid.at(first[i], i);
      *found = share[curve] > 0.0f ? start + share[curve] * (grid.at(last[i], i) - start) : start;
    }
  }
}

// Moves knots by the gradient (curves x numbers) of what lies between them; those rows of `values` stay which `held`
// names. bounded: values stay in [0, 1]. means, squares, ages: Adam's, of the rows of `values`.
CS_EXPORT void cs_step_knots(int64_t curves, int64_t numbers, const float* gradient, const int64_t* before,
                             const int64_t* after, const float* share, const uint8_t* held, int64_t bounded,
                             double rate, double keep_mean, double keep_square, double epsilon, float* values,
                             float* means, float* squares, int32_t* ages) {
  const Adam adam{rate, keep_mean, keep_square, epsilon};
  for (int64_t curve = 0; curve < curves; curve++, gradient += numbers) {
    const auto step = [&](int64_t row, float part) {
      if (held && held[row]) return;
      const int64_t begin = numbers * row;
      step_knot(adam, numbers, gradient, part, bounded, values + begin, means + begin, squares + begin, ages[row]);
    };
    step(before[curve], 1.0f - share[curve]);
    if (share[curve] > 0.0f) step(after[curve], share[curve]);
  }
}
