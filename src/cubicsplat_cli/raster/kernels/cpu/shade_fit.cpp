// Gradients fitted to pixels: the numbers of the geometry and the places of the inner stops by damped Gauss-Newton steps,
// in which the colours are always the best ones (variable projection; G. Golub and V. Pereyra, 1973).
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "damped.h"
#include "shades.h"

namespace cs {
namespace {

constexpr int kRounds = 12;
constexpr double kEnough = 1e-3;  // gain, relative, below which a fit has converged
constexpr double kFar = 4.0;      // levels^2 beyond which a pixel counts by the logarithm
constexpr double kTurn = 1e-3;    // radians or shares, of the differences that stand for derivatives
constexpr double kShift = 1e-4;   // of the pixels' extent, the same
constexpr double kKnot = 1e-3;    // of the ramp's length, the same
constexpr double kApart = 1e-6;   // of the ramp's length, between knots
constexpr double kLean = 0.95;    // of the way from the middle to the rim, the farthest focus

struct Shade {
  Geometry frame;
  int parameters;  // of the geometry: 2 of a line, 3 of a circle, 5 of an ellipse, 7 of one with a focus
  Ramp ramp;

  int steps() const { return parameters == 2 ? 1 : parameters - 1; }
};

// A direction turned about the pixels' middle; an ellipse moved, and stretched along x and at 45 degrees, since its scale
// is the ramp's; its lean moved.
Geometry stepped(const Shade& shade, const double* step, double x, double y) {
  Geometry out = shade.frame;
  const double* m = shade.frame.map;
  if (shade.parameters == 2) {
    const double cosine = std::cos(step[0]), sine = std::sin(step[0]);
    out.map[0] = cosine * m[0] - sine * m[1], out.map[1] = sine * m[0] + cosine * m[1];
    out.map[2] = m[2] + (m[0] - out.map[0]) * x + (m[1] - out.map[1]) * y;
    return out;
  }
  const double det = m[0] * m[5] - m[1] * m[4];
  const double cx = (m[1] * m[6] - m[5] * m[2]) / det + step[0], cy = (m[4] * m[2] - m[0] * m[6]) / det + step[1];
  if (shade.parameters >= 5) {
    const double along = step[2], across = step[3];
    for (int row = 0; row < 8; row += 4) {
      out.map[row] = m[row] * (1.0 + along) + m[row + 1] * across;
      out.map[row + 1] = m[row] * across + m[row + 1] * (1.0 - along);
    }
  }
  for (int row = 0; row < 8; row += 4) out.map[row + 2] = -(out.map[row] * cx + out.map[row + 1] * cy);
  if (shade.parameters == 7) {
    const double along = m[3] + step[4], across = m[7] + step[5];
    const double less = std::min(1.0, kLean / std::max(std::hypot(along, across), 1e-9));
    out.map[3] = less * along, out.map[7] = less * across;
  }
  return out;
}

// The problem that `minimise` solves.
class Fit {
 public:
  Fit(const Pixels& pixels, Shade shade) : pixels_(pixels), now_(std::move(shade)), weights_(pixels.count, 1.0) {
    double low[2] = {pixels.x[0], pixels.y[0]}, high[2] = {low[0], low[1]};
    for (int64_t i = 0; i < pixels.count; i++) {
      const double at[2] = {pixels.x[i], pixels.y[i]};
      for (int k = 0; k < 2; k++) {
        low[k] = std::min(low[k], at[k]), high[k] = std::max(high[k], at[k]);
        middle_[k] += at[k] / double(pixels.count);
      }
    }
    extent_ = std::max({high[0] - low[0], high[1] - low[1], 1.0});
    at_.resize(4 * pixels.count), t_.resize(pixels.count);
    next_at_.resize(4 * pixels.count), next_t_.resize(pixels.count);
    place(now_.frame, t_);
    evaluate(now_.ramp, t_, at_);
  }

  const Shade& shade() const { return now_; }

  // The loss, and the pixels' weights by it.
  double begin() { return weighed(at_); }

