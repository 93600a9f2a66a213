// Places new convex shapes in front of a picture, one after the other: of many tries the one that takes away most of
// the squared error, then moved at random for as long as that takes away more. Source of the search: M. Fogleman's
// primitive. Sums along the rows give the error under a shape, and its best colour, in a time by its rows alone.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "abi.h"

namespace {

constexpr int kColours = 3;
constexpr int kSums = kColours + 2;
// Of the step of a move: where it pays, and where it does not. Sizes stay where one move in five pays.
constexpr float kLonger = 1.5f, kShorter = 0.9f;
constexpr float kShift = 0.5f, kTurn = 0.4f, kGrowth = 0.4f;  // of a step: mean half-axes, radians, logarithm

// A shape: the unit outline turned, stretched along the axes, turned by the angle and shifted.
struct Place {
  float x, y, angle, across, down, turn;  // across, down: logarithms of half-axes in px
};

struct Found {
  float gain = 0, colour[kColours] = {};
};

class Placing {
 public:
  Placing(const float* target, const float* weights, float* picture, int height, int width, const float* outline,
          int corners, float opacity)
      : target_(target), weights_(weights), picture_(picture), height_(height), width_(width), outline_(outline),
        corners_(corners), opacity_(opacity), sums_(size_t(height) * (width + 1) * kSums), left_(height),
        right_(height), x_(corners), y_(corners) {
    sum_rows(0, height);
  }

  // By how much the error falls with the shape there, in the colour that suits best.
  Found gain(const Place& place) {
    float total[kSums] = {};
    const auto [top, bottom] = spans(place);
    for (int y = top; y < bottom; ++y) {
      if (left_[y] >= right_[y]) continue;
      const float* row = &sums_[size_t(y) * (width_ + 1) * kSums];
      for (int k = 0; k < kSums; ++k) total[k] += row[right_[y] * kSums + k] - row[left_[y] * kSums + k];
    }
    Found found;
    const float weight = total[kColours + 1];
    if (!(weight > 0)) return found;
    found.gain = total[kColours];
    for (int k = 0; k < kColours; ++k) {
      found.colour[k] = std::clamp(total[k] / (opacity_ * weight), 0.0f, 1.0f);
      const float painted = opacity_ * found.colour[k];
      found.gain += painted * (2 * total[k] - weight * painted);
    }
    return found;
  }

  void paint(const Place& place, const float* colour) {
    const auto [top, bottom] = spans(place);
    for (int y = top; y < bottom; ++y)
      for (int x = left_[y]; x < right_[y]; ++x) {
        float* pixel = picture_ + (size_t(y) * width_ + x) * kColours;
        for (int k = 0; k < kColours; ++k) pixel[k] += opacity_ * (colour[k] - pixel[k]);
      }
    sum_rows(top, bottom);
  }

 private:
  const float *target_, *weights_;
  float* picture_;
  int height_, width_;
  const float* outline_;
  int corners_;
  float opacity_;
  // H x (W + 1) x kSums, from the row's start, weighted: what the picture seen through the shape lacks of the target,
  // by how much the squared error falls with black there, and 1.
  std::vector<float> sums_;
  std::vector<int> left_, right_;  // of each row, the pixels of the last shape
  std::vector<float> x_, y_;       // its corners

  void sum_rows(int top, int bottom) {
    for (int y = top; y < bottom; ++y) {
      float* sum = &sums_[size_t(y) * (width_ + 1) * kSums];
      for (int x = 0; x < width_; ++x, sum += kSums) {
        const size_t pixel = size_t(y) * width_ + x;
        const float weight = weights_ ? weights_[pixel] : 1.0f;
        float fall = 0;
        for (int k = 0; k < kColours; ++k) {
          const float wanted = target_[pixel * kColours + k], now = picture_[pixel * kColours + k];
          const float lacking = wanted - (1 - opacity_) * now;
          sum[kSums + k] = sum[k] + weight * lacking;
          fall += (wanted - now) * (wanted - now) - lacking * lacking;
        }
        sum[kSums + kColours] = sum[kColours] + weight * fall;
        sum[kSums + kColours + 1] = sum[kColours + 1] + weight;
      }
    }
  }

