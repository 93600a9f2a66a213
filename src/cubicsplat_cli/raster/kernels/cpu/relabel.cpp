// The fill that each uncertain pixel of a picture has most of, by its colour and by the fills of its neighbours.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <new>
#include <utility>
#include <vector>

#include "abi.h"
#include "colours.h"

extern "C" int64_t cs_components(const int32_t* values, int64_t height, int64_t width, int32_t* labels);

namespace cs {
namespace {

// What the choice of a fill costs, in nats: a misfit as many times its square as `scale` divides that, at most `most`; each
// neighbour of another fill; and a fill of a slot from `sure` on. bounded: pixels blend only with what is right beside them,
// and misfits have no bound.
struct Costs {
  double scale, most, neighbour, unsure;
  int64_t sure;
  bool bounded;
};

// The square that a blend of a fill with at most as much of a second one leaves of a value.
double blend_left(const float* value, const double* first, const double* second) {
  double along = 0.0, length = 0.0, squares = 0.0;
  for (int c = 0; c < 4; c++) {
    along += (double(value[c]) - first[c]) * (second[c] - first[c]);
    length += (second[c] - first[c]) * (second[c] - first[c]);
  }
  const double share = std::clamp(along / std::max(length, 1e-9), 0.0, 0.5);
  for (int c = 0; c < 4; c++) {
    const double rest = (double(value[c]) - first[c]) - share * (second[c] - first[c]);
    squares += rest * rest;
  }
  return squares;
}

class Relabelling {
 public:
  Relabelling(int64_t height, int64_t width, const float* values, const double* fills, int64_t count,
              const int64_t* pixels, int64_t slots, const int32_t* candidates, const Costs& costs, int32_t* labels)
      : height_(height), width_(width), values_(values), fills_(fills), count_(count), pixels_(pixels), slots_(slots),
        candidates_(candidates), costs_(costs), labels_(labels), numbers_(height * width, -1), alike_(slots) {
    for (int64_t i = 0; i < count; i++) numbers_[pixels[i]] = int32_t(i);
  }

  // Chooses all fills at once, again and again until none changes.
  void run(int64_t rounds) {
    std::vector<int32_t> open(count_);
    for (int64_t i = 0; i < count_; i++) open[i] = int32_t(i);
    for (int64_t round = 0; round < rounds && !open.empty(); round++) {
      std::vector<std::pair<int64_t, int32_t>> changes;
      for (const int32_t i : open)
        if (const int32_t label = best(i); label != labels_[pixels_[i]]) changes.emplace_back(pixels_[i], label);
      for (const auto& [pixel, label] : changes) labels_[pixel] = label;
      // Only what is beside a change may choose otherwise.
      open.clear();
      for (const auto& change : changes)
        around(change.first, [&](int64_t pixel) {
          if (numbers_[pixel] >= 0) open.push_back(numbers_[pixel]);
        });
      std::sort(open.begin(), open.end());
      open.erase(std::unique(open.begin(), open.end()), open.end());
    }
  }

 private:
  // The pixel itself comes first; at the border a pixel is its own neighbour in place of those beyond.
  template <class Visit>
  void around(int64_t pixel, const Visit& visit) const {
    visit(pixel);
    const int64_t y = pixel / width_, x = pixel % width_;
    for (int64_t v = y - 1; v <= y + 1; v++)
      for (int64_t u = x - 1; u <= x + 1; u++)
        if (v != y || u != x)
          visit(std::clamp<int64_t>(v, 0, height_ - 1) * width_ + std::clamp<int64_t>(u, 0, width_ - 1));
  }

  int32_t best(int64_t i) {
    const int32_t* own = candidates_ + slots_ * i;
    for (int64_t k = 0; k < slots_; k++) alike_[k] = 0;
    int64_t visited = 0;
    around(pixels_[i], [&](int64_t pixel) {
      if (visited++ > 0)
        for (int64_t k = 0; k < slots_; k++) alike_[k] += own[k] == labels_[pixel];
    });
    int32_t chosen = own[0];
    double least = INFINITY;
    for (int64_t k = 0; k < slots_; k++) {
      if (own[k] < 0) continue;
      const double cost = left(i, k) + (k < costs_.sure ? 0.0 : costs_.unsure) - costs_.neighbour * alike_[k];
      if (cost < least) least = cost, chosen = own[k];
    }
    return chosen;
  }

