// Runs of points that are to be divided into pieces, and the nodes where these may join. What is meant is said in
// tests/outline_loops.py (`laid_out`).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "cubic.h"
#include "local_fits.h"

namespace cs {
namespace {

constexpr double kSureWeight = 4.0;  // 1/px^2: points that know less are no place for a joint
constexpr double kFewestNodes = 6.0, kNodesPerRadian = 4.0, kNodesPerRoot = 0.5;  // and per root of a px
constexpr double kStraightShare = 0.01;  // of sqrt(1/px): how dense nodes are on straight stretches
constexpr double kLeastBend = 2e-3;      // 1/px, of a run that is level or upright for a moment only
constexpr double kLeastError = 0.01;     // px and radians

using Errors = std::array<double, 2>;  // px across the run, and radians

// A run of points: where the local fits place each one, and which way it heads and bends there. weights: 1/px^2, 0 where
// the points tell nothing. ends, tangents, errors: where it starts and stops. corners: whether it does so at corners, or
// is a loop.
struct Section {
  std::vector<Point> at, along;
  std::vector<double> bend, weights;
  std::vector<Errors> known_to;
  Point ends[2], tangents[2];
  Errors errors[2];
  bool corners;

  bool sure(int64_t i) const { return weights[i] > kSureWeight; }

  // Fits parabolas about the points of a chain (x 2); `weights` are those of the points.
  void fit(const std::vector<Point>& points) {
    static constexpr int64_t halves[] = {2, 4, 7, 12, 20};
    static const std::vector<double> most = [] {
      std::vector<double> out;
      for (const int64_t half : halves) out.push_back(1.0 + 2.0 * std::sqrt(2.0 / double(2 * half - 2)));
      return out;
    }();
    const int64_t count = int64_t(points.size());
    std::vector<double> length(count, 0.0);
    for (int64_t i = 1; i < count; i++) length[i] = length[i - 1] + (points[i] - points[i - 1]).length();
    at.resize(count), along.resize(count), bend.resize(count), known_to.resize(count);
    for (int64_t i = 0; i < count; i++) {
      double terms[6] = {};
      parabola(count, &points[0].x, weights.data(), length.data(), i, {5, halves, most.data()}, terms,
               known_to[i].data());
      const double speed = std::max(std::hypot(terms[2], terms[3]), 1e-9);
      at[i] = {terms[0], terms[1]}, along[i] = {terms[2] / speed, terms[3] / speed};
      bend[i] = 2.0 * (terms[2] * terms[5] - terms[3] * terms[4]) / (speed * speed * speed);
    }
  }
};

// A place where pieces may join: before which point, where, which way the run heads there, whether that is exactly along
// an axis, and how well it is known.
struct Node {
  int64_t index;
  Point at, tangent;
  bool level;
  Errors errors;
};

// Where a run is horizontal or vertical for a moment.
inline std::vector<Node> extrema(const Section& run) {
  const int64_t count = int64_t(run.at.size());
  std::vector<Node> out;
  std::vector<uint8_t> taken(count, 0);
  for (int c = 0; c < 2; c++)
    for (int64_t before = 0; before + 1 < count; before++) {
      const auto slope = [&](int64_t i) { return c ? run.along[i].y : run.along[i].x; };
      if (slope(before) * slope(before + 1) > 0.0 || !run.sure(before) || !run.sure(before + 1)) continue;
      if (std::fabs(run.bend[before]) <= kLeastBend) continue;
      const int64_t k = std::fabs(slope(before)) < std::fabs(slope(before + 1)) ? before : before + 1;
      if (k < 2 || k >= count - 2 || taken[k - 1] || taken[k] || taken[k + 1]) continue;
      const Point here = run.along[k], normal{-here.y, here.x};
      const double bend = run.bend[k], turning = bend * (c ? normal.y : normal.x);
      const double step = std::fabs(turning) > 1e-9 ? std::clamp(-slope(k) / turning, -1.0, 1.0) : 0.0;
      const double off = 0.5 * step * step * bend;
      const double ahead = std::copysign(1.0, c ? here.x : here.y);
      taken[k] = 1;
      out.push_back({k, run.at[k] + here * step + normal * off, c ? Point{ahead, 0.0} : Point{0.0, ahead}, true, {}});
    }
  return out;
}

// Nodes along a run, denser where it bends.
inline std::vector<Node> nodes_of(const Section& run) {
  const int64_t count = int64_t(run.at.size());
  std::vector<double> measure(count, 0.0);
  const auto density = [&](int64_t i) {
    return run.sure(i) ? std::sqrt(std::min(std::fabs(run.bend[i]), 1.0)) + kStraightShare : 0.0;
  };
  double length = 0.0, turn = 0.0;
  for (int64_t i = 1; i < count; i++) {
    const double step = (run.at[i] - run.at[i - 1]).length();
    length += step;
    if (run.sure(i)) turn += std::fabs(0.5 * (run.bend[i] + run.bend[i - 1]) * step);
    measure[i] = measure[i - 1] + 0.5 * (density(i) + density(i - 1)) * step;
  }
  const double wanted = kFewestNodes + kNodesPerRadian * turn + kNodesPerRoot * std::sqrt(length);
  const int64_t many = int64_t(std::min(wanted, double(std::max<int64_t>(2, count / 2))));
  std::vector<Node> out = extrema(run);
  std::vector<uint8_t> near(count + 2, 0), chosen(count, 0);
  for (const Node& node : out) near[node.index - 1] = near[node.index] = near[node.index + 1] = 1;
  const auto choose = [&](int64_t i) {
    if (i > 1 && i < count - 2 && run.sure(i) && !near[i]) chosen[i] = 1;
  };
  for (int64_t k = 1, i = 0; k + 1 < many; k++) {
    const double at = measure[count - 1] * (double(k) / double(many - 1));
    while (i < count - 1 && measure[i] < at) i++;
    choose(i);
  }
  // Where the known points of a run begin and end, the way may change to one that hides.
  for (int64_t i = 0; i + 1 < count; i++)
    if (run.sure(i) != run.sure(i + 1)) choose(run.sure(i + 1) ? i + 1 : i);
  for (int64_t i = 0; i < count; i++)
    if (chosen[i]) out.push_back({i, run.at[i], run.along[i], false, {}});
  for (Node& node : out)
    for (int c = 0; c < 2; c++) node.errors[c] = std::max(run.known_to[node.index][c], kLeastError);
  out.push_back({0, run.ends[0], run.tangents[0], false, run.errors[0]});
  out.push_back({count, run.ends[1], run.tangents[1], false, run.errors[1]});
  std::sort(out.begin(), out.end(), [](const Node& a, const Node& b) { return a.index < b.index; });
  return out;
}

}  // namespace
}  // namespace cs
