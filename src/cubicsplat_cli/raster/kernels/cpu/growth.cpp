// An area of a gradient grows by the pixels around it that the gradient explains too.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "shades.h"

namespace cs {
namespace {

constexpr int kReach = 5, kAround = 2;    // px: the width of the ring around an area, and half of a window of means
constexpr uint8_t kEdge = 1, kLarge = 2;  // kinds of pixels: on an edge; in a large part of one colour

// What an area has to explain. unlike: the most levels in a space (4 x 4, rows of colours times it), and mean: the most
// in the means of windows in another one, of pixels on edges; off: the most levels of any channel elsewhere.
struct Tolerance {
  double off, unlike, mean;
  const double *space, *means;
};

// A pixel that is or was in the ring. rest: its residual in the space of the means.
struct Place {
  int64_t at;
  double rest[4];
  bool close, like, first, explained, dirty;
  int64_t joined;  // the last round in which it was explained and connected to the area
};

class Growth {
 public:
  Growth(int64_t height, int64_t width, const float* levels, const uint8_t* kinds, const Geometry& geometry,
         const Ramp& ramp, const Tolerance& tolerance, uint8_t* inside)
      : height_(height), width_(width), levels_(levels), kinds_(kinds), geometry_(geometry), ramp_(ramp),
        tolerance_(tolerance), inside_(inside), slots_(height * width, -1) {}

  // Adds the ring's explained and connected pixels to the area; as long as it grows if `on`, but into large parts only by
  // the first ring.
  void run(bool on) {
    std::vector<int64_t> fresh;
    for (int64_t at = 0; at < height_ * width_; at++)
      if (inside_[at]) fresh.push_back(at);
    int64_t area = int64_t(fresh.size()), size = area;
    for (int64_t round = 1;; round++) {
      widen(fresh, round == 1);
      explain();
      const std::vector<int32_t> joined = connected(round);
      const int64_t before = size;
      size = area + int64_t(joined.size());
      const bool last = !on || size <= before;
      fresh.clear();
      for (const int32_t slot : joined)
        if (last || kinds_[places_[slot].at] != kLarge || places_[slot].first) fresh.push_back(places_[slot].at);
      for (const int64_t at : fresh) inside_[at] = 1;
      area += int64_t(fresh.size());
      if (last) return;
    }
  }

 private:
  template <class Visit>
  void around(int64_t at, int reach, const Visit& visit) const {
    const int64_t y = at / width_, x = at % width_;
    for (int64_t v = std::max<int64_t>(y - reach, 0); v <= std::min(y + reach, height_ - 1); v++)
      for (int64_t u = std::max<int64_t>(x - reach, 0); u <= std::min(x + reach, width_ - 1); u++)
        visit(v * width_ + u);
  }

  template <class Visit>
  void beside(int64_t at, const Visit& visit) const {
    const int64_t x = at % width_;
    if (at >= width_) visit(at - width_);
    if (at + width_ < height_ * width_) visit(at + width_);
    if (x > 0) visit(at - 1);
    if (x + 1 < width_) visit(at + 1);
  }

  // Adds the pixels near new ones of the area to the ring, and takes these out of it.
  void widen(const std::vector<int64_t>& fresh, bool first) {
    const size_t known = places_.size();
    for (const int64_t at : fresh) {
      if (slots_[at] >= 0) soil(at);
      bool rim = false;
      around(at, 1, [&](int64_t other) { rim |= !inside_[other]; });
      if (rim)
        around(at, kReach, [&](int64_t other) {
          if (!inside_[other] && slots_[other] < 0) add(other, first);
        });
    }
    for (size_t slot = known; slot < places_.size(); slot++) soil(places_[slot].at);
    ring_.erase(std::remove_if(ring_.begin(), ring_.end(), [&](int32_t slot) { return inside_[places_[slot].at]; }),
                ring_.end());
    for (size_t slot = known; slot < places_.size(); slot++) ring_.push_back(int32_t(slot));
  }

