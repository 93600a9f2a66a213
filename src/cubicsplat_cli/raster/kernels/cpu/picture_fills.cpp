// The fill colours that the even parts of a picture show. What is computed is said in artwork/regions/fills.py. Pictures
// are premultiplied RGBA in levels of 0..255.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
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

}  // namespace
}  // namespace cs

extern "C" {

// The fills (room x 4) and sizes (room, px) of `parts` parts of a picture of `count` pixels. owner: the part of each,
// from 1 on, 0 for none. Parts whose colours spread by no more than `even` levels have one fill, others one for every
// cell of `side` levels. room: as many as pixels have a part. Returns the number of fills; -1 where there is no memory.
CS_EXPORT int64_t cs_part_fills(int64_t count, const float* levels, const int32_t* owner, int64_t parts, double even,
                                double side, double* fills, double* sizes) {
  using namespace cs;
  return counted([&] {
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
  });
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
}
