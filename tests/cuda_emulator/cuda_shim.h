// The part of CUDA that the kernels use, for a C++ compiler: see README.md.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#define __CUDACC__
#define __global__
#define __device__
#define __host__
#define __forceinline__ inline __attribute__((always_inline))
#define __shared__ static  // one block runs at a time
#define __align__(n) alignas(n)
#define __launch_bounds__(...)
#define __restrict__ __restrict
#define CS_DYNAMIC_SHARED(name) unsigned char* name = emulator::dynamic_shared()

struct alignas(8) float2 {
  float x, y;
};
struct alignas(16) float4 {
  float x, y, z, w;
};
inline float2 make_float2(float x, float y) { return {x, y}; }
inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }

namespace emulator {

struct Index {
  unsigned x, y, z;
};

// What lanes or threads wait for together.
enum class Meeting { syncthreads, syncthreads_or, syncwarp, ballot, shuffle_xor, shuffle_up, shuffle };

// A kernel of a program by its name; kernels.cpp lists them, up to one without a name.
struct Kernel {
  const char* name;
  void (*run)(const void* frame);
};
extern const Kernel kKernels[];

Index thread_index();
Index block_index();
unsigned char* dynamic_shared();
// Waits until all threads of the block (syncthreads) or all lanes of the warp have come to the same line of the source
// for the same purpose, and returns the result for the caller: the other lane's bits, the ballot, or the disjunction.
uint64_t meet(Meeting kind, unsigned mask, uint64_t value, int argument, const char* file, int line);

template <class T>
uint64_t bits_of(T value) {
  uint64_t bits = 0;
  std::memcpy(&bits, &value, sizeof value);
  return bits;
}

template <class T>
T from_bits(uint64_t bits) {
  T value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

template <class T>
T exchange(Meeting kind, unsigned mask, T value, int argument, const char* file, int line) {
  return from_bits<T>(meet(kind, mask, bits_of(value), argument, file, line));
}

// A result as far off as the GPU's approximate division and square root may be: 2 units in the last place, up or down
// by the bits of the result.
inline float approximate(float exact) {
#ifdef EMULATOR_APPROXIMATE
  const uint32_t bits = uint32_t(bits_of(exact));
  const float toward = (bits * 2654435761u) >> 31 ? INFINITY : -INFINITY;
  if (std::isfinite(exact) && exact != 0.0f) exact = std::nextafter(std::nextafter(exact, toward), toward);
#endif
  return exact;
}

template <class T>
T fetch_add(T* at, T value) {
  T before = *at;
  *at = before + value;
  return before;
}

}  // namespace emulator

#define threadIdx (emulator::thread_index())
#define blockIdx (emulator::block_index())
#define EMULATOR_MEET(kind, mask, value, argument) \
  emulator::meet(emulator::Meeting::kind, mask, value, argument, __FILE__, __LINE__)
#define __syncthreads() EMULATOR_MEET(syncthreads, ~0u, 0, 0)
#define __syncthreads_or(vote) int(EMULATOR_MEET(syncthreads_or, ~0u, (vote) ? 1 : 0, 0))
#define __syncwarp() EMULATOR_MEET(syncwarp, ~0u, 0, 0)
#define __ballot_sync(mask, vote) unsigned(EMULATOR_MEET(ballot, mask, (vote) ? 1 : 0, 0))
#define __any_sync(mask, vote) int(EMULATOR_MEET(ballot, mask, (vote) ? 1 : 0, 0) != 0)
#define __all_sync(mask, vote) int(EMULATOR_MEET(ballot, mask, (vote) ? 1 : 0, 0) == 0xffffffffu)
#define __shfl_sync(mask, value, lane) \
  emulator::exchange(emulator::Meeting::shuffle, mask, value, lane, __FILE__, __LINE__)
#define __shfl_xor_sync(mask, value, step) \
  emulator::exchange(emulator::Meeting::shuffle_xor, mask, value, step, __FILE__, __LINE__)
#define __shfl_up_sync(mask, value, step) \
  emulator::exchange(emulator::Meeting::shuffle_up, mask, value, step, __FILE__, __LINE__)

inline float __fdividef(float a, float b) { return emulator::approximate(a / b); }
inline float emulated_root(float x) { return emulator::approximate(std::sqrt(x)); }
#define sqrtf emulated_root
inline int __popc(unsigned x) { return __builtin_popcount(x); }
inline int __ffs(int x) { return __builtin_ffs(x); }
inline float __saturatef(float x) { return x > 0.0f ? (x < 1.0f ? x : 1.0f) : 0.0f; }  // NaN gives 0, as on the GPU
inline float atomicAdd(float* at, float value) { return emulator::fetch_add(at, value); }
inline int atomicAdd(int* at, int value) { return emulator::fetch_add(at, value); }
// A clock by which the tiles take any time, so that they are drawn in any order.
inline long long clock64() {
  static uint64_t state = 1, time = 0;
  state = state * 6364136223846793005ull + 1442695040888963407ull;
  return (long long)(time += 1ull << (state >> 60));
}
inline int atomicCAS(int* at, int expected, int value) {
  int before = *at;
  if (before == expected) *at = value;
  return before;
}
