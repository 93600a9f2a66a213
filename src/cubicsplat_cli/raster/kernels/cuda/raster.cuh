// Stage raster: a block draws one tile, forward, loss and backward, with nothing but sums leaving the block.
//
// A warp owns a strip of 8 x 4 pixels and walks the tile's pairs on its own; the block meets at barriers only between
// batches of pairs. Control flow is uniform over a warp wherever lanes exchange values.
#pragma once

#include "backward.cuh"

namespace cs {

// Pairs of the batch that show in a strip, or whose outline is near it (shift 8), as a set of bits.
CS_INLINE unsigned strip_pairs(const Lists& s, int count, int shift, const Place& p) {
  return ballot(p.lane < count && (s.flags()[p.lane] >> (shift + p.strip) & 1u));
}

// Looks at an outline: by a search on the way forward, which is noted, and by the note on the way back. Where the slots
// are used up, it is searched again.
template <bool Exact>
CS_INLINE Seeing look_at(const Frame& f, const Lists& s, const Place& p, int pair, unsigned curve, const Way& way,
                         int slot) {
  const Outlined o = outlined(f, s, pair, curve, p.strip);
  const int backdrop = s.backdrops(pair)[p.strip];
  const bool noted = slot < f.slots && (!way.back || slot < way.outlines);  // the same for the whole warp
  const bool known = noted && way.back;
  Seeing seeing;
  seeing.found = known ? unpack(o, s.codes(slot)[threadIdx.x], p.px, p.py)
                       : find(o, backdrop, p.lane / kStripWidth, p.px, p.py);
  seeing.cover = relaxed_coverage(seeing.found, o);
  if (Exact)
    seeing.cover.coverage = known ? s.coverages(f, slot)[threadIdx.x]
                                  : exact_coverage(o, seeing.found, backdrop, p.px, p.py, p.lane);
  if (noted && !way.back && f.backward) {
    s.codes(slot)[threadIdx.x] = pack(seeing.found);
    if (Exact) s.coverages(f, slot)[threadIdx.x] = seeing.cover.coverage;
  }
  return seeing;
}

// Lets the strip's pixels see the batch's pairs, until none of them can be seen any more. Returns whether one still
// can.
template <bool Exact>
CS_INLINE bool visit_batch(const Frame& f, const Lists& s, const Place& p, int first, int count, const Way& way,
                           Pixel& pixel) {
  unsigned pairs = strip_pairs(s, count, 0, p);
  const unsigned outlines = strip_pairs(s, count, kStrips, p);
  bool live = any(pixel.state.transmittance >= kMinTransmittance);
  for (; live && pairs; pairs &= pairs - 1) {
    const int pair = lowest(pairs);
    const unsigned curve = s.listed()[first + pair];
    const bool outline = (outlines >> pair & 1u) != 0;
    Seeing seeing{{{0.0f, 0.0f, -1.0f}, true}, {1.0f, 0.0f, 0.0f, 0.0f}};
    if (outline) seeing = look_at<Exact>(f, s, p, pair, curve, way, pixel.outlines++);
    if (way.back) {
      return_pair(f, s, p, pair, curve, outline, seeing, f.step->importance_kind, pixel);
    } else {
      const Fill fill(f, s.attributes(pair), curve, p.px, p.py);
      const float alpha = limited(fill.opacity * seeing.cover.coverage);
      composite<kChannels>(alpha, fill.colour, pixel.state.transmittance, pixel.colour);
    }
    live = any(pixel.state.transmittance >= kMinTransmittance);
  }
  return live;
}

// Lists and classifies the tile's pairs batch by batch and visits them: on the way forward until no pixel of the tile
// can see more, on the way back as far as on the way forward.
template <bool Exact>
CS_INLINE void walk(const Frame& f, const Lists& s, const Place& p, Way& way, Pixel& pixel) {
  const int tile_x = p.tile % f.tiles_x, tile_y = p.tile / f.tiles_x;
  const float left = float(tile_x * kTile), top = float(tile_y * kTile);
  int batches = 0;
  for (int base = 0;; base += kListed) {
    const bool kept = way.back && way.retained > 0;
    const int found = kept ? way.retained : list_curves(f, s, tile_x, tile_y, base) - base;
    const int listed = least(found, kListed);
    for (int first = 0; first < listed;) {
      const int count = kept ? listed : cull_batch(f, s, first, listed, left, top);
      __syncthreads();
      const bool live = visit_batch<Exact>(f, s, p, first, count, way, pixel);
      batches++;
      if (way.back) {
        __syncthreads();
        add_sums(f, s, first, count);
      } else {
        way.batches = batches;
        way.retained = base == 0 && count == found ? count : 0;
      }
      // Also the barrier after which the batch's lists may be overwritten.
      const bool more = __syncthreads_or(live) != 0;
      if (way.back ? batches == way.batches : !more) return;
      first += count;
    }
    if (found < kListed) return;
  }
}

// Adds up the loss and the background gradient of the tile. Leaves the pairs' sums zero, and ends with a barrier.
CS_INLINE void store_tile_sums(const Frame& f, const Lists& s, const Place& p, float* values) {
  const float total = sum_of_eight(values, p.lane);
  if (p.lane % 4 == 0) s.sums(0)[p.strip * 8 + p.lane / 4] = total;
  __syncthreads();
  if (threadIdx.x < 8) {
    float tile = 0.0f;
    for (int strip = 0; strip < kStrips; strip++) tile += s.sums(0)[strip * 8 + threadIdx.x];
    f.tile_sums[size_t(p.tile) * 8 + threadIdx.x] = tile;
  }
  __syncthreads();
  for (int i = threadIdx.x; i < kBatch * kSumStride; i += kThreads) s.sums(0)[i] = 0.0f;
  __syncthreads();
}

// Writes the picture, and the tile's loss and background gradient; readies the pixel for the way back. Ends with a
// barrier.
CS_INLINE void finish(const Frame& f, const Lists& s, const Place& p, Pixel& pixel) {
  const Step& step = *f.step;
  const bool inside = p.inside(f);
  const size_t at = p.index(f);
  float error[kChannels];
  for (int c = 0; c < kChannels; c++) {
    const float colour = fmaf(pixel.state.transmittance, step.background[c], pixel.colour[c]);
    if (inside && step.image) step.image[at + c] = colour;
    error[c] = inside && f.target ? colour - f.target[at + c] : 0.0f;
    pixel.colour[c] = colour;
    pixel.gradient[c] = 0.0f;
  }
  if (!f.tile_sums) return;
  const float factor = factor_of(f, p);
  float sums[8] = {f.target ? pixel_loss<kChannels>(error, step.penalty) * factor : 0.0f};
  if (f.target) pixel_loss_gradient<kChannels>(error, step.penalty, pixel.gradient);
  for (int c = 0; c < kChannels; c++) pixel.gradient[c] *= factor;
  if (f.gradient)
    for (int c = 0; c < kChannels; c++) pixel.gradient[c] = inside ? f.gradient[at + c] : 0.0f;
  for (int c = 0; c < kChannels; c++) sums[1 + c] = pixel.state.transmittance * pixel.gradient[c];
  store_tile_sums(f, s, p, sums);
  pixel.state = {inside ? 1.0f : 0.0f, 0.0f};
  for (int c = 0; c < kChannels; c++) {
    pixel.state.behind = fmaf(pixel.colour[c], pixel.gradient[c], pixel.state.behind);
    pixel.colour[c] = -pixel.colour[c];
  }
}

// The walk stands once in the machine code, and runs twice.
template <bool Exact>
CS_INLINE void draw_tile(const Frame& f, const Lists& s, const Place& p) {
  Pixel pixel{{p.inside(f) ? 1.0f : 0.0f, 0.0f}, {}, {}, 0};
  Way way{};
#pragma unroll 1
  for (;;) {
    walk<Exact>(f, s, p, way, pixel);
    if (way.back) return;
    finish(f, s, p, pixel);
    if (!f.backward || way.batches == 0) return;
    way.back = true;
    way.outlines = pixel.outlines;
    pixel.outlines = 0;
  }
}

template <bool Exact>
CS_INLINE void raster_tile(const Frame& f, unsigned char* memory) {
  const unsigned start = unsigned(clock64());
  const Place p = place(f);
  draw_tile<Exact>(f, {memory}, p);
  if (f.order && threadIdx.x == 0) note_cost(f, p.tile, unsigned(clock64()) - start);
}

}  // namespace cs
