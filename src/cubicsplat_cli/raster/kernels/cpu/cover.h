// Coverage of one block by one primitive whose outline is near.
#pragma once

#include "exact_fill.h"
#include "exact_stroke.h"
#include "gather.h"

namespace cs {
namespace CS_ISA {

// What a mixed block keeps of a primitive for the way back.
struct Record {
  Coverage<Lanes> cover;
  Lanes t, edge;  // the nearest point: parameter on its edge, and the edge's number, negative where none is in reach
  unsigned touching;  // pixels whose centre lies on the outline (fills)
};

struct Nearby {
  Nearest<Lanes> nearest;
  Mask inside;
};

// The nearest edge of each pixel and, for fills, the winding number of its centre.
template <bool Closed>
CS_INLINE Nearby look_around(const Outline& o, const Block& b) {
  const float reach = o.primitive->reach;
  Nearby r{{Lanes(reach * reach), Lanes(0.0f), Lanes(-1.0f)}, {}};
  Lanes winding(0.0f);
  if (Closed) winding = left_windings(o, b);
  o.each_near(b, [&](uint32_t n, const TileEdge& e) {
    const Lanes wx = b.px - Lanes(e.ax), wy = b.py - Lanes(e.ay);
    nearest_update(r.nearest, e, wx, wy, float(n));
    if (!Closed) return;
    // The sign of a cross product stands for the crossing's x, which would need a division.
    const float direction = e.by > e.ay ? 1.0f : -1.0f;
    const float low = e.by > e.ay ? e.ay : e.by, high = e.by > e.ay ? e.by : e.ay;
    const Lanes side = fused(wx, Lanes(e.vy * direction), wy * Lanes(-e.vx * direction));
    const Mask crossed = (b.py >= Lanes(low)) & (b.py < Lanes(high)) & (side >= Lanes(0.0f));
    winding = add_where(crossed, winding, Lanes(direction));
  });
  if (Closed) r.inside = winding != Lanes(0.0f);
  return r;
}

CS_INLINE float support_of(const Primitive& q) { return 1.0f / (2.0f * kHalfSupport * q.edge_width); }

CS_INLINE void cover_block_by_fill(const Outline& o, const Block& b, bool exact, Record& r) {
  const Nearby near = look_around<true>(o, b);
  const float support = support_of(*o.primitive);
  r.cover = cover_fill(near.nearest.squared, near.inside, support);
  r.t = near.nearest.t;
  r.edge = near.nearest.edge;
  const Mask touching = near.nearest.squared < Lanes(kTouching * kTouching);
  r.touching = bits(touching);
  if (r.touching) r.cover.pull = select(touching, Lanes(0.0f), r.cover.pull);
  if (exact) r.cover.coverage = exact_fill(o, b);
}

CS_INLINE void cover_block_by_stroke(const Outline& o, const Block& b, bool exact, Record& r) {
  const Nearby near = look_around<false>(o, b);
  r.cover = cover_stroke(near.nearest.squared, o.primitive->half_width, support_of(*o.primitive));
  r.t = near.nearest.t;
  r.edge = near.nearest.edge;
  r.touching = 0;
  if (exact) r.cover.coverage = exact_stroke(o, b, near.nearest.squared);
}

}  // namespace CS_ISA
}  // namespace cs
