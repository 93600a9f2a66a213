// Stacks of shapes in double precision: their picture, and how it changes with every control point. This is what the
// artwork style optimises.

#include "stack.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <utility>
#include <vector>

#include "stack_misfit.h"
#include "stack_trace.h"

namespace cs {
namespace {

// The part of the canvas that pieces may reach.
Window window_of(const CsStack& s, int first, int last) {
  double low[2] = {1e9, 1e9}, high[2] = {-1e9, -1e9};
  for (const double* p = s.cubics + 8 * int64_t(first); p < s.cubics + 8 * int64_t(last); p += 2)
    for (int c = 0; c < 2; c++) low[c] = std::min(low[c], p[c]), high[c] = std::max(high[c], p[c]);
  const auto bounded = [](double v, int most) { return int(std::clamp(v, 0.0, double(most))); };
  const int left = bounded(std::floor(low[0]), s.width), right = bounded(std::ceil(high[0]), s.width);
  const int top = bounded(std::floor(low[1]), s.height), bottom = bounded(std::ceil(high[1]), s.height);
  return {left, top, std::max(right - left, 0), std::max(bottom - top, 0), {}};
}

// Lays the spans of a layer over the picture.
void lay(const Span* first, const Span* last, const double* ink, int width, double* image) {
  for (const Span* span = first; span < last; span++) {
    double* pixel = image + 4 * (int64_t(span->row) * width + span->first);
    const double share = span->covered, passes = 1.0 - ink[3] * share;
    double add[4];
    for (int k = 0; k < 4; k++) add[k] = share * ink[k];
    for (int i = span->first; i < span->last; i++, pixel += 4)
      for (int k = 0; k < 4; k++) pixel[k] = pixel[k] * passes + add[k];
  }
}

void draw(const CsStack& s, const CsFit& fit, double* image, double* misfit, CsCrossings* out) {
  const int64_t pixels = int64_t(s.width) * s.height;
  std::fill(image, image + 4 * pixels, 0.0);
  Crossings crossings(out, s.width, s.height);
  std::vector<Span> spans;
  std::vector<int64_t> span_ends{0}, ends{0};
  for (int layer = 0, piece = 0; layer < s.layers; layer++) {
    Window w = window_of(s, piece, s.ends[layer]);
    Tracer tracer(w, crossings, s.grid);
    for (; piece < s.ends[layer]; piece++)
      tracer.piece(piece, s.cubics + 8 * int64_t(piece), s.lines[piece] != 0, s.signs[piece]);
    const double* ink = s.inks + 4 * layer;
    for (int64_t n = std::min(ends.back(), out->room); n < std::min(out->count, out->room); n++)
      for (int k = 0; k < 4; k++) out->slope[4 * n + k] = ink[k] - ink[3] * image[4 * int64_t(out->pixel[n]) + k];
    w.finish(spans);
    lay(spans.data() + span_ends.back(), spans.data() + spans.size(), ink, s.width, image);
    span_ends.push_back(int64_t(spans.size()));
    ends.push_back(out->count);
  }
  if (out->count > out->room) return;
  std::vector<float> open(pixels, 1.0f);
  for (int layer = s.layers - 1; layer >= 0; layer--) {
    for (int64_t n = ends[layer]; n < ends[layer + 1]; n++)
      for (int k = 0; k < 4; k++) out->slope[4 * n + k] *= open[out->pixel[n]];
    const float opacity = float(s.inks[4 * layer + 3]);
    for (int64_t n = span_ends[layer]; n < span_ends[layer + 1]; n++) {
      float* row = open.data() + int64_t(spans[n].row) * s.width;
      const float passes = 1.0f - opacity * spans[n].covered;
      for (int i = spans[n].first; i < spans[n].last; i++) row[i] *= passes;
    }
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
