// Where in its pixels two fills lie: the network of `finer_labels` in raster/unmix.py, and the pairs of fills that it is
// asked about.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "colours.h"
#include "parallel.h"

namespace cs {
namespace {

constexpr int64_t kAtOnce = 16;      // pixels that go through the network together
constexpr int kHalvings = 20;        // of the range of a shift of logits
constexpr double kMostShift = 24.0;  // beyond which hardly any share changes
constexpr double kFaint = 2.0;       // levels that a fill costs that a pixel shows nothing of: rounding tells no less
constexpr int64_t kLetter = 4096, kFewFills = 4;  // pixels of a part whose fills are few, and how many these are

// A network of full layers, each but the last one cut off at nothing below. sizes: layers + 1; weights: of each layer
// its matrix, a row for each output, and its offsets.
struct Network {
  int64_t layers;
  const int32_t* sizes;
  const float* weights;

  // The outputs of kAtOnce inputs, which lie beside each other for every number of one; `values` is overwritten.
  void apply(std::vector<float>& values, std::vector<float>& next) const {
    const float* matrix = weights;
    for (int64_t layer = 0; layer < layers; layer++) {
      const int64_t in = sizes[layer], out = sizes[layer + 1];
      const float* offsets = matrix + in * out;
      next.resize(out * kAtOnce);
      for (int64_t o = 0; o < out; o++, matrix += in) {
        float sum[kAtOnce];
        std::fill(sum, sum + kAtOnce, offsets[o]);
        for (int64_t i = 0; i < in; i++)
          for (int64_t k = 0; k < kAtOnce; k++) sum[k] += matrix[i] * values[i * kAtOnce + k];
        for (int64_t k = 0; k < kAtOnce; k++)
          next[o * kAtOnce + k] = layer + 1 < layers ? std::max(sum[k], 0.0f) : sum[k];
      }
      matrix = offsets + out;
      std::swap(values, next);
    }
  }
};

// A picture whose pixels are blends of two fills each.
struct Blended {
  int64_t height, width;
  const int32_t *first, *second;
  const float* share;

  // How much of a fill there is in a pixel; beyond the border the picture goes on as it ends.
  float of(int32_t fill, int64_t y, int64_t x) const {
    const int64_t p = std::clamp<int64_t>(y, 0, height - 1) * width + std::clamp<int64_t>(x, 0, width - 1);
    const float part = first[p] == second[p] ? 0.0f : share[p];
    return (second[p] == fill ? part : 0.0f) + (first[p] == fill ? 1.0f - part : 0.0f);
  }
};

// What lies around a pixel, inverted, mirrored and transposed as `_turned` of tools/train_subpixels.py does it, and how
// to turn the answer back.
class Window {
 public:
  // side: px; values: side^2, written, by how much more there is of the second fill than of the first one.
  Window(const Blended& picture, int64_t p, int64_t side, std::vector<float>& values) {
    const int64_t half = side / 2, y = p / picture.width, x = p % picture.width;
    inverted_ = picture.share[p] > 0.5f;
    double right = 0.0, down = 0.0;
    std::vector<float> seen(values.size());
    for (int64_t i = 0; i < side; i++)
      for (int64_t j = 0; j < side; j++) {
        const int64_t at_y = y + i - half, at_x = x + j - half;
        float& value = seen[i * side + j];
        value = picture.of(picture.second[p], at_y, at_x) - picture.of(picture.first[p], at_y, at_x);
        if (inverted_) value = -value;
        right += value * double(j - half), down += value * double(i - half);
      }
    mirrored_ = right < 0.0;
    upturned_ = down < 0.0;
    transposed_ = std::fabs(down) > std::fabs(right);
    for (int64_t k = 0; k < side * side; k++) values[k] = seen[place(k, side)];
  }

  // The place in the picture of number k of side x side numbers.
  int64_t place(int64_t k, int64_t side) const {
    int64_t row = k / side, column = k % side;
    if (transposed_) std::swap(row, column);
    if (mirrored_) column = side - 1 - column;
    if (upturned_) row = side - 1 - row;
    return row * side + column;
  }

  bool inverted() const { return inverted_; }

