// Exact area coverage of strokes.
#pragma once

#include "gather.h"

namespace cs {
namespace CS_ISA {

// How far sub-samples lie from their pixel's centre, rounded up, and how wide the boxes around them are.
constexpr float kSampleRadius = 0.5304f;
constexpr float kSampleBox = 1.0f / kExactSubsamples;

// Squared distance from points (x, y) to an edge. x and y count from its start.
CS_INLINE Lanes squared_distance(const TileEdge& e, Lanes x, Lanes y) {
  const Lanes t = minimum(maximum(fused(x, Lanes(e.ux), y * Lanes(e.uy)), Lanes(0.0f)), Lanes(1.0f));
  const Lanes dx = fused(t, Lanes(-e.vx), x), dy = fused(t, Lanes(-e.vy), y);
  return fused(dx, dx, dy * dy);
}

// The least squared distances of a block's sub-samples, from the edges that can be nearest to one of a mixed pixel: no
// sub-sample is nearer to an edge that lies farther from the centre by twice its own distance from there.
CS_INLINE void search_samples(const Outline& o, const Block& b, Lanes d, Mask mixed,
                              Lanes (&squared)[kExactSubsamples][kExactSubsamples]) {
  const Lanes limit = d + Lanes(2.0f * kSampleRadius), squared_limit = limit * limit;
  o.each_near(b, [&](uint32_t, const TileEdge& e) {
    const Lanes x = b.px - Lanes(e.ax), y = b.py - Lanes(e.ay);
    if (!any(mixed & (squared_distance(e, x, y) < squared_limit))) return;
    for (int j = 0; j < kExactSubsamples; j++)
      for (int i = 0; i < kExactSubsamples; i++) {
        const Lanes right((float(i) + 0.5f) * kSampleBox - 0.5f), down((float(j) + 0.5f) * kSampleBox - 0.5f);
        squared[j][i] = minimum(squared[j][i], squared_distance(e, x + right, y + down));
      }
  });
}

// Area of the stroke in each pixel of a block, from sub-samples filtered by a box of their own size. squared: that of the
// distance from the pixels' centres to the polyline.
CS_INLINE Lanes exact_stroke(const Outline& o, const Block& b, Lanes squared) {
  const float r = o.primitive->half_width, margin = kSampleRadius + 0.5f * kSampleBox, reach = o.primitive->reach;
  const Lanes d = square_root(squared), whole = select(d < Lanes(r), Lanes(1.0f), Lanes(0.0f));
  const Mask mixed = (d < Lanes(r + margin)) & (d > Lanes(r - margin));
  if (!any(mixed)) return whole;
  Lanes samples[kExactSubsamples][kExactSubsamples];
  for (auto& row : samples)
    for (Lanes& s : row) s = Lanes(reach * reach);
  search_samples(o, b, d, mixed, samples);
  Lanes area(0.0f);
  for (const auto& row : samples)
    for (const Lanes& s : row) area = area + box_stroke(s, r);
  return select(mixed, area * Lanes(kSampleBox * kSampleBox), whole);
}

}  // namespace CS_ISA
}  // namespace cs
