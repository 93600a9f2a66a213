// The order in which the tiles are drawn: those that took longest in the step before come first, so that none of them is
// begun when the other multiprocessors have nothing left to do.
//
// A tile counts itself into a class by its time when it is done; the next step's blocks go through the classes from the
// longest down. There are two such lists, of the even and the odd steps: one is read while the other is written. The
// order within a class is by chance, and nothing depends on it.
#pragma once

#include "frame.cuh"

namespace cs {

// One list: how many tiles each class has, and their numbers.
struct Order {
  int *counts, *tiles;
  int stride;  // places of a class

  CS_INLINE Order(const Frame& f, int parity) : stride(f.tiles_x * f.tiles_y) {
    counts = f.order + size_t(parity) * kCosts * (1 + stride);
    tiles = counts + kCosts;
  }
};

// Empties the list that this step writes.
CS_INLINE void clear_order(const Frame& f) {
  if (f.order && blockIdx.x == 0 && threadIdx.x < kCosts) Order(f, f.step->number & 1).counts[threadIdx.x] = 0;
}

// The tile of this block; blocks in their own order where the list does not hold every tile once, as before the first
// step.
CS_INLINE int ordered_tile(const Frame& f) {
  const int block = int(blockIdx.x);
  if (!f.order) return block;
  const Order before(f, ~f.step->number & 1);
  int place = -1, listed = 0;
  for (int cost = kCosts - 1; cost >= 0; cost--) {
    const int count = before.counts[cost], rank = block - listed;
    if (rank >= 0 && rank < count) place = cost * before.stride + rank;
    listed += count;
  }
  return listed == before.stride && place >= 0 ? before.tiles[place] : block;
}

// Notes the time of a tile; one thread's work.
CS_INLINE void note_cost(const Frame& f, int tile, unsigned clocks) {
  const Order now(f, f.step->number & 1);
  const int cost = least(most(int(2.0f * log2f(float(clocks))) - kCheapest, 0), kCosts - 1);
  const int rank = atomicAdd(now.counts + cost, 1);
  if (rank < now.stride) now.tiles[cost * now.stride + rank] = tile;  // more only where a step is not a whole one
}

}  // namespace cs
