// The fill that each uncertain pixel of a picture has most of, by its colour and by the fills of its neighbours.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "abi.h"

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
    const float* value = values_ + 4 * pixels_[i];
    const double *first = fills_ + 4 * int64_t(fill), *second = fills_ + 4 * int64_t(other);
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
    return squares / costs_.scale;
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
}
