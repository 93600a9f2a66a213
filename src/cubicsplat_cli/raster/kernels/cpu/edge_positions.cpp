// Where the borders between regions run within the pixels beside them. What is computed is said in
// artwork/regions/sampling.py; raster/borders.py says what the function means.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "abi.h"
#include "colours.h"

namespace cs {
namespace {

constexpr int64_t kWalk = 3;         // pixels to either side of a crack that may belong to the border's blend
constexpr double kPureShare = 0.02;  // from 0 or 1, that ends the walk
constexpr double kClean = 10.0;      // levels of residual of a blend that only its two fills explain
// Standard errors in px: beside a third fill; without a clean walk; of an edge of a line without a pure pixel; of what ends
// with the canvas. Levels by which a pixel there must differ from its fill for an edge to be sought.
constexpr double kNearThird = 0.3, kGuess = 0.5, kThin = 0.1, kRimSigma = 0.02, kRimLevels = 4.0;
// px a line may be across, and px beyond it within which its ground must be pure; levels that are pure; of the squares of
// the sines between the colours above and below it and its own above which both edges follow from the sums; px from the
// crack that an edge may lie; and px.
constexpr int64_t kMost = 4;
constexpr double kPure = 6.0, kApart = 0.03, kFarthest = 1.5, kThinnest = 0.1;

struct Edge {
  double at, sigma;
};

// A picture seen so that the cracks in question are level: `rows` of `width` px, whose indices are `down` and `across`
// apart from `first` on.
struct View {
  const void* levels;
  bool wide;  // of float64, else of float32
  const int32_t* labels;
  const double* fills;
  int64_t rows, width, first, down, across;

  int64_t index(int64_t row, int64_t x) const { return first + row * down + x * across; }
  int32_t label(int64_t row, int64_t x) const { return labels[index(row, x)]; }
  int64_t within(int64_t row) const { return std::clamp<int64_t>(row, 0, rows - 1); }
  Colour fill(int32_t label) const { return colour(fills + 4 * int64_t(label)); }
  Colour value(int64_t row, int64_t x) const {
    const int64_t i = 4 * index(row, x);
    return wide ? colour(static_cast<const double*>(levels) + i) : colour(static_cast<const float*>(levels) + i);
  }
};

// The first row from `row` on that is purely the fill of its region, -1 where there is none within kMost px.
int64_t pure_row(const View& view, int64_t row, int64_t x, int64_t sign) {
  const int32_t label = view.label(row, x);
  for (int64_t step = 0; step < kMost; step++) {
    const int64_t here = view.within(row + sign * step);
    if (view.label(here, x) != label) return -1;
    if (view.value(here, x).off(1.0, view.fill(label)) <= kPure) return here;
  }
  return -1;
}

// The height of the border at the crack above a pixel of which the line to one side, below it for a sign of 1, is so thin
// that no pixel across it is purely its own. NaN where it is not found.
//
// Down a column across a line of fill T, with fill B above and C below, lie the edges e1 and e2. Whatever their slopes, the
// pixels of the column from row r0 to r1 sum up to B (e1 - r0) + T (e2 - e1) + C (r1 - e2), a linear equation in e1 and e2
// for each channel. Where B, T and C lie on one line of colours it tells only one of them; then the line's middle is taken
// from the centroid of what differs from its ground.
double thin_edge(const View& view, int64_t y, int64_t x, int64_t sign) {
  constexpr double unknown = std::numeric_limits<double>::quiet_NaN();
  const int64_t inner = sign > 0 ? y : y - 1, near = sign > 0 ? y - 1 : y;
  const int32_t own = view.label(inner, x);
  int64_t far = inner;
  for (int64_t k = 0; k < kMost && view.label(far, x) == own; k++) far = view.within(far + sign);
  if (view.label(far, x) == own) return unknown;
  const int64_t start = pure_row(view, near, x, -sign), stop = pure_row(view, far, x, sign);
  if (start < 0 || stop < 0) return unknown;
  const int64_t top = sign > 0 ? start : stop, bottom = sign > 0 ? stop : start;
  const Colour fill = view.fill(own);
  const Colour above = view.fill(view.label(sign > 0 ? near : far, x)),
               below = view.fill(view.label(sign > 0 ? far : near, x));
  Colour total{}, moment{};
  for (int64_t row = top; row <= bottom; row++) {
    const Colour value = view.value(row, x);
    for (int c = 0; c < 4; c++) total.of[c] += value.of[c], moment.of[c] += value.of[c] * (double(row) + 0.5);
  }
  const double r0 = double(top), r1 = double(bottom) + 1.0;
  const Colour a = above - fill, c = fill - below;
  Colour rest;
  for (int k = 0; k < 4; k++) rest.of[k] = total.of[k] + above.of[k] * r0 - below.of[k] * r1;
  const double aa = a.dot(a), cc = c.dot(c), ac = a.dot(c), ra = rest.dot(a), rc = rest.dot(c);
  const double det = aa * cc - ac * ac;
  double upper = unknown, lower = unknown;
  if (det > kApart * aa * cc) {
    upper = (ra * cc - rc * ac) / det, lower = (rc * aa - ra * ac) / det;
  } else if (above.off(1.0, below) <= kPure) {
    // On one line of colours: how much fill, and around which height, above a ground that is the same on both sides.
    Colour span, more, turning;
    for (int k = 0; k < 4; k++) {
      const double base = 0.5 * (above.of[k] + below.of[k]);
      span.of[k] = fill.of[k] - base;
      more.of[k] = total.of[k] - base * (r1 - r0), turning.of[k] = moment.of[k] - base * (0.5 * (r1 * r1 - r0 * r0));
    }
    const double length = std::max(span.dot(span), kTiny), amount = more.dot(span) / length;
    const double middle = turning.dot(span) / length / (std::fabs(amount) > kThinnest ? amount : unknown);
    upper = middle - 0.5 * amount, lower = middle + 0.5 * amount;
  }
  const double edge = sign > 0 ? upper : lower;
  return lower - upper > kThinnest && std::fabs(edge - double(y)) < kFarthest ? edge : unknown;
}

// The border across the crack above a pixel. error: in levels, of the picture; share_error: of its shares.
Edge edge(const View& view, int64_t y, int64_t x, double error, double share_error) {
  const int32_t above = view.label(y - 1, x), below = view.label(y, x);
  const Colour base = view.fill(below), span = view.fill(above) - base;
  const auto third_beside = [&](int64_t row) {
    for (const int64_t side : {std::max<int64_t>(x - 1, 0), std::min(x + 1, view.width - 1)})
      if (const int32_t other = view.label(row, side); other != above && other != below) return true;
    return false;
  };
  double shift = 0.0, thin = std::numeric_limits<double>::quiet_NaN();
  bool clean = true, third = false;
  for (const int64_t sign : {-1, 1}) {
    const int32_t own = sign < 0 ? above : below;
    double walked = 0.0;
    bool ended = false;
    for (int64_t step = 0; step < kWalk && !ended; step++) {
      const int64_t row = sign < 0 ? y - 1 - step : y + step;
      // Walking into another region without having met the pure fill is no clean end.
      if (row < 0 || row >= view.rows) {
        ended = step > 0;
      } else if (view.label(row, x) == own) {
        const Blend blend = between(view.value(row, x) - base, span);
        const double missing = sign < 0 ? 1.0 - blend.share : blend.share;
        walked += missing;
        third |= blend.residual > kClean || third_beside(row);
        ended = missing <= kPureShare;
      }
    }
    clean &= ended;
    if (!ended && view.label(view.within(y + sign * kWalk), x) != own) thin = thin_edge(view, y, x, sign);
    shift += sign < 0 ? -walked : walked;
  }
  if (!std::isnan(thin)) return {thin, kThin};
  const double known = std::hypot(share_error, error / std::max(std::sqrt(span.dot(span)), 1.0));
  return {double(y) + shift, !clean ? kGuess : third ? kNearThird : known};
}

// How far below the canvas's upper border the topmost region begins: what is beyond it, nothing or another one of so many
// kinds of fills, shows in its pixels only. rounding: levels by which a clean picture's pixels are off.
Edge rim(const View& view, int64_t x, int64_t kinds, const double* fills, double rounding, double share_error) {
  const int32_t own = view.label(0, x);
  const Colour base = view.fill(own), value = view.value(0, x) - base;
  if (!(view.value(0, x).off(1.0, base) > kRimLevels)) return {0.0, kRimSigma};
  Colour span = Colour{} - base;
  double rest = between(value, span).residual;
  // Nothing, or the fill that explains clearly more.
  for (int64_t k = 0; k < kinds; k++) {
    const Colour other = colour(fills + 4 * k) - base;
    if (const double residual = between(value, other).residual; residual + kRimLevels < rest)
      span = other, rest = residual;
  }
  double walked = 0.0;
  bool ended = false;
  for (int64_t row = 0; row < std::min(kWalk, view.rows) && !ended; row++) {
    if (view.label(row, x) != own) continue;
    const double share = between(view.value(row, x) - base, span).share;
    walked += share, ended = share <= kPureShare;
  }
  const bool beside = view.label(0, (x + view.width - 1) % view.width) != own ||
                      view.label(0, (x + 1) % view.width) != own;
  if (!ended || rest > kClean || beside) return {0.0, kNearThird};
  return {walked, std::hypot(share_error, rounding / std::max(std::sqrt(span.dot(span)), 1.0))};
}

}  // namespace
}  // namespace cs

