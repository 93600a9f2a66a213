// Cracks, the unit edges between pixels, the closed loops of them around masks and regions, which run with these on their
// right, so that outer loops are clockwise as seen (y grows downwards) and holes the other way; and where borders run
// across them.
#pragma once

#include <cstdint>
#include <vector>

namespace cs {

// East, south, west, north; and the pixels to the right and left of a crack from vertex (x, y), relative to it.
constexpr int kStep[4][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
constexpr int kRight[4][2] = {{0, 0}, {-1, 0}, {-1, -1}, {0, -1}};
constexpr int kLeft[4][2] = {{0, -1}, {0, 0}, {-1, 0}, {-1, -1}};

struct Crack {
  int64_t x, y;
  int d;
  double middle(int axis) const { return double(axis == 0 ? x : y) + 0.5 * kStep[d][axis]; }
};

// Adds the cracks of the loop around what is `inside`, with that on their right, from the upper left vertex of a pixel that
// has nothing of it above. seen: which pixels, `width` a row, have had their upper crack in a loop.
template <class Inside>
void follow(const Inside& inside, int64_t left, int64_t top, int64_t width, std::vector<uint8_t>& seen,
            std::vector<Crack>& cracks) {
  int64_t x = left, y = top;
  int d = 0;
  do {
    if (d == 0) seen[y * width + x] = 1;
    cracks.push_back({x, y, d});
    x += kStep[d][0], y += kStep[d][1];
    // Right where it ends ahead, else straight, else left.
    if (!inside(x + kRight[d][0], y + kRight[d][1]))
      d = (d + 1) % 4;
    else if (inside(x + kLeft[d][0], y + kLeft[d][1]))
      d = (d + 3) % 4;
  } while (x != left || y != top || d != 0);
}

// Twice the px^2 that a loop encloses, below 0 for a hole.
inline int64_t twice_enclosed(const Crack* first, const Crack* end) {
  int64_t twice = 0;
  for (const Crack* c = first; c < end; c++) twice += c->x * kStep[c->d][1] - c->y * kStep[c->d][0];
  return twice;
}

// Where borders run across the cracks of a picture: `EdgePositions` in raster/outlines.py.
struct Positions {
  const double *rows, *row_sigma, *columns, *column_sigma;
  int64_t height, width;
  double rim;
};

struct EdgePoint {
  double x, y, sigma;
  int64_t crack;
};

// Adds the points along a closed loop: see `contours_of` in raster/outlines.py.
void add_points(const Crack* loop, int64_t count, const Positions& at, std::vector<EdgePoint>& out);

}  // namespace cs