  void add(int64_t at, bool first) {
    double off[4], most = 0.0, square = 0.0;
    ramp_.at(geometry_.t(double(at % width_) + 0.5, double(at / width_) + 0.5), off);
    for (int k = 0; k < 4; k++) most = std::max(most, std::fabs(off[k] -= double(levels_[4 * at + k])));
    Place place = {at, {}, most <= tolerance_.off, false, first, false, false, 0};
    for (int k = 0; k < 4; k++) {
      double seen = 0.0;
      for (int i = 0; i < 4; i++) {
        place.rest[k] += off[i] * tolerance_.means[4 * i + k];
        seen += off[i] * tolerance_.space[4 * i + k];
      }
      square += seen * seen;
    }
    place.like = std::sqrt(square) <= tolerance_.unlike;
    slots_[at] = int32_t(places_.size());
    places_.push_back(place);
  }

  // Marks the pixels of the ring whose windows a pixel has entered or left.
  void soil(int64_t at) {
    around(at, kAround, [&](int64_t other) {
      const int32_t slot = slots_[other];
      if (slot < 0 || inside_[other] || places_[slot].dirty) return;
      places_[slot].dirty = true;
      dirty_.push_back(slot);
    });
  }

  void explain() {
    for (const int32_t slot : dirty_) {
      Place& place = places_[slot];
      place.dirty = false;
      place.explained = place.close || (kinds_[place.at] == kEdge && place.like && like_around(place.at));
    }
    dirty_.clear();
  }

  // True if the mean residual of the like pixels in a window is small. The chroma of a single one is unreliable.
  bool like_around(int64_t at) const {
    double sums[4] = {}, count = 0.0, most = 0.0;
    around(at, kAround, [&](int64_t other) {
      if (slots_[other] < 0 || inside_[other] || !places_[slots_[other]].like) return;
      for (int k = 0; k < 4; k++) sums[k] += places_[slots_[other]].rest[k];
      count += 1.0;
    });
    for (int k = 0; k < 4; k++) most = std::max(most, std::fabs(sums[k]));
    return most <= tolerance_.mean * count;
  }

  // The explained pixels of the ring that are connected to the area, along the sides of pixels.
  std::vector<int32_t> connected(int64_t round) {
    std::vector<int32_t> joined;
    const auto join = [&](int32_t slot) {
      places_[slot].joined = round;
      joined.push_back(slot);
    };
    for (const int32_t slot : ring_) {
      bool touches = false;
      if (places_[slot].explained) beside(places_[slot].at, [&](int64_t other) { touches |= bool(inside_[other]); });
      if (touches) join(slot);
    }
    for (size_t k = 0; k < joined.size(); k++)
      beside(places_[joined[k]].at, [&](int64_t other) {
        const int32_t slot = slots_[other];
        if (slot >= 0 && !inside_[other] && places_[slot].explained && places_[slot].joined != round) join(slot);
      });
    return joined;
  }

  int64_t height_, width_;
  const float* levels_;
  const uint8_t* kinds_;
  const Geometry& geometry_;
  const Ramp& ramp_;
  const Tolerance& tolerance_;
  uint8_t* inside_;
  std::vector<int32_t> slots_, ring_, dirty_;  // (H x W) the number of each pixel's place, -1 for none
  std::vector<Place> places_;
};

}  // namespace
}  // namespace cs

extern "C" {

// Grows the area `inside` (height x width) of a gradient in a picture (height x width x 4), levels: see Growth. kinds:
// (height x width), of pixels. space, means: see Tolerance. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_grow_shade(int64_t height, int64_t width, const float* levels, const uint8_t* kinds,
                                const double* frame, int64_t radial, int64_t knots, const double* places,
                                const double* colours, double off, double unlike, double mean, const double* space,
                                const double* means, int64_t on, uint8_t* inside) {
  return cs::failed([&] {
    const cs::Geometry geometry(frame, radial != 0);
    const cs::Ramp ramp = {{places, places + knots}, {colours, colours + 4 * knots}};
    const cs::Tolerance tolerance = {off, unlike, mean, space, means};
    cs::Growth(height, width, levels, kinds, geometry, ramp, tolerance, inside).run(on != 0);
  });
}
}
