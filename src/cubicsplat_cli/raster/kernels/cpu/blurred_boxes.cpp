// The field of a soft shadow: what boxes become that are moved, made larger, blurred and let through; and its fit to what
// is seen of it.
//
// The blur of a box with sharp corners is the product of what its rows and its columns have, differences of error
// functions; what round corners lack is an integral over their height, by Gauss and Legendre's rule, whose every node is
// such a product too.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <map>
#include <utility>
#include <vector>

#include "abi.h"
#include "damped.h"

namespace cs {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr int kNumbers = 6;  // of a layer: dx, dy, px by which it is larger and rounder, log sigma, log-odds of alpha
constexpr double kOutlying = 4.0;                       // levels beyond which a pixel counts linearly
constexpr double kLeastSigma = 0.7, kMostSigma = 40.0;  // px
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
// Nodes along the arc of a corner: at least, for each sigma of its radius, and at most.
constexpr int kNodes = 10, kMostNodes = 160;
constexpr double kMoreNodes = 3.0;
constexpr double kBeyond = 6.0;  // sigmas from an edge, where the normal distribution is 0 or 1 but for 1e-9

// A box by its sides, px, whose corners are quarters of ellipses.
struct Box {
  double left, top, right, bottom, rx, ry;
};

// One blurred copy of a box.
struct Layer {
  double dx, dy, grown, rounder, sigma, alpha;

  explicit Layer(const double* numbers)
      : dx(numbers[0]), dy(numbers[1]), grown(numbers[2]), rounder(numbers[3]),
        sigma(std::clamp(std::exp(numbers[4]), kLeastSigma, kMostSigma)), alpha(1.0 / (1.0 + std::exp(-numbers[5]))) {}

  // Sharp corners do not become round by growing, as those of shadows in CSS do not.
  Box of(const Box& box) const {
    const auto radius = [&](double own) { return std::max((own > 0.0 ? own + grown : 0.0) + rounder, 0.0); };
    const double x = 0.5 * (box.left + box.right) + dx, y = 0.5 * (box.top + box.bottom) + dy;
    const double half_x = std::max(0.5 * (box.right - box.left) + grown, 0.0);
    const double half_y = std::max(0.5 * (box.bottom - box.top) + grown, 0.0);
    return {x - half_x,
            y - half_y,
            x + half_x,
            y + half_y,
            std::min(radius(box.rx), half_x),
            std::min(radius(box.ry), half_y)};
  }
};

double normal(double z) {
  if (z < -kBeyond) return 0.0;
  return z > kBeyond ? 1.0 : 0.5 * std::erfc(-z * std::sqrt(0.5));
}

// Nodes in -1..1 and weights of Gauss and Legendre's rule.
struct Rule {
  std::vector<double> nodes, weights;

  explicit Rule(int count) : nodes(count), weights(count) {
    for (int i = 0; i < count; i++) {
      double x = std::cos(kPi * (i + 0.75) / (count + 0.5)), slope = 1.0;
      for (int round = 0; round < 20; round++) {
        double last = 1.0, value = x;
        for (int k = 2; k <= count; k++) {
          const double next = ((2 * k - 1) * x * value - (k - 1) * last) / k;
          last = value, value = next;
        }
        slope = count * (x * value - last) / (x * x - 1.0);
        const double step = value / slope;
        x -= step;
        if (std::fabs(step) < 1e-15) break;
      }
      nodes[i] = x, weights[i] = 2.0 / ((1.0 - x * x) * slope * slope);
    }
  }
};

// What a box with round corners lacks of one with sharp ones, as products of what rows and columns lack at each node along
// the arc: px by which the side lies farther in there, px above the corner's lowest line, and weight.
struct Corner {
  std::vector<double> insets, heights, weights;

