// What outlines cover of pixels, without derivatives.
#include <cstdint>

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
}
