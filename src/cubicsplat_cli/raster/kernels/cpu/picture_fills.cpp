// The fill colours that the even parts of a picture show, and which of those of its small squares are lines. What is
// computed is said in artwork/regions/fills.py. Pictures are premultiplied RGBA in levels of 0..255.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <exception>
#include <map>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

using Key = std::array<int32_t, 4>;

// A run of pixels of one rounded colour, or all of them: how many, and the first.
struct Run {
  Key key;
  int64_t count, first;
};

// The colour that a part shows as a whole: the commonest one, or the median where none is common.
void mode(const float* levels, const std::vector<int64_t>& pixels, std::vector<Run>& runs, double* out) {
  runs.clear();
  for (int64_t i : pixels) {
    Key key;
    for (int c = 0; c < 4; c++) key[c] = int32_t(std::nearbyint(levels[4 * i + c]));
    if (!runs.empty() && runs.back().key == key)
      runs.back().count++;
    else
      runs.push_back({key, 1, i});
  }
  std::stable_sort(runs.begin(), runs.end(), [](const Run& a, const Run& b) { return a.key < b.key; });
  size_t kept = 0, best = 0;
  for (size_t i = 1; i < runs.size(); i++) {
    if (runs[i].key == runs[kept].key)
      runs[kept].count += runs[i].count;
    else
      runs[++kept] = runs[i];
  }
  for (size_t i = 1; i <= kept; i++)
    if (runs[i].count > runs[best].count) best = i;
  if (4 * runs[best].count >= int64_t(pixels.size())) {
    for (int c = 0; c < 4; c++) out[c] = levels[4 * runs[best].first + c];
    return;
  }
  std::vector<float> values(pixels.size());
  const auto middle = values.begin() + values.size() / 2;
  for (int c = 0; c < 4; c++) {
    for (size_t i = 0; i < pixels.size(); i++) values[i] = levels[4 * pixels[i] + c];
    std::nth_element(values.begin(), middle, values.end());
    out[c] = values.size() % 2 ? *middle : 0.5f * (*middle + *std::max_element(values.begin(), middle));
  }
}

// The means of the colours of a part within cells of a side, and of how many pixels each is.
int64_t banded(const float* levels, const std::vector<int64_t>& pixels, double side, double* fills, double* sizes) {
  std::map<Key, std::array<double, 5>> cells;
  for (int64_t i : pixels) {
    Key key;
    for (int c = 0; c < 4; c++) key[c] = int32_t(std::floor(double(levels[4 * i + c]) / side));
    std::array<double, 5>& sums = cells[key];
    for (int c = 0; c < 4; c++) sums[c] += levels[4 * i + c];
    sums[4] += 1.0;
  }
  int64_t count = 0;
  for (const auto& [key, sums] : cells) {
    for (int c = 0; c < 4; c++) fills[4 * count + c] = sums[c] / sums[4];
    sizes[count++] = sums[4];
  }
  return count;
}

template <class A, class B>
bool within(const A* a, const B* b, double levels) {
  for (int c = 0; c < 4; c++)
    if (!(std::fabs(double(a[c]) - double(b[c])) <= levels)) return false;
  return true;
}

// A picture (height x width), its places clamped to it.
struct Picture {
  const float* levels;
  int64_t height, width;
  const float* at(int64_t y, int64_t x) const {
    const int64_t row = std::clamp<int64_t>(y, 0, height - 1), column = std::clamp<int64_t>(x, 0, width - 1);
    return levels + 4 * (row * width + column);
  }
};

}  // namespace
}  // namespace cs