  Corner(const Box& box, const Rule& rule) {
    for (size_t k = 0; k < rule.nodes.size(); k++) {
      const double turn = 0.25 * kPi * (rule.nodes[k] + 1.0);
      insets.push_back(box.rx * (1.0 - std::cos(turn))), heights.push_back(box.ry * std::sin(turn));
      weights.push_back(rule.weights[k] * 0.25 * kPi * box.ry * std::cos(turn));
    }
  }
};

// Along rows: of each place what the sharp box has there, and between which nodes (x 2) corners add something, what.
struct Rows {
  std::vector<double> whole, corners;
  std::vector<int> nodes;

  Rows(const Box& box, double sigma, const Corner& corner, const std::vector<double>& y) : whole(y.size()) {
    const int count = int(corner.weights.size());
    corners.resize(y.size() * count), nodes.resize(2 * y.size());
    for (size_t i = 0; i < y.size(); i++) {
      whole[i] = normal((y[i] - box.top) / sigma) - normal((y[i] - box.bottom) / sigma);
      int &first = nodes[2 * i], &last = nodes[2 * i + 1];
      for (int k = 0; k < count; k++) {
        double density = 0.0;
        // At the same distance from both ends the same is missing.
        for (const double end : {box.top + box.ry - corner.heights[k], box.bottom - box.ry + corner.heights[k]}) {
          const double z = (y[i] - end) / sigma;
          if (std::fabs(z) < kBeyond) density += std::exp(-0.5 * z * z);
        }
        if (density == 0.0) continue;
        corners[i * count + k] = -corner.weights[k] / (sigma * std::sqrt(2.0 * kPi)) * density;
        if (last == 0) first = k;
        last = k + 1;
      }
    }
  }
};

// Along columns: the same, what corners add only once it is asked for.
class Columns {
 public:
  std::vector<double> whole;

  Columns(const Box& box, double sigma, const Corner& corner, const std::vector<double>& x)
      : whole(x.size()), box_(box), sigma_(sigma), x_(x), insets_(corner.insets), bent_(x.size()) {
    for (size_t i = 0; i < x.size(); i++) {
      whole[i] = normal((x[i] - box.left) / sigma) - normal((x[i] - box.right) / sigma);
      const double within = std::min(x[i] - box.left, box.right - x[i]);
      bent_[i] = !insets_.empty() && within > -kBeyond * sigma && within < box.rx + kBeyond * sigma;
    }
    corners_.assign(x.size() * insets_.size(), std::nan(""));
  }

  bool bent(size_t i) const { return bent_[i]; }

  double corner(size_t i, int k) {
    double& known = corners_[i * insets_.size() + k];
    if (std::isnan(known)) {
      const auto share = [&](double edge) { return normal((x_[i] - edge) / sigma_); };
      known = share(box_.left) - share(box_.left + insets_[k]) + share(box_.right - insets_[k]) - share(box_.right);
    }
    return known;
  }

 private:
  Box box_;
  double sigma_;
  const std::vector<double>& x_;
  std::vector<double> insets_, corners_;
  std::vector<uint8_t> bent_;
};

// The blurred coverage of a box at a row and a column.
double coverage(const Rows& rows, size_t row, Columns& columns, size_t column) {
  double sum = rows.whole[row] * columns.whole[column];
  if (!columns.bent(column)) return std::clamp(sum, 0.0, 1.0);
  const size_t count = rows.corners.size() / rows.whole.size();
  for (int k = rows.nodes[2 * row]; k < rows.nodes[2 * row + 1]; k++)
    sum += rows.corners[row * count + k] * columns.corner(column, k);
  return std::clamp(sum, 0.0, 1.0);
}

// The rules for corners, each made once.
class Corners {
 public:
  // None of a box with sharp corners.
  Corner of(const Box& box, double sigma) {
    int count = 0;
    if (std::min(box.rx, box.ry) > 0.0) count = std::min(kNodes + int(kMoreNodes * box.ry / sigma), kMostNodes);
    return Corner(box, rules_.try_emplace(count, count).first->second);
  }

 private:
  std::map<int, Rule> rules_;
};

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

