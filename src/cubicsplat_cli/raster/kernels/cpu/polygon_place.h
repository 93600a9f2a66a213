// Polygons of a stack on a grid, and what one of them would change of the picture's squared error with any outline and
// colour. That is quadratic in the colour, so that sums over what an outline covers tell it of all colours at once.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace cs {
namespace {

constexpr int kColours = 3, kLevels = 15;                     // channels, and the highest level of one
constexpr int kFirst = kColours + 1, kSums = 2 * kFirst + 1;  // those by coverage, and with those by its square
constexpr int kLines = 2;                                     // sampled in a row of pixels

using Outline = std::vector<int32_t>;  // x and y of each vertex, units
using Paint = std::array<int32_t, kColours>;

struct Crossing {
  float x;
  int turn;
};

// Part of the picture, px.
struct Window {
  int left, top, right, bottom;
  int width() const { return right - left; }
  size_t pixels() const { return size_t(right - left) * (bottom - top); }
};

// The part of a window that holds vertices, and what is between them.
Window around(const std::vector<float>& vertices, const Window& window) {
  float low[2], high[2];
  for (int axis = 0; axis < 2; ++axis) {
    low[axis] = std::numeric_limits<float>::max(), high[axis] = -low[axis];
    for (size_t i = axis; i < vertices.size(); i += 2) {
      low[axis] = std::min(low[axis], vertices[i]), high[axis] = std::max(high[axis], vertices[i]);
    }
  }
  const auto within = [](float value, int least, int most) {
    return int(std::clamp(value, float(least), float(most)));
  };
  return {within(std::floor(low[0]), window.left, window.right), within(std::floor(low[1]), window.top, window.bottom),
          within(std::ceil(high[0]), window.left, window.right), within(std::ceil(high[1]), window.top, window.bottom)};
}

// Finds the coverage of polygons, by the nonzero rule: exact along each of a few lines in a row of pixels.
class Coverage {
 public:
  explicit Coverage(int width) : row_(width + 2) {}

  // Calls each(y, first, last, coverage of pixel `first` and on) for every row of the window that it covers.
  template <class Each>
  void rows(const std::vector<float>& outline, const Window& window, Each&& each) {
    const Window part = around(outline, window);
    const float width = float(window.width());
    if (part.left >= part.right) return;
    for (int y = part.top; y < part.bottom; ++y) {
      int first = window.width(), last = -1;
      for (int line = 0; line < kLines; ++line) {
        cross(outline, float(y) + (float(line) + 0.5f) / kLines);
        int winding = 0;
        for (const Crossing& crossing : crossings_) {
          const int before = winding;
          winding += crossing.turn;
          if (before && winding) continue;
          const float x = std::clamp(crossing.x - float(window.left), 0.0f, width), sign = before ? -1.0f : 1.0f;
          const int pixel = int(x);
          const float share = x - float(pixel);
          row_[pixel] += sign * (1 - share) / kLines, row_[pixel + 1] += sign * share / kLines;
          first = std::min(first, pixel), last = std::max(last, pixel);
        }
      }
      if (last < 0) continue;
      float sum = 0;
      for (int x = first; x <= last + 1; ++x) sum += row_[x], row_[x] = sum;
      const int end = std::min(last + 1, window.width());
      if (first < end) each(y, first, end, row_.data() + first);
      std::fill(row_.begin() + first, row_.begin() + last + 2, 0.0f);
    }
  }

 private:
  std::vector<float> row_;
  std::vector<Crossing> crossings_;

  // Where the sides cross a line, from left to right.
  void cross(const std::vector<float>& outline, float y) {
    crossings_.clear();
    for (size_t i = 0, j = outline.size() - 2; i < outline.size(); j = i, i += 2) {
      const float *a = &outline[j], *b = &outline[i];
      if ((a[1] <= y) == (b[1] <= y)) continue;
      const Crossing found{a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]), a[1] <= y ? 1 : -1};
      size_t place = crossings_.size();
      crossings_.push_back(found);
      for (; place > 0 && crossings_[place - 1].x > found.x; --place) crossings_[place] = crossings_[place - 1];
      crossings_[place] = found;
    }
  }
};

// A picture and the polygons drawn over a ground, from front to back.
struct Stack {
  const float *goal, *weights;
  int height, width, channels;
  const double* scale;  // px per unit, along x and y
  const int32_t *vertices, *ends, *levels;
  int64_t count;
  const float* ground;
  float opacity;

  Outline outline(int64_t index) const {
    return {vertices + 2 * (index ? ends[index - 1] : 0), vertices + 2 * ends[index]};
  }
  Paint paint(int64_t index) const {
    const int32_t* level = levels + kColours * index;
    return {level[0], level[1], level[2]};
  }
  std::vector<float> pixels(const Outline& outline) const {
    std::vector<float> scaled(outline.size());
    for (size_t i = 0; i < outline.size(); ++i) scaled[i] = float(outline[i] * scale[i % 2]);
    return scaled;
  }
};

// The change p + q c + r c c of the error from that without a polygon, for its colour c.
struct Cost {
  double p = 0, q[kColours] = {}, r = 0;
  double of(const Paint& paint) const {
    double sum = p;
    for (int k = 0; k < kColours; ++k) {
      const double c = double(paint[k]) / kLevels;
      sum += c * (q[k] + r * c);
    }
    return sum;
  }
  Paint best() const {
    Paint paint{};
    for (int k = 0; r > 0 && k < kColours; ++k)
      paint[k] = int32_t(std::clamp(std::nearbyint(-0.5 * q[k] / r * kLevels), 0.0, double(kLevels)));
    return paint;
  }
};

