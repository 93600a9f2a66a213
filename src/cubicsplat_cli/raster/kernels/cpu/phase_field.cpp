// Where in its pixels two fills lie: a phase field of several steps a pixel. What is computed, and where that is from,
// is said in `finer_labels` of raster/unmix.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <vector>

#include "abi.h"
#include "colours.h"
#include "parallel.h"

namespace cs {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr float kStep = 0.5f, kKept = 0.8f;       // of a step downhill, and of the step before it
constexpr double kSharpened = 0.7;                // share of the rounds until which the double well grows
constexpr int64_t kAtOnce = 1024;                 // pixels that a thread takes
constexpr int64_t kLetter = 4096, kFewFills = 4;  // pixels of a part whose fills are few, and how many these are

// Pixels with two fills each, and the share of the second in each of their steps.
class Field {
 public:
  Field(int64_t height, int64_t width, int64_t steps, const int32_t* first, const int32_t* second, const float* share)
      : height_(height), width_(width), steps_(steps), first_(first), second_(second), share_(share) {
    own_.assign(height * width, -1);
    for (int64_t p = 0; p < height * width; p++)
      if (first[p] != second[p]) own_[p] = int64_t(mixed_.size()), mixed_.push_back(p);
    now_.resize(mixed_.size() * area()), later_.resize(now_.size()), speed_.assign(now_.size(), 0.0f);
    for (size_t n = 0; n < mixed_.size(); n++) begin(n);
  }

  // Rounds of descent. edge: px of the width of an edge; well: its weight.
  void descend(int64_t rounds, double edge, double well, int64_t threads) {
    const int64_t count = int64_t(mixed_.size()), turns = (count + kAtOnce - 1) / kAtOnce;
    // An edge of the double obstacle potential is half a sine wave.
    const double wide = edge * double(steps_) / kPi;
    for (int64_t round = 0; round < rounds; round++) {
      const double grown = well * std::min(1.0, double(round) / (kSharpened * double(rounds)));
      each_index(turns, threads, [&](int64_t turn) {
        for (int64_t n = turn * kAtOnce; n < std::min(count, (turn + 1) * kAtOnce); n++)
          step(n, float(2.0 * well * wide * wide), float(grown));
      });
      std::swap(now_, later_);
    }
  }

  // The fill that each step has most of, and its levels.
  void write(const double* palette, int32_t* labels, float* levels) const {
    for (int64_t p = 0; p < height_ * width_; p++)
      for (int64_t k = 0; k < area(); k++) {
        const float part = own_[p] < 0 ? 0.0f : now_[own_[p] * area() + k];
        const int64_t at = (p / width_ * steps_ + k / steps_) * width_ * steps_ + p % width_ * steps_ + k % steps_;
        labels[at] = part > 0.5f ? second_[p] : first_[p];
        for (int c = 0; c < 4; c++)
          levels[4 * at + c] = float((1.0 - part) * palette[4 * first_[p] + c] +
                                     double(part) * palette[4 * second_[p] + c]);
      }
  }

 private:
  int64_t area() const { return steps_ * steps_; }

  // How much of a fill there is where so much is of a pixel's second one.
  float of(int32_t fill, int64_t p, float part) const {
    return own_[p] >= 0 && second_[p] == fill ? part : first_[p] == fill ? 1.0f - part : 0.0f;
  }

  // The share of a fill in a pixel.
  float share(int64_t y, int64_t x, int32_t fill) const {
    const int64_t p = std::clamp<int64_t>(y, 0, height_ - 1) * width_ + std::clamp<int64_t>(x, 0, width_ - 1);
    return of(fill, p, own_[p] < 0 ? 0.0f : share_[p]);
  }

  // The steps of a pixel between its share and those of its neighbours.
  void begin(size_t n) {
    const int64_t y = mixed_[n] / width_, x = mixed_[n] % width_;
    const int32_t fill = second_[mixed_[n]];
    for (int64_t k = 0; k < area(); k++) {
      const double down = (double(k / steps_) + 0.5) / double(steps_) - 0.5;
      const double right = (double(k % steps_) + 0.5) / double(steps_) - 0.5;
      const int64_t beside = x + (right < 0.0 ? -1 : 1), below = y + (down < 0.0 ? -1 : 1);
      const double across = std::fabs(right), along = std::fabs(down);
      now_[n * area() + k] = float(
          (1.0 - along) * ((1.0 - across) * share(y, x, fill) + across * share(y, beside, fill)) +
          along * ((1.0 - across) * share(below, x, fill) + across * share(below, beside, fill)));
    }
  }

