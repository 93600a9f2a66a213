// Colours of four channels, in levels, and blends of two of them.
#pragma once

#include <algorithm>
#include <cmath>

namespace cs {
namespace {

constexpr double kTiny = 1e-9;
constexpr double kFarther = 1.5;  // levels by which a blend must be better for each place its colours are farther away

struct Colour {
  double of[4];
  Colour operator-(const Colour& other) const {
    Colour out;
    for (int c = 0; c < 4; c++) out.of[c] = of[c] - other.of[c];
    return out;
  }
  double dot(const Colour& other) const {
    return of[0] * other.of[0] + of[1] * other.of[1] + of[2] * other.of[2] + of[3] * other.of[3];
  }
  // The largest channel of this less a times one and b times another.
  double off(double a, const Colour& one, double b = 0.0, const Colour& other = {}) const {
    double most = 0.0;
    for (int c = 0; c < 4; c++) most = std::max(most, std::fabs(of[c] - a * one.of[c] - b * other.of[c]));
    return most;
  }
};

template <class Number>
Colour colour(const Number* at) {
  return {{double(at[0]), double(at[1]), double(at[2]), double(at[3])}};
}

struct Blend {
  double share, residual;
};

// A value as a blend of a colour with another one, relative to the latter.
inline Blend between(const Colour& value, const Colour& span) {
  const double share = std::min(std::max(value.dot(span) / std::max(span.dot(span), kTiny), 0.0), 1.0);
  return {share, value.off(share, span)};
}

}  // namespace
}  // namespace cs
