// Stage raster, the way back: gradients of the curves that a tile's pixels see, and what each curve is worth.
#pragma once

#include "fill.cuh"

namespace cs {

// Where a thread is.
struct Place {
  int lane, strip, tile;
  float px, py;  // the pixel's centre

  CS_INLINE bool inside(const Frame& f) const { return px < float(f.width) && py < float(f.height); }
  // Of the pixel's first value in a picture.
  CS_INLINE size_t index(const Frame& f) const { return (size_t(int(py)) * f.width + int(px)) * kChannels; }
};

CS_INLINE Place place(const Frame& f) {
  Place p;
  p.lane = threadIdx.x % kWarp;
  p.strip = threadIdx.x / kWarp;
  p.tile = ordered_tile(f);
  const int tile_x = p.tile % f.tiles_x, tile_y = p.tile / f.tiles_x;
  p.px = float(tile_x * kTile + (p.strip & 1) * kStripWidth + p.lane % kStripWidth) + 0.5f;
  p.py = float(tile_y * kTile + (p.strip >> 1) * kStripHeight + p.lane / kStripWidth) + 0.5f;
  return p;
}

// State of a pixel in the walk over its curves, which runs front to back both ways.
struct Pixel {
  Backward<float> state;      // transmittance; on the way back also what lies behind
  float colour[kChannels];    // accumulated so far; on the way back less F, for the leave-one-out importance
  float gradient[kChannels];  // dL/dF, on the way back
  int outlines;               // met by the warp so far: the number of a slot
};

// One of the two walks. What the way forward leaves is what the way back repeats.
struct Way {
  bool back;
  int batches;   // visited before every pixel of the tile was finished
  int retained;  // pairs of the whole tile where a single batch holds them, whose lists are still there; else 0
  int outlines;  // that the warp met
};

// One pixel's view of one curve.
struct Seeing {
  Found found;
  Coverage<float> cover;
};

// Alpha below one. A coverage or opacity that is not a number stays none and shows in the loss.
CS_INLINE float limited(float raw) { return raw > kMaxAlpha ? kMaxAlpha : raw; }

// The factor of a pixel's loss and importance.
CS_INLINE float factor_of(const Frame& f, const Place& p) {
  return f.weights && p.inside(f) ? f.weights[p.index(f) / kChannels] : 1.0f;
}

// What the curve is worth in the pixel. Counted from F, so that F itself is not needed: acc - F in place of acc, and 0
// in place of F. The error is read again from the pictures: in the few steps that ask for it this costs less than
// registers in all others.
CS_INLINE float importance_of(const Frame& f, const Place& p, int kind, float alpha, float weight, const float* colour,
                              Pixel& pixel) {
  if (!p.inside(f)) return 0.0f;
  const float factor = factor_of(f, p);
  if (kind == 1) return weight * factor;
  const float *image = f.step->image + p.index(f), *target = f.target + p.index(f), zero[kChannels] = {};
  float error[kChannels];
  for (int c = 0; c < kChannels; c++) error[c] = image[c] - target[c];
  return leave_one_out<kChannels>(alpha, weight, colour, zero, error, f.step->penalty, pixel.colour) * factor;
}

// Gradient of the loss with respect to the nearest point of the outline.
CS_INLINE void pull_of(const Outlined& o, const Seeing& seeing, const Place& p, float d_coverage, float& x, float& y) {
  const Edge e = o.edge(int(seeing.found.nearest.edge));
  if (kClosed && seeing.found.nearest.squared < kTouching * kTouching) {
    // The centre lies on the outline: the outward normal stands for (c - x) / d.
    float phi, slope;
    relaxed_step(0.0f, o.attributes[kSupport], phi, slope);
    const float length = square_root(e.vx * e.vx + e.vy * e.vy);
    const float g = length > 0.0f ? d_coverage * slope * o.attributes[kOrientation] / length : 0.0f;
    x = g * e.vy;
    y = -g * e.vx;
    return;
  }
  const float strength = seeing.cover.pull * d_coverage, t = seeing.found.nearest.t;
  x = strength * (fmaf(t, e.vx, e.ax) - p.px);
  y = strength * (fmaf(t, e.vy, e.ay) - p.py);
}

// Adds the pulls of the strip's pixels to the ends of their edges. Few edges pass through a strip, so the warp sums up
// one edge after the other and makes one atomic access for each.
CS_INLINE void scatter(const Frame& f, const Outlined& o, unsigned curve, int edge, float x, float y, float t,
                       int lane) {
  const Rings rings = f.rings_of(int(curve));
  const int samples = int(o.attributes[kSamples]);
  float* gradients = f.vertex_gradients + size_t(curve) * (f.edge_stride + 1) * 2;
  unsigned left = ballot(edge >= 0 && !(x == 0.0f && y == 0.0f));
  while (left) {
    const int current = __shfl_sync(kFullWarp, edge, lowest(left));
    const bool mine = (left >> lane & 1u) && edge == current;
    left &= ~ballot(mine);
    float values[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    if (mine) {
      values[2] = x * t;
      values[3] = y * t;
      values[0] = x - values[2];
      values[1] = y - values[3];
    }
    const float total = sum_of_four(values, lane);
    if (lane % 8 == 0) {
      const int i = lane / 8;
      const int vertex = i < 2 ? current : rings.end_vertex(current, samples, kClosed);
      atomicAdd(gradients + 2 * vertex + i % 2, total);
    }
  }
}

// Sums the strip's gradients of one curve into the pair's place for this strip.
CS_INLINE void store_sums(const Lists& s, int pair, const Place& p, float* values, bool few) {
  float* sums = s.sums(pair) + p.strip * 8;
  if (few) {
    const float total = sum_of_four(values, p.lane);
    if (p.lane % 8 == 0) sums[p.lane / 8] = total;
    return;
  }
  const float total = sum_of_eight(values, p.lane);
  if (p.lane % 4 == 0) sums[p.lane / 4] = total;
}

// What one curve's pixels in the strip add to its gradients.
CS_INLINE void return_pair(const Frame& f, const Lists& s, const Place& p, int pair, unsigned curve, bool outline,
                           const Seeing& seeing, int kind, Pixel& pixel) {
  const float* attributes = s.attributes(pair);
  const int edge = int(seeing.found.nearest.edge);
  if (!any(seeing.cover.coverage > 0.0f || edge >= 0)) return;
  const Fill fill(f, attributes, curve, p.px, p.py);
  const float raw = fill.opacity * seeing.cover.coverage, alpha = limited(raw);
  float weight, d_alpha = composite_backward<kChannels>(alpha, fill.colour, pixel.gradient, pixel.state, weight);
  if (raw > kMaxAlpha) d_alpha = 0.0f;
  const float d_coverage = d_alpha * fill.opacity;
  float values[8];
  for (int c = 0; c < 3; c++) values[c] = weight * pixel.gradient[c];
  values[kSumOpacity] = d_alpha * seeing.cover.coverage;
  fill.give_back(f, attributes, curve, p.px, p.py, p.lane, values);
  values[kSumHalfWidth] = d_coverage * seeing.cover.widening;
  values[kSumImportance] = kind == 0 ? 0.0f : importance_of(f, p, kind, alpha, weight, fill.colour, pixel);
  values[kSumEdgeWidth] = d_coverage * seeing.cover.softening;
  values[7] = 0.0f;
  // Colour and opacity come first; a fill of common edge width has no more when nobody asks for its importance.
  store_sums(s, pair, p, values, kClosed && kind == 0 && !f.edge_widths);
  if (!outline) return;
  const Outlined o = outlined(f, s, pair, curve, p.strip);
  float x = 0.0f, y = 0.0f;
  if (edge >= 0) pull_of(o, seeing, p, d_coverage, x, y);
  scatter(f, o, curve, edge, x, y, seeing.found.nearest.t, p.lane);
}

// Adds the batch's sums to those of the curves: eight threads a pair. Leaves zeros behind for the next batch.
CS_INLINE void add_sums(const Frame& f, const Lists& s, int first, int count) {
  const int pair = threadIdx.x / 8, kind = threadIdx.x % 8;
  if (pair >= count) return;
  float total = 0.0f;
  for (int strip = 0; strip < kStrips; strip++) {
    float& sum = s.sums(pair)[strip * 8 + kind];
    total += sum;
    sum = 0.0f;
  }
  if (total != 0.0f) atomicAdd(f.sums + size_t(s.listed()[first + pair]) * kSums + kind, total);
}

}  // namespace cs
