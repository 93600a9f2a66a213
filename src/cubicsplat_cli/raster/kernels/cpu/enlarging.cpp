// Lines of pixels before they were enlarged: linear least squares, whose equations are a band around the diagonal.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

constexpr int kTaps = 6;                          // pixels of the smaller line in one of the larger
constexpr int kRounds = 6;                        // in which clipped values are found
constexpr double kFull = 255.0, kRounding = 0.5;  // levels

// Rows of values, each the sum of kTaps rows of a smaller array, from `first` on, times weights.
class Enlarging {
 public:
  Enlarging(int64_t length, int64_t count, int64_t columns, const int32_t* first, const double* weights)
      : length_(length), count_(count), columns_(columns), first_(first), weights_(weights), band_(count) {
    each([&](int64_t row, int64_t i, double weight) {
      const int64_t last = std::min<int64_t>(first_[row] + kTaps, count_);
      for (int64_t j = i; j < last; j++) band_[i][j - i] += weight * weights_[kTaps * row + j - first_[row]];
    });
    // Cholesky's decomposition: of the column of each number its part from the diagonal on.
    for (int64_t i = 0; i < count_; i++) {
      std::array<double, kTaps>& own = band_[i];
      own[0] = std::sqrt(own[0]);
      for (int k = 1; k < kTaps; k++) own[k] /= own[0];
      for (int k = 1; k < std::min<int64_t>(kTaps, count_ - i); k++)
        for (int l = k; l < kTaps; l++) band_[i + k][l - k] -= own[k] * own[l];
    }
  }

  // large: length x columns, written.
  void enlarge(const double* small, double* large) const {
    std::fill(large, large + length_ * columns_, 0.0);
    each([&](int64_t row, int64_t i, double weight) { add(large + row * columns_, weight, small + i * columns_); });
  }

  // small: count x columns, written: what is nearest to `large` once it is enlarged.
  void solve(const double* large, double* small) const {
    std::fill(small, small + count_ * columns_, 0.0);
    each([&](int64_t row, int64_t i, double weight) { add(small + i * columns_, weight, large + row * columns_); });
    for (int64_t i = 0; i < count_; i++) {
      divide(small + i * columns_, band_[i][0]);
      for (int64_t k = 1; k < std::min<int64_t>(kTaps, count_ - i); k++)
        add(small + (i + k) * columns_, -band_[i][k], small + i * columns_);
    }
    for (int64_t i = count_; i-- > 0;) {
      for (int64_t k = 1; k < std::min<int64_t>(kTaps, count_ - i); k++)
        add(small + i * columns_, -band_[i][k], small + (i + k) * columns_);
      divide(small + i * columns_, band_[i][0]);
    }
  }

 private:
  int64_t length_, count_, columns_;
  const int32_t* first_;
  const double* weights_;
  std::vector<std::array<double, kTaps>> band_;

  // Calls `call(row, i, weight)` for the rows of the larger array and those of the smaller one that are in each.
  template <class Call>
  void each(Call call) const {
    for (int64_t row = 0; row < length_; row++)
      for (int k = 0; k < kTaps; k++) {
        const double weight = weights_[kTaps * row + k];  // 0 of most taps, as few kernels are as wide
        if (weight != 0.0) call(row, first_[row] + k, weight);
      }
  }
  void add(double* to, double weight, const double* from) const {
    for (int64_t c = 0; c < columns_; c++) to[c] += weight * from[c];
  }
  void divide(double* values, double by) const {
    for (int64_t c = 0; c < columns_; c++) values[c] /= by;
  }
};

}  // namespace
}  // namespace cs

extern "C" {

// small: count x columns, written, whole levels; again: length x columns, the same enlarged; see `before_enlarging` in
// raster/ndimage.py. first: length; weights: length x 6, 0 for rows of `small` that there are not.
CS_EXPORT int32_t cs_before_enlarging(int64_t length, int64_t count, int64_t columns, const int32_t* first,
                                      const double* weights, const double* lines, double* small, double* again) {
  using namespace cs;
  return failed([&] {
    const Enlarging enlarging(length, count, columns, first, weights);
    const int64_t values = length * columns;
    std::vector<double> target(lines, lines + values);
    const auto cut_off = [](double v) { return v <= kRounding || v >= kFull - kRounding; };
    const int rounds = std::any_of(lines, lines + values, cut_off) ? kRounds : 0;
    enlarging.solve(lines, small);
    for (int round = 0; round < rounds; round++) {
      for (int64_t n = 0; n < count * columns; n++) small[n] = std::clamp(small[n], 0.0, kFull);
      enlarging.enlarge(small, again);
      // What is beyond an end of the scale was cut off there.
      for (int64_t n = 0; n < values; n++)
        if (cut_off(lines[n]))
          target[n] = lines[n] <= kRounding ? std::min(again[n], lines[n]) : std::max(again[n], lines[n]);
      enlarging.solve(target.data(), small);
    }
    for (int64_t n = 0; n < count * columns; n++) small[n] = std::clamp(std::nearbyint(small[n]), 0.0, kFull);
    enlarging.enlarge(small, again);
  });
}
}
