// SSIM of one channel of two pictures and more, as sums over its windows. evaluate/metrics.py says what it is.
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

constexpr int kReach = 5, kTaps = 2 * kReach + 1;  // of a window, px
constexpr double kSigma = 1.5;
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;

// The weights of a window's middle and of those beside it.
std::array<float, kReach + 1> weights() {
  std::array<double, kReach + 1> raw{};
  double sum = 0.0;
  for (int k = 0; k <= kReach; k++) {
    raw[k] = std::exp(-0.5 * (k / kSigma) * (k / kSigma));
    sum += k ? 2.0 * raw[k] : raw[k];
  }
  std::array<float, kReach + 1> out{};
  for (int k = 0; k <= kReach; k++) out[k] = float(raw[k] / sum);
  return out;
}

// The weighted sums of kTaps lines of so many values.
void smooth(const std::array<const float*, kTaps>& lines, int64_t count, float* __restrict out) {
  static const auto w = weights();
  const auto [a, b, c, d, e, m, f, g, h, i, j] = lines;
  for (int64_t x = 0; x < count; x++)
    out[x] = w[0] * m[x] + w[1] * (e[x] + f[x]) + w[2] * (d[x] + g[x]) + w[3] * (c[x] + h[x]) + w[4] * (b[x] + i[x]) +
             w[5] * (a[x] + j[x]);
}

// Of a reference and others, (1 + count, height, width): what is smoothed lies in lines, that of the reference and for
// each other its values, the squares of both, and their product. All about the reference's mean, so that the variances,
// which are differences of smoothed squares, lose little to rounding.
class Similarity {
 public:
  Similarity(const float* planes, int64_t count, int64_t height, int64_t width)
      : planes_(planes), count_(count), height_(height), width_(width), lines_(1 + 3 * count) {
    double sum = 0.0;
    for (int64_t i = 0; i < height * width; i++) sum += planes[i];
    middle_ = float(sum / double(height * width));
    for (auto& line : recent_) line.resize(lines_ * width);
    down_.resize(width);
    smoothed_.assign(lines_, std::vector<float>(width));
  }

  void add(double* sums) {
    const int64_t windows = width_ - 2 * kReach;
    for (int64_t row = 0; row < height_; row++) {
      read(row, recent_[row % kTaps].data());
      if (row < 2 * kReach) continue;
      for (int64_t line = 0; line < lines_; line++) {
        std::array<const float*, kTaps> above{}, beside{};
        for (int k = 0; k < kTaps; k++) above[k] = &recent_[(row - 2 * kReach + k) % kTaps][line * width_];
        smooth(above, width_, down_.data());
        for (int k = 0; k < kTaps; k++) beside[k] = &down_[k];
        smooth(beside, windows, smoothed_[line].data());
      }
      for (int64_t k = 0; k < count_; k++) sums[k] += of_row(k, windows);
    }
  }

 private:
  void read(int64_t row, float* __restrict out) const {
    const float* reference = planes_ + row * width_;
    for (int64_t x = 0; x < width_; x++) out[x] = reference[x] - middle_;
    for (int64_t k = 0; k < count_; k++) {
      const float* other = planes_ + ((1 + k) * height_ + row) * width_;
      float *own = out + (1 + 3 * k) * width_, *squares = own + width_, *products = squares + width_;
      for (int64_t x = 0; x < width_; x++) {
        const float a = out[x], b = other[x] - middle_;
        own[x] = b;
        squares[x] = a * a + b * b;
        products[x] = a * b;
      }
    }
  }

  double of_row(int64_t k, int64_t windows) {
    const float *first = smoothed_[0].data(), *second = smoothed_[1 + 3 * k].data();
    const float *squares = smoothed_[2 + 3 * k].data(), *products = smoothed_[3 + 3 * k].data();
    float* out = down_.data();
    for (int64_t x = 0; x < windows; x++) {
      const float a = first[x], b = second[x], p = a + middle_, q = b + middle_;
      const float covariance = 2.0f * (products[x] - a * b) + kC2;
      const float variances = squares[x] - a * a - b * b + kC2;
      out[x] = (2.0f * p * q + kC1) * covariance / ((p * p + q * q + kC1) * variances);
    }
    double sum = 0.0;
    for (int64_t x = 0; x < windows; x++) sum += out[x];
    return sum;
  }

  const float* planes_;
  int64_t count_, height_, width_, lines_;
  float middle_;
  std::array<std::vector<float>, kTaps> recent_;  // rows of the pictures
  std::vector<float> down_;
  std::vector<std::vector<float>> smoothed_;
};

}  // namespace
}  // namespace cs

CS_EXPORT int32_t cs_similarity(const float* planes, int64_t count, int64_t height, int64_t width, double* sums) {
  return cs::failed([&] { cs::Similarity(planes, count, height, width).add(sums); });
}