  // How much of each of two fills a step has that lies beyond a pixel's own.
  void beyond(int64_t y, int64_t x, int32_t one, int32_t other, float& of_one, float& of_other) const {
    y = std::clamp<int64_t>(y, 0, height_ * steps_ - 1), x = std::clamp<int64_t>(x, 0, width_ * steps_ - 1);
    const int64_t p = y / steps_ * width_ + x / steps_, own = own_[p];
    const float part = own < 0 ? 0.0f : now_[own * area() + y % steps_ * steps_ + x % steps_];
    of_one = of(one, p, part), of_other = of(other, p, part);
  }

  void step(int64_t n, float smooth, float well) {
    const int64_t p = mixed_[n], y = p / width_ * steps_, x = p % width_ * steps_;
    const float* now = &now_[n * area()];
    float mean = 0.0f;
    for (int64_t k = 0; k < area(); k++) mean += now[k];
    const float off = mean / float(area()) - share_[p];
    constexpr int64_t kDown[4] = {-1, 1, 0, 0}, kRight[4] = {0, 0, -1, 1};
    for (int64_t k = 0; k < area(); k++) {
      const int64_t row = k / steps_, column = k % steps_;
      const float own = now[k];
      float curved = 0.0f;  // half of the Laplacians of the second fill's part less that of the first
      for (int d = 0; d < 4; d++) {
        const int64_t i = row + kDown[d], j = column + kRight[d];
        if (i >= 0 && j >= 0 && i < steps_ && j < steps_) {
          curved += now[i * steps_ + j] - own;
        } else {
          float of_first, of_second;
          beyond(y + i, x + j, first_[p], second_[p], of_first, of_second);
          curved += 0.5f * (of_second - of_first + 1.0f) - own;
        }
      }
      float& speed = speed_[n * area() + k];
      speed = kKept * speed - kStep * (off - smooth * curved + well * (1.0f - 2.0f * own));
      const float to = own + speed, within = std::clamp(to, 0.0f, 1.0f);
      if (to != within) speed = 0.0f;
      later_[n * area() + k] = within;
    }
  }

  int64_t height_, width_, steps_;
  const int32_t *first_, *second_;
  const float* share_;
  std::vector<int64_t> own_, mixed_;
  std::vector<float> now_, later_, speed_;
};

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

// Gives the values of a part blends of few fills in place of their likeliest ones, if these explain them as well.
void with_few_fills(const std::vector<int64_t>& part, const float* values, int64_t fills, const double* palette,
                    int64_t slots, const int32_t* near, double farther, std::vector<Pair>& pairs) {
  std::vector<int64_t> votes(fills, 0);
  for (const int64_t i : part)
    if (near[slots * i] >= 0) votes[near[slots * i]]++;
  std::vector<int32_t> chosen{int32_t(std::max_element(votes.begin(), votes.end()) - votes.begin())};
  std::vector<Pair> found(part.size(), {chosen[0], chosen[0], 0.0, INFINITY}), best(found), trial(found);
  while (int64_t(chosen.size()) < std::min(kFewFills, fills)) {
    double least = INFINITY;
    int32_t added = -1;
    for (int32_t fill = 0; fill < fills; fill++) {
      if (std::find(chosen.begin(), chosen.end(), fill) != chosen.end()) continue;
      double excess = 0.0;
      for (size_t n = 0; n < part.size() && excess < least; n++) {
        trial[n] = found[n];
        for (const int32_t other : chosen) {
          const Pair pair = blend_pair(colour(values + 4 * part[n]), palette, other, fill);
          if (pair.off < trial[n].off) trial[n] = pair;
        }
        const double worse = std::max(trial[n].off - pairs[part[n]].off, 0.0);
        excess += worse * worse;
      }
      if (excess < least) least = excess, added = fill, std::swap(best, trial);
    }
    if (added < 0) return;
    chosen.push_back(added), found = best;
    if (least < farther * farther * double(part.size())) {
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
  try {
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
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}

// The labels (height steps x width steps) and levels of a picture in so many steps a pixel each way, whose pixels are
// blends of two fills. Returns 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_phase_field(int64_t height, int64_t width, int64_t steps, const int32_t* first,
                                 const int32_t* second, const float* share, const double* palette, int64_t rounds,
                                 double edge, double well, int64_t threads, int32_t* labels, float* levels) {
  try {
    cs::Field field(height, width, steps, first, second, share);
    field.descend(rounds, edge, well, threads);
    field.write(palette, labels, levels);
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}
