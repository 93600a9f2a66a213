// What outlines cover of pixels, without derivatives.
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#include "abi.h"
#include "stack_trace.h"

namespace cs::stack {
namespace {

void trace(int64_t pieces, const double* cubics, const uint8_t* lines, Window& window) {
  Trace none;
  Crossings crossings(none, 0, 0);
  Tracer tracer(window, crossings, 0);
  for (int64_t n = 0; n < pieces; n++) tracer.piece(cubics + 8 * n, lines[n] != 0, 1.0);
}

// Rows and columns, those at the ends not included.
struct Box {
  int64_t top, left, bottom, right;

  bool has(int64_t y, int64_t x) const { return y >= top && y < bottom && x >= left && x < right; }
  int64_t place(int64_t y, int64_t x) const { return (y - top) * (right - left) + x - left; }
};

// Calls `found(place)` for the places from `first` to `last` at which a row has a byte.
template <class Found>
void each_byte(const uint8_t* row, int64_t first, int64_t last, int byte, const Found& found) {
  while (first < last) {
    const void* at = std::memchr(row + first, byte, size_t(last - first));
    if (!at) return;
    first = static_cast<const uint8_t*>(at) - row;
    found(first++);
  }
}

}  // namespace
}  // namespace cs::stack

extern "C" {

// out: height x width, the coverage of a window, its corner at (left, top), by closed outlines of pieces (x 8), of which
// some are lines. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_coverage(int64_t pieces, const double* cubics, const uint8_t* lines, int64_t left, int64_t top,
                              int64_t width, int64_t height, double* out) {
  return cs::failed([&] {
    cs::stack::Window window{int(left), int(top), int(width), int(height), {}};
    cs::stack::trace(pieces, cubics, lines, window);
    window.finish(out);
  });
}

// The middles, x and y, of the pixels of a window that closed outlines enclose by more than half, though they may not,
// or do not enclose, though they must, row by row. may: height x width of the window, its corner at (left, top). box:
// top, left, bottom and right, in the window, of must and besides, what else they may enclose there, or null. out: room
// for all pixels of the window. Returns how many, or -1 without memory.
CS_EXPORT int64_t cs_misplaced(int64_t pieces, const double* cubics, const uint8_t* lines, int64_t left, int64_t top,
                               int64_t height, int64_t width, const uint8_t* may, const int64_t* box,
                               const uint8_t* must, const uint8_t* besides, double* out) {
  return cs::counted([&] {
    const cs::stack::Box needed{box[0], box[1], box[2], box[3]};
    cs::stack::Window window{int(left), int(top), int(width), int(height), {}};
    cs::stack::trace(pieces, cubics, lines, window);
    std::vector<cs::stack::Span> spans;
    std::vector<int64_t> rows;
    std::vector<cs::stack::Turned> below;
    window.finish(spans, rows, below);
    int64_t count = 0;
    const auto add = [&](int64_t y, int64_t x) {
      out[2 * count] = double(left + x) + 0.5, out[2 * count + 1] = double(top + y) + 0.5;
      count++;
    };
    // Masks are of bytes 0 and 1.
    const auto missed = [&](int64_t y, int64_t first, int64_t last) {
      first = std::max(first, needed.left), last = std::min(last, needed.right);
      if (y < needed.top || y >= needed.bottom || first >= last) return;
      const uint8_t* row = must + needed.place(y, needed.left) - needed.left;
      cs::stack::each_byte(row, first, last, 1, [&](int64_t x) { add(y, x); });
    };
    const auto enclosed = [&](int64_t y, int64_t first, int64_t last) {
      cs::stack::each_byte(may + y * width, first, last, 0, [&](int64_t x) {
        if (!(besides && needed.has(y, x) && besides[needed.place(y, x)])) add(y, x);
      });
    };
    for (int64_t y = 0; y < height; y++) {
      int64_t x = 0;
      for (int64_t n = rows[y]; n < rows[y + 1]; n++) {
        if (spans[n].covered <= 0.5f) continue;
        missed(y, x, spans[n].first - left), enclosed(y, spans[n].first - left, spans[n].last - left);
        x = spans[n].last - left;
      }
      missed(y, x, width);
    }
    return count;
  });
}
}
