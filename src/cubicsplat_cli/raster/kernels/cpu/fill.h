// What a block's pixels see of a curve's fill: one colour, or those of a gradient. Which of the two is settled when the
// raster stage is compiled, so that scenes without gradients know nothing of them.
#pragma once

#include "../shared/paint.h"
#include "backward.h"

namespace cs {
namespace CS_ISA {

// Where the gradients of a pair's fill go: the stops', then the frame's.
CS_INLINE float* paint_gradient(const TileTask& task, const Outline& o) {
  const ChunkView& chunk = task.chunks[o.pair->primitive / task.chunk_size];
  return chunk.paint_gradients + size_t(o.pair - chunk.pairs) * paint_stride(task.scene->most_stops);
}

CS_INLINE void add_four_to(float* sums, const Four& more) {
  for (int i = 0; i < 4; i++) sums[i] += more.v[i];
}

// What the way back finds out of a block's pixels: T alpha, dL/dF, dL/dalpha and the coverage.
struct Returned {
  Lanes weight, d_alpha, coverage;
  const Lanes* gradient;

  CS_INLINE void add_flat(PairSums& s) const {
    for (int c = 0; c < 3; c++) s.colour[c] = fused(weight, gradient[c], s.colour[c]);
    s.opacity = fused(d_alpha, coverage, s.opacity);
  }
};

struct FlatFill {
  const float* colour;
  Lanes opacity;

  CS_INLINE FlatFill(const TileTask&, const Outline& o, const Block&)
      : colour(o.primitive->colour), opacity(o.primitive->opacity) {}

  CS_INLINE void give_back(const TileTask&, const Outline& o, const Block&, const Returned& r) const {
    r.add_flat(*o.sums);
  }
};

struct GradientFill {
  Lanes colour[kStopValues];  // the fourth is the stops' opacity
  Lanes opacity;
  Paint paint;

  CS_INLINE GradientFill(const TileTask& task, const Outline& o, const Block& b)
      : paint(paints_of(*task.scene).of(o.pair->primitive)) {
    const Primitive& q = *o.primitive;
    opacity = Lanes(q.opacity);
    if (paint.kind == kFlat) {
      for (int c = 0; c < 3; c++) colour[c] = Lanes(q.colour[c]);
      return;
    }
    paint_value(paint, place(task, b).t, colour);
    opacity = opacity * colour[3];
  }

  CS_INLINE void give_back(const TileTask& task, const Outline& o, const Block& b, const Returned& r) const {
    if (paint.kind == kFlat) return r.add_flat(*o.sums);
    const Lanes d_opacity = r.d_alpha * r.coverage;
    o.sums->opacity = fused(d_opacity, colour[3], o.sums->opacity);
    const Lanes d[kStopValues] = {r.weight * r.gradient[0], r.weight * r.gradient[1], r.weight * r.gradient[2],
                                  d_opacity * Lanes(o.primitive->opacity)};
    float* const sums = paint_gradient(task, o);
    const OnTheWay<Lanes> at = place(task, b);
    const Lanes d_t = paint_backward(paint, at.t, d, [&](int k, Lanes share) {
      add_four_to(sums + kStopValues * k, sum_of_four(share * d[0], share * d[1], share * d[2], share * d[3]));
    });
    Lanes f[kFrameValues];
    frame_backward(paint, at, x_of(task, b), y_of(task, b), d_t, f);
    float* const frame = sums + kStopValues * task.scene->most_stops;
    add_four_to(frame, sum_of_four(f[0], f[1], f[2], f[3]));
    if (paint.kind == kRadial) add_four_to(frame + 4, sum_of_four(f[4], f[5], f[6], f[7]));
  }

 private:
  static CS_INLINE Lanes x_of(const TileTask& task, const Block& b) { return b.px + Lanes(float(task.tile_x * kTile)); }
  static CS_INLINE Lanes y_of(const TileTask& task, const Block& b) { return b.py + Lanes(float(task.tile_y * kTile)); }

  CS_INLINE OnTheWay<Lanes> place(const TileTask& task, const Block& b) const {
    return on_the_way(paint, x_of(task, b), y_of(task, b));
  }
};

}  // namespace CS_ISA
}  // namespace cs
