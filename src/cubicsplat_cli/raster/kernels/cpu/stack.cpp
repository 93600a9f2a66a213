// Stacks of shapes in double precision: their picture, and how it changes with every control point. This is what the
// artwork style optimises.
//
// A pixel's coverage is its area within the outlines, whose winding number is 0 or 1. An edge (dx, dy) in a pixel adds the
// area to its left there and -dy to all pixels to its right; moving it by (u, v) changes its pixel's area by u dy - v dx.

#include "stack.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <vector>

#include "stack_misfit.h"

namespace cs {
namespace {

constexpr double kFlatness = 0.001;  // px between a cubic and its polyline
constexpr int kMostEdges = 256;

struct Point {
  double x, y;
};

Point between(Point a, Point b, double t) { return {a.x + (b.x - a.x) * t, a.y + (b.y - a.y) * t}; }

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

// Pixels from (left, top) on, and the sums along their rows that become coverages.
struct Window {
  int left, top, width, height;
  std::vector<double> sums;    // height x (width + 2)
  std::vector<float> covered;  // height x width

  // What bounds the area from `x` on along `height` px of a row.
  void add(int row, double x, double height) {
    if (row < top || row >= top + this->height) return;
    const double along = std::clamp(x - left, 0.0, double(width));
    const int column = int(along);
    const double share = x - left < 0.0 ? 0.0 : along - column;
    double* at = &sums[size_t(row - top) * (width + 2) + column];
    at[0] += height * (1.0 - share);
    at[1] += height * share;
  }

  void finish() {
    covered.resize(size_t(width) * height);
    for (int j = 0; j < height; j++) {
      double sum = 0.0;
      for (int i = 0; i < width; i++) {
        sum += sums[size_t(j) * (width + 2) + i];
        covered[size_t(j) * width + i] = float(std::clamp(sum, 0.0, 1.0));
      }
    }
    std::vector<double>().swap(sums);
  }
};

// Collects what the pieces do to the pixels that they cross.
class Crossings {
 public:
  Crossings(CsCrossings* out, int width, int height) : out_(out), width_(width), height_(height) { out_->count = 0; }

  void begin(int piece) { piece_ = piece, pixel_ = -1; }

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

  void end() {
    if (pixel_ >= 0) {
      const int64_t n = out_->count++;
      if (n < out_->room) {
        out_->piece[n] = piece_, out_->pixel[n] = pixel_, out_->t[n] = moment_ / weight_;
        std::copy(change_, change_ + 8, out_->change + 8 * n);
      }
    }
    pixel_ = -1;
  }

 private:
  CsCrossings* out_;
  int width_, height_, piece_ = 0, pixel_ = -1;
  double weight_ = 0.0, moment_ = 0.0, change_[8] = {};
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

  void piece(int number, const double* points, bool line, double sign) {
    const Cubic cubic{points};
    const int count = line ? 1 : cubic.edges();
    crossings_.begin(number);
    Point from = cubic.at(0);
    for (int i = 0; i < count; i++) {
      const Point to = i + 1 == count ? cubic.at(3) : cubic.at(double(i + 1) / count);
      edge(from, to, double(i) / count, 1.0 / count, sign);
      if (grid_ > 0) samples(from, to, sign);
      from = to;
    }
    crossings_.end();
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

// The part of the canvas that pieces may reach.
Window window_of(const CsStack& s, int first, int last) {
  double low[2] = {1e9, 1e9}, high[2] = {-1e9, -1e9};
  for (const double* p = s.cubics + 8 * int64_t(first); p < s.cubics + 8 * int64_t(last); p += 2)
    for (int c = 0; c < 2; c++) low[c] = std::min(low[c], p[c]), high[c] = std::max(high[c], p[c]);
  const auto bounded = [](double v, int most) { return int(std::clamp(v, 0.0, double(most))); };
  const int left = bounded(std::floor(low[0]), s.width), right = bounded(std::ceil(high[0]), s.width);
  const int top = bounded(std::floor(low[1]), s.height), bottom = bounded(std::ceil(high[1]), s.height);
  Window w{left, top, std::max(right - left, 0), std::max(bottom - top, 0), {}, {}};
  w.sums.assign(size_t(w.height) * (w.width + 2), 0.0);
  return w;
}

// Lays a layer over the picture, and notes at its crossings what more of it would change.
void lay(const Window& w, const double* ink, int width, double* image, CsCrossings* c, int64_t first, int64_t last) {
  for (int64_t n = first; n < last; n++)
    for (int k = 0; k < 4; k++) c->slope[4 * n + k] = ink[k] - ink[3] * image[4 * int64_t(c->pixel[n]) + k];
  for (int j = 0; j < w.height; j++) {
    double* pixel = image + 4 * (int64_t(w.top + j) * width + w.left);
    const float* covered = &w.covered[size_t(j) * w.width];
    for (int i = 0; i < w.width; i++, pixel += 4) {
      if (covered[i] == 0.0f) continue;
      const double share = covered[i], passes = 1.0 - ink[3] * share;
      for (int k = 0; k < 4; k++) pixel[k] = pixel[k] * passes + share * ink[k];
    }
  }
}

void draw(const CsStack& s, const CsFit& fit, double* image, double* misfit, CsCrossings* out) {
  const int64_t pixels = int64_t(s.width) * s.height;
  std::fill(image, image + 4 * pixels, 0.0);
  Crossings crossings(out, s.width, s.height);
  std::vector<Window> windows;
  std::vector<int64_t> ends;
  for (int layer = 0, piece = 0; layer < s.layers; layer++) {
    const int64_t first = out->count;
    Window w = window_of(s, piece, s.ends[layer]);
    Tracer tracer(w, crossings, s.grid);
    for (; piece < s.ends[layer]; piece++)
      tracer.piece(piece, s.cubics + 8 * int64_t(piece), s.lines[piece] != 0, s.signs[piece]);
    w.finish();
    lay(w, s.inks + 4 * layer, s.width, image, out, std::min(first, out->room), std::min(out->count, out->room));
    windows.push_back(std::move(w));
    ends.push_back(out->count);
  }
  if (out->count > out->room) return;
  std::vector<float> open(pixels, 1.0f);
  for (int layer = s.layers - 1; layer >= 0; layer--) {
    for (int64_t n = layer ? ends[layer - 1] : 0; n < ends[layer]; n++)
      for (int k = 0; k < 4; k++) out->slope[4 * n + k] *= open[out->pixel[n]];
    const Window& w = windows[layer];
    const float opacity = float(s.inks[4 * layer + 3]);
    for (int j = 0; j < w.height; j++)
      for (int i = 0; i < w.width; i++)
        open[int64_t(w.top + j) * s.width + w.left + i] *= 1.0f - opacity * w.covered[size_t(j) * w.width + i];
  }
  if (fit.reach > 0) blur(fit, image, s.width, s.height, false);
  double rest[4];
  for (int64_t pixel = 0; pixel < pixels; pixel++) {
    const double size = residual(fit, image, pixel, rest);
    misfit[pixel] = size <= fit.bound ? size * size : fit.bound * (2.0 * size - fit.bound);
  }
}

}  // namespace
}  // namespace cs

extern "C" {

int32_t cs_stack_draw(const CsStack* stack, const CsFit* fit, double* image, double* misfit, CsCrossings* out) {
  try {
    cs::draw(*stack, *fit, image, misfit, out);
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}
}
