// Stage raster: a block draws one tile, forward, loss and backward, with nothing but sums leaving the block.
//
// A warp owns a strip of 8 x 4 pixels and walks the tile's pairs on its own; the block meets at barriers only between
// batches of pairs. Control flow is uniform over a warp wherever lanes exchange values.
#pragma once

#include "cover.cuh"

namespace cs {

// Where a thread is, and what it reads once.
struct Place {
  int lane, strip, tile;
  float left, top;  // the tile's corner, px
  float px, py;     // the pixel's centre
  bool valid;       // inside the picture
  size_t pixel;     // its first value in a picture
};

CS_INLINE Place place(const Frame& f) {
  Place p;
  p.lane = threadIdx.x % kWarp;
  p.strip = threadIdx.x / kWarp;
  p.tile = blockIdx.x;
  const int tile_x = p.tile % f.tiles_x, tile_y = p.tile / f.tiles_x;
  const int x = tile_x * kTile + (p.strip & 1) * kStripWidth + p.lane % kStripWidth;
  const int y = tile_y * kTile + (p.strip >> 1) * kStripHeight + p.lane / kStripWidth;
  p.left = float(tile_x * kTile);
  p.top = float(tile_y * kTile);
  p.px = float(x) + 0.5f;
  p.py = float(y) + 0.5f;
  p.valid = x < f.width && y < f.height;
  p.pixel = (size_t(y) * f.width + x) * kChannels;
  return p;
}

// How far the forward pass came, which the backward pass repeats.
struct Progress {
  int batches;    // visited before every pixel of the tile was finished
  int pairs;      // of the last batch
  bool retained;  // a single batch holds the whole tile: its lists are still there
};

// Lists and classifies the tile's pairs batch by batch and calls visit(first, count) on each, until it returns false
// for every thread or `limit` batches are done.
template <bool Exact, class Visit>
CS_INLINE Progress each_batch(const Frame& f, const Lists& s, const Place& p, int limit, Visit visit) {
  const int tile_x = p.tile % f.tiles_x, tile_y = p.tile / f.tiles_x;
  Progress progress{0, 0, false};
  for (int base = 0;; base += kListed) {
    const int found = list_curves(f, s, tile_x, tile_y, base) - base, listed = least(found, kListed);
    progress.retained = base == 0 && found <= f.batch;
    for (int first = 0; first < listed; first += f.batch) {
      const int count = least(f.batch, listed - first);
      cull_batch<Exact>(f, s, first, count, p.left, p.top);
      __syncthreads();
      progress.batches++;
      progress.pairs = count;
      const bool live = visit(first, count);
      // Also the barrier after which the batch's lists may be overwritten.
      if (!__syncthreads_or(live) || progress.batches == limit) return progress;
    }
    if (found < kListed) return progress;
  }
}

// Pairs of the batch that show in a strip, or whose outline is near it (shift 8), as a set of bits.
CS_INLINE unsigned strip_pairs(const Lists& s, int count, int shift, const Place& p) {
  return ballot(p.lane < count && (s.flags()[p.lane] >> (shift + p.strip) & 1u));
}

// State of a pixel on the way forward, and the warp's count of kept outlines.
struct Forward {
  float transmittance, accumulated[kChannels];
  int kept;
};

template <bool Exact>
CS_INLINE float outline_coverage(const Frame& f, const Lists& s, const Outlined& o, const Place& p, int backdrop, int slot) {
  const Found found = find(o, backdrop, p.lane / kStripWidth, p.px, p.py);
  const float covered = Exact ? exact_coverage(o, found, p.px, p.py, p.lane)
                              : relaxed_coverage(found, o).coverage;
  if (f.backward && slot < f.slots) {
    s.codes(slot)[threadIdx.x] = pack(found);
    if (Exact) s.coverages(f, slot)[threadIdx.x] = covered;
  }
  return covered;
}

// Returns whether the strip has a pixel left to draw on.
template <bool Exact>
CS_INLINE bool forward_batch(const Frame& f, const Lists& s, const Place& p, int first, int count, Forward& pixel) {
  unsigned pairs = strip_pairs(s, count, 0, p);
  const unsigned outlines = strip_pairs(s, count, kStrips, p);
  bool live = any(pixel.transmittance >= kMinTransmittance);
  for (; live && pairs; pairs &= pairs - 1) {
    const int pair = lowest(pairs);
    const float* attributes = s.attributes(pair);
    float covered = 1.0f;
    if (outlines >> pair & 1u) {
      const Outlined o = outlined(f, s, pair, s.listed()[first + pair], p.strip);
      covered = outline_coverage<Exact>(f, s, o, p, s.backdrops(pair)[p.strip], pixel.kept++);
    }
    const float alpha = fminf(attributes[kOpacity] * covered, kMaxAlpha);
    composite<kChannels>(alpha, attributes, pixel.transmittance, pixel.accumulated);
    live = any(pixel.transmittance >= kMinTransmittance);
  }
  return live;
}

// What a finished pixel knows: its colour F, and dL/dF.
struct Finished {
  float colour[kChannels], gradient[kChannels];
};

// Writes the picture, and the tile's loss and background gradient. Ends with a barrier.
CS_INLINE Finished finish(const Frame& f, const Lists& s, const Place& p, const Forward& pixel) {
  const Step& step = *f.step;
  Finished done;
  float error[kChannels];
  for (int c = 0; c < kChannels; c++) {
    done.colour[c] = fmaf(pixel.transmittance, step.background[c], pixel.accumulated[c]);
    if (p.valid && step.image) step.image[p.pixel + c] = done.colour[c];
    error[c] = p.valid && f.target ? done.colour[c] - f.target[p.pixel + c] : 0.0f;
    done.gradient[c] = 0.0f;
  }
  if (!f.tile_sums) return done;
  float sums[8] = {f.target ? pixel_loss<kChannels>(error) : 0.0f};
  if (f.target) pixel_loss_gradient<kChannels>(error, done.gradient);
  if (f.gradient)
    for (int c = 0; c < kChannels; c++) done.gradient[c] = p.valid ? f.gradient[p.pixel + c] : 0.0f;
  for (int c = 0; c < kChannels; c++) sums[1 + c] = pixel.transmittance * done.gradient[c];
  const float total = sum_of_eight(sums, p.lane);
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
  return done;
}

}  // namespace cs
