// What outlines cover of pixels, without derivatives; and inks arranged within pixels, as artwork/details/subpixels.py says.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <vector>

#include "abi.h"
#include "stack_trace.h"

namespace cs {
namespace {

constexpr double kTaken = -1e9, kSure = 1e6;  // of scores: of what may not be chosen; of a choice without another

void trace(int64_t pieces, const double* cubics, const uint8_t* lines, Window& window) {
  CsCrossings none{};
  Crossings crossings(&none, 0, 0);
  Tracer tracer(window, crossings, 0);
  for (int64_t n = 0; n < pieces; n++) tracer.piece(int(n), cubics + 8 * n, lines[n] != 0, 1.0);
}

}  // namespace
}  // namespace cs

extern "C" {

// out: height x width, the coverage of a window, its corner at (left, top), by closed outlines of pieces (x 8), of which
// some are lines. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_coverage(int64_t pieces, const double* cubics, const uint8_t* lines, int32_t left, int32_t top,
                              int32_t width, int32_t height, double* out) {
  try {
    cs::Window window{left, top, width, height, {}};
    cs::trace(pieces, cubics, lines, window);
    window.finish(out);
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}

// labels: height x width, brought up to date with that of each layer, back to front, where it covers more than half of a
// pixel. ends: layers, how many pieces there are up to and with each. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_paint_labels(int32_t layers, const int64_t* ends, const uint16_t* label, const double* cubics,
                                  const uint8_t* lines, int32_t width, int32_t height, uint16_t* labels) {
  try {
    std::vector<cs::Span> spans;
    for (int64_t layer = 0, first = 0; layer < layers; first = ends[layer++]) {
      cs::Window window{0, 0, width, height, {}};
      cs::trace(ends[layer] - first, cubics + 8 * first, lines + first, window);
      spans.clear();
      window.finish(spans, true);
      for (const cs::Span& span : spans) {
        uint16_t* row = labels + int64_t(span.row) * width;
        if (span.covered > 0.5f) std::fill(row + span.first, row + span.last, label[layer]);
      }
    }
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}

// Gives each of `places` subpixels of as many pixels one of the inks, those first that would lose most by another one.
// scores: pixels x places x inks; counts: pixels x inks, how many subpixels each ink gets; out: pixels x places.
CS_EXPORT void cs_arrange(int64_t pixels, int64_t places, int64_t inks, const double* scores, const int64_t* counts,
                          int64_t* out) {
  std::vector<int64_t> left(inks);
  for (int64_t pixel = 0; pixel < pixels; pixel++, scores += places * inks, counts += inks, out += places) {
    std::copy(counts, counts + inks, left.begin());
    std::fill(out, out + places, int64_t(-1));
    for (int64_t round = 0; round < places; round++) {
      double most = -1.0;
      int64_t chosen = -1, ink = 0;
      for (int64_t place = 0; place < places; place++) {
        if (out[place] >= 0) continue;
        double first = -INFINITY, second = -INFINITY;
        int64_t best = 0;
        for (int64_t k = 0; k < inks; k++) {
          const double score = left[k] > 0 ? scores[place * inks + k] : cs::kTaken;
          if (score > first) second = first, first = score, best = k;
          else if (score > second) second = score;
        }
        const double regret = std::min(first - (inks > 1 ? second : 0.0), cs::kSure);
        if (chosen < 0 || regret > most) most = regret, chosen = place, ink = best;
      }
      out[chosen] = ink, left[ink]--;
    }
  }
}
}
