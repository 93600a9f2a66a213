// Which stops a gradient has along a given geometry: those with which its description is shortest.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "abi.h"
#include "shades.h"

namespace cs {
namespace {

constexpr int kBins = 64, kTried = 6, kSweeps = 2;
constexpr double kSame = 1e-9;  // of t, below which knots are one

// The means of pixels between equally distant t; what has none is left out.
struct Bins {
  std::vector<double> middles, means, sizes;

  Bins(const Pixels& pixels, const Geometry& frame) {
    std::vector<double> t(pixels.count);
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (int64_t i = 0; i < pixels.count; i++) {
      t[i] = frame.t(pixels.x[i], pixels.y[i]);
      low = std::min(low, t[i]), high = std::max(high, t[i]);
    }
    double sum[kBins][5] = {}, size[kBins] = {};
    const double scale = kBins / std::max(high - low, 1e-12);
    for (int64_t i = 0; i < pixels.count; i++) {
      const int bin = std::min(int((t[i] - low) * scale), kBins - 1);
      size[bin] += 1.0, sum[bin][4] += t[i];
      for (int k = 0; k < 4; k++) sum[bin][k] += pixels.values[4 * i + k];
    }
    for (int bin = 0; bin < kBins; bin++) {
      if (size[bin] == 0.0) continue;
      sizes.push_back(size[bin]), middles.push_back(sum[bin][4] / size[bin]);
      for (int k = 0; k < 4; k++) means.push_back(sum[bin][k] / size[bin]);
    }
  }

  int count() const { return int(sizes.size()); }

  Ramp fitted(const std::vector<double>& knots) const {
    RampEquations equations(int(knots.size()));
    for (int i = 0; i < count(); i++)
      equations.add(Hat(knots.data(), int(knots.size()), middles[i]), sizes[i], &means[4 * i]);
    return {knots, equations.colours()};
  }

  // The sum of the squares left, levels^2.
  double left(const Ramp& ramp) const {
    double sum = 0.0, at[4];
    for (int i = 0; i < count(); i++) {
      ramp.at(middles[i], at);
      sum += sizes[i] * squared(at, &means[4 * i]);
    }
    return sum;
  }
};

// The best ramp with one knot more, of those with it in every second bin; then each knot at its best place.
Ramp with_a_knot(const Bins& bins, const Ramp& ramp) {
  std::vector<double> best = ramp.knots;
  double least = std::numeric_limits<double>::infinity();
  const auto consider = [&](const std::vector<double>& knots) {
    const double left = bins.left(bins.fitted(knots));
    if (left < least) best = knots, least = left;
  };
  for (int bin = 1; bin + 1 < bins.count(); bin += 2) {
    const double place = bins.middles[bin];
    const auto same = [&](double knot) { return std::fabs(knot - place) < kSame; };
    if (std::any_of(ramp.knots.begin(), ramp.knots.end(), same)) continue;
    std::vector<double> knots = ramp.knots;
    knots.insert(std::upper_bound(knots.begin(), knots.end(), place), place);
    consider(knots);
  }
  if (best.size() == ramp.knots.size()) return ramp;
  for (int sweep = 0; sweep < kSweeps; sweep++)
    for (size_t i = 1; i + 1 < best.size(); i++) {
      std::vector<double> near;
      for (const double place : bins.middles)
        if (place > best[i - 1] + kSame && place < best[i + 1] - kSame) near.push_back(place);
      const double own = best[i];
      const auto nearer = [&](double a, double b) { return std::fabs(a - own) < std::fabs(b - own); };
      std::stable_sort(near.begin(), near.end(), nearer);
      for (size_t k = 1; k < near.size() && k <= kTried; k++) {
        std::vector<double> knots = best;
        knots[i] = near[k];
        consider(knots);
      }
    }
  return bins.fitted(best);
}

}  // namespace
}  // namespace cs

extern "C" {

// The stops along the t of a frame (2, 3) with the shortest description, at most `most`: price, levels^2, is what one is
// worth. knots (most), colours (most x 4): filled in. Returns how many, -1 without memory.
CS_EXPORT int64_t cs_ramp(int64_t n, const double* x, const double* y, const double* values, const double* frame,
                          int64_t radial, int64_t most, double price, double* knots, double* colours) {
  return cs::counted([&] {
    const cs::Geometry own{frame, radial != 0};
    const cs::Bins bins({n, x, y, values}, own);
    double first = bins.middles.front(), last = bins.middles.back();
    if (last - first < cs::kSame) last = first + 1.0;
    cs::Ramp best = bins.fitted({first, last});
    double left = bins.left(best);
    while (best.count() < most) {
      const cs::Ramp trial = cs::with_a_knot(bins, best);
      const double following = bins.left(trial);
      if (trial.count() == best.count() || following + price >= left) break;
      best = trial, left = following;
    }
    std::copy(best.knots.begin(), best.knots.end(), knots);
    std::copy(best.colours.begin(), best.colours.end(), colours);
    return best.count();
  });
}

// The mean square, levels^2, by which pixels differ from those that have about the same t; below 0 without memory.
CS_EXPORT double cs_scatter(int64_t n, const double* x, const double* y, const double* values, const double* frame,
                            int64_t radial) {
  return cs::counted([&] {
    const cs::Geometry own{frame, radial != 0};
    const cs::Bins bins({n, x, y, values}, own);
    cs::Ramp means{bins.middles, bins.means};
    if (means.count() == 1) {
      means.knots.push_back(means.knots[0] + 1.0);
      means.colours.insert(means.colours.end(), bins.means.begin(), bins.means.end());
    }
    double sum = 0.0, at[4];
    for (int64_t i = 0; i < n; i++) {
      means.at(own.t(x[i], y[i]), at);
      sum += cs::squared(at, values + 4 * i);
    }
    return sum / double(n);
  });
}
}
