// The pixels of a picture that nothing explains which is drawn near them. What is computed is said in raster/unmix.py.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

using Colour = std::array<double, 4>;
using Offset = std::array<int64_t, 2>;  // rows, columns

// Over which residuals are averaged: a square of 3 x 3 px, and lines of 5 px in four directions.
std::vector<std::vector<Offset>> stencils() {
  std::vector<std::vector<Offset>> all(5);
  for (int64_t i = -1; i <= 1; i++)
    for (int64_t j = -1; j <= 1; j++) all[0].push_back({i, j});
  for (int64_t i = -2; i <= 2; i++) {
    const Offset lines[] = {{0, i}, {i, 0}, {i, i}, {i, -i}};
    for (int k = 0; k < 4; k++) all[k + 1].push_back(lines[k]);
  }
  return all;
}

class Unexplained {
 public:
  Unexplained(const float* levels, const double* painted, int64_t height, int64_t width, const double* space)
      : levels_(levels), painted_(painted), height_(height), width_(width), space_(space) {}

  double gap(int64_t pixel) const {
    double most = 0.0;
    for (int64_t c = 4 * pixel; c < 4 * pixel + 4; c++) most = std::max(most, std::fabs(levels_[c] - painted_[c]));
    return most;
  }

  // Marks the rough pixels that are unlike all of the other picture's colours within `reach` px.
  void mark(const std::vector<int64_t>& rough, int64_t reach, double seam, double unlike, double own, double allowed,
            const float* ringing, uint8_t* where) {
    const auto all = stencils();
    const auto [seen, drawn] = converted(rough, reach);
    std::vector<int32_t> number(height_ * width_, -1);
    for (size_t n = 0; n < rough.size(); n++) number[rough[n]] = int32_t(n);
    for (const auto& [one, other] : {std::pair{&seen, &drawn}, std::pair{&drawn, &seen}}) {
      std::vector<Colour> off;
      for (const int64_t pixel : rough) off.push_back(beyond((*one)[pixel], *other, pixel, reach, seam, unlike));
      for (size_t n = 0; n < rough.size(); n++) {
        const auto large = [&](double v) { return std::fabs(v) > own * unlike; };
        if (where[rough[n]] || std::none_of(off[n].begin(), off[n].end(), large)) continue;
        for (const std::vector<Offset>& stencil : all) {
          const Colour mean = averaged(off, number, rough[n], stencil);
          for (int c = 0; c < 4; c++) {
            const double least = allowed + ringing[4 * rough[n] + c], along = mean[c] < 0.0 ? -off[n][c] : off[n][c];
            if (std::fabs(mean[c]) > least && along > own * std::fabs(mean[c])) where[rough[n]] = 1;
          }
        }
      }
    }
  }

 private:
  const float* levels_;
  const double* painted_;
  int64_t height_, width_;
  const double* space_;

  template <class Call>
  void around(int64_t pixel, int64_t reach, Call call) const {
    const int64_t y = pixel / width_, x = pixel % width_;
    for (int64_t j = std::max<int64_t>(y - reach, 0); j <= std::min(y + reach, height_ - 1); j++)
      for (int64_t i = std::max<int64_t>(x - reach, 0); i <= std::min(x + reach, width_ - 1); i++) call(j * width_ + i);
  }

  // The pixel further in beside one on the border, where an edge has one of its two colours beyond the picture.
  template <class Call>
  void outwards(int64_t pixel, Call call) const {
    const int64_t y = pixel / width_, x = pixel % width_;
    if (y == 0 && height_ > 1) call(pixel + width_);
    if (y == height_ - 1 && height_ > 1) call(pixel - width_);
    if (x == 0 && width_ > 1) call(pixel + 1);
    if (x == width_ - 1 && width_ > 1) call(pixel - 1);
  }

  template <class Value>
  Colour in_space(const Value* rgba) const {
    Colour out{};
    for (int k = 0; k < 4; k++)
      for (int c = 0; c < 4; c++) out[c] += double(rgba[k]) * space_[4 * k + c];
    return out;
  }

  // Both pictures in the space where they are compared, within `reach` px of some pixels.
  std::pair<std::vector<Colour>, std::vector<Colour>> converted(const std::vector<int64_t>& pixels,
                                                                int64_t reach) const {
    std::vector<Colour> seen(height_ * width_), drawn(height_ * width_);
    std::vector<uint8_t> done(height_ * width_, 0);
    for (const int64_t pixel : pixels)
      around(pixel, reach, [&](int64_t at) {
        if (done[at]) return;
        done[at] = 1, seen[at] = in_space(levels_ + 4 * at), drawn[at] = in_space(painted_ + 4 * at);
      });
    return {std::move(seen), std::move(drawn)};
  }

  // By how much a colour is outside of those that the other picture has within `reach` px.
  Colour beyond(const Colour& own, const std::vector<Colour>& other, int64_t pixel, int64_t reach, double seam,
                double unlike) const {
    Colour low, high, off;
    low.fill(std::numeric_limits<double>::infinity()), high.fill(-std::numeric_limits<double>::infinity());
    around(pixel, reach, [&](int64_t at) {
      for (int c = 0; c < 4; c++) low[c] = std::min(low[c], other[at][c]), high[c] = std::max(high[c], other[at][c]);
    });
    outwards(pixel, [&](int64_t inner) {
      for (int c = 0; c < 4; c++) {
        const double rise = other[pixel][c] - other[inner][c];
        if (rise > unlike) high[c] = std::numeric_limits<double>::infinity();
        if (rise < -unlike) low[c] = -std::numeric_limits<double>::infinity();
      }
    });
    double range = 0.0;
    for (int c = 0; c < 4; c++) range = std::max(range, high[c] - low[c]);
    const double slack = range > unlike ? seam : 0.0;
    for (int c = 0; c < 4; c++) off[c] = own[c] - std::min(std::max(own[c], low[c] - slack), high[c] + slack);
    return off;
  }

  Colour averaged(const std::vector<Colour>& off, const std::vector<int32_t>& number, int64_t pixel,
                  const std::vector<Offset>& stencil) const {
    Colour sum{};
    for (const auto& [dy, dx] : stencil) {
      const int64_t y = pixel / width_ + dy, x = pixel % width_ + dx;
      if (y < 0 || x < 0 || y >= height_ || x >= width_ || number[y * width_ + x] < 0) continue;
      for (int c = 0; c < 4; c++) sum[c] += off[number[y * width_ + x]][c];
    }
    for (double& value : sum) value /= double(stencil.size());
    return sum;
  }
};

}  // namespace
}  // namespace cs

extern "C" {

// gap: (height x width) by how much a picture (height x width x 4) is off what is painted, in the channel with most; where:
// the pixels of more than own * unlike that are unexplained. space: (4 x 4) what both are multiplied by to be compared.
// allowed, and ringing of each (height x width x 4): levels that a mean may be off. Returns 1 where there is no memory.
CS_EXPORT int32_t cs_unexplained(const float* levels, const double* painted, int64_t height, int64_t width,
                                 const double* space, const float* ringing, int64_t reach, double seam, double unlike,
                                 double own, double allowed, double* gap, uint8_t* where) {
  return cs::failed([&] {
    cs::Unexplained pictures(levels, painted, height, width, space);
    std::vector<int64_t> rough;
    for (int64_t pixel = 0; pixel < height * width; pixel++) {
      gap[pixel] = pictures.gap(pixel), where[pixel] = 0;
      if (gap[pixel] > own * unlike) rough.push_back(pixel);
    }
    if (!rough.empty()) pictures.mark(rough, reach, seam, unlike, own, allowed, ringing, where);
  });
}
}
