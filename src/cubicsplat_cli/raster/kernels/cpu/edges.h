// The edges of a pair in the tile's coordinates, sixteen at a time, and which of the tile's blocks each is near.
#pragma once

#include "block.h"

namespace cs {
namespace CS_ISA {

// An edge from the tile's corner, with both of its ends: an end computed as start + direction could round to the other
// side of a row than the next edge's start, and the winding number would leak along the whole row.
struct TileEdge : Edge {
  float bx, by;
};

// Sixteen edges of a pair, of which the last group may have fewer; the rest is near no block.
struct EdgeGroup {
  float ax[kLanes], ay[kLanes], bx[kLanes], by[kLanes];
  float vx[kLanes], vy[kLanes], ux[kLanes], uy[kLanes];  // as in Edge
  float direction[kLanes];                               // 1 where the edge goes down, else -1
  float x0[kLanes], x1[kLanes], y0[kLanes], y1[kLanes];  // its box
  float spread[kLanes];   // |side| below which its line is within reach of a block's pixel centres, see Sight
  uint16_t near[kLanes];  // the blocks it is near

  TileEdge edge(unsigned i) const { return {{ax[i], ay[i], vx[i], vy[i], ux[i], uy[i]}, bx[i], by[i]}; }

  // Takes so many lines, 1 or more, to the coordinates of a tile whose corner is (x, y). Behind them as many are read as
  // make four, and no more: they may not be in the nearest memory.
  void fetch(const Line* lines, uint32_t count, float x, float y) {
    const float* rows[4];
    for (uint32_t i = 0; i < 4; i++) rows[i] = &lines[4 * i < count ? 4 * i : 0].ax;
    Lanes ends[4];
    load_pixels<4>(rows, ends);
    (ends[0] - Lanes(x)).store(ax);
    (ends[1] - Lanes(y)).store(ay);
    (ends[2] - Lanes(x)).store(bx);
    (ends[3] - Lanes(y)).store(by);
    for (uint16_t& n : near) n = 0;
  }

  // Everything that follows from the ends.
  void derive(float reach) {
    constexpr float half = 0.5f * (kBlock - 1);
    const Lanes a_x = Lanes::load(ax), a_y = Lanes::load(ay), b_x = Lanes::load(bx), b_y = Lanes::load(by);
    const Lanes v_x = b_x - a_x, v_y = b_y - a_y, squared = fused(v_x, v_x, v_y * v_y);
    const Lanes inverse = Lanes(1.0f) / maximum(squared, Lanes(kMinSquaredLength));
    v_x.store(vx);
    v_y.store(vy);
    (v_x * inverse).store(ux);
    (v_y * inverse).store(uy);
    select(b_y > a_y, Lanes(1.0f), Lanes(-1.0f)).store(direction);
    minimum(a_x, b_x).store(x0);
    maximum(a_x, b_x).store(x1);
    minimum(a_y, b_y).store(y0);
    maximum(a_y, b_y).store(y1);
    fused(square_root(squared), Lanes(reach), (absolute(v_x) + absolute(v_y)) * Lanes(half)).store(spread);
  }
};

// An edge as the sixteen blocks see it, one a lane.
struct Sight {
  Mask near;  // within reach of the block's pixel centres, by the edge's box, then its line; one too many does no harm
  Mask left;  // not near, and if it shares rows with the block, left of it

  static CS_INLINE Lanes middles_x() { return (columns() - Lanes(0.5f)) * Lanes(kBlock) + Lanes(0.5f * kBlock); }
  static CS_INLINE Lanes middles_y() { return (rows() - Lanes(0.5f)) * Lanes(kBlock) + Lanes(0.5f * kBlock); }

  CS_INLINE Sight(const EdgeGroup& g, unsigned i, float reach) {
    const Lanes x = middles_x(), y = middles_y();
    const float margin = 0.5f * (kBlock - 1) + reach;
    // Positive where the block's middle is right of the edge; the lesser product where the edge is level does no harm.
    const Lanes side = ((x - Lanes(g.ax[i])) * Lanes(g.vy[i]) - (y - Lanes(g.ay[i])) * Lanes(g.vx[i])) *
                       Lanes(g.direction[i]);
    const Mask from_left = x >= Lanes(g.x0[i] - margin), to_right = x <= Lanes(g.x1[i] + margin);
    near = from_left & to_right & (y >= Lanes(g.y0[i] - margin)) & (y <= Lanes(g.y1[i] + margin)) &
           (absolute(side) <= Lanes(g.spread[i]));
    left = without(from_left & ((x > Lanes(g.x1[i] + margin)) | (side > Lanes(0.0f))), near);
  }
};

}  // namespace CS_ISA
}  // namespace cs