// levels: height x width x 4 of float64 where `wide`, else of float32; labels: of each pixel; fills: of the labels x 4;
// kinds: so many different ones x 4, ascending. rows, row_sigma: (height + 1) x width; columns, column_sigma: height x
// (width + 1).
CS_EXPORT void cs_edge_positions(const void* levels, int64_t wide, const int32_t* labels, int64_t height, int64_t width,
                                 const double* fills, int64_t kinds, const double* kind, double error, double rounding,
                                 double share_error, double* rows, double* row_sigma, double* columns,
                                 double* column_sigma) {
  using namespace cs;
  for (const bool upright : {false, true}) {
    const int64_t high = upright ? width : height, across = upright ? height : width;
    const int64_t down = upright ? 1 : width, along = upright ? width : 1;
    const View view{levels, wide != 0, labels, fills, high, across, 0, down, along};
    const View turned{levels, wide != 0, labels, fills, high, across, (high - 1) * down, -down, along};
    for (int64_t y = 0; y <= high; y++)
      for (int64_t x = 0; x < across; x++) {
        Edge found{double(y), kRimSigma};
        if (y == 0) {
          found = rim(view, x, kinds, kind, rounding, share_error);
        } else if (y == high) {
          found = rim(turned, x, kinds, kind, rounding, share_error);
          found.at = double(high) - found.at;
        } else if (view.label(y - 1, x) != view.label(y, x)) {
          found = edge(view, y, x, error, share_error);
        }
        const int64_t place = upright ? x * (width + 1) + y : y * width + x;
        (upright ? columns : rows)[place] = found.at, (upright ? column_sigma : row_sigma)[place] = found.sigma;
      }
  }
}
