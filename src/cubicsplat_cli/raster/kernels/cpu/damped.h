// Levenberg's and Marquardt's method for problems of a few variables (D. Marquardt, "An Algorithm for Least-Squares
// Estimation of Nonlinear Parameters", 1963).
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

namespace cs {

// The normal equations of `count` variables.
struct NormalEquations {
  int count = 0;
  std::vector<double> gram, slope;

  void clear(int variables) {
    count = variables;
    gram.assign(size_t(count) * count, 0.0), slope.assign(count, 0.0);
  }

  // Adds some residuals with their derivatives, (variables x channels), and a weight.
  template <int channels>
  void add(double weight, const double* derivatives, const double* residuals) {
    for (int p = 0; p < count; p++) {
      const double* own = derivatives + size_t(p) * channels;
      for (int k = 0; k < channels; k++) slope[p] += weight * own[k] * residuals[k];
      for (int q = 0; q <= p; q++) {
        const double* other = derivatives + size_t(q) * channels;
        double sum = 0.0;
        for (int k = 0; k < channels; k++) sum += own[k] * other[k];
        gram[size_t(p) * count + q] += weight * sum;
      }
    }
  }

  // The damped step, by Cholesky's decomposition; false where rounding leaves none.
  bool step(double damping, std::vector<double>& out) const {
    std::vector<double> factor = gram;
    out.assign(count, 0.0);
    for (int i = 0; i < count; i++) {
      double* own = &factor[size_t(i) * count];
      own[i] += damping * (own[i] + 1e-9);
      double rest = -slope[i];
      for (int j = 0; j <= i; j++) {
        const double* other = &factor[size_t(j) * count];
        double sum = own[j];
        for (int k = 0; k < j; k++) sum -= own[k] * other[k];
        if (j == i && !(sum > 0.0)) return false;
        own[j] = j == i ? std::sqrt(sum) : sum / other[j];
        if (j < i) rest -= own[j] * out[j];
      }
      out[i] = rest / own[i];
    }
    for (int i = count - 1; i >= 0; i--) {
      out[i] /= factor[size_t(i) * count + i];
      for (int k = 0; k < i; k++) out[k] -= factor[size_t(i) * count + k] * out[i];
    }
    return true;
  }
};

constexpr double kFirstDamping = 1e-3, kDampingFactor = 5.0, kMostDamping = 1e6;

// Takes steps until one gains less than `enough` of the loss, which is returned. A problem has
//   void equations(NormalEquations&), at the place it has reached,
//   double loss_after(const std::vector<double>& step), of a step from there,
//   void accept(), to go to where the last step led, and
//   bool hopeless(int round, double loss), to give up.
template <class Problem>
double minimise(Problem& problem, double loss, int rounds, double enough) {
  NormalEquations equations;
  std::vector<double> step;
  double damping = kFirstDamping;
  for (int round = 0; round < rounds && !problem.hopeless(round, loss); round++) {
    problem.equations(equations);
    double gained = 0.0;
    for (; damping < kMostDamping; damping *= kDampingFactor) {
      if (!equations.step(damping, step)) continue;
      const double following = problem.loss_after(step);
      if (!(following < loss)) continue;
      gained = loss - following, loss = following;
      problem.accept();
      damping /= kDampingFactor;
      break;
    }
    if (gained < enough * loss) break;
  }
  return loss;
}

}  // namespace cs