  // Of each box its rows or columns.
  std::vector<Rows> down(const Layer& layer) {
    std::vector<Rows> out;
    for (int b = 0; b < boxes; b++) {
      const Box own = layer.of(box[b]);
      out.emplace_back(own, layer.sigma, corners.of(own, layer.sigma), rows.at);
    }
    return out;
  }

  std::vector<Columns> across(const Layer& layer) {
    std::vector<Columns> out;
    for (int b = 0; b < boxes; b++) {
      const Box own = layer.of(box[b]);
      out.emplace_back(own, layer.sigma, corners.of(own, layer.sigma), columns.at);
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
      out.add(1, weight, derivatives.data(), &residual_[i]);
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
}  // namespace cs

extern "C" {

// The box (6) of a layer's shadow before it is blurred. numbers: of the layer (6).
CS_EXPORT void cs_shadow_box(const double* box, const double* numbers, double* out) {
  const cs::Box found = cs::Layer(numbers).of(*reinterpret_cast<const cs::Box*>(box));
  std::copy(&found.left, &found.left + 6, out);
}

// What the layers (6 each) of a box let through at rows y (h) and columns x (w), (h x w). Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_shadow_window(const double* box, int32_t layers, const double* numbers, int64_t h, const double* y,
                                   int64_t w, const double* x, double* light) {
  try {
    std::fill(light, light + h * w, 1.0);
    const std::vector<double> ys(y, y + h), xs(x, x + w);
    cs::Corners corners;
    for (int k = 0; k < layers; k++) {
      const cs::Layer layer(numbers + cs::kNumbers * k);
      const cs::Box own = layer.of(*reinterpret_cast<const cs::Box*>(box));
      const cs::Corner corner = corners.of(own, layer.sigma);
      const cs::Rows rows(own, layer.sigma, corner, ys);
      cs::Columns columns(own, layer.sigma, corner, xs);
      for (int64_t i = 0; i < h; i++)
        for (int64_t j = 0; j < w; j++) light[i * w + j] *= 1.0 - layer.alpha * cs::coverage(rows, i, columns, j);
    }
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}

// The same of some boxes (6 each) that have the same layers, at the middles of n pixels. open: (boxes x n). light (n): what
// is left of it.
CS_EXPORT int32_t cs_shadow_light(int32_t boxes, const double* sides, int64_t n, const int64_t* rows,
                                  const int64_t* columns, const uint8_t* open, int32_t layers, const double* numbers,
                                  double* light) {
  try {
    cs::Shaded shaded(boxes, sides, n, rows, columns, open);
    for (int k = 0; k < layers; k++) {
      const std::vector<double> own = shaded.light(cs::Layer(numbers + cs::kNumbers * k));
      for (int64_t i = 0; i < n; i++) light[i] *= own[i];
    }
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}

// Brings the numbers of layers (6 each) as near to what is seen (n), of which others let so much through (n), as they come,
// outliers counting linearly. scale: levels of a whole shade. Returns the mean square left, levels^2; below 0 without memory.
CS_EXPORT double cs_fit_shadows(int32_t boxes, const double* sides, int64_t n, const int64_t* rows,
                                const int64_t* columns, const uint8_t* open, const double* seen, const double* through,
                                double scale, int32_t layers, double* numbers) {
  try {
    cs::Shaded shaded(boxes, sides, n, rows, columns, open);
    cs::Fit fit(shaded, seen, through, scale, {numbers, numbers + cs::kNumbers * layers});
    const double loss = cs::minimise(fit, fit.begin(), cs::kRounds, cs::kEnough);
    for (int k = 0; k < cs::kNumbers * layers; k++)
      numbers[k] = k % cs::kNumbers == 4 ? std::log(cs::Layer(&fit.numbers()[k - 4]).sigma) : fit.numbers()[k];
    return loss / double(std::max(n, int64_t(1)));
  } catch (const std::exception&) {
    return -1.0;
  }
}
}