  double loss_after(const std::vector<double>& step) {
    next_ = moved(step.data());
    place(next_.frame, next_t_);
    next_.ramp.colours = colours(next_.ramp.knots, next_t_);
    evaluate(next_.ramp, next_t_, next_at_);
    return loss(next_at_);
  }

  void accept() {
    now_ = next_;
    at_.swap(next_at_), t_.swap(next_t_);
    weighed(at_);
  }

  bool hopeless(int, double) const { return false; }

  void equations(NormalEquations& out) {
    const int geometry = now_.steps(), count = geometry + now_.ramp.count();
    const std::vector<double> steps = differences();
    std::vector<Ramp> ramps;
    std::vector<std::vector<double>> t(geometry, std::vector<double>(pixels_.count));
    for (int p = 0; p < count; p++) {
      std::vector<double> step(count, 0.0);
      step[p] = steps[p];
      const Shade trial = moved(step.data());
      if (p < geometry) place(trial.frame, t[p]);
      ramps.push_back({trial.ramp.knots, colours(trial.ramp.knots, p < geometry ? t[p] : t_)});
    }
    out.clear(count);
    std::vector<double> derivatives(4 * size_t(count));
    for (int64_t i = 0; i < pixels_.count; i++) {
      double residual[4], there[4];
      for (int k = 0; k < 4; k++) residual[k] = at_[4 * i + k] - pixels_.values[4 * i + k];
      for (int p = 0; p < count; p++) {
        ramps[p].at(p < geometry ? t[p][i] : t_[i], there);
        for (int k = 0; k < 4; k++) derivatives[4 * p + k] = (there[k] - at_[4 * i + k]) / steps[p];
      }
      out.add<4>(weights_[i], derivatives.data(), residual);
    }
  }

 private:
  Pixels pixels_;
  Shade now_, next_ = now_;
  std::vector<double> at_, t_, next_at_, next_t_, weights_;
  double middle_[2] = {}, extent_;

  void place(const Geometry& frame, std::vector<double>& t) const {
    for (int64_t i = 0; i < pixels_.count; i++) t[i] = frame.t(pixels_.x[i], pixels_.y[i]);
  }

  void evaluate(const Ramp& ramp, const std::vector<double>& t, std::vector<double>& at) const {
    for (int64_t i = 0; i < pixels_.count; i++) ramp.at(t[i], &at[4 * i]);
  }

  std::vector<double> colours(const std::vector<double>& knots, const std::vector<double>& t) const {
    RampEquations equations(int(knots.size()));
    for (int64_t i = 0; i < pixels_.count; i++)
      equations.add(Hat(knots.data(), int(knots.size()), t[i]), weights_[i], pixels_.values + 4 * i);
    return equations.colours();
  }

  double loss(const std::vector<double>& at) const {
    double sum = 0.0;
    for (int64_t i = 0; i < pixels_.count; i++) {
      const double square = squared(&at[4 * i], pixels_.values + 4 * i);
      sum += square < kFar ? square : kFar * (1.0 + std::log(square / kFar));
    }
    return sum;
  }

  double weighed(const std::vector<double>& at) {
    for (int64_t i = 0; i < pixels_.count; i++)
      weights_[i] = std::min(1.0, kFar / std::max(squared(&at[4 * i], pixels_.values + 4 * i), 1e-9));
    return loss(at);
  }

  std::vector<double> differences() const {
    const std::vector<double>& knots = now_.ramp.knots;
    std::vector<double> out;
    if (now_.parameters == 2) out = {kTurn};
    if (now_.parameters != 2) out = {kShift * extent_, kShift * extent_};
    if (now_.parameters >= 5) out.insert(out.end(), now_.parameters - 3, kTurn);
    out.insert(out.end(), knots.size(), kKnot * std::max(knots.back() - knots.front(), 1e-9));
    return out;
  }

