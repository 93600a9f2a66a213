// Exact area coverage of strokes.
#pragma once

#include "gather.h"

namespace cs {
namespace CS_ISA {

// Area of the stroke in each pixel of a block, from sub-samples filtered by a box of their own size.
CS_INLINE Lanes exact_stroke(const Outline& o, const Block& b) {
  constexpr int n = kExactSubsamples;
  constexpr float step = 1.0f / n;
  const float reach = o.primitive->reach;
  Lanes squared[n * n];
  for (Lanes& s : squared) s = Lanes(reach * reach);
  o.each_near(b, [&](uint32_t, const TileEdge& e) {
    const Lanes wx = b.px - Lanes(e.ax), wy = b.py - Lanes(e.ay);
    for (int i = 0; i < n * n; i++) {
      const float x = (float(i % n) + 0.5f) * step - 0.5f, y = (float(i / n) + 0.5f) * step - 0.5f;
      Nearest<Lanes> sample{squared[i], Lanes(0.0f), Lanes(0.0f)};
      nearest_update(sample, e, wx + Lanes(x), wy + Lanes(y), 0.0f);
      squared[i] = sample.squared;
    }
  });
  Lanes area(0.0f);
  for (const Lanes& s : squared) area = area + box_stroke(s, o.primitive->half_width);
  return area * Lanes(step * step);
}

}  // namespace CS_ISA
}  // namespace cs
