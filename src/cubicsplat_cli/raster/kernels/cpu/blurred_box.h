// The field of a soft shadow: what a box becomes that is moved, made larger and blurred.
//
// The blur of a box with sharp corners is the product of what its rows and its columns have, differences of error
// functions; what round corners lack is an integral over their height, by Gauss and Legendre's rule, whose every node is
// such a product too.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <vector>

namespace cs::shadow {

constexpr double kPi = 3.14159265358979323846;
constexpr int kNumbers = 6;  // of a layer: dx, dy, px by which it is larger and rounder, log sigma, log-odds of alpha
constexpr double kLeastSigma = 0.7, kMostSigma = 40.0;  // px
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

inline double normal(double z) {
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
inline double coverage(const Rows& rows, size_t row, Columns& columns, size_t column) {
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

}  // namespace cs::shadow