extern "C" {

// The fills (room x 4) and sizes (room, px) of `parts` parts of a picture of `count` pixels. owner: the part of each,
// from 1 on, 0 for none. Parts whose colours spread by no more than `even` levels have one fill, others one for every
// cell of `side` levels. room: as many as pixels have a part. Returns the number of fills; -1 where there is no memory.
CS_EXPORT int64_t cs_part_fills(int64_t count, const float* levels, const int32_t* owner, int64_t parts, double even,
                                double side, double* fills, double* sizes) {
  using namespace cs;
  try {
    std::vector<int64_t> ends(parts + 1, 0), order;
    for (int64_t i = 0; i < count; i++) ends[owner[i]] += owner[i] > 0;
    for (int64_t k = 1; k <= parts; k++) ends[k] += ends[k - 1];
    order.resize(ends[parts]);
    std::vector<int64_t> next(ends);
    for (int64_t i = 0; i < count; i++)
      if (owner[i] > 0) order[next[owner[i] - 1]++] = i;
    std::vector<int64_t> pixels;
    std::vector<Run> runs;
    int64_t found = 0;
    for (int64_t k = 0; k < parts; k++) {
      pixels.assign(order.begin() + ends[k], order.begin() + ends[k + 1]);
      float low[4] = {INFINITY, INFINITY, INFINITY, INFINITY}, high[4] = {-INFINITY, -INFINITY, -INFINITY, -INFINITY};
      for (int64_t i : pixels)
        for (int c = 0; c < 4; c++) {
          low[c] = std::min(low[c], levels[4 * i + c]);
          high[c] = std::max(high[c], levels[4 * i + c]);
        }
      float spread = 0.0f;
      for (int c = 0; c < 4; c++) spread = std::max(spread, high[c] - low[c]);
      if (spread <= even) {
        mode(levels, pixels, runs, fills + 4 * found);
        sizes[found++] = double(pixels.size());
      } else {
        found += banded(levels, pixels, side, fills + 4 * found, sizes + found);
      }
    }
    return found;
  } catch (const std::exception&) {
    return -1;
  }
}

// Fills (count x 4) in their order, each joined to the nearest of those kept before where that is within `same` levels,
// else kept, at most `most`. kept: the numbers of those kept; weights: theirs become those of all that joined them.
// Returns how many are kept.
CS_EXPORT int64_t cs_join_fills(int64_t count, const double* fills, double* weights, double same, int64_t most,
                                int64_t* kept) {
  int64_t found = 0;
  for (int64_t i = 0; i < count; i++) {
    double least = INFINITY;
    int64_t nearest = 0;
    for (int64_t k = 0; k < found; k++) {
      double gap = 0.0;
      for (int c = 0; c < 4; c++) gap = std::max(gap, std::fabs(fills[4 * kept[k] + c] - fills[4 * i + c]));
      if (gap < least) least = gap, nearest = kept[k];
    }
    if (least <= same)
      weights[nearest] += weights[i];
    else if (found < most)
      kept[found++] = i;
  }
  return found;
}

// Whether each of `colours` colours (x 4) that fill squares of 2 x 2 px of a picture is what lines of one of the fills
// (x 4) make of two rows of pixels: a blend of it with a ground that lies on both sides of `between` of the squares,
// shares from `lowest` to `highest`, within `off` levels, where more than `more` times its `sizes` px have that fill in
// what is thin (height x width). one: levels that are one colour; same: and of a ground. Returns 1 where there is no
// memory.
CS_EXPORT int32_t cs_are_lines(const float* levels, int64_t height, int64_t width, const uint8_t* thin, int64_t colours,
                               const double* colour, const double* sizes, int64_t fills, const double* fill, double one,
                               double same, double between, double off, double lowest, double highest, double more,
                               uint8_t* lines) {
  using namespace cs;
  const Picture picture{levels, height, width};
  try {
    std::vector<double> thins(fills, -1.0);
    const auto thin_pixels = [&](int64_t k) {
      if (thins[k] < 0.0) {
        thins[k] = 0.0;
        for (int64_t i = 0; i < height * width; i++) thins[k] += thin[i] && within(levels + 4 * i, fill + 4 * k, one);
      }
      return thins[k];
    };
    std::vector<uint8_t> here(height * width);
    std::vector<std::array<const float*, 4>> sides;
    for (int64_t n = 0; n < colours; n++) {
      const double* own = colour + 4 * n;
      for (int64_t i = 0; i < height * width; i++) here[i] = within(levels + 4 * i, own, one);
      sides.clear();
      for (int64_t y = 0; y + 1 < height; y++)
        for (int64_t x = 0; x + 1 < width; x++) {
          const uint8_t* at = &here[y * width + x];
          if (at[0] && at[1] && at[width] && at[width + 1])
            sides.push_back({picture.at(y - 1, x), picture.at(y + 2, x), picture.at(y, x - 1), picture.at(y, x + 2)});
        }
      lines[n] = 0;
      for (int64_t g = 0; g < fills && !sides.empty() && !lines[n]; g++) {
        const double* ground = fill + 4 * g;
        int64_t amid = 0;
        for (const auto& s : sides)
          amid += (within(s[0], ground, same) && within(s[1], ground, same)) ||
                  (within(s[2], ground, same) && within(s[3], ground, same));
        if (double(amid) < between * double(sides.size())) continue;
        for (int64_t k = 0; k < fills && !lines[n]; k++) {
          double length = 0.0, along = 0.0, rest = 0.0;
          for (int c = 0; c < 4; c++) {
            const double span = fill[4 * k + c] - ground[c];
            length += span * span, along += span * (own[c] - ground[c]);
          }
          const double share = along / std::max(length, 1e-9);
          if (!(share > lowest && share < highest)) continue;
          for (int c = 0; c < 4; c++)
            rest = std::max(rest, std::fabs(own[c] - ground[c] - share * (fill[4 * k + c] - ground[c])));
          lines[n] = rest <= off && thin_pixels(k) > more * sizes[n];
        }
      }
    }
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}
}
