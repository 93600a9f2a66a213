// Fill colours in pixels: the nearest one, those near a pixel, and the shares of at most three of them in a blend.
// Colours are premultiplied RGBA in levels of 0..255. What is computed is said in raster/unmix.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <vector>

#include "abi.h"
#include "colours.h"

namespace cs {
namespace {

constexpr double kSimpler = 2.0;       // levels by which a blend of three colours must be better than one of two
constexpr double kDeterminate = 1e-3;  // squared sine between the edges of three colours' triangle that tells shares

// A value as a blend of a fill with one or both of two others.
Blend among(const Colour& value, const Colour& fill, const Colour& first, const Colour& second) {
  const Colour a = fill - first, b = second - first, v = value - first;
  const double aa = a.dot(a), bb = b.dot(b), ab = a.dot(b), av = a.dot(v), bv = b.dot(v);
  const double square = aa * bb - ab * ab, det = std::max(square, 1e-6);
  const double t = (av * bb - bv * ab) / det, u = (bv * aa - av * ab) / det;
  Blend best{0.0, INFINITY};
  if (t >= 0.0 && u >= 0.0 && t + u <= 1.0 && square > kDeterminate * aa * bb) best = {t, v.off(t, a, u, b)};
  for (const Colour& base : {first, second}) {
    const Blend two = between(value - base, fill - base);
    if (two.residual <= best.residual + kSimpler) best = two;
  }
  return best;
}

// Sums over square windows of a picture that is 0 but at some pixels, in no more room than the box around these.
class Windows {
 public:
  Windows(int64_t count, const int64_t* y, const int64_t* x, int64_t window)
      : half_(window / 2), even_(window % 2 == 0) {
    top_ = *std::min_element(y, y + count), left_ = *std::min_element(x, x + count);
    height_ = *std::max_element(y, y + count) - top_ + 1, width_ = *std::max_element(x, x + count) - left_ + 1;
    sums_.resize((height_ + 1) * (width_ + 1));
  }

  template <class Value>
  void gather(int64_t count, const int64_t* y, const int64_t* x, const Value& value) {
    std::fill(sums_.begin(), sums_.end(), 0.0);
    for (int64_t i = 0; i < count; i++) at(y[i] - top_ + 1, x[i] - left_ + 1) = value(i);
    for (int64_t row = 1; row <= height_; row++) {
      double along = 0.0;
      for (int64_t column = 1; column <= width_; column++) {
        along += at(row, column);
        at(row, column) = along + at(row - 1, column);
      }
    }
  }

  double around(int64_t y, int64_t x) {
    const int64_t top = std::max<int64_t>(y - top_ - half_, 0), left = std::max<int64_t>(x - left_ - half_, 0);
    const int64_t bottom = std::min(y - top_ + half_ + !even_, height_);
    const int64_t right = std::min(x - left_ + half_ + !even_, width_);
    return at(bottom, right) - at(top, right) - at(bottom, left) + at(top, left);
  }

 private:
  double& at(int64_t row, int64_t column) { return sums_[row * (width_ + 1) + column]; }
  int64_t half_, top_, left_, height_, width_;
  bool even_;
  std::vector<double> sums_;
};

}  // namespace
}  // namespace cs

