// What a picture tells of how it came to be: its colours, how wide its edges are, how its colours change. What is computed is
// said in raster/unmix.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <numeric>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

constexpr int kReach = 8;  // px to either side of an edge, at most
// Squared px by which an edge is displaced from line to line: along the other lines it is less.
constexpr double kSteepest = 1.2;
constexpr double kSquare = 1.0 / 12.0;  // variance of a pixel's width
// Share of its steepest step: a rest that may be cut off an edge, which is a tenth of its variance; noise hides none.
constexpr double kTail = 0.05;

struct Limits {
  double even, contrast, off;
  bool cut;
};

// A picture along its rows, or, turned, along its columns.
struct Lines {
  const float *levels, *luma;
  int64_t height, width, down, along;
  double light(int64_t y, int64_t x) const { return luma[y * down + x * along]; }
  float step(int64_t y, int64_t x) const { return luma[y * down + (x + 1) * along] - luma[y * down + x * along]; }
  const float* colour(int64_t y, int64_t x) const { return levels + 4 * (y * down + x * along); }
};

// The pixels from `first` to `last` of a row, between which an edge lies.
struct Edge {
  int64_t y, first, last;
};

// px by which an edge, of so much light in all, is displaced from line to line.
double shift(const Lines& lines, const Edge& edge, double total) {
  const int64_t before = std::max<int64_t>(edge.y - 1, 0), after = std::min(edge.y + 1, lines.height - 1);
  double sum = 0.0;
  for (int64_t k = edge.first; k <= edge.last; k++) sum += lines.light(after, k) - lines.light(before, k);
  return after > before ? sum / total / double(after - before) : 0.0;
}

// The pixels of an edge are blends of those at either end, as no line between two areas is.
bool blended(const Lines& lines, const Edge& edge, const Limits& limits) {
  double before[4], span[4], square = 0.0;
  for (int c = 0; c < 4; c++) {
    const auto at = [&](int64_t x) { return double(lines.colour(edge.y, x)[c]); };
    const int inner = limits.cut ? 0 : 1;
    before[c] = 0.5 * (at(edge.first) + at(edge.first + inner));
    span[c] = 0.5 * (at(edge.last - inner) + at(edge.last)) - before[c];
    square += span[c] * span[c];
  }
  const double most = limits.off * std::sqrt(square) + limits.even;
  for (int64_t k = edge.first; k <= edge.last; k++) {
    const float* colour = lines.colour(edge.y, k);
    double along = 0.0, rest = 0.0;
    for (int c = 0; c < 4; c++) along += (colour[c] - before[c]) * span[c];
    along /= std::max(square, 1e-6);
    for (int c = 0; c < 4; c++) {
      const double off = colour[c] - before[c] - along * span[c];
      rest += off * off;
    }
    if (!(std::sqrt(rest) <= most)) return false;
  }
  return true;
}

// The pixel at which an edge with its steepest step at x ends, before or behind that. Within reach it does in two even
// steps; or it is cut off where one is even, or where another edge hides a faint rest. -1 where it does not end.
int64_t end_of(const Lines& lines, int64_t y, int64_t x, int64_t way, const Limits& limits) {
  const auto step = [&](int64_t k) { return double(lines.step(y, x) > 0.0f ? lines.step(y, k) : -lines.step(y, k)); };
  const double steepest = step(x), even = limits.even;
  double least = steepest;
  for (int64_t at = x + way; at >= 0 && at + 1 < lines.width; at += way) {
    if (limits.cut && (step(at) <= 0.5 * even || step(at) > least + even)) {
      const bool ends = std::fabs(step(at)) <= 0.5 * even || least <= kTail * steepest;
      return ends && 0.5 * even <= kTail * steepest ? at + (way < 0) : -1;
    }
    // Of one sign, and falling, but for noise.
    if (!(step(at) >= -even && step(at) <= steepest && step(at) <= least + even)) return -1;
    if (std::abs(at - x) == kReach)
      return std::fabs(step(at)) <= even && std::fabs(step(at - way)) <= even ? at + (way > 0) : -1;
    least = std::min(least, std::fabs(step(at)));
  }
  return -1;
}