  // Without the colours of its ramp.
  Shade moved(const double* step) const {
    Shade out{stepped(now_, step, middle_[0], middle_[1]), now_.parameters, {now_.ramp.knots, {}}};
    std::vector<double>& knots = out.ramp.knots;
    for (size_t i = 0; i < knots.size(); i++) knots[i] += step[now_.steps() + i];
    std::sort(knots.begin(), knots.end());
    const double apart = kApart * (knots.back() - knots.front()) + 1e-12;
    for (size_t i = 1; i < knots.size(); i++) knots[i] = std::max(knots[i], knots[i - 1] + apart);
    return out;
  }
};

}  // namespace
}  // namespace cs

extern "C" {

// Brings a shade nearer to pixels: frame (2, 4), stops knots and colours (x 4) are changed in place. parameters: of the
// geometry, 2, 3, 5 or 7. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_fit_shade(int64_t n, const double* x, const double* y, const double* values, double* frame,
                               int64_t parameters, int64_t stops, double* knots, double* colours) {
  return cs::failed([&] {
    cs::Shade shade{
        {frame, parameters != 2}, int(parameters), {{knots, knots + stops}, {colours, colours + 4 * stops}}};
    cs::Fit fit({n, x, y, values}, std::move(shade));
    cs::minimise(fit, fit.begin(), cs::kRounds, cs::kEnough);
    const cs::Shade& found = fit.shade();
    std::copy(found.frame.map, found.frame.map + 8, frame);
    std::copy(found.ramp.knots.begin(), found.ramp.knots.end(), knots);
    std::copy(found.ramp.colours.begin(), found.ramp.colours.end(), colours);
  });
}

// The best colours (stops x 4) of given stops.
CS_EXPORT int32_t cs_shade_colours(int64_t n, const double* x, const double* y, const double* values,
                                   const double* frame, int64_t radial, int64_t stops, const double* knots,
                                   double* colours) {
  return cs::failed([&] {
    const cs::Geometry own{frame, radial != 0};
    cs::RampEquations equations{int(stops)};
    for (int64_t i = 0; i < n; i++) equations.add(cs::Hat(knots, int(stops), own.t(x[i], y[i])), 1.0, values + 4 * i);
    const std::vector<double> found = equations.colours();
    std::copy(found.begin(), found.end(), colours);
  });
}

// What a shade has at places (n x 4), levels; where values are given, off them instead.
CS_EXPORT void cs_shaded(int64_t n, const double* x, const double* y, const double* values, const double* frame,
                         int64_t radial, int64_t stops, const double* knots, const double* colours, double* out) {
  const cs::Geometry own{frame, radial != 0};
  for (int64_t i = 0; i < n; i++) {
    const cs::Hat hat(knots, int(stops), own.t(x[i], y[i]));
    const double *before = colours + 4 * (hat.after - 1), *after = before + 4;
    for (int k = 0; k < 4; k++) {
      const double at = before[k] + hat.share * (after[k] - before[k]);
      out[4 * i + k] = values ? at - values[4 * i + k] : at;
    }
  }
}

// The squares of what a shade has less the values, rows of RGBA times a matrix (4 x 4): their sums over each of some groups
// of pixels, which end at `ends`.
CS_EXPORT void cs_shade_misfits(int64_t n, const double* x, const double* y, const double* values, const double* frame,
                                int64_t radial, int64_t stops, const double* knots, const double* colours,
                                const double* space, int64_t groups, const int64_t* ends, double* sums) {
  const cs::Geometry own{frame, radial != 0};
  const cs::Ramp ramp = {{knots, knots + stops}, {colours, colours + 4 * stops}};
  for (int64_t i = 0, group = 0; i < n; i++) {
    while (group < groups && i >= ends[group]) group++;
    double at[4];
    ramp.at(own.t(x[i], y[i]), at);
    for (int k = 0; k < 4; k++) {
      double off = 0.0;
      for (int c = 0; c < 4; c++) off += (at[c] - values[4 * i + c]) * space[4 * c + k];
      sums[group] += off * off;
    }
  }
}

