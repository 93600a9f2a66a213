// Outlines traced through pixels: what they cover of each, and how that changes with their control points.
//
// A pixel's coverage is its area within the outlines, whose winding number is 0 or 1; where they cross themselves or
// overlap, the size of the sum of its winding numbers, 1 at most, since viewers fill what has any but 0. An edge (dx, dy)
// in a pixel adds the area to its left there and -dy to all pixels to its right; moving it by (u, v) changes its pixel's
// area by u dy - v dx.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "abi.h"
#include "cubic.h"

namespace cs::stack {

// Neighbours of a row that a layer covers alike.
struct Span {
  int first, last;  // columns, the last one not included
  float covered;    // more than nothing
};

// Where a pixel is: in which tile, and where in that.
struct Address {
  int32_t tile, place;
};

// What a layer's outlines cover, and how that changes with their control points. Pictures in which it lies the same share it.
struct Trace {
  std::vector<double> cubics, signs;  // of the pieces
  std::vector<uint8_t> lines;
  int left = 0, top = 0, right = 0, bottom = 0;  // px that it may cover, the last ones not included
  std::vector<Span> spans;                       // row by row from left to right
  std::vector<int64_t> rows;                     // bottom - top + 1: where the spans of each row begin
  std::vector<int64_t> starts{0};                // pieces + 1: where the crossings of each piece begin
  std::vector<int32_t> pixel;                    // of the crossings
  std::vector<Address> address;                  // of their pixels
  std::vector<double> t, change;                 // x 8
  std::vector<int32_t> tiles;                    // that have crossings, in order
  std::vector<int64_t> tile_starts, by_tile;     // the numbers of those of each tile

  int64_t pieces() const { return int64_t(lines.size()); }
};

namespace {

constexpr double kFlatness = 0.001;  // px between a cubic and its polyline
constexpr int kMostEdges = 256;
constexpr float kNothing = 1e-12f;  // coverage that is only the rounding of a sum

inline Point between(Point a, Point b, double t) { return a + (b - a) * t; }

struct Cubic {
  const double* p;

  Point at(int k) const { return {p[2 * k], p[2 * k + 1]}; }
  Point at(double t) const {
    const double s = 1.0 - t, b[4] = {s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t};
    Point q{0.0, 0.0};
    for (int k = 0; k < 4; k++) q = {q.x + b[k] * p[2 * k], q.y + b[k] * p[2 * k + 1]};
    return q;
  }
  // Edges that keep within the flatness: the root of 3/4 |second difference| / flatness.
  int edges() const {
    double bend = 0.0;
    for (int k = 0; k < 4; k++) bend = std::max(bend, std::fabs(p[k] - 2.0 * p[k + 2] + p[k + 4]));
    return std::clamp(int(std::ceil(std::sqrt(0.75 * std::min(bend, 1e6) / kFlatness))), 1, kMostEdges);
  }
};

// Pixels of a row whose winding number is below zero: there an edge changes the coverage the other way.
struct Turned {
  int row, first, last;  // columns, the last one not included

  bool has(int x, int y) const { return y == row && first <= x && x < last; }
};

// Pixels from (left, top) on, and what outlines add to the sums along their rows that become coverages.
struct Window {
  int left, top, width, height;
  struct Edge {
    int row, column;
    double here, beyond;  // what it adds in its column, and in the next one
  };
  std::vector<Edge> edges;  // in the order of the pieces

  // What bounds the area from `x` on along `height` px of a row.
  void add(int row, double x, double height) {
    if (row < top || row >= top + this->height) return;
    const double along = std::clamp(x - left, 0.0, double(width));
    const int column = int(along);
    const double share = x - left < 0.0 ? 0.0 : along - column;
    edges.push_back({row - top, column, height * (1.0 - share), height * share});
  }

  // Adds the coverages to `out`, row by row from left to right, and where sums are below zero to `below`. Sums are taken
  // in the order of the pieces, so that they are the same to the last bit as those over every pixel of the window.
  void finish(std::vector<Span>& out, std::vector<int64_t>& rows, std::vector<Turned>& below) const {
    rows.assign(1, 0);
    std::vector<int64_t> ends(height + 1, 0);
    for (const Edge& edge : edges) ends[edge.row + 1] += 2;
    for (int j = 0; j < height; j++) ends[j + 1] += ends[j];
    std::vector<Step> sorted(2 * edges.size());
    for (size_t n = edges.size(); n-- > 0;) {
      const Edge& edge = edges[n];
      Step* const step = &sorted[ends[edge.row + 1] -= 2];
      step[0] = {edge.column, edge.here}, step[1] = {edge.column + 1, edge.beyond};
    }
    for (int j = 0; j < height; j++) {
      Step* const begin = sorted.data() + ends[j + 1];
      Step* const end = j + 1 < height ? sorted.data() + ends[j + 2] : sorted.data() + sorted.size();
      sort(begin, end);
      double sum = 0.0;
      for (const Step* at = begin; at < end;) {
        const int first = at->column;
        double change = 0.0;
        for (; at < end && at->column == first; at++) change += at->change;
        sum += change;
        const int last = std::min(at < end ? at->column : width, width);
        const float covered = float(std::min(std::fabs(sum), 1.0));
        if (covered <= kNothing || first >= last) continue;
        out.push_back({left + first, left + last, covered});
        if (sum < 0.0) below.push_back({top + j, left + first, left + last});
      }
      rows.push_back(int64_t(out.size()));
    }
  }

  struct Step {
    int column;
    double change;
  };

