// The shadows of boxes at pixels, and their fit to what is seen of them.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "abi.h"
#include "blurred_box.h"
#include "damped.h"

namespace cs::shadow {
namespace {

constexpr double kOutlying = 4.0;  // levels beyond which a pixel counts linearly
constexpr int kRounds = 25;
constexpr double kEnough = 1e-4;  // gain, relative, below which a fit has converged
// Rounds after which a mean square in levels^2 beyond this is hopeless.
constexpr int kEarly = 7;
constexpr double kHopeless = 16.0;
// Steps for differences, and the farthest that one round may go.
constexpr double kSteps[kNumbers] = {0.02, 0.02, 0.02, 0.02, 0.005, 0.01};
constexpr double kFarthest[kNumbers] = {8.0, 8.0, 4.0, 4.0, 0.8, 1.2};
// What a layer costs for each px^2 by which it is rounder, in levels^2 a pixel: wide shadows say nothing of that.
constexpr double kRounder = 1e-4;

// Places along one axis, each once, and which of them each pixel has.
struct Places {
  std::vector<double> at;
  std::vector<int32_t> own;

  Places(int64_t n, const int64_t* given) : own(n) {
    std::vector<int64_t> known(given, given + n);
    std::sort(known.begin(), known.end());
    known.erase(std::unique(known.begin(), known.end()), known.end());
    for (const int64_t place : known) at.push_back(double(place) + 0.5);
    for (int64_t i = 0; i < n; i++)
      own[i] = int32_t(std::lower_bound(known.begin(), known.end(), given[i]) - known.begin());
  }
};

// Pixels in the shade of boxes. open: for each box whether its shadow falls on the pixel.
struct Shaded {
  int boxes;
  const Box* box;
  int64_t count;
  const uint8_t* open;
  Places rows, columns;
  Corners corners;

  Shaded(int boxes, const double* sides, int64_t n, const int64_t* rows, const int64_t* columns, const uint8_t* open)
      : boxes(boxes), box(reinterpret_cast<const Box*>(sides)), count(n), open(open), rows(n, rows),
        columns(n, columns) {}

  std::vector<Rows> down(const Layer& layer) { return each<Rows>(layer, rows.at); }
  std::vector<Columns> across(const Layer& layer) { return each<Columns>(layer, columns.at); }

  // Of each box its rows or columns.
  template <class Lines>
  std::vector<Lines> each(const Layer& layer, const std::vector<double>& at) {
    std::vector<Lines> out;
    for (int b = 0; b < boxes; b++) {
      const Box own = layer.of(box[b]);
      out.emplace_back(own, layer.sigma, corners.of(own, layer.sigma), at);
    }
    return out;
  }

  // The share of light (n) that a layer leaves each pixel, its rows and columns known.
  std::vector<double> light(double alpha, const std::vector<Rows>& down, std::vector<Columns>& across) const {
    std::vector<double> out(count, 1.0);
    for (int b = 0; b < boxes; b++)
      for (int64_t i = 0; i < count; i++)
        if (open[b * count + i]) out[i] *= 1.0 - alpha * coverage(down[b], rows.own[i], across[b], columns.own[i]);
    return out;
  }

  std::vector<double> light(const Layer& layer) {
    std::vector<Columns> own = across(layer);
    return light(layer.alpha, down(layer), own);
  }
};

// The problem that `minimise` solves.
class Fit {
 public:
  Fit(Shaded& shaded, const double* seen, const double* through, double scale, std::vector<double> numbers)
      : shaded_(shaded), seen_(seen), through_(through), scale_(scale), numbers_(std::move(numbers)),
        layers_(int(numbers_.size()) / kNumbers) {}

  const std::vector<double>& numbers() const { return numbers_; }

  double begin() {
    const double loss = loss_after(std::vector<double>(numbers_.size(), 0.0));
    accept();
    return loss;
  }

  bool hopeless(int round, double loss) const { return round == kEarly && loss > kHopeless * double(shaded_.count); }

  double loss_after(const std::vector<double>& step) {
    next_ = numbers_;
    for (size_t k = 0; k < step.size(); k++)
      next_[k] += std::clamp(step[k], -kFarthest[k % kNumbers], kFarthest[k % kNumbers]);
    next_lights_.clear();
    for (int layer = 0; layer < layers_; layer++)
      next_lights_.push_back(shaded_.light(Layer(&next_[kNumbers * layer])));
    double sum = 0.0;
    next_residual_.resize(shaded_.count);
    for (int64_t i = 0; i < shaded_.count; i++) {
      double light = through_[i];
      for (const std::vector<double>& own : next_lights_) light *= own[i];
      next_residual_[i] = scale_ * (1.0 - light - seen_[i]);
      const double size = std::fabs(next_residual_[i]);
      sum += size <= kOutlying ? size * size : kOutlying * (2.0 * size - kOutlying);
    }
    for (int layer = 0; layer < layers_; layer++) {
      const double rounder = next_[kNumbers * layer + 3];
      sum += kRounder * double(shaded_.count) * rounder * rounder;
    }
    return sum;
  }

  void accept() { numbers_ = next_, lights_ = next_lights_, residual_ = next_residual_; }