// How far pixels reach beyond the ramp of a shade: the least and greatest t; and for the first stop and the last one the
// squared differences of the pixels beyond it from its colour, and from the ramp carried on.
CS_EXPORT void cs_shade_reach(int64_t n, const double* x, const double* y, const double* values, const double* frame,
                              int64_t radial, int64_t stops, const double* knots, const double* colours, double* range,
                              double* squares) {
  const cs::Geometry own{frame, radial != 0};
  range[0] = INFINITY, range[1] = -INFINITY;
  const int64_t ends[2] = {0, stops - 1}, beside[2] = {1, stops - 2};
  for (int64_t i = 0; i < n; i++) {
    const double t = own.t(x[i], y[i]);
    range[0] = std::min(range[0], t), range[1] = std::max(range[1], t);
    if (t >= knots[0] && t <= knots[stops - 1]) continue;
    const int64_t e = t > knots[stops - 1], end = ends[e], next = beside[e];
    for (int k = 0; k < 4; k++) {
      const double slope = (colours[4 * end + k] - colours[4 * next + k]) / (knots[end] - knots[next]);
      const double off = colours[4 * end + k] - values[4 * i + k], on = off + slope * (t - knots[end]);
      squares[2 * e] += off * off, squares[2 * e + 1] += on * on;
    }
  }
}

// How the colours of pixels change, in blocks of size x size px from their first row and column on: of blocks (room) that
// have `fewest` px or more, not in a line, the middle (x 2), slopes (4 x 2), levels per px times the weight, by which each
// counts as its errors allow, mean values (x 4), and that weight. Returns how many; below 0 without memory.
CS_EXPORT int64_t cs_slopes(int64_t n, const double* x, const double* y, const double* values, int64_t size,
                            int64_t fewest, int64_t room, double* middles, double* slopes, double* means,
                            double* weights) {
  return cs::counted([&] {
    const double left = *std::min_element(x, x + n), top = *std::min_element(y, y + n);
    const double right = *std::max_element(x, x + n), bottom = *std::max_element(y, y + n);
    const int64_t columns = int64_t(right - left) / size + 1, rows = int64_t(bottom - top) / size + 1;
    // Of each block: how many, x, y, xx, xy, yy, and of each channel v, xv, yv; x and y from the block's own corner.
    std::vector<std::array<double, 18>> sums(columns * rows);
    for (int64_t i = 0; i < n; i++) {
      const int64_t column = int64_t(x[i] - left) / size, row = int64_t(y[i] - top) / size;
      const double dx = x[i] - left - double(column * size), dy = y[i] - top - double(row * size);
      std::array<double, 18>& sum = sums[row * columns + column];
      const double terms[6] = {1.0, dx, dy, dx * dx, dx * dy, dy * dy};
      for (int k = 0; k < 6; k++) sum[k] += terms[k];
      for (int k = 0; k < 4; k++)
        for (int p = 0; p < 3; p++) sum[6 + 3 * k + p] += terms[p] * values[4 * i + k];
    }
    int64_t count = 0;
    for (int64_t block = 0; block < columns * rows; block++) {
      const std::array<double, 18>& sum = sums[block];
      const double own = sum[0];
      if (own < double(fewest)) continue;
      const double mx = sum[1] / own, my = sum[2] / own;
      const double xx = sum[3] / own - mx * mx, xy = sum[4] / own - mx * my, yy = sum[5] / own - my * my;
      const double det = xx * yy - xy * xy;
      if (det <= 0.02 || count == room) continue;
      middles[2 * count] = left + double(block % columns * size) + mx;
      middles[2 * count + 1] = top + double(block / columns * size) + my;
      weights[count] = std::sqrt(own * std::min(xx, yy));
      const double root = weights[count] / det;
      for (int k = 0; k < 4; k++) {
        const double* v = &sum[6 + 3 * k];
        means[4 * count + k] = v[0] / own;
        const double vx = (v[1] - mx * v[0]) / own, vy = (v[2] - my * v[0]) / own;
        slopes[8 * count + 2 * k] = root * (vx * yy - vy * xy);
        slopes[8 * count + 2 * k + 1] = root * (vy * xx - vx * xy);
      }
      count++;
    }
    return count;
  });
}
}
