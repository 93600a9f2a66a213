// Which curves a tile has to look at, in their order, and which of their edges each strip of it needs.
#pragma once

#include "flatten.cuh"

namespace cs {

// A block's lists in shared memory.
struct Lists {
  unsigned char* memory;

  CS_INLINE unsigned* listed() const { return reinterpret_cast<unsigned*>(memory + kListAt); }
  CS_INLINE float* attributes(int pair) const {
    return reinterpret_cast<float*>(memory + kAttributesAt) + pair * kAttributes;
  }
  // Edges near a strip: sets of as many words as the curve has edges for, one for each strip of each pair.
  CS_INLINE unsigned* masks() const { return reinterpret_cast<unsigned*>(memory + kMasksAt); }
  // Winding numbers at the left side of a strip's four rows from the edges left of it, a signed byte each.
  CS_INLINE int* backdrops(int pair) const { return reinterpret_cast<int*>(memory + kBackdropsAt) + pair * kStrips; }
  // Bits 0-7: the curve shows in the strip; bits 8-15: its outline is near; from bit 16: words of sets before its own.
  CS_INLINE unsigned* flags() const { return reinterpret_cast<unsigned*>(memory + kFlagsAt); }
  CS_INLINE int* scan() const { return reinterpret_cast<int*>(memory + kScanAt); }
  CS_INLINE float* sums(int pair) const { return reinterpret_cast<float*>(memory + kSumsAt) + pair * kSumStride; }
  CS_INLINE unsigned short* codes(int slot) const {
    return reinterpret_cast<unsigned short*>(memory + kSlotsAt + slot * kCodeBytes);
  }
  // Exact mode only, behind all the codes.
  CS_INLINE float* coverages(const Frame& f, int slot) const {
    return reinterpret_cast<float*>(memory + kSlotsAt + f.slots * kCodeBytes + slot * kExactBytes);
  }
};

// Of a thread's share of the curves, from a super-tile's set of them or from all, those whose bounds touch the tile.
CS_INLINE unsigned touching_bits(const Frame& f, const unsigned* set, int first, int share, float left, float top) {
  if (first >= f.curves) return 0;
  unsigned bits = set ? set[first / kWarp] >> (first % kWarp) : kFullWarp, kept = 0;
  const int there = least(share, f.curves - first);
  if (there < kWarp) bits &= (1u << there) - 1u;
  for (; bits; bits &= bits - 1) {
    int i = lowest(bits);
    if (touches(f.bounds[first + i], left, top, left + kTile, top + kTile)) kept |= 1u << i;
  }
  return kept;
}

// Lists the curves of the tile whose rank among them is base .. base + kListed - 1, front to back. Returns how many
// curves were found up to there; kListed or more beyond base means that there may be others. Ends with a barrier.
CS_INLINE int list_curves(const Frame& f, const Lists& s, int tile_x, int tile_y, int base) {
  const int thread = threadIdx.x, lane = thread % kWarp, warp = thread / kWarp;
  const int super = (tile_y >> f.super_shift) * f.supers_x + (tile_x >> f.super_shift);
  const unsigned* set = f.super_masks ? f.super_masks + size_t(super) * f.words : nullptr;
  const float left = float(tile_x * kTile), top = float(tile_y * kTile);
  int share = 1;  // curves of a thread in a round: a word's worth at most, few enough that all threads have some
  while (share < kWarp && share * kThreads < f.curves) share <<= 1;
  int found = 0;
  for (int start = 0, round = 0; start < f.curves && found < base + kListed; start += share * kThreads, round++) {
    const int first = start + thread * share;
    unsigned bits = touching_bits(f, set, first, share, left, top);
    int count = __popc(bits), before = count_before(count, lane);
    int* totals = s.scan() + (round & 1) * kStrips;  // two sets of totals, so that one barrier a round is enough
    if (lane == kWarp - 1) totals[warp] = before + count;
    __syncthreads();
    int rank = found + before;
    for (int w = 0; w < kStrips; w++) {
      if (w < warp) rank += totals[w];
      found += totals[w];
    }
    for (; bits; bits &= bits - 1, rank++)
      if (rank >= base && rank < base + kListed) s.listed()[rank - base] = unsigned(first + lowest(bits));
  }
  __syncthreads();
  return found;
}

// Words of a set of so many edges.
CS_INLINE int words_for(int edges) { return (edges + kWarp - 1) / kWarp; }

// One edge as its lane sees it while a curve is sorted into the strips of a tile.
struct Seen {
  float ax, ay, vx, vy, x0, x1, y0, y1;
  float spread;     // |side| below which the edge's line is within reach of a strip's pixel centres
  int first, last;  // rows of the tile that it crosses
};

// First row of the tile whose centre lies at y or below it; the limits hold for NaN too.
CS_INLINE int row_at(float y, float top) {
  float r = ceilf(y - top - 0.5f);
  if (!(r > 0.0f)) return 0;
  return r < float(kTile) ? int(r) : kTile;
}

CS_INLINE Seen look(const float4& edge, float reach, float top) {
  Seen e;
  e.ax = edge.x;
  e.ay = edge.y;
  e.vx = edge.z - edge.x;
  e.vy = edge.w - edge.y;
  e.x0 = fminf(edge.x, edge.z);
  e.x1 = fmaxf(edge.x, edge.z);
  e.y0 = fminf(edge.y, edge.w);
  e.y1 = fmaxf(edge.y, edge.w);
  // |vx| + |vy| >= |v| saves a root; the test may keep an edge too many, never drop one.
  float u = fabsf(e.vx), v = fabsf(e.vy);
  e.spread = 0.5f * (float(kStripHeight - 1) * u + float(kStripWidth - 1) * v) + reach * (u + v);
  e.first = row_at(e.y0, top);
  e.last = row_at(e.y1, top);
  return e;
}

// Winding of an edge over the rows of one band of four, a signed byte each.
CS_INLINE int band_winding(const Seen& e, int band) {
  unsigned rows = ((1u << e.last) - (1u << e.first)) >> (band * kStripHeight) & 15u;
  unsigned bytes = (rows & 1u) | (rows & 2u) << 7 | (rows & 4u) << 14 | (rows & 8u) << 21;
  return e.vy > 0.0f ? int(bytes) : -int(bytes);
}

// Is the edge within reach of the strip's pixel centres? By its box, then by its line.
CS_INLINE bool near_strip(const Seen& e, float x, float y, float reach, float& side) {
  constexpr float w = kStripWidth - 1, h = kStripHeight - 1;
  side = (x + 0.5f * w - e.ax) * e.vy - (y + 0.5f * h - e.ay) * e.vx;
  return e.x1 + reach >= x && e.x0 - reach <= x + w && e.y1 + reach >= y && e.y0 - reach <= y + h &&
         fabsf(side) <= e.spread;
}

// Of an edge that is not near a strip but shares rows with it: does it pass left of the strip?
CS_INLINE bool left_of_strip(const Seen& e, float x, float side) {
  return e.x1 <= x || (e.x0 < x + float(kStripWidth - 1) && (side > 0.0f) == (e.vy > 0.0f));
}

// Sorts 32 edges of a curve, one a lane, into the eight strips. Lanes 0-7 get the word of their strip.
CS_INLINE void sort_edges(const Seen& e, bool near, float reach, float left, float top, int lane, int* backdrops,
                          unsigned& mask) {
#pragma unroll
  for (int strip = 0; strip < kStrips; strip++) {
    const int band = strip >> 1;
    const float x = left + float((strip & 1) * kStripWidth) + 0.5f, y = top + float(band * kStripHeight) + 0.5f;
    float side;
    const bool here = near && near_strip(e, x, y, reach, side);
    const unsigned word = ballot(here);
    if (lane == strip) mask = word;
    if (!kClosed) continue;
    const int winding = band_winding(e, band);
    if (near && !here && winding && left_of_strip(e, x, side)) atomicAdd(backdrops + strip, winding);
  }
}

// Edges that pass left of the whole tile count for both columns of strips.
CS_INLINE void sort_left_edges(const Seen& e, bool passes, int* backdrops) {
#pragma unroll
  for (int band = 0; band < kStrips / 2; band++) {
    const int winding = passes ? band_winding(e, band) : 0;
    if (!winding) continue;
    atomicAdd(backdrops + 2 * band, winding);
    atomicAdd(backdrops + 2 * band + 1, winding);
  }
}

// Sorts one curve into the strips of the tile; one warp's work. Not near means: no gradient of its place from there.
CS_INLINE void cull_pair(const Frame& f, const Lists& s, int pair, unsigned curve, int place, float left, float top,
                         int lane) {
  const float* attributes = f.attributes + size_t(curve) * kAttributes;
  const float reach = attributes[kReach];
  const int edges = int(attributes[kEdges]);
  int* backdrops = s.backdrops(pair);
  if (lane <= kSamples) s.attributes(pair)[lane] = attributes[lane];  // the last place is padding
  if (lane < kStrips) backdrops[lane] = 0;
  __syncwarp();
  unsigned* masks = s.masks() + place * kStrips + lane * words_for(edges);
  unsigned seen = 0;
  for (int word = 0; word * kWarp < edges; word++) {
    const int number = word * kWarp + lane;
    const bool valid = number < edges;
    const float4 far = make_float4(-kFar, -kFar, -kFar, -kFar);
    const Seen e = look(valid ? f.edges[size_t(curve) * f.edge_stride + number] : far, reach, top);
    const bool level = e.y1 + reach >= top + 0.5f && e.y0 - reach <= top + float(kTile) - 0.5f;
    const bool near = valid && level && e.x1 + reach >= left + 0.5f && e.x0 - reach <= left + float(kTile) - 0.5f;
    const bool passes = kClosed && valid && level && !near && e.x1 < left + 0.5f;
    unsigned mask = 0;
    if (any(near)) sort_edges(e, near, reach, left, top, lane, backdrops, mask);
    if (kClosed) sort_left_edges(e, passes, backdrops);
    seen |= mask;
    if (lane < kStrips) masks[word] = mask;
  }
  __syncwarp();
  const bool outline = lane < kStrips && seen != 0,
             shows = outline || (kClosed && lane < kStrips && backdrops[lane] != 0);
  const unsigned flags = (ballot(shows) & 0xffu) | (ballot(outline) & 0xffu) << 8 | unsigned(place) << 16;
  if (lane == 0) s.flags()[pair] = flags;
}

// How many of the next listed curves make up a batch: as many as have room for their sets of edges. Returns to each lane
// where the sets of its curve lie, in words per strip. The same in all warps.
CS_INLINE int batch_of(const Frame& f, const Lists& s, int first, int listed, int lane, int& place) {
  const bool there = first + lane < listed;
  const float* attributes = f.attributes + (there ? size_t(s.listed()[first + lane]) * kAttributes : 0);
  const int words = there ? words_for(int(attributes[kEdges])) : 0;
  place = count_before(words, lane);
  return __popc(ballot(there && place + words <= kMaskPlaces));
}

// Classifies the next pairs of the list, which the warps share out, and returns how many.
CS_INLINE int cull_batch(const Frame& f, const Lists& s, int first, int listed, float left, float top) {
  const int lane = threadIdx.x % kWarp;
  int own;
  const int count = batch_of(f, s, first, listed, lane, own);
  for (int pair = threadIdx.x / kWarp; pair < count; pair += kStrips) {
    const int place = __shfl_sync(kFullWarp, own, pair);
    cull_pair(f, s, pair, s.listed()[first + pair], place, left, top, lane);
  }
  return count;
}

}  // namespace cs