// What the part of the picture that outlines cover looks like without one of the polygons.
class Place {
 public:
  Place(const Stack& stack, int64_t index, const std::vector<Outline>& outlines) : stack_(stack) {
    std::vector<float> all;
    for (const Outline& outline : outlines) {
      const std::vector<float> scaled = stack.pixels(outline);
      all.insert(all.end(), scaled.begin(), scaled.end());
    }
    window_ = around(all, {0, 0, stack.width, stack.height});
    const int n = stack.channels;
    std::vector<float> behind(window_.pixels() * n), front(behind.size()), seen(window_.pixels(), 1.0f);
    for (size_t k = 0; k < behind.size(); ++k) behind[k] = stack.ground[k % n];
    Coverage coverage(window_.width());
    for (int64_t i = 0; i < stack.count; ++i) {  // those in front, from front to back, and then those behind
      const int64_t which = i < index ? i : stack.count + index - i;
      if (which == stack.count) continue;
      float paint[kColours + 1] = {0, 0, 0, 1};
      for (int c = 0; c < kColours; ++c) paint[c] = float(stack.levels[which * kColours + c]) / kLevels;
      coverage.rows(stack.pixels(stack.outline(which)), window_, [&](int y, int first, int end, const float* a) {
        size_t k = size_t(y - window_.top) * window_.width() + first;
        for (int x = first; x < end; ++x, ++k, ++a) {
          const float alpha = *a * stack.opacity;
          for (int c = 0; c < n; ++c) {
            if (which < index)
              front[k * n + c] += seen[k] * alpha * paint[c];
            else
              behind[k * n + c] += alpha * (paint[c] - behind[k * n + c]);
          }
          if (which < index) seen[k] *= 1 - alpha;
        }
      });
    }
    gather(behind, front, seen);
  }

  // What a polygon with this outline costs.
  Cost cost(const Outline& outline) const {
    double sums[kSums] = {};
    Coverage(window_.width()).rows(stack_.pixels(outline), window_, [&](int y, int first, int end, const float* a) {
      const float* from = &moments_[(size_t(y - window_.top) * (window_.width() + 1) + first) * kSums];
      float row[kSums] = {};
      for (int x = first; x < end;) {
        const float alpha = *a * stack_.opacity, square = alpha * alpha, *to = from;
        for (const float same = *a; x < end && *a == same; ++x, ++a) to += kSums;  // between two sides it is constant
        for (int k = 0; k < kFirst; ++k) row[k] += alpha * (to[k] - from[k]);
        for (int k = kFirst; k < kSums; ++k) row[k] += square * (to[k] - from[k]);
        from = to;
      }
      for (int k = 0; k < kSums; ++k) sums[k] += double(row[k]);
    });
    Cost cost;
    cost.p = sums[kFirst] - 2 * sums[0], cost.r = sums[kSums - 1];
    for (int c = 0; c < kColours; ++c) cost.q[c] = 2 * (sums[1 + c] - sums[kFirst + 1 + c]);
    return cost;
  }

 private:
  const Stack& stack_;
  Window window_;
  std::vector<float> moments_;

  // Sums from the left over each row, 0 at first, of what a pixel adds: by coverage w t e b and w t e of each colour,
  // and by its square those of w t t b b, w t t b and w t t. There e is the error without the polygon, b the colour
  // behind it and t how much is seen of it through those in front, for weights w. A picture with alpha counts half over
  // black and half over white.
  void gather(const std::vector<float>& behind, const std::vector<float>& front, const std::vector<float>& seen) {
    moments_.resize((window_.pixels() + window_.bottom - window_.top) * kSums);
    float* of = moments_.data();
    const int n = stack_.channels;
    for (int y = window_.top, k = 0; y < window_.bottom; ++y, of += kSums) {
      for (int x = window_.left; x < window_.right; ++x, ++k) {
        std::copy(of, of + kSums, of + kSums);
        of += kSums;
        const size_t pixel = size_t(y) * stack_.width + x;
        const float* b = &behind[size_t(k) * n];
        const float *f = &front[size_t(k) * n], *goal = stack_.goal + pixel * n;
        const float t = seen[k], weight = (stack_.weights ? stack_.weights[pixel] : 1.0f) * t;
        for (int over = kColours; over <= n; ++over) {  // black, or what is opaque, and white
          const bool white = over > kColours;
          const float share = weight / float(n - kColours + 1);
          const float rest = white ? 1 - b[kColours] : 0.0f;
          const float alpha = white ? f[kColours] + t * b[kColours] - goal[kColours] : 0.0f;
          for (int c = 0; c < kColours; ++c) {
            const float ground = b[c] + rest, error = f[c] + t * b[c] - goal[c] - alpha;
            of[0] += share * error * ground, of[1 + c] += share * error;
            of[kFirst] += share * t * ground * ground, of[kFirst + 1 + c] += share * t * ground;
          }
        }
        of[kSums - 1] += weight * t;
      }
    }
  }
};

}  // namespace
}  // namespace cs