  // The misfit of a pixel as a blend of half or more of a candidate with another one, or as the candidate alone.
  double left(int64_t i, int64_t k) const {
    const int32_t* own = candidates_ + slots_ * i;
    double least = blended(i, own[k], own[k]);
    for (int64_t other = 0; other < slots_; other++)
      if (other != k && own[other] >= 0 && (!costs_.bounded || alike_[other] > 0))
        least = std::min(least, blended(i, own[k], own[other]));
    return costs_.bounded ? least : std::min(least, costs_.most);
  }

  double blended(int64_t i, int32_t fill, int32_t other) const {
    return blend_left(values_ + 4 * pixels_[i], fills_ + 4 * int64_t(fill), fills_ + 4 * int64_t(other)) / costs_.scale;
  }

  int64_t height_, width_;
  const float* values_;
  const double* fills_;
  int64_t count_;
  const int64_t* pixels_;
  int64_t slots_;
  const int32_t* candidates_;
  const Costs& costs_;
  int32_t* labels_;
  std::vector<int32_t> numbers_;  // (H x W) of the uncertain pixels, -1 for the others
  std::vector<int64_t> alike_;    // (slots) neighbours of each candidate's fill
};

// What it costs, in nats, to explain a picture by labels: a part of one label; each pair of neighbours with different ones;
// and what the likeliest blend of a pixel's fill with one beside it leaves: ln(1 + square / scale), and half of what square /
// scale is beyond `bound`. near: levels between the fills of a part and of what it may join.
struct PartCosts {
  double part, neighbour, scale, bound, near;
};

class Joining {
 public:
  Joining(int64_t height, int64_t width, const float* values, const double* fills, const PartCosts& costs,
          int32_t* labels)
      : height_(height), width_(width), values_(values), fills_(fills), costs_(costs), labels_(labels),
        visited_(height * width), parts_(height * width) {}

  // Gives each small part, the smallest first, the label of a neighbour that lowers the cost most. True if any changed.
  bool round(int64_t most) {
    const int64_t count = cs_components(labels_, height_, width_, parts_.data());
    if (count < 0) throw std::bad_alloc();
    std::vector<int64_t> start(count + 1), pixels(height_ * width_);
    for (const int32_t part : parts_) start[part + 1]++;
    std::vector<int32_t> order;
    for (int64_t k = 0; k < count; k++)
      if (start[k + 1] <= most) order.push_back(int32_t(k));
    std::stable_sort(order.begin(), order.end(), [&](int32_t a, int32_t b) { return start[a + 1] < start[b + 1]; });
    for (int64_t k = 0; k < count; k++) start[k + 1] += start[k];
    std::vector<int64_t> next(start.begin(), start.end() - 1);
    for (int64_t i = 0; i < height_ * width_; i++) pixels[next[parts_[i]]++] = i;
    std::fill(visited_.begin(), visited_.end(), -1);
    bool changed = false;
    for (const int32_t part : order)
      changed |= joined(part, pixels.data() + start[part], pixels.data() + start[part + 1]);
    return changed;
  }

 private:
  template <class Visit>
  void around(int64_t pixel, const Visit& visit) const {
    const int64_t y = pixel / width_, x = pixel % width_;
    for (int64_t v = std::max<int64_t>(y - 1, 0); v <= std::min(y + 1, height_ - 1); v++)
      for (int64_t u = std::max<int64_t>(x - 1, 0); u <= std::min(x + 1, width_ - 1); u++)
        if (v != y || u != x) visit(v * width_ + u, v == y || u == x);
  }

