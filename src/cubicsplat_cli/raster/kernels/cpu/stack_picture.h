// A stack as it is drawn: what its layers cover, and the picture in square tiles. Pictures of stacks that differ little
// share the rest of both.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "stack.h"
#include "stack_trace.h"

namespace cs::stack {

constexpr int kTile = 16;  // px a side

// RGBA of the pixels of a tile, row by row; those beyond the canvas are zero.
using Colours = std::array<double, 4 * kTile * kTile>;

struct Tile {
  std::shared_ptr<const Colours> sharp, seen;  // before and after the goal's blur: the same without one
  std::array<double, kTile * kTile> misfit{};
  double cost = 0.0;  // the sum of the misfit and of the leaks
};

// The residual of a pixel, each channel weighted, and the square of its length.
inline double residual(const CsGoal& goal, const double* colour, int64_t pixel, double* rest) {
  double squares = 0.0;
  for (int k = 0; k < 4; k++) {
    rest[k] = (colour[k] - goal.target[4 * pixel + k]) * goal.channels[k];
    squares += rest[k] * rest[k];
  }
  return squares;
}

// The misfit of a pixel by the square of its residual: linear beyond the bound, and steep where it is on the wrong side of
// an edge without anti-aliasing.
inline double misfit(const CsGoal& goal, int64_t pixel, double squares) {
  const double within = squares <= goal.bound * goal.bound ? squares
                                                           : goal.bound * (2.0 * std::sqrt(squares) - goal.bound);
  if (!goal.half) return within;
  const double beyond = std::clamp(std::sqrt(squares) - goal.half[pixel], 0.0, goal.half[pixel]);
  return within + goal.steep * beyond * beyond;
}

// The derivative of the misfit by that square: how much a pixel counts in least squares.
inline double trust(const CsGoal& goal, int64_t pixel, double squares) {
  const double within = squares <= goal.bound * goal.bound ? 1.0 : goal.bound / std::sqrt(squares);
  if (!goal.half) return within;
  const double off = std::sqrt(squares), half = goal.half[pixel];
  return half < off && off < 2.0 * half ? within + goal.steep * (off - half) / off : within;
}

// The share of the background that shows in a pixel where it may not.
inline double leak(const CsGoal& goal, const double* colour, int64_t pixel) {
  constexpr double kShows = 1e-6;
  const double share = goal.opaque != nullptr && goal.opaque[pixel] ? 1.0 - colour[3] : 0.0;
  return share > kShows ? share : 0.0;
}

}  // namespace cs::stack

struct CsPicture {
  CsGoal goal;
  std::vector<double> fills;    // layers x 4
  std::vector<int32_t> starts;  // layers + 1: the first piece of each; those of a base have none
  std::vector<int32_t> own;     // the layers that are not the base's
  const CsPicture* base;
  std::vector<std::shared_ptr<const cs::stack::Trace>> layers;
  std::vector<std::shared_ptr<const cs::stack::Tile>> tiles;

  int across() const { return (goal.width + cs::stack::kTile - 1) / cs::stack::kTile; }
  int down() const { return (goal.height + cs::stack::kTile - 1) / cs::stack::kTile; }
  cs::stack::Address at(int x, int y) const {
    constexpr int kTile = cs::stack::kTile;
    return {y / kTile * across() + x / kTile, y % kTile * kTile + x % kTile};
  }
};

namespace cs::stack {

// Calls `call(pixel, address)` for the pixels that a piece crosses, some of them twice.
template <class Call>
void each_pixel(const CsPicture& picture, int32_t piece, Call call) {
  const auto next = std::upper_bound(picture.starts.begin(), picture.starts.end(), piece);
  const int64_t layer = next - picture.starts.begin() - 1, own = piece - picture.starts[layer];
  const Trace& trace = *picture.layers[layer];
  for (int64_t n = trace.starts[own]; n < trace.starts[own + 1]; n++) call(trace.pixel[n], trace.address[n]);
}

// By how much the sharp picture changes with the coverage at each crossing of some layers (x 4), layer by layer.
std::vector<std::vector<double>> slopes(const CsPicture& picture, const std::vector<uint8_t>& wanted);

}  // namespace cs::stack