 private:
  bool inverted_, mirrored_, upturned_, transposed_;
};

double logistic(double logit) { return 1.0 / (1.0 + std::exp(-logit)); }

// By how much logits must grow for the mean of their shares to be `share`.
double shift_of(const std::vector<double>& logits, double share) {
  double low = -kMostShift, high = kMostShift;
  for (int round = 0; round < kHalvings; round++) {
    const double middle = 0.5 * (low + high);
    double sum = 0.0;
    for (const double logit : logits) sum += logistic(logit + middle);
    (sum < share * double(logits.size()) ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

// How the mean over each of `to` parts of a row comes from `from` numbers: to x from weights.
std::vector<double> means(int64_t from, int64_t to) {
  const double width = double(from) / double(to);
  std::vector<double> weights;
  for (int64_t part = 0; part < to; part++)
    for (int64_t n = 0; n < from; n++) {
      const double end = std::min(double(n + 1), double(part + 1) * width);
      weights.push_back(std::max(0.0, end - std::max(double(n), double(part) * width)) / width);
    }
  return weights;
}

// The share of the second fill in steps^2 steps of each of some pixels. rows: `means` of the network's steps.
void ask(const Network& network, const Blended& picture, const int64_t* pixels, int64_t count, double contrast,
         int64_t steps, const std::vector<double>& rows, float* shares) {
  const int64_t inputs = network.sizes[0], outputs = network.sizes[network.layers];
  const int64_t side = std::llround(std::sqrt(double(inputs))), fine = int64_t(rows.size()) / steps;
  std::vector<float> values(inputs * kAtOnce, 0.0f), next, around(inputs), own(outputs);
  std::vector<Window> windows;
  for (int64_t k = 0; k < count; k++) {
    windows.emplace_back(picture, pixels[k], side, around);
    for (int64_t i = 0; i < inputs; i++) values[i * kAtOnce + k] = around[i];
  }
  network.apply(values, next);
  std::vector<double> logits(outputs);
  for (int64_t k = 0; k < count; k++) {
    const double sign = windows[k].inverted() ? -1.0 : 1.0;
    for (int64_t n = 0; n < outputs; n++) logits[n] = sign * double(values[n * kAtOnce + k]);
    const double shift = shift_of(logits, double(picture.share[pixels[k]]));
    for (int64_t n = 0; n < outputs; n++)
      own[windows[k].place(n, fine)] = float(
          std::clamp(0.5 + contrast * (logistic(logits[n] + shift) - 0.5), 0.0, 1.0));
    for (int64_t to = 0; to < steps * steps; to++) {
      const double *down = &rows[to / steps * fine], *right = &rows[to % steps * fine];
      double sum = 0.0;
      for (int64_t n = 0; n < outputs; n++) sum += down[n / fine] * right[n % fine] * double(own[n]);
      shares[k * steps * steps + to] = float(sum);
    }
  }
}

// Two fills, the share of the second in a value, and by how many levels they are off it.
struct Pair {
  int32_t first, second;
  double share, off;
};

Pair blend_pair(const Colour& value, const double* palette, int32_t first, int32_t second) {
  const Colour one = colour(palette + 4 * first);
  const Blend found = between(value - one, colour(palette + 4 * second) - one);
  return {first, second, found.share, found.residual};
}

// A value as a blend of a fill near it and any other.
Pair likeliest(const Colour& value, int64_t fills, const double* palette, int64_t slots, const int32_t* near,
               double farther) {
  Pair best{0, 0, 0.0, INFINITY};
  for (int64_t a = 0; a < slots && near[a] >= 0; a++)
    for (int32_t b = 0; b < fills; b++) {
      if (b == near[a]) continue;
      Pair pair = blend_pair(value, palette, near[a], b);
      if (std::find(near, near + slots, b) == near + slots) pair.off += farther;
      if (pair.off < best.off) best = pair;
    }
  return best;
}

// Gives the values of a part blends of few fills in place of their likeliest ones, if these explain them as well: of
// fills that do so equally, since a pale line is a blend of many darker ones, that which the values show most of.
void with_few_fills(const std::vector<int64_t>& part, const float* values, int64_t fills, const double* palette,
                    int64_t slots, const int32_t* near, double farther, std::vector<Pair>& pairs) {
  std::vector<int64_t> votes(fills, 0);
  for (const int64_t i : part)
    if (near[slots * i] >= 0) votes[near[slots * i]]++;
  std::vector<int32_t> chosen{int32_t(std::max_element(votes.begin(), votes.end()) - votes.begin())};
  std::vector<Pair> found(part.size(), {chosen[0], chosen[0], 0.0, INFINITY}), best(found), trial(found);
  while (int64_t(chosen.size()) < std::min(kFewFills, fills)) {
    double least = INFINITY, rest = INFINITY;
    int32_t added = -1;
    for (int32_t fill = 0; fill < fills; fill++) {
      if (std::find(chosen.begin(), chosen.end(), fill) != chosen.end()) continue;
      double excess = 0.0, faint = 0.0;
      for (size_t n = 0; n < part.size() && excess + faint < least; n++) {
        trial[n] = found[n];
        for (const int32_t other : chosen) {
          Pair pair = blend_pair(colour(values + 4 * part[n]), palette, other, fill);
          if (!votes[fill]) pair.off += farther;
          if (pair.off < trial[n].off) trial[n] = pair;
        }
        const double worse = std::max(trial[n].off - pairs[part[n]].off, 0.0);
        const double unseen = kFaint * (trial[n].second == fill ? 1.0 - trial[n].share : 1.0);
        excess += worse * worse, faint += unseen * unseen;
      }
      if (excess + faint < least) least = excess + faint, rest = excess, added = fill, std::swap(best, trial);
    }
    if (added < 0) return;
    chosen.push_back(added), found = best;
    if (rest < farther * farther * double(part.size())) {
      for (size_t n = 0; n < part.size(); n++) pairs[part[n]] = found[n];
      return;
    }
  }
}

}  // namespace
}  // namespace cs

// The two of the fills that blend best to n values, and the share of the second: of a part, numbered from 0 on, two of as
// few fills as explain all of its values. near: (n x slots) the fills near each, of which one is the first; a blend with
// another costs `farther` levels more, by which on average fewer fills may explain worse.
CS_EXPORT int32_t cs_blend_pairs(int64_t count, const float* values, const int32_t* parts, int64_t fills,
                                 const double* palette, int64_t slots, const int32_t* near, double farther,
                                 int32_t* first, int32_t* second, float* share) {
  using namespace cs;
  return failed([&] {
    std::vector<Pair> pairs(count);
    std::vector<std::vector<int64_t>> members;
    for (int64_t i = 0; i < count; i++) {
      pairs[i] = likeliest(colour(values + 4 * i), fills, palette, slots, near + slots * i, farther);
      if (size_t(parts[i]) >= members.size()) members.resize(parts[i] + 1);
      members[parts[i]].push_back(i);
    }
    for (const std::vector<int64_t>& part : members)
      if (!part.empty() && int64_t(part.size()) <= kLetter)
        with_few_fills(part, values, fills, palette, slots, near, farther, pairs);
    for (int64_t i = 0; i < count; i++)
      first[i] = pairs[i].first, second[i] = pairs[i].second, share[i] = float(pairs[i].share);
  });
}

// The labels (height steps x width steps) and levels of a picture in so many steps a pixel each way, whose pixels are
// blends of two fills. Returns 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_subpixels(int64_t height, int64_t width, int64_t steps, const int32_t* first,
                               const int32_t* second, const float* share, const double* palette, int64_t layers,
                               const int32_t* sizes, const float* weights, double contrast, int64_t threads,
                               int32_t* labels, float* levels) {
  using namespace cs;
  return failed([&] {
    const Blended picture{height, width, first, second, share};
    std::vector<int64_t> mixed;
    const auto write = [&](int64_t p, const float* parts) {
      for (int64_t k = 0; k < steps * steps; k++) {
        const double part = parts ? double(parts[k]) : 0.0;
        const int64_t at = (p / width * steps + k / steps) * width * steps + p % width * steps + k % steps;
        labels[at] = part > 0.5 ? second[p] : first[p];
        for (int c = 0; c < 4; c++)
          levels[4 * at + c] = float((1.0 - part) * palette[4 * first[p] + c] + part * palette[4 * second[p] + c]);
      }
    };
    for (int64_t p = 0; p < height * width; p++)
      if (first[p] != second[p])
        mixed.push_back(p);
      else
        write(p, nullptr);
    const Network network{layers, sizes, weights};
    const std::vector<double> rows = means(std::llround(std::sqrt(double(sizes[layers]))), steps);
    const int64_t count = int64_t(mixed.size());
    each_index((count + kAtOnce - 1) / kAtOnce, threads, [&](int64_t turn) {
      const int64_t start = turn * kAtOnce, some = std::min(kAtOnce, count - start);
      std::vector<float> shares(some * steps * steps);
      ask(network, picture, &mixed[start], some, contrast, steps, rows, shares.data());
      for (int64_t k = 0; k < some; k++) write(mixed[start + k], &shares[k * steps * steps]);
    });
  });
}
