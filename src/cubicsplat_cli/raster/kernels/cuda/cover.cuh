// Coverage of one strip by one curve whose outline is near: a warp's work, one pixel a lane.
#pragma once

#include "arc.h"
#include "area.h"
#include "cull.cuh"

namespace cs {

// A curve as a strip sees it.
struct Outlined {
  const float4* edges;
  const float2* inverses;
  const unsigned* masks;  // edges near the strip
  const float* attributes;
  int words;

  CS_INLINE Edge edge(int number) const {
    const float4 ends = edges[number];
    const float2 inverse = inverses[number];
    return {ends.x, ends.y, ends.z - ends.x, ends.w - ends.y, inverse.x, inverse.y};
  }
};

CS_INLINE Outlined outlined(const Frame& f, const Lists& s, int pair, unsigned curve, int strip) {
  const size_t at = size_t(curve) * f.edge_stride;
  const float* attributes = s.attributes(pair);
  const int words = words_for(int(attributes[kEdges]));
  const int set = int(s.flags()[pair] >> 16) * kStrips + strip * words;
  return {f.edges + at, f.inverses + at, s.masks() + set, attributes, words};
}

// Calls visit(number) for the edges of a set, in their order; the same for all lanes.
template <class Visit>
CS_INLINE void each_edge(const unsigned* set, int words, Visit visit) {
  for (int word = 0; word < words; word++)
    for (unsigned bits = set[word]; bits; bits &= bits - 1) visit(word * kWarp + lowest(bits));
}

// Winding that an edge from y0 to y1 adds to a point on the row at y, (wx, wy) from the edge's start: one where it
// crosses the row at or left of the point, half-open in y. The sign of a cross product stands for the crossing's x,
// which would need a division; the comparisons in y are those of all engines, so no row leaks at a vertex.
CS_INLINE int winding_step(const Edge& e, float y0, float y1, float y, float wx, float wy) {
  const bool starts = y0 <= y, ends = y1 <= y;
  const float side = wx * e.vy - wy * e.vx;
  return (starts && !ends && side >= 0.0f) - (!starts && ends && side <= 0.0f);
}

// What a pixel knows of a curve's outline: the nearest edge within reach (-1: none), and its own side.
struct Found {
  Nearest<float> nearest;
  bool inside;
};

// Winding number at the left side of one of a strip's rows, from the edges that are not near. The bytes are made positive
// before one is taken out, so that none borrows from its neighbour.
CS_INLINE int left_winding(int backdrop, int row) {
  return int((unsigned(backdrop) + 0x80808080u) >> (8 * row) & 0xffu) - 0x80;
}

CS_INLINE Found find(const Outlined& o, int backdrop, int row, float px, float py) {
  const float reach = o.attributes[kReach];
  Nearest<float> best{reach * reach, 0.0f, -1.0f};
  int winding = left_winding(backdrop, row);
  each_edge(o.masks, o.words, [&](int number) {
    const float4 ends = o.edges[number];
    const float2 inverse = o.inverses[number];
    const Edge e{ends.x, ends.y, ends.z - ends.x, ends.w - ends.y, inverse.x, inverse.y};
    const float wx = px - e.ax, wy = py - e.ay;
    nearest_update(best, e, wx, wy, float(number));
    if (kClosed) winding += winding_step(e, ends.y, ends.w, py, wx, wy);
  });
  return {best, winding != 0};
}

// The few bits that bring a Found back without a search.
CS_INLINE unsigned short pack(const Found& found) {
  return (unsigned short)(((int(found.nearest.edge) + 1) << 1) | int(found.inside));
}

CS_INLINE Found unpack(const Outlined& o, unsigned short code, float px, float py) {
  const float reach = o.attributes[kReach];
  Found found{{reach * reach, 0.0f, -1.0f}, (code & 1) != 0};
  const int number = (code >> 1) - 1;
  if (number < 0) return found;
  const Edge e = o.edge(number);
  nearest_update(found.nearest, e, px - e.ax, py - e.ay, float(number));
  return found;
}

CS_INLINE Coverage<float> relaxed_coverage(const Found& found, const Outlined& o) {
  const float support = o.attributes[kSupport];
  if (kClosed) return cover_fill(found.nearest.squared, found.inside, support);
  return cover_stroke(found.nearest.squared, o.attributes[kHalfWidth], support);
}

// The leftmost crossing of the sub-scanline at y that lies after (x, number); false where there is none.
struct Crossed {
  float x;
  int number, direction;
};

CS_INLINE bool next_crossing(const Outlined& o, float y, Crossed& at) {
  Crossed next{kFar, -1, 0};
  each_edge(o.masks, o.words, [&](int number) {
    const float4 e = o.edges[number];
    if ((e.y <= y) == (e.w <= y)) return;
    // Rounded once and so the same each time, for the comparison with the crossing before.
    const float x = fmaf(y - e.y, quotient(e.z - e.x, e.w - e.y), e.x);
    const bool after = x > at.x || (x == at.x && number > at.number);
    if (after && x < next.x) next = {x, number, e.w > e.y ? 1 : -1};
  });
  at = next;
  return next.number >= 0;
}

// A strip as exact coverage sees it: its corner and middle, and the winding numbers at its left side.
struct Strip {
  float x, y, middle;
  int backdrop, lane;
};

// Area of the fill in each pixel of the strip, for any winding: horizontally exact, mean of 16 sub-scanlines a row. The
// eight lanes of a row take two sub-scanlines each over all its pixels, and exchange the sums.
//
// Edges left of the strip show only in the winding number at its left side. That is known at the centre of the row; on
// another line it differs by the ends of near edges between the two, where a chain of left edges begins or ends.
CS_INLINE float sampled_fill(const Outlined& o, const Strip& strip) {
  const int row = strip.lane / kStripWidth, column = strip.lane % kStripWidth;
  const float centre = strip.y + float(row) + 0.5f;
  float area[kStripWidth];
#pragma unroll
  for (int c = 0; c < kStripWidth; c++) area[c] = 0.0f;
#pragma unroll 1
  for (int k = 2 * column; k < 2 * column + 2; k++) {
    const float y = strip.y + float(row) + (float(k) + 0.5f) * (1.0f / kExactRows);
    int winding = left_winding(strip.backdrop, row);
    each_edge(o.masks, o.words, [&](int number) {
      const float4 e = o.edges[number];
      if (e.z < strip.middle) winding += int(e.w <= y) - int(e.w <= centre);
      if (e.x < strip.middle) winding -= int(e.y <= y) - int(e.y <= centre);
    });
    bool covered = winding != 0;
#pragma unroll
    for (int c = 0; c < kStripWidth; c++) area[c] += covered ? 1.0f : 0.0f;
    Crossed at{-kFar, -1, 0};
    while (any(next_crossing(o, y, at))) {
      if (at.number < 0) continue;
      winding += at.direction;
      if ((winding != 0) == covered) continue;
      covered = !covered;
      const float sign = covered ? 1.0f : -1.0f, beyond = strip.x + 1.0f - at.x;
#pragma unroll
      for (int c = 0; c < kStripWidth; c++) area[c] += sign * __saturatef(beyond + float(c));
    }
  }
  return __saturatef(sum_of_row(area, strip.lane) * (1.0f / kExactRows));
}

// Ends and direction of an edge, for ArcTest.
struct Ends {
  float ax, ay, bx, by, vx, vy;
};

// Does the box of the edge touch the pixel?
CS_INLINE bool touches_pixel(const float4& e, float px, float py) {
  return fminf(e.x, e.z) <= px + 0.5f && fmaxf(e.x, e.z) >= px - 0.5f && fminf(e.y, e.w) <= py + 0.5f &&
         fmaxf(e.y, e.w) >= py - 0.5f;
}

// Area of the fill in each pixel of the strip. Where the edges in a pixel form a single arc, the signed area is the area
// up to its sign, exact in x and y: an arc's sides differ by one in their winding numbers, and if neither is outside, the
// signed area is at least one everywhere. The other pixels are sampled.
CS_INLINE float exact_fill(const Outlined& o, const Strip& strip, float px, float py) {
  const float top = py - 0.5f;
  ArcTest test;
  float area = float(left_winding(strip.backdrop, strip.lane / kStripWidth));
  each_edge(o.masks, o.words, [&](int number) {
    const float4 e = o.edges[number];
    const Ends ends{e.x, e.y, e.z, e.w, e.z - e.x, e.w - e.y};
    if (touches_pixel(e, px, py)) test.add(ends);
    const Span<float> span = span_in_row(e.y, e.w, top);
    add_area(area, e.x, e.y, slope_of(ends.vx, ends.vy), span, top, px + 0.5f);
    if (e.x < strip.middle) area += float(e.y <= py) - (1.0f - span.start);
    if (e.z < strip.middle) area += (1.0f - span.end) - float(e.w <= py);
  });
  area = fabsf(area);
  if (area > 1.0f) area = 1.0f;  // not fminf(): what is not a number stays none
  const bool exact = test.none() || test.passed();
  if (all(exact)) return area;
  const float sampled = sampled_fill(o, strip);  // the whole warp's work
  return exact ? area : sampled;
}

// Area of the stroke in each pixel, from sub-samples filtered by a box of their own size. Nearer to the middle line
// or farther from it than the outline's neighbourhood, all sub-samples are full, or empty.
CS_INLINE float exact_stroke(const Outlined& o, const Found& found, float px, float py) {
  constexpr int n = kExactSubsamples;
  constexpr float step = 1.0f / n, margin = 0.84f;  // half a pixel's diagonal and half a sub-sample, rounded up
  const float half_width = o.attributes[kHalfWidth], reach = o.attributes[kReach];
  const float d = square_root(found.nearest.squared);
  const bool mixed = found.nearest.edge >= 0.0f && d < half_width + margin && d > half_width - margin;
  if (!any(mixed)) return d < half_width ? 1.0f : 0.0f;
  float squared[n * n];
#pragma unroll
  for (int i = 0; i < n * n; i++) squared[i] = reach * reach;
  each_edge(o.masks, o.words, [&](int number) {
    const Edge e = o.edge(number);
    const float wx = px - e.ax, wy = py - e.ay;
#pragma unroll
    for (int i = 0; i < n * n; i++) {
      Nearest<float> sample{squared[i], 0.0f, 0.0f};
      nearest_update(sample, e, wx + ((i % n) + 0.5f) * step - 0.5f, wy + ((i / n) + 0.5f) * step - 0.5f, 0.0f);
      squared[i] = sample.squared;
    }
  });
  float area = 0.0f;
#pragma unroll
  for (int i = 0; i < n * n; i++) area += box_stroke(squared[i], half_width);
  return area * (step * step);
}

CS_INLINE float exact_coverage(const Outlined& o, const Found& found, int backdrop, float px, float py, int lane) {
  if (!kClosed) return exact_stroke(o, found, px, py);
  if (!any(found.nearest.edge >= 0.0f)) return found.inside ? 1.0f : 0.0f;
  // (px, py) is the lane's pixel; the strip's corner is that of lane 0.
  const float x = px - 0.5f - float(lane % kStripWidth), y = py - 0.5f - float(lane / kStripWidth);
  return exact_fill(o, {x, y, x + 0.5f * kStripWidth, backdrop, lane}, px, py);
}

}  // namespace cs
