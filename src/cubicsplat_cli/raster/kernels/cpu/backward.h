// The way back through one block: gradients of what a primitive's pixels saw.
#pragma once

#include "cover.h"

namespace cs {
namespace CS_ISA {

CS_INLINE void add(EdgeGradient& to, const Four& sums) {
  to.start_x += sums.v[0];
  to.start_y += sums.v[1];
  to.end_x += sums.v[2];
  to.end_y += sums.v[3];
}

// The rare pixels whose centre lies on the outline: the outward normal stands for (c - x) / d.
inline void pull_touching(const Outline& o, const Record& r, Lanes d_coverage) {
  float strength[kLanes], edge[kLanes], t[kLanes];
  d_coverage.store(strength);
  r.edge.store(edge);
  r.t.store(t);
  Lanes phi, slope;
  relaxed_step(Lanes(0.0f), support_of(*o.primitive), phi, slope);
  for (unsigned m = r.touching; m; m &= m - 1) {
    const unsigned i = lowest_bit(m), n = unsigned(edge[i]);
    const TileEdge e = o.edge(n);
    const float length = std::sqrt(e.vx * e.vx + e.vy * e.vy);
    if (!(length > 0.0f)) continue;
    const float g = strength[i] * first(slope) * o.primitive->orientation / length;
    const float x = g * e.vy, y = -g * e.vx;
    add(o.gradients[n], {{x * (1.0f - t[i]), y * (1.0f - t[i]), x * t[i], y * t[i]}});
  }
}

// Adds the pull of the block's pixels on their nearest points to the ends of their edges.
CS_INLINE void pull_edges(const Outline& o, const Block& b, const Record& r, Lanes d_coverage) {
  const Lanes pull = r.cover.pull * d_coverage;
  float numbers[kLanes];
  r.edge.store(numbers);
  for (unsigned left = bits(r.edge >= Lanes(0.0f)); left;) {
    const float number = numbers[lowest_bit(left)];
    const Mask mine = r.edge == Lanes(number);
    left &= ~bits(mine);
    const TileEdge e = o.edge(unsigned(number));
    const Lanes strength = select(mine, pull, Lanes(0.0f));
    const Lanes x = strength * fused(r.t, Lanes(e.vx), Lanes(e.ax) - b.px);
    const Lanes y = strength * fused(r.t, Lanes(e.vy), Lanes(e.ay) - b.py);
    const Lanes end_x = x * r.t, end_y = y * r.t;
    add(o.gradients[unsigned(number)], sum_of_four(x - end_x, y - end_y, end_x, end_y));
  }
  if (r.touching) pull_touching(o, r, d_coverage);
}

// Gradients of a mixed block's other parameters: those of the coverage.
CS_INLINE void add_cover_gradient(const CsScene& scene, const Outline& o, const Record& r, Lanes d_coverage) {
  PairGradient& g = o.pair->gradient;
  if (!scene.closed) o.sums->half_width = fused(d_coverage, r.cover.widening, o.sums->half_width);
  if (scene.edge_widths) g.edge_width += sum(d_coverage * r.cover.softening) / o.primitive->edge_width;
}

}  // namespace CS_ISA
}  // namespace cs
