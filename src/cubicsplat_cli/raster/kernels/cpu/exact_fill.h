// Exact area coverage of fills.
#pragma once

#include "../shared/area.h"
#include "gather.h"

namespace cs {
namespace CS_ISA {

CS_INLINE Lanes left_windings(const Outline& o, const Block& b) {
  const int n = b.number;
  return repeat_each(o.winding[0][n], o.winding[1][n], o.winding[2][n], o.winding[3][n]);
}

// Where edges cross the sub-scanlines of one pixel row, one sub-scanline a lane: crossings sorted by x.
struct SubRows {
  Lanes* x;
  Lanes* direction;
  int count = 0;
  Lanes left;  // winding number at the block's left side

  CS_INLINE void insert(Lanes at, Lanes towards) {
    for (int i = 0; i < count; i++) {
      const Mask before = at < x[i];
      const Lanes later = select(before, x[i], at), later_direction = select(before, direction[i], towards);
      x[i] = minimum(x[i], at);
      direction[i] = select(before, towards, direction[i]);
      at = later;
      towards = later_direction;
    }
    x[count] = at;
    direction[count++] = towards;
  }
};

// The sub-scanlines of row j of a block.
//
// Edges left of the block show only in the winding number at its left side. That is known at the centre of the row; on
// another line it differs by the ends of near edges between the two, where a chain of left edges begins or ends.
CS_INLINE SubRows cross_row(const Outline& o, const Block& b, int j) {
  const float top = b.top + float(j), bottom = top + 1.0f, centre = top + 0.5f, middle = b.left + 0.5f * kBlock;
  const Lanes y = fused(lane_numbers(), Lanes(1.0f / kExactRows), Lanes(top + 0.5f / kExactRows));
  const Lanes one(1.0f), zero(0.0f);
  SubRows s{o.crossings, o.crossings + o.pair->edge_count, 0, Lanes(o.winding[j][b.number])};
  o.each_near(b, [&](uint32_t, const TileEdge& e) {
    if ((e.ay <= top && e.by <= top) || (e.ay > bottom && e.by > bottom)) return;
    const Lanes starts = select(Lanes(e.ay) <= y, one, zero), ends = select(Lanes(e.by) <= y, one, zero);
    if (e.bx < middle) s.left = s.left + ends - Lanes(e.by <= centre ? 1.0f : 0.0f);
    if (e.ax < middle) s.left = s.left - starts + Lanes(e.ay <= centre ? 1.0f : 0.0f);
    const Mask crosses = starts != ends;
    if (!any(crosses)) return;
    const Lanes x = fused(y - Lanes(e.ay), Lanes((e.bx - e.ax) / (e.by - e.ay)), Lanes(e.ax - b.left));
    s.insert(select(crosses, x, Lanes(float(kTile))), starts - ends);
  });
  return s;
}

// Sum over the sub-scanlines of the length, in each pixel of the row, of where the winding number is not zero.
CS_INLINE Four covered_lengths(const SubRows& s) {
  const auto inside = [](Lanes number) { return select(number != Lanes(0.0f), Lanes(1.0f), Lanes(0.0f)); };
  Lanes number = s.left, before = inside(number), sums[kBlock] = {before, before, before, before};
  for (int i = 0; i < s.count; i++) {
    number = number + s.direction[i];
    const Lanes after = inside(number), change = after - before;
    for (int c = 0; c < kBlock; c++) {
      const Lanes beyond = minimum(maximum(Lanes(float(c + 1)) - s.x[i], Lanes(0.0f)), Lanes(1.0f));
      sums[c] = fused(change, beyond, sums[c]);
    }
    before = after;
  }
  return sum_of_four(sums[0], sums[1], sums[2], sums[3]);
}

// Area by sub-scanlines, for any winding: horizontally exact, mean of 16 lines a row.
inline Lanes sampled_fill(const Outline& o, const Block& b) {
  float area[kLanes];
  for (int j = 0; j < kBlock; j++) {
    const Four lengths = covered_lengths(cross_row(o, b, j));
    for (int c = 0; c < kBlock; c++) area[j * kBlock + c] = lengths.v[c];
  }
  const Lanes mean = Lanes::load(area) * Lanes(1.0f / kExactRows);
  return minimum(maximum(mean, Lanes(0.0f)), Lanes(1.0f));
}

// Signed area: for each pixel the integral of the winding number over it, exact in x and y.
//
// An edge adds what lies right of it, clipped to the pixel's row. The rows' winding numbers at the left side stand for
// the edges left of the block, as in sampled_fill.
CS_INLINE Lanes signed_area(const Outline& o, const Block& b) {
  const float middle = b.left + 0.5f * kBlock;
  const Lanes top = b.py - Lanes(0.5f), right = b.px + Lanes(0.5f), zero(0.0f), one(1.0f);
  Lanes area = left_windings(o, b);
  o.each_near(b, [&](uint32_t, const TileEdge& e) {
    const Span<Lanes> span = span_in_row(e.ay, e.by, top);
    add_area(area, e.ax, e.ay, slope_of(e.vx, e.vy), span, top, right);
    if (e.ax < middle) area = area - (one - span.start) + select(Lanes(e.ay) <= b.py, one, zero);
    if (e.bx < middle) area = area + (one - span.end) - select(Lanes(e.by) <= b.py, one, zero);
  });
  return area;
}

// Area in each pixel of a block. A single arc has but two sides, whose winding numbers differ by one: if one of them is
// outside, the signed area is the area up to its sign, else it is at least one everywhere.
CS_INLINE Lanes exact_fill(const Outline& o, const Block& b) {
  bool arc = o.arc;
  if (!arc) {
    ArcTest test;
    o.each_near(b, [&](uint32_t, const TileEdge& e) { test.add(e); });
    arc = test.passed();
  }
  if (arc) return minimum(absolute(signed_area(o, b)), Lanes(1.0f));
  return sampled_fill(o, b);
}

}  // namespace CS_ISA
}  // namespace cs