  // By columns; those in one column stay in their order. A row mostly has few, for which the library would ask for memory.
  static void sort(Step* begin, Step* end) {
    constexpr int64_t kFew = 64;
    const auto before = [](const Step& a, const Step& b) { return a.column < b.column; };
    if (end - begin > kFew) return std::stable_sort(begin, end, before);
    for (Step* at = begin + 1; at < end; at++) {
      const Step step = *at;
      Step* to = at;
      for (; to > begin && before(step, to[-1]); to--) *to = to[-1];
      *to = step;
    }
  }

  // The same of every pixel, height x width.
  void finish(double* out) const {
    std::vector<double> sums(size_t(width + 2) * height, 0.0);
    for (const Edge& edge : edges) {
      double* const sum = &sums[size_t(edge.row) * (width + 2) + edge.column];
      sum[0] += edge.here, sum[1] += edge.beyond;
    }
    for (int j = 0; j < height; j++) {
      double sum = 0.0;
      for (int i = 0; i < width; i++) {
        sum += sums[size_t(j) * (width + 2) + i];
        *out++ = std::min(std::fabs(sum), 1.0);
      }
    }
  }
};

// Collects what the pieces do to the pixels that they cross; on a canvas without pixels nothing.
class Crossings {
 public:
  Crossings(Trace& out, int width, int height) : out_(out), width_(width), height_(height) {}

  // An edge (dx, dy) in pixel (column, row), at parameter t in its middle.
  void add(int column, int row, double t, double dx, double dy) {
    if (column < 0 || row < 0 || column >= width_ || row >= height_) return;
    const int pixel = row * width_ + column;
    if (pixel != pixel_) {
      end();
      pixel_ = pixel, weight_ = moment_ = 0.0;
      std::fill(change_, change_ + 8, 0.0);
    }
    const double s = 1.0 - t, b[4] = {s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t};
    const double length = std::fabs(dx) + std::fabs(dy) + 1e-12;
    weight_ += length, moment_ += length * t;
    for (int k = 0; k < 4; k++) change_[2 * k] += b[k] * dy, change_[2 * k + 1] -= b[k] * dx;
  }

  void end_piece() {
    end();
    out_.starts.push_back(int64_t(out_.pixel.size()));
  }

 private:
  Trace& out_;
  int width_, height_, pixel_ = -1;
  double weight_ = 0.0, moment_ = 0.0, change_[8] = {};

  void end() {
    if (pixel_ >= 0) {
      out_.pixel.push_back(pixel_), out_.t.push_back(moment_ / weight_);
      out_.change.insert(out_.change.end(), change_, change_ + 8);
    }
    pixel_ = -1;
  }
};

// Where a value that runs from a to b next passes a whole number, as a share of the way, and the share between two.
struct Steps {
  double next, step;
  Steps(double a, double b) : next(2.0), step(0.0) {
    if (a == b) return;
    const double first = b > a ? std::floor(a) + 1.0 : std::ceil(a) - 1.0;
    next = (first - a) / (b - a), step = 1.0 / std::fabs(b - a);
  }
  void pass(double at) {
    if (next <= at) next += step;
  }
};

class Tracer {
 public:
  Tracer(Window& window, Crossings& crossings, int grid) : window_(window), crossings_(crossings), grid_(grid) {}

  void piece(const double* points, bool line, double sign) {
    const Cubic cubic{points};
    const int count = line ? 1 : cubic.edges();
    Point from = cubic.at(0);
    for (int i = 0; i < count; i++) {
      const Point to = i + 1 == count ? cubic.at(3) : cubic.at(double(i + 1) / count);
      edge(from, to, double(i) / count, 1.0 / count, sign);
      if (grid_ > 0) samples(from, to, sign);
      from = to;
    }
    crossings_.end_piece();
  }

 private:
  Window& window_;
  Crossings& crossings_;
  int grid_;

  void edge(Point from, Point to, double t, double span, double sign) {
    Steps across(from.x, to.x), down(from.y, to.y);
    double at = 0.0;
    Point start = from;
    while (at < 1.0) {
      const double until = std::min({across.next, down.next, 1.0});
      // The last part ends exactly where the next edge starts, or coverage would leak along rows.
      const Point stop = until >= 1.0 ? to : between(from, to, until);
      const double x = 0.5 * (start.x + stop.x), y = 0.5 * (start.y + stop.y);
      const double dx = sign * (stop.x - start.x), dy = sign * (stop.y - start.y);
      crossings_.add(int(std::floor(x)), int(std::floor(y)), t + span * 0.5 * (at + until), dx, dy);
      if (grid_ == 0) window_.add(int(std::floor(y)), x, -dy);
      start = stop, at = until;
      across.pass(at), down.pass(at);
    }
  }

  // The crossings of the middles of the sub-scanlines, to the nearest sample.
  void samples(Point from, Point to, double sign) {
    const bool falls = to.y > from.y;
    const Point top = falls ? from : to, bottom = falls ? to : from;
    const double slope = (bottom.x - top.x) / (bottom.y - top.y), height = (falls ? -sign : sign) / grid_;
    const double first = std::max(std::ceil(top.y * grid_ - 0.5), double(window_.top) * grid_);
    const double last = std::min(std::ceil(bottom.y * grid_ - 0.5), double(window_.top + window_.height) * grid_);
    for (double line = first; line < last; line += 1.0) {
      const double x = top.x + slope * ((line + 0.5) / grid_ - top.y);
      window_.add(int(std::floor(line / grid_)), std::floor(x * grid_ + 0.5) / grid_, height);
    }
  }
};

}  // namespace
}  // namespace cs::stack