  bool joined(int32_t part, const int64_t* first, const int64_t* last) {
    const int32_t own = labels_[*first];
    near_.clear(), others_.clear();
    for (const int64_t* at = first; at < last; at++) {
      if (visited_[*at] != part) visited_[*at] = part, near_.push_back(*at);
      around(*at, [&](int64_t pixel, bool beside) {
        if (visited_[pixel] != part) visited_[pixel] = part, near_.push_back(pixel);
        const int32_t label = labels_[pixel];
        if (beside && label != own && near(own, label) &&
            std::find(others_.begin(), others_.end(), label) == others_.end())
          others_.push_back(label);
      });
    }
    double least = cost(first, last) + costs_.part;
    int32_t chosen = own;
    for (const int32_t label : others_) {
      for (const int64_t* at = first; at < last; at++) labels_[*at] = label;
      if (const double now = cost(first, last); now < least) least = now, chosen = label;
    }
    for (const int64_t* at = first; at < last; at++) labels_[*at] = chosen;
    return chosen != own;
  }

  bool near(int32_t first, int32_t second) const {
    const Colour off = colour(fills_ + 4 * int64_t(first)) - colour(fills_ + 4 * int64_t(second));
    return off.dot(off) <= costs_.near * costs_.near;
  }

  // Of the pixels of a part and those beside it.
  double cost(const int64_t* first, const int64_t* last) const {
    double sum = 0.0;
    for (const int64_t pixel : near_) {
      double least = left(pixel, labels_[pixel]);
      around(pixel, [&](int64_t other, bool) {
        if (labels_[other] != labels_[pixel]) least = std::min(least, left(pixel, labels_[other]));
      });
      least /= costs_.scale;
      sum += std::log1p(least) + 0.5 * std::max(least - costs_.bound, 0.0);
    }
    for (const int64_t* at = first; at < last; at++)
      around(*at, [&](int64_t other, bool beside) {
        if (labels_[other] != labels_[*at]) sum += costs_.neighbour * (beside ? 1.0 : std::sqrt(0.5));
      });
    return sum;
  }

  // The square that a blend of a pixel's own fill with less of another one leaves.
  double left(int64_t pixel, int32_t other) const {
    return blend_left(values_ + 4 * pixel, fills_ + 4 * int64_t(labels_[pixel]), fills_ + 4 * int64_t(other));
  }

  int64_t height_, width_;
  const float* values_;
  const double* fills_;
  const PartCosts& costs_;
  int32_t* labels_;
  std::vector<int32_t> visited_, parts_;  // (H x W) the last part that a pixel is of or beside; and its own
  std::vector<int64_t> near_;             // the pixels of a part and beside it
  std::vector<int32_t> others_;           // the labels beside it
};

}  // namespace
}  // namespace cs

extern "C" {

// Chooses the labels (height x width) of some pixels (count) of a picture (height x width x 4) anew, among candidates
// (count x slots), numbers of fills (x 4) or -1; in at most so many rounds. Costs: see Costs. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_relabel(int64_t height, int64_t width, const float* values, const double* fills, int64_t count,
                             const int64_t* pixels, int64_t slots, const int32_t* candidates, double scale, double most,
                             double neighbour, double unsure, int64_t sure, int64_t bounded, int64_t rounds,
                             int32_t* labels) {
  return cs::failed([&] {
    const cs::Costs costs = {scale, most, neighbour, unsure, sure, bounded != 0};
    cs::Relabelling(height, width, values, fills, count, pixels, slots, candidates, costs, labels).run(rounds);
  });
}

// Gives small parts of one label (height x width), of at most so many px, that of a neighbour where the picture (height x
// width x 4) in fills (x 4) costs less so; in at most so many rounds. Costs: see PartCosts. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_join_parts(int64_t height, int64_t width, const float* values, const double* fills, int64_t most,
                                double part, double neighbour, double scale, double bound, double near, int64_t rounds,
                                int32_t* labels) {
  return cs::failed([&] {
    const cs::PartCosts costs = {part, neighbour, scale, bound, near};
    cs::Joining joining(height, width, values, fills, costs, labels);
    for (int64_t round = 0; round < rounds && joining.round(most); round++) continue;
  });
}
}
