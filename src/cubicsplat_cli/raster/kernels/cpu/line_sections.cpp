// The lines in a fill between areas of others and their sections, by the shares of pixels: see `line_sections` in
// raster/unmix.py.
#include <cstdint>

#include "abi.h"
#include "colours.h"

namespace cs {
namespace {

struct Line {
  const float* levels;
  const int32_t* areas;
  const double* palette;
  Colour fill;
  double off, part;

  Blend over(int64_t pixel, int64_t area) const {
    const Colour ground = colour(palette + 4 * areas[area]);
    return between(colour(levels + 4 * pixel) - ground, fill - ground);
  }

  // A pixel as a blend of the line with the nearer one of two areas, or the likelier.
  Blend in_section(int64_t pixel, int64_t before, int64_t behind) const {
    if (pixel - before != behind - pixel) return over(pixel, pixel - before < behind - pixel ? before : behind);
    const Blend one = over(pixel, before), other = over(pixel, behind);
    return other.residual < one.residual ? other : one;
  }

  // Adds to the pixels of each section in a row of pixels the sum of its shares, and marks sections of whole pixels.
  void add(int64_t start, int64_t step, int64_t count, float* share, double* sums, uint8_t* whole) const {
    for (int64_t first = 1, end; first < count; first = end + 1) {
      for (end = first; end < count && areas[start + end * step] < 0; end++) {
      }
      const int64_t before = start + (first - 1) * step, behind = start + end * step;
      if (end == first || end == count || areas[before] < 0) continue;
      double sum = 0.0;
      bool told = true;
      for (int64_t at = before + step; at < behind && told; at += step) {
        const Blend found = in_section(at, before, behind);
        told = found.residual <= off;
        sum += found.share;
      }
      if (!told) continue;
      for (int64_t at = before + step; at < behind; at += step) {
        share[at] = float(in_section(at, before, behind).share), sums[at] = sum;
        whole[at] |= sum >= part * double(end - first);
      }
    }
  }
};

}  // namespace
}  // namespace cs

// levels: height x width x 4; areas: height x width, numbers in the palette, -1 elsewhere; line: 4. off: levels by which
// a blend may miss a pixel. share, across, down and whole are 0.
CS_EXPORT void cs_line_sections(int64_t height, int64_t width, const float* levels, const int32_t* areas,
                                const double* palette, const double* line, double off, double part, float* share,
                                double* across, double* down, uint8_t* whole) {
  using namespace cs;
  const Line of{levels, areas, palette, colour(line), off, part};
  for (int64_t y = 0; y < height; y++) of.add(y * width, 1, width, share, across, whole);
  for (int64_t x = 0; x < width; x++) of.add(x, width, height, share, down, whole);
}
