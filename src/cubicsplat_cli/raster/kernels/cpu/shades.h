// Gradients while they are fitted: a parameter t of every place, and colours that follow straight lines along it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace cs {

constexpr int kMany = 16;        // knots, of which the one before a place is sought by halving
constexpr double kStiff = 1e-6;  // ties knots that hardly a pixel is near to their neighbours, per pixel

// Where pixels are and what they have, premultiplied levels (x 4).
struct Pixels {
  int64_t count;
  const double *x, *y, *values;
};

// (2, 4): an affine map of px, and the lean of a radial gradient whose focus is not its middle. t is the first coordinate
// of what the map gives; or the length, and that along the lean times its length, so that the map takes the focus to 0.
struct Geometry {
  double map[8];
  bool radial;

  Geometry(const double* frame, bool is_radial) : radial(is_radial) { std::copy(frame, frame + 8, map); }

  double t(double x, double y) const {
    const double first = map[0] * x + map[1] * y + map[2];
    if (!radial) return first;
    const double second = map[4] * x + map[5] * y + map[6];
    return std::sqrt(first * first + second * second) + map[3] * first + map[7] * second;
  }
};

// Between which knots a t lies: `after` is the second one's number, `share` what the ramp has of it.
struct Hat {
  int after;
  double share;

  Hat(const double* knots, int count, double t) : after(1) {
    if (count > kMany) after = std::clamp(int(std::upper_bound(knots, knots + count, t) - knots), 1, count - 1);
    while (after < count - 1 && t >= knots[after]) after++;
    const double width = std::max(knots[after] - knots[after - 1], 1e-12);
    share = (std::clamp(t, knots[0], knots[count - 1]) - knots[after - 1]) / width;
  }
};

struct Ramp {
  std::vector<double> knots, colours;  // (K), ascending; (K x 4) levels

  int count() const { return int(knots.size()); }

  void at(double t, double* out) const { blend(Hat(knots.data(), count(), t), out); }

  void blend(const Hat& hat, double* out) const {
    const double *before = &colours[4 * (hat.after - 1)], *after = before + 4;
    for (int k = 0; k < 4; k++) out[k] = before[k] + hat.share * (after[k] - before[k]);
  }
};

// The colours of given knots by weighted least squares: every pixel lies between two of them, so that the equations are
// tridiagonal.
class RampEquations {
 public:
  explicit RampEquations(int knots) : count_(knots), diagonal_(knots), beside_(knots), values_(4 * size_t(knots)) {}

  void add(const Hat& hat, double weight, const double* value) {
    const double after = hat.share, before = 1.0 - after;
    const int i = hat.after - 1;
    diagonal_[i] += weight * before * before, diagonal_[i + 1] += weight * after * after;
    beside_[i] += weight * before * after;
    for (int k = 0; k < 4; k++) {
      values_[4 * i + k] += weight * before * value[k];
      values_[4 * i + 4 + k] += weight * after * value[k];
    }
    total_ += weight;
  }

  // (K x 4)
  std::vector<double> colours() {
    const double stiff = kStiff * total_;
    for (int i = 0; i + 1 < count_; i++) diagonal_[i] += stiff, diagonal_[i + 1] += stiff, beside_[i] -= stiff;
    for (int i = 0; i + 1 < count_; i++) {
      const double factor = beside_[i] / std::max(diagonal_[i], 1e-300);
      diagonal_[i + 1] -= factor * beside_[i];
      for (int k = 0; k < 4; k++) values_[4 * i + 4 + k] -= factor * values_[4 * i + k];
    }
    for (int i = count_ - 1; i >= 0; i--)
      for (int k = 0; k < 4; k++) {
        if (i + 1 < count_) values_[4 * i + k] -= beside_[i] * values_[4 * i + 4 + k];
        values_[4 * i + k] /= std::max(diagonal_[i], 1e-300);
      }
    return values_;
  }

 private:
  int count_;
  double total_ = 0.0;
  std::vector<double> diagonal_, beside_, values_;
};

inline double squared(const double* a, const double* b) {
  double sum = 0.0;
  for (int k = 0; k < 4; k++) sum += (a[k] - b[k]) * (a[k] - b[k]);
  return sum;
}

}  // namespace cs
