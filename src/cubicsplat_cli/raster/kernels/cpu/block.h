// How a tile is cut up: sixteen blocks of 4 x 4 pixels, each one vector, and the scratch memory they share.
//
// A block is as compact as a vector can be, so that few of them lie near an outline and few edges near each of them.
#pragma once

#include "lanes.h"
#include "tile.h"

namespace cs {
namespace CS_ISA {

constexpr int kBlock = 4;                                     // pixels per side
constexpr int kBlocks = (kTile / kBlock) * (kTile / kBlock);  // of a tile, row by row
static_assert(kBlock * kBlock == kLanes, "a block is one vector");
static_assert(kBlocks == kLanes, "the blocks of a tile can be looked at all at once");

// A block's place; x and y count from the tile's corner.
struct Block {
  int number;
  float left, top;
  Lanes px, py;  // pixel centres

  explicit Block(int n)
      : number(n), left(float(n % 4 * kBlock)), top(float(n / 4 * kBlock)), px(columns() + Lanes(left)),
        py(rows() + Lanes(top)) {}
};

CS_INLINE unsigned lowest_bit(unsigned m) {
#if defined(__GNUC__)
  return unsigned(__builtin_ctz(m));
#else
  unsigned n = 0;
  while (!(m >> n & 1)) n++;
  return n;
#endif
}

// Asks for memory that will be needed soon: a tile's share of large lists and pictures, scattered as it is.
CS_INLINE void ask_for(const void* begin, size_t bytes) {
#if defined(__GNUC__)
  const char* at = static_cast<const char*>(begin);
  const char* const end = at + bytes;
  for (at -= reinterpret_cast<uintptr_t>(at) & 63; at < end; at += 64) {
    __builtin_prefetch(at);
    __asm__ __volatile__("");  // or GCC takes the function for one without effects, and leaves out its calls
  }
#endif
}

constexpr size_t aligned(size_t bytes) { return (bytes + 63) & ~size_t(63); }

// Hands out pieces of the tile's scratch memory.
struct Arena {
  char* at;
  template <class T>
  T* take(size_t count) {
    T* result = reinterpret_cast<T*>(at);
    at += aligned(count * sizeof(T));
    return result;
  }
};

}  // namespace CS_ISA
}  // namespace cs