extern "C" {

// The spread of the values (height x width x channels) in windows of rows x columns px, odd, in the channel with most.
CS_EXPORT int32_t cs_spread(const float* values, int64_t height, int64_t width, int64_t channels, int64_t rows,
                            int64_t columns, float* out) {
  return cs::failed([&] {
    const int64_t line = width * channels, up = rows / 2, beside = columns / 2;
    // The least and greatest along the row, of as many rows as a window has.
    std::vector<float> low(rows * line), high(rows * line), least(line), most(line);
    int64_t next = 0;
    for (int64_t y = 0; y < height; y++) {
      for (; next < std::min(height, y + up + 1); next++) {
        const float* from = values + next * line;
        float *lower = &low[next % rows * line], *higher = &high[next % rows * line];
        std::copy(from, from + line, lower);
        std::copy(from, from + line, higher);
        for (int64_t step = 1; step <= std::min(beside, width - 1); step++) {
          const int64_t shift = step * channels;
          for (int64_t i = shift; i < line; i++) {
            lower[i] = std::min(lower[i], from[i - shift]);
            higher[i] = std::max(higher[i], from[i - shift]);
          }
          for (int64_t i = 0; i < line - shift; i++) {
            lower[i] = std::min(lower[i], from[i + shift]);
            higher[i] = std::max(higher[i], from[i + shift]);
          }
        }
      }
      const int64_t first = std::max<int64_t>(0, y - up);
      std::copy_n(&low[first % rows * line], line, least.begin());
      std::copy_n(&high[first % rows * line], line, most.begin());
      for (int64_t row = first + 1; row < next; row++) {
        const float *lower = &low[row % rows * line], *higher = &high[row % rows * line];
        for (int64_t i = 0; i < line; i++) {
          least[i] = std::min(least[i], lower[i]);
          most[i] = std::max(most[i], higher[i]);
        }
      }
      for (int64_t x = 0; x < width; x++) {
        float found = 0.0f;
        for (int64_t c = 0; c < channels; c++)
          found = std::max(found, most[x * channels + c] - least[x * channels + c]);
        out[y * width + x] = found;
      }
    }
  });
}

// The nearest fill (n) to each of n values, by their distance where that is to be `straight`, else by the channel that is
// farthest off, and how far it is.
CS_EXPORT void cs_nearest_fills(int64_t count, const float* values, int64_t fills, const float* palette,
                                int64_t straight, int32_t* nearest, float* gap) {
  // Pictures have few colours, so most were looked up before.
  int64_t known[4096];
  std::fill(std::begin(known), std::end(known), -1);
  for (int64_t i = 0; i < count; i++) {
    const float* value = values + 4 * i;
    uint32_t bits[4];
    std::memcpy(bits, value, sizeof bits);
    const uint32_t mixed = ((bits[0] * 31u + bits[1]) * 31u + bits[2]) * 31u + bits[3];
    int64_t& before = known[(mixed * 2654435761u) >> 20];
    if (before >= 0 && std::memcmp(values + 4 * before, value, sizeof bits) == 0) {
      nearest[i] = nearest[before], gap[i] = gap[before];
      continue;
    }
    float least = INFINITY;
    int32_t best = 0;
    for (int64_t k = 0; k < fills; k++) {
      float most = 0.0f, square = 0.0f;
      for (int c = 0; c < 4; c++) {
        const float off = std::fabs(value[c] - palette[4 * k + c]);
        most = std::max(most, off), square += off * off;
      }
      if (const float far = straight ? std::sqrt(square) : most; far < least) least = far, best = int32_t(k);
    }
    nearest[i] = best, gap[i] = least;
    before = i;
  }
}

// The different numbers >= 0 of a map (height x width), at most `slots`, nearest to n of its pixels within `reach` px
// to all sides, -1 where there are fewer; and, unless null, the pixels (n x slots) where they are. Returns 1 where
// there is no memory, else 0.
CS_EXPORT int32_t cs_near(const int32_t* map, int64_t height, int64_t width, int64_t count, const int64_t* pixels,
                          int64_t reach, int64_t slots, int32_t* near, int64_t* places) {
  struct Step {
    int64_t square, y, x;
  };
  return cs::failed([&] {
    std::vector<Step> steps;
    for (int64_t dy = -reach; dy <= reach; dy++)
      for (int64_t dx = -reach; dx <= reach; dx++) steps.push_back({dy * dy + dx * dx, dy, dx});
    std::stable_sort(steps.begin(), steps.end(), [](const Step& a, const Step& b) { return a.square < b.square; });
    for (int64_t i = 0; i < count; i++) {
      int32_t* own = near + slots * i;
      int64_t used = 0;
      if (places) std::fill(places + slots * i, places + slots * (i + 1), pixels[i]);
      for (const Step& step : steps) {
        const int64_t row = pixels[i] / width + step.y, column = pixels[i] % width + step.x;
        if (row < 0 || column < 0 || row >= height || column >= width) continue;
        const int32_t found = map[row * width + column];
        if (found < 0 || std::find(own, own + used, found) != own + used) continue;
        if (places) places[slots * i + used] = row * width + column;
        own[used++] = found;
        if (used == slots) break;
      }
      std::fill(own + used, own + slots, -1);
    }
  });
}

// The pair of near fills (n x slots) that blends best to n values: the fill with the greater share, and the residual.
CS_EXPORT void cs_unmix(int64_t count, const float* values, const double* palette, int64_t slots, const int32_t* near,
                        int32_t* winner, double* residual) {
  using namespace cs;
  for (int64_t i = 0; i < count; i++) {
    const Colour value = colour(values + 4 * i);
    const int32_t* own = near + slots * i;
    double least = INFINITY;
    winner[i] = -1, residual[i] = INFINITY;
    for (int64_t a = 0; a < slots; a++) {
      if (own[a] < 0) break;
      const Colour one = colour(palette + 4 * own[a]);
      for (int64_t b = a; b < slots && own[b] >= 0; b++) {
        const Colour other = colour(palette + 4 * own[b]);
        const Blend found = between(value - other, one - other);
        const double cost = found.residual + kFarther * double(a + b);
        if (cost < least) {
          least = cost, residual[i] = found.residual;
          winner[i] = found.share >= 0.5 ? own[a] : own[b];
        }
      }
    }
  }
}

// The least residual of each of n values as a blend of three of the fills near it (n x slots); infinite where there are
// fewer.
CS_EXPORT void cs_unmix_three(int64_t count, const float* values, const double* palette, int64_t slots,
                              const int32_t* near, double* residual) {
  using namespace cs;
  for (int64_t i = 0; i < count; i++) {
    const Colour value = colour(values + 4 * i);
    const int32_t* own = near + slots * i;
    residual[i] = INFINITY;
    for (int64_t a = 0; a < slots; a++)
      for (int64_t b = a + 1; b < slots; b++)
        for (int64_t c = b + 1; c < slots; c++) {
          if (own[a] < 0 || own[b] < 0 || own[c] < 0) continue;
          const Blend found = among(value, colour(palette + 4 * own[a]), colour(palette + 4 * own[b]),
                                    colour(palette + 4 * own[c]));
          residual[i] = std::min(residual[i], found.residual);
        }
  }
}

// The share of a fill in n values that are its blends with one or both of two others, and the residual. *_step: 4, or 0
// where all values have the same one.
CS_EXPORT void cs_blend_with(int64_t count, const double* values, int64_t value_step, const double* fill,
                             int64_t fill_step, const double* first, int64_t first_step, const double* second,
                             int64_t second_step, double* share, double* residual) {
  using namespace cs;
  for (int64_t i = 0; i < count; i++) {
    const Blend found = among(colour(values + value_step * i), colour(fill + fill_step * i),
                              colour(first + first_step * i), colour(second + second_step * i));
    share[i] = found.share, residual[i] = found.residual;
  }
}

// Of n values at pixels y, x the fill that explains those in the window around each best as blends with the two fills
// beside them, first and second (n x 4), and its share and residual there. most: a larger residual counts as that;
// faint: cost of a fill without a share; later: cost of every fill before it in the palette. Returns 1 where there is
// no memory.
CS_EXPORT int32_t cs_line_fills(int64_t count, const float* values, const int64_t* y, const int64_t* x, int64_t fills,
                                const double* palette, const double* first, const double* second, int64_t window,
                                double most, double faint, double later, int64_t* fill, double* share,
                                double* residual) {
  using namespace cs;
  if (!count) return 0;
  return failed([&] {
    Windows sums(count, y, x, window);
    std::vector<double> around(count), best(count, INFINITY);
    std::vector<Blend> blends(count);
    sums.gather(count, y, x, [](int64_t) { return 1.0; });
    for (int64_t i = 0; i < count; i++) around[i] = sums.around(y[i], x[i]), fill[i] = -1, share[i] = residual[i] = 0.0;
    for (int64_t k = 0; k < fills; k++) {
      const Colour own = colour(palette + 4 * k);
      for (int64_t i = 0; i < count; i++)
        blends[i] = among(colour(values + 4 * i), own, colour(first + 4 * i), colour(second + 4 * i));
      sums.gather(count, y, x,
                  [&](int64_t i) { return std::min(blends[i].residual, most) + faint * (1.0 - blends[i].share); });
      for (int64_t i = 0; i < count; i++) {
        const double mean = sums.around(y[i], x[i]) / around[i] + later * double(k);
        if (mean < best[i]) best[i] = mean, fill[i] = k, share[i] = blends[i].share, residual[i] = blends[i].residual;
      }
    }
  });
}

// The squared distance of n values to the nearest blend of two fills, one of them from `from` on.
CS_EXPORT void cs_off_blends(int64_t count, const float* values, int64_t fills, const double* palette, int64_t from,
                             double* square) {
  using namespace cs;
  for (int64_t i = 0; i < count; i++) square[i] = INFINITY;
  for (int64_t a = from; a < fills; a++)
    for (int64_t b = 0; b <= a; b++) {
      const Colour base = colour(palette + 4 * a), span = colour(palette + 4 * b) - base;
      const double length = std::max(span.dot(span), kTiny);
      for (int64_t i = 0; i < count; i++) {
        const Colour rest = colour(values + 4 * i) - base;
        const double t = std::min(std::max(rest.dot(span) / length, 0.0), 1.0);
        double off = 0.0;
        for (int c = 0; c < 4; c++) off += (rest.of[c] - t * span.of[c]) * (rest.of[c] - t * span.of[c]);
        square[i] = std::min(square[i], off);
      }
    }
}
}