// The variance of the blur of the edge whose steepest step is at x, px^2; NaN where there is no single edge.
double variance(const Lines& lines, int64_t y, int64_t x, const Limits& limits) {
  const Edge edge{y, end_of(lines, y, x, -1, limits), end_of(lines, y, x, 1, limits)};
  if (edge.first < 0 || edge.last < 0 || !blended(lines, edge, limits)) return NAN;
  const double total = lines.light(y, edge.last) - lines.light(y, edge.first), slant = shift(lines, edge, total);
  if (!(std::fabs(total) > limits.contrast && slant * slant < kSteepest)) return NAN;
  double sum = 0.0, mean = 0.0, square = 0.0;
  for (int64_t k = edge.first; k < edge.last; k++) {
    const double own = lines.step(y, k), step = std::fabs(own) > 0.5 * limits.even ? own : 0.0, at = double(k - x);
    sum += step, mean += step * at, square += step * at * at;
  }
  mean /= sum;
  // Pixels are squares, and steps between them are as wide again.
  return (square / sum - mean * mean - kSquare) / (1.0 + slant * slant) - kSquare;
}

}  // namespace
}  // namespace cs

extern "C" {

// Variances, px^2, of the blur of single edges along the rows of a picture (height x width x 4), and along its
// columns, of at most `most` edges each way; out: room for twice as many. luma: (height x width). even, contrast: levels;
// off: share of an edge's contrast. cut: whether edges count that others
// cut off. Returns how many there are; -1 where there is no memory.
CS_EXPORT int64_t cs_edge_widths(const float* levels, const float* luma, int64_t height, int64_t width, int64_t most,
                                 double even, double contrast, double off, int64_t cut, double* out) {
  using namespace cs;
  return counted([&] {
    int64_t found = 0;
    const Limits limits{even, contrast, off, cut != 0};
    for (const Lines& lines :
         {Lines{levels, luma, height, width, width, 1}, Lines{levels, luma, width, height, 1, width}}) {
      std::vector<std::pair<int64_t, int64_t>> peaks;
      for (int64_t y = 0; y < lines.height; y++)
        for (int64_t x = 1; x + 2 < lines.width; x++) {
          const float own = std::fabs(lines.step(y, x));
          const bool peak = own >= std::fabs(lines.step(y, x - 1)) && own >= std::fabs(lines.step(y, x + 1));
          if (peak && own > contrast / 8.0) peaks.push_back({y, x});
        }
      const int64_t count = int64_t(peaks.size()), kept = std::min(count, most);
      for (int64_t i = 0; i < kept; i++) {
        const auto [y, x] = peaks[kept < count ? i * (count - 1) / (kept - 1) : i];
        const double own = variance(lines, y, x, limits);
        if (!std::isnan(own)) out[found++] = own;
      }
    }
    return found;
  });
}

// The means of windows of size x size px of values (height x width x channels), whose border goes on beyond it, and by how
// much the planes through them change per px, in the channel with most. Returns 1 where there is no memory.
CS_EXPORT int32_t cs_planes(const float* values, int64_t height, int64_t width, int64_t channels, int64_t size,
                            float* means, float* slopes) {
  return cs::failed([&] {
    const int64_t half = size / 2, line = width * channels;
    // Of the rows of a window: the sums along the row, and those times the distance from the middle.
    std::vector<float> sums(size * line), moments(size * line), padded(line + 2 * half * channels);
    std::vector<float> across(line), down(line), mean(line);
    double square = 0.0;
    for (int64_t k = -half; k <= half; k++) square += double(k * k);
    const float slope = float(1.0 / (square * double(size))), share = float(1.0 / double(size * size));
    int64_t next = 0;
    for (int64_t y = 0; y < height; y++) {
      for (; next < std::min(height, y + half + 1); next++) {
        const float* from = values + next * line;
        for (int64_t k = 0; k < half; k++)
          for (int64_t c = 0; c < channels; c++) {
            padded[k * channels + c] = from[c];
            padded[(half + width + k) * channels + c] = from[line - channels + c];
          }
        std::copy(from, from + line, padded.begin() + half * channels);
        float *sum = &sums[next % size * line], *moment = &moments[next % size * line];
        std::fill(sum, sum + line, 0.0f);
        std::fill(moment, moment + line, 0.0f);
        for (int64_t k = 0; k < size; k++) {
          const float at = float(k - half), *shifted = &padded[k * channels];
          for (int64_t i = 0; i < line; i++) sum[i] += shifted[i], moment[i] += at * shifted[i];
        }
      }
      for (auto* each : {&across, &down, &mean}) std::fill(each->begin(), each->end(), 0.0f);
      for (int64_t k = -half; k <= half; k++) {
        const int64_t row = std::clamp<int64_t>(y + k, 0, height - 1) % size * line;
        const float at = float(k), *sum = &sums[row], *moment = &moments[row];
        for (int64_t i = 0; i < line; i++) mean[i] += sum[i], down[i] += at * sum[i], across[i] += moment[i];
      }
      for (int64_t x = 0; x < width; x++) {
        float most = 0.0f;
        for (int64_t i = x * channels; i < (x + 1) * channels; i++) {
          const float u = across[i] * slope, v = down[i] * slope;
          most = std::max(most, u * u + v * v);
          means[y * line + i] = mean[i] * share;
        }
        slopes[y * width + x] = std::sqrt(most);
      }
    }
  });
}

// The larger one of the second differences along the row and along the column at each pixel of a picture (height x width x
// 4), 0 where it has no neighbours, of the first three channels that which has the largest.
CS_EXPORT void cs_second_differences(const float* values, int64_t height, int64_t width, float* out) {
  for (int64_t y = 0; y < height; y++)
    for (int64_t x = 0; x < width; x++) {
      const float* at = values + 4 * (y * width + x);
      const bool beside = x > 0 && x + 1 < width, above = y > 0 && y + 1 < height;
      float most = 0.0f;
      for (int c = 0; c < 3; c++) {
        if (beside) most = std::max(most, std::fabs(at[c + 4] - 2.0f * at[c] + at[c - 4]));
        if (above) most = std::max(most, std::fabs(at[c + 4 * width] - 2.0f * at[c] + at[c - 4 * width]));
      }
      out[y * width + x] = most;
    }
}

// The largest difference of a channel between each pixel and the one `apart` values further on, in so many runs of so many
// pixels, which begin every `stride` values.
CS_EXPORT void cs_steps(const float* values, int64_t runs, int64_t pixels, int64_t channels, int64_t stride,
                        int64_t apart, float* out) {
  for (int64_t run = 0; run < runs; run++) {
    const float *one = values + run * stride, *other = one + apart;
    for (int64_t i = 0; i < pixels; i++, one += channels, other += channels) {
      float most = 0.0f;
      for (int64_t c = 0; c < channels; c++) most = std::max(most, std::fabs(other[c] - one[c]));
      *out++ = most;
    }
  }
}

// The largest difference of the four channels between each pixel and the colour that it is said to be.
CS_EXPORT void cs_off_palette(const float* values, int64_t pixels, const double* palette, const int32_t* labels,
                              double* out) {
  for (int64_t i = 0; i < pixels; i++) {
    const double* colour = palette + 4 * int64_t(labels[i]);
    double most = 0.0;
    for (int c = 0; c < 4; c++) most = std::max(most, std::fabs(double(values[4 * i + c]) - colour[c]));
    out[i] = most;
  }
}

// The different ones of `count` keys: which of them each is, numbered in the order of the keys, and the first of each.
// Returns how many there are; -1 where there is no memory.
CS_EXPORT int64_t cs_distinct(int64_t count, const uint64_t* keys, int64_t* numbers, int64_t* first) {
  return cs::counted([&] {
    std::vector<int64_t> table(1024, -1);
    const auto slot_of = [&](uint64_t key) {
      uint64_t at = (key ^ (key >> 32)) * 0x9e3779b97f4a7c15u >> 20;
      for (;; at++) {
        const int64_t own = table[at & (table.size() - 1)];
        if (own < 0 || keys[first[own]] == key) return at & (table.size() - 1);
      }
    };
    int64_t found = 0;
    for (int64_t i = 0; i < count; i++) {
      if (i > 0 && keys[i] == keys[i - 1]) {
        numbers[i] = numbers[i - 1];
        continue;
      }
      uint64_t slot = slot_of(keys[i]);
      if (table[slot] < 0) {
        first[found] = i;
        table[slot] = found++;
        if (2 * found > int64_t(table.size())) {
          table.assign(2 * table.size(), -1);
          for (int64_t k = 0; k < found; k++) table[slot_of(keys[first[k]])] = k;
          slot = slot_of(keys[i]);
        }
      }
      numbers[i] = table[slot];
    }
    std::vector<int64_t> order(found), place(found), unsorted(first, first + found);
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](int64_t a, int64_t b) { return keys[first[a]] < keys[first[b]]; });
    for (int64_t k = 0; k < found; k++) place[order[k]] = k;
    for (int64_t k = 0; k < found; k++) first[k] = unsorted[order[k]];
    for (int64_t i = 0; i < count; i++) numbers[i] = place[numbers[i]];
    return found;
  });
}
}
