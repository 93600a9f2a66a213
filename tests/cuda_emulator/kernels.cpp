// The kernels of raster.cu for the emulator, compiled once for each program.

#include "cuda_shim.h"
#include "raster.cu"

namespace emulator {
namespace {

// Mistakes on purpose, which the tests want to see found.
void divergent_barrier(const cs::Frame) {
  if (threadIdx.x < 40) __syncthreads();
}

void divergent_vote(const cs::Frame) {
  if (threadIdx.x % 32 < 8) __ballot_sync(0xffffffffu, true);
}

void two_places(const cs::Frame) {
  if (threadIdx.x % 2)
    __syncwarp();
  else
    __ballot_sync(0xffffffffu, true);
}

void partial_mask(const cs::Frame) { __ballot_sync(0xffu, true); }

// Without the barrier, what a warp reads depends on which warp ran first.
void missing_barrier(const cs::Frame f) {
  int* values = reinterpret_cast<int*>(dynamic_shared());
  values[threadIdx.x] = int(threadIdx.x);
  if (threadIdx.x < 32) f.status[threadIdx.x] = values[32 + threadIdx.x];
}

void past_the_end(const cs::Frame f) { f.status[2] = 1; }

template <void (*Kernel)(const cs::Frame)>
void call(const void* frame) {
  Kernel(*static_cast<const cs::Frame*>(frame));
}

}  // namespace

const Kernel kKernels[] = {{"blunt", call<blunt>},
                           {"flatten", call<flatten>},
                           {"bin", call<bin>},
                           {"raster_relaxed", call<raster_relaxed>},
                           {"raster_exact", call<raster_exact>},
                           {"update", call<update>},
                           {"divergent_barrier", call<divergent_barrier>},
                           {"divergent_vote", call<divergent_vote>},
                           {"two_places", call<two_places>},
                           {"partial_mask", call<partial_mask>},
                           {"missing_barrier", call<missing_barrier>},
                           {"past_the_end", call<past_the_end>},
                           {nullptr, nullptr}};

}  // namespace emulator

extern "C" void emulator_set_step(const cs::Step* values, cs::Step* step) { set_step(*values, step); }
