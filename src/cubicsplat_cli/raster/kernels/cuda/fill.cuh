// What a pixel sees of a curve's fill: its one colour or, in programs for gradients, that of its place.
#pragma once

#include "cover.cuh"

namespace cs {

#if CS_PAINTED

struct Fill {
  Paint paint;
  OnTheWay<float> at;
  float colour[kStopValues];  // the fourth is the stops' opacity
  float opacity;

  CS_INLINE Fill(const Frame& f, const float* attributes, unsigned curve, float px, float py)
      : paint(f.paint_of(curve)) {
    opacity = attributes[kOpacity];
    if (paint.kind == kFlat) {
      for (int c = 0; c < 3; c++) colour[c] = attributes[c];
      colour[3] = 1.0f;
      return;
    }
    at = on_the_way(paint, px, py);
    paint_value(paint, at.t, colour);
    opacity *= colour[3];
  }

  // Of values = dL/d(colour, opacity) by pixel leaves what the curve's own colour and opacity have; the warp adds up
  // the rest for the stops and the frame.
  CS_INLINE void give_back(const Frame& f, const float* attributes, unsigned curve, float px, float py, int lane,
                           float* values) const {
    if (paint.kind == kFlat) return;
    const float d[kStopValues] = {values[0], values[1], values[2], values[3] * attributes[kOpacity]};
    for (int c = 0; c < 3; c++) values[c] = 0.0f;
    values[3] *= colour[3];
    const float d_t = paint_backward(paint, at.t, d, [&](int k, float share) {
      float of_stop[kStopValues];
      for (int c = 0; c < kStopValues; c++) of_stop[c] = share * d[c];
      if (f.out_stops) add_four(f.out_stops + (size_t(curve) * f.most_stops + k) * kStopValues, of_stop, lane);
    });
    if (!f.out_frames) return;
    float of_frame[kFrameValues];
    frame_backward(paint, at, px, py, d_t, of_frame);
    float* out = f.out_frames + size_t(curve) * kFrameValues;
    add_four(out, of_frame, lane);
    if (paint.kind == kRadial) add_four(out + 4, of_frame + 4, lane);
  }

 private:
  // Adds the warp's sums of four values to those of the whole picture.
  static CS_INLINE void add_four(float* sums, float* values, int lane) {
    const float total = sum_of_four(values, lane);
    if (lane % 8 == 0 && total != 0.0f) atomicAdd(sums + lane / 8, total);
  }
};

#else

struct Fill {
  const float* colour;
  float opacity;

  CS_INLINE Fill(const Frame&, const float* attributes, unsigned, float, float)
      : colour(attributes), opacity(attributes[kOpacity]) {}

  CS_INLINE void give_back(const Frame&, const float*, unsigned, float, float, int, float*) const {}
};

#endif

}  // namespace cs
