// Sums and votes within a warp.
#pragma once

#include "frame.cuh"

namespace cs {

constexpr unsigned kFullWarp = 0xffffffffu;

CS_INLINE unsigned ballot(bool vote) { return __ballot_sync(kFullWarp, vote); }
CS_INLINE bool any(bool vote) { return __any_sync(kFullWarp, vote) != 0; }
CS_INLINE bool all(bool vote) { return __all_sync(kFullWarp, vote) != 0; }

CS_INLINE int lowest(unsigned bits) { return __ffs(int(bits)) - 1; }

CS_INLINE float warp_least(float x) {
#pragma unroll
  for (int step = 16; step > 0; step >>= 1) x = fminf(x, __shfl_xor_sync(kFullWarp, x, step));
  return x;
}

CS_INLINE float warp_most(float x) {
#pragma unroll
  for (int step = 16; step > 0; step >>= 1) x = fmaxf(x, __shfl_xor_sync(kFullWarp, x, step));
  return x;
}

CS_INLINE float warp_sum(float x) {
#pragma unroll
  for (int step = 16; step > 0; step >>= 1) x += __shfl_xor_sync(kFullWarp, x, step);
  return x;
}

// Halves the values a lane holds: of 2 N it keeps N, added to those of its partner `step` lanes away.
template <int N>
CS_INLINE void exchange(float* values, int step, int lane) {
  const bool upper = (lane & step) != 0;
#pragma unroll
  for (int i = 0; i < N; i++) {
    float sent = upper ? values[i] : values[i + N], kept = upper ? values[i + N] : values[i];
    values[i] = kept + __shfl_xor_sync(kFullWarp, sent, step);
  }
}

// Sums of eight values over the warp in 9 shuffles instead of 40: lane l gets the sum of value l / 4.
CS_INLINE float sum_of_eight(float* values, int lane) {
  exchange<4>(values, 16, lane);
  exchange<2>(values, 8, lane);
  exchange<1>(values, 4, lane);
  float x = values[0];
  x += __shfl_xor_sync(kFullWarp, x, 2);
  return x + __shfl_xor_sync(kFullWarp, x, 1);
}

// The same for four values in 6 shuffles: lane l gets the sum of value l / 8.
CS_INLINE float sum_of_four(float* values, int lane) {
  exchange<2>(values, 16, lane);
  exchange<1>(values, 8, lane);
  float x = values[0];
  x += __shfl_xor_sync(kFullWarp, x, 4);
  x += __shfl_xor_sync(kFullWarp, x, 2);
  return x + __shfl_xor_sync(kFullWarp, x, 1);
}

// Sums of eight values over each group of eight lanes: lane l gets its group's sum of value l mod 8.
CS_INLINE float sum_of_row(float* values, int lane) {
  exchange<4>(values, 4, lane);
  exchange<2>(values, 2, lane);
  exchange<1>(values, 1, lane);
  return values[0];
}

// Number of set bits in the lanes before this one.
CS_INLINE int count_before(int count, int lane) {
  int sum = count;
#pragma unroll
  for (int step = 1; step < kWarp; step <<= 1) {
    int other = __shfl_up_sync(kFullWarp, sum, step);
    if (lane >= step) sum += other;
  }
  return sum - count;
}

}  // namespace cs
