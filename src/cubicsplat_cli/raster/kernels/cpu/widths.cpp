// Which shapes may be pen strokes, by their widths along the outline alone. raster/strokes.py says what the function
// means.
//
// The width at a point of the outline is the diameter of the largest disc inside that touches it there (J. Ma, S. W. Bae
// and S. Choi, "3D Medial Axis Point Approximation Using Nearest Neighbors and the Normal Field", 2012).
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "abi.h"
#include "cubic.h"

namespace cs {
namespace {

constexpr double kCorner = 0.93969262078590838;  // cosine of 20 degrees, from which a joint is a corner
constexpr double kNearEnd = 1e-3;                // parameter of a cubic near an end where it has a direction
constexpr double kStepsAcross = 4.0;             // points of an outline over a width of it
constexpr double kWidest = 4.0;                  // mean widths, up to which discs grow
constexpr double kLeastStep = 0.25;              // px

struct Sample {
  Point at, inward;
  double length;  // px of the outline that it stands for
  int64_t ring;
};

struct Outlines {
  const double* cubics;  // (pieces, 4, 2)
  int64_t rings;
  const int64_t* ends;  // of the pieces of each ring; the first ring is the outer one
};

double length(const double* p) {
  double out = 0.0;
  for (int k = 0; k < 6; k += 2) out += std::hypot(p[k + 2] - p[k], p[k + 3] - p[k + 1]);
  return out;
}

Point way(const double* p, double u) {
  const Point first = Place(p, u).first;
  return first / std::max(first.length(), kStill);
}

struct Measured {
  std::vector<Sample> samples;
  double width = 0.0, around = 0.0;  // px: twice the area over the length, and that
  int64_t corners = 0;

  explicit Measured(const Outlines& shape) {
    std::vector<double> signs;
    double whole = 0.0;
    for (int64_t ring = 0, n = 0; ring < shape.rings; ring++) {
      double own = 0.0;
      for (; n < shape.ends[ring]; n++)
        own += swept(shape.cubics + 8 * n) / 20.0, around += length(shape.cubics + 8 * n);
      signs.push_back((own > 0.0) == (ring == 0) ? 1.0 : -1.0);
      whole += signs.back() * own;
    }
    width = 2.0 * whole / std::max(around, kLeast);
    if (!(width > 0.0)) return;
    const double step = std::max(width / kStepsAcross, kLeastStep);
    for (int64_t ring = 0, first = 0; ring < shape.rings; first = shape.ends[ring++])
      for (int64_t n = first; n < shape.ends[ring]; n++) {
        const double *p = shape.cubics + 8 * n, *next = shape.cubics + 8 * (n + 1 < shape.ends[ring] ? n + 1 : first);
        const Point out = way(p, 1.0 - kNearEnd), in = way(next, kNearEnd);
        corners += dot(out, in) < kCorner;
        const double px = length(p);
        const int64_t count = std::max<int64_t>(1, int64_t(std::ceil(px / step)));
        for (int64_t k = 0; k < count; k++) {
          const double u = (double(k) + 0.5) / double(count);
          const Point along = way(p, u);
          const Point inward{-along.y * signs[ring], along.x * signs[ring]};
          samples.push_back({Place(p, u).at, inward, px / double(count), ring});
        }
      }
    // By x, so that what is near is found from neighbour to neighbour.
    std::stable_sort(samples.begin(), samples.end(), [](const Sample& a, const Sample& b) { return a.at.x < b.at.x; });
  }

  double width_at(int64_t i) const {
    const Sample& own = samples[i];
    double best = kWidest * width;
    const auto narrower = [&](const Sample& other) {
      const double x = other.at.x - own.at.x, y = other.at.y - own.at.y;
      if (std::fabs(x) > best) return false;
      const double ahead = x * own.inward.x + y * own.inward.y, square = x * x + y * y;
      if (square < best * ahead) best = square / ahead;
      return true;
    };
    for (int64_t k = i - 1; k >= 0 && narrower(samples[k]);) k--;
    for (int64_t k = i + 1; k < int64_t(samples.size()) && narrower(samples[k]);) k++;
    return best;
  }
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + int64_t(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double even_width(const Outlines& shape, double share, double px, double beside) {
  const Measured outline(shape);
  if (outline.samples.empty()) return 0.0;
  std::vector<double> widths(outline.samples.size());
  for (size_t i = 0; i < widths.size(); i++) widths[i] = outline.width_at(int64_t(i));
  const double usual = median(widths);
  double uneven = 0.0;
  for (size_t i = 0; i < widths.size(); i++)
    if (std::fabs(widths[i] - usual) > share * usual + px) uneven += outline.samples[i].length;
  return uneven <= std::max((double(outline.corners) + beside) * usual, share * outline.around) ? usual : 0.0;
}

// Of each ring the usual width along it, and the share of its length that is even.
void ring_widths(const Outlines& shape, double share, double px, double* usual, double* even) {
  const Measured outline(shape);
  std::vector<std::vector<std::pair<double, double>>> found(shape.rings);  // widths, and for what lengths
  for (size_t i = 0; i < outline.samples.size(); i++) {
    const Sample& sample = outline.samples[i];
    found[sample.ring].emplace_back(outline.width_at(int64_t(i)), sample.length);
  }
  for (int64_t ring = 0; ring < shape.rings; ring++) {
    usual[ring] = even[ring] = 0.0;
    if (found[ring].empty()) continue;
    std::vector<double> widths;
    for (const auto& each : found[ring]) widths.push_back(each.first);
    usual[ring] = median(std::move(widths));
    double around = 0.0;
    for (const auto& [width, length] : found[ring]) {
      around += length;
      if (std::fabs(width - usual[ring]) <= share * usual[ring] + px) even[ring] += length;
    }
    even[ring] /= around;
  }
}
}  // namespace
}  // namespace cs

using namespace cs;

extern "C" {
// shape_ends: of the rings of each shape; out: its usual width, 0 where it is of no one width. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_even_widths(int64_t shapes, const int64_t* shape_ends, const int64_t* ring_ends,
                                 const double* cubics, double share, double px, double beside, double* out) {
  return failed([&] {
    std::vector<int64_t> ends;
    for (int64_t shape = 0, first = 0; shape < shapes; first = shape_ends[shape++]) {
      const int64_t begin = first ? ring_ends[first - 1] : 0;
      ends.assign(ring_ends + first, ring_ends + shape_ends[shape]);
      for (int64_t& end : ends) end -= begin;
      out[shape] = even_width({cubics + 8 * begin, int64_t(ends.size()), ends.data()}, share, px, beside);
    }
  });
}

// Of one shape: (rings,) the usual width along each ring, and the share of that which has it. Returns 0, or 1 without
// memory.
CS_EXPORT int32_t cs_ring_widths(int64_t rings, const int64_t* ring_ends, const double* cubics, double share, double px,
                                 double* usual, double* even) {
  return failed([&] { ring_widths({cubics, rings, ring_ends}, share, px, usual, even); });
}
}