  // The pixels whose middles lie in the shape, and the rows, from the first to the one after the last.
  std::pair<int, int> spans(const Place& place) {
    const float a = std::exp(place.across), b = std::exp(place.down);
    const float c = std::cos(place.angle), s = std::sin(place.angle);
    const float u = std::cos(place.turn), v = std::sin(place.turn);
    for (int i = 0; i < corners_; ++i) {
      const float p = a * (u * outline_[2 * i] - v * outline_[2 * i + 1]);
      const float q = b * (v * outline_[2 * i] + u * outline_[2 * i + 1]);
      x_[i] = place.x + c * p - s * q, y_[i] = place.y + s * p + c * q;
    }
    const auto [low, high] = std::minmax_element(y_.begin(), y_.end());
    const int top = first(*low, height_), bottom = first(*high, height_);
    std::fill(left_.begin() + top, left_.begin() + std::max(top, bottom), width_);
    std::fill(right_.begin() + top, right_.begin() + std::max(top, bottom), 0);
    for (int i = 0, j = corners_ - 1; i < corners_; j = i++) {
      const int begin = first(std::min(y_[i], y_[j]), height_), end = first(std::max(y_[i], y_[j]), height_);
      const float slope = (x_[j] - x_[i]) / (y_[j] - y_[i]);
      for (int y = begin; y < end; ++y) {
        const int x = first(x_[i] + (float(y) + 0.5f - y_[i]) * slope, width_);
        left_[y] = std::min(left_[y], x), right_[y] = std::max(right_[y], x);
      }
    }
    return {top, bottom};
  }

  // The first of so many pixels whose middle lies at a coordinate or beyond.
  static int first(float coordinate, int count) {
    return int(std::clamp(std::ceil(coordinate - 0.5f), 0.0f, float(count)));
  }
};

}  // namespace

// target, picture: height x width x 3, of which the picture is painted on; weights: height x width, or null. outline:
// corners x 2, convex. tries: count x try_count x 6, as in Place; moves: count x move_count x 6, of mean 0 and standard
// deviation 1. Writes to found, count x 9, places and colours from back to front.
CS_EXPORT void cs_place(const float* target, const float* weights, float* picture, int64_t height, int64_t width,
                        const float* outline, int64_t corners, double opacity, const float* tries, int64_t try_count,
                        const float* moves, int64_t move_count, int64_t count, float* found) {
  Placing placing(target, weights, picture, int(height), int(width), outline, int(corners), float(opacity));
  for (int64_t n = 0; n < count; ++n, tries += 6 * try_count, moves += 6 * move_count, found += 9) {
    Place best{};
    Found known;
    for (int64_t i = 0; i < try_count; ++i) {
      const float* t = tries + 6 * i;
      const Place place{t[0], t[1], t[2], t[3], t[4], t[5]};
      const Found now = placing.gain(place);
      if (i == 0 || now.gain > known.gain) best = place, known = now;
    }
    float step = 1;
    for (int64_t i = 0; i < move_count; ++i) {
      const float *m = moves + 6 * i, shift = step * kShift * std::exp(0.5f * (best.across + best.down));
      const Place place{best.x + shift * m[0],
                        best.y + shift * m[1],
                        best.angle + step * kTurn * m[2],
                        best.across + step * kGrowth * m[3],
                        best.down + step * kGrowth * m[4],
                        best.turn + step * kTurn * m[5]};
      const Found now = placing.gain(place);
      const bool pays = now.gain > known.gain;
      if (pays) best = place, known = now;
      step = std::min(1.0f, step * (pays ? kLonger : kShorter));
    }
    placing.paint(best, known.colour);
    const float values[9] = {best.x,    best.y,          best.angle,      best.across,    best.down,
                             best.turn, known.colour[0], known.colour[1], known.colour[2]};
    std::copy(values, values + 9, found);
  }
}