  void equations(NormalEquations& out) {
    const int count = kNumbers * layers_;
    std::vector<std::vector<double>> changes;  // of each number the change of its layer's light
    for (int layer = 0; layer < layers_; layer++) {
      const double* own = &numbers_[kNumbers * layer];
      const std::vector<Rows> down = shaded_.down(Layer(own));
      std::vector<Columns> across = shaded_.across(Layer(own));
      for (int k = 0; k < kNumbers; k++) {
        std::vector<double> changed(own, own + kNumbers);
        changed[k] += kSteps[k];
        const Layer moved(changed.data());
        // A shift along one axis leaves the other as it was, and so does alpha both.
        const bool same_rows = k == 0 || k == 5, same_columns = k == 1 || k == 5;
        std::vector<Columns> columns = same_columns ? std::vector<Columns>() : shaded_.across(moved);
        changes.push_back(
            shaded_.light(moved.alpha, same_rows ? down : shaded_.down(moved), same_columns ? across : columns));
      }
    }
    out.clear(count);
    std::vector<double> derivatives(count);
    for (int64_t i = 0; i < shaded_.count; i++) {
      for (int layer = 0; layer < layers_; layer++) {
        double others = through_[i];
        for (int other = 0; other < layers_; other++)
          if (other != layer) others *= lights_[other][i];
        for (int k = 0; k < kNumbers; k++)
          derivatives[kNumbers * layer + k] = scale_ * others * (lights_[layer][i] - changes[kNumbers * layer + k][i]) /
                                              kSteps[k];
      }
      const double weight = std::min(1.0, kOutlying / std::max(std::fabs(residual_[i]), 1e-12));
      out.add<1>(weight, derivatives.data(), &residual_[i]);
    }
    for (int layer = 0; layer < layers_; layer++) {
      const int k = kNumbers * layer + 3;
      out.gram[size_t(k) * count + k] += kRounder * double(shaded_.count);
      out.slope[k] += kRounder * double(shaded_.count) * numbers_[k];
    }
  }

 private:
  Shaded& shaded_;
  const double *seen_, *through_;
  double scale_;
  std::vector<double> numbers_, next_, residual_, next_residual_;
  std::vector<std::vector<double>> lights_, next_lights_;
  int layers_;
};

}  // namespace
}  // namespace cs::shadow

extern "C" {

// The box (6) of a layer's shadow before it is blurred. numbers: of the layer (6).
CS_EXPORT void cs_shadow_box(const double* box, const double* numbers, double* out) {
  const cs::shadow::Box found = cs::shadow::Layer(numbers).of(*reinterpret_cast<const cs::shadow::Box*>(box));
  std::copy(&found.left, &found.left + 6, out);
}

// What the layers (6 each) of a box let through at rows y (h) and columns x (w), (h x w). Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_shadow_window(const double* box, int64_t layers, const double* numbers, int64_t h, const double* y,
                                   int64_t w, const double* x, double* light) {
  return cs::failed([&] {
    std::fill(light, light + h * w, 1.0);
    const std::vector<double> ys(y, y + h), xs(x, x + w);
    cs::shadow::Corners corners;
    for (int k = 0; k < layers; k++) {
      const cs::shadow::Layer layer(numbers + cs::shadow::kNumbers * k);
      const cs::shadow::Box own = layer.of(*reinterpret_cast<const cs::shadow::Box*>(box));
      const cs::shadow::Corner corner = corners.of(own, layer.sigma);
      const cs::shadow::Rows rows(own, layer.sigma, corner, ys);
      cs::shadow::Columns columns(own, layer.sigma, corner, xs);
      for (int64_t i = 0; i < h; i++)
        for (int64_t j = 0; j < w; j++)
          light[i * w + j] *= 1.0 - layer.alpha * cs::shadow::coverage(rows, i, columns, j);
    }
  });
}

// The same of some boxes (6 each) that have the same layers, at the middles of n pixels. open: (boxes x n). light (n): what
// is left of it.
CS_EXPORT int32_t cs_shadow_light(int64_t boxes, const double* sides, int64_t n, const int64_t* rows,
                                  const int64_t* columns, const uint8_t* open, int64_t layers, const double* numbers,
                                  double* light) {
  return cs::failed([&] {
    cs::shadow::Shaded shaded(boxes, sides, n, rows, columns, open);
    for (int k = 0; k < layers; k++) {
      const std::vector<double> own = shaded.light(cs::shadow::Layer(numbers + cs::shadow::kNumbers * k));
      for (int64_t i = 0; i < n; i++) light[i] *= own[i];
    }
  });
}

// Brings the numbers of layers (6 each) as near to what is seen (n), of which others let so much through (n), as they come,
// outliers counting linearly. scale: levels of a whole shade. Returns the mean square left, levels^2; below 0 without memory.
CS_EXPORT double cs_fit_shadows(int64_t boxes, const double* sides, int64_t n, const int64_t* rows,
                                const int64_t* columns, const uint8_t* open, const double* seen, const double* through,
                                double scale, int64_t layers, double* numbers) {
  return cs::counted([&] {
    cs::shadow::Shaded shaded(boxes, sides, n, rows, columns, open);
    cs::shadow::Fit fit(shaded, seen, through, scale, {numbers, numbers + cs::shadow::kNumbers * layers});
    const double loss = cs::minimise(fit, fit.begin(), cs::shadow::kRounds, cs::shadow::kEnough);
    for (int k = 0; k < cs::shadow::kNumbers * layers; k++)
      numbers[k] = k % cs::shadow::kNumbers == 4 ? std::log(cs::shadow::Layer(&fit.numbers()[k - 4]).sigma)
                                                 : fit.numbers()[k];
    return loss / double(std::max(n, int64_t(1)));
  });
}
}
