// The CUDA engine: one step is set_step, blunt, flatten, bin, raster, update, in this order on one stream.
//
// Compiled at first use by NVRTC, and by the tests with a C++ compiler against an emulator of CUDA's threads; no header
// of the toolkit is needed. The kernels take one plain struct and know nothing of torch. No kernel waits for the host,
// nothing is sorted and every buffer has a fixed size, so a step can be captured in a CUDA graph; what changes between
// its replays is in Step. The gradients are added with atomics, in no fixed order: pictures repeat bit by bit,
// gradients up to rounding.

#include "raster.cuh"
#include "spikes.cuh"
#include "update.cuh"

#ifndef CS_DYNAMIC_SHARED
#define CS_DYNAMIC_SHARED(name) extern __shared__ __align__(16) unsigned char name[]
#endif

extern "C" {

// Values reach the device as a kernel's arguments: no pinned memory, no copy that a later step could overtake.
__global__ void set_step(const cs::Step values, cs::Step* step) { *step = values; }

__global__ void __launch_bounds__(cs::kSmallThreads) blunt(const cs::Frame f) {
  CS_DYNAMIC_SHARED(memory);
  cs::blunt_curve(f, memory);
}

__global__ void __launch_bounds__(cs::kSmallThreads) flatten(const cs::Frame f) { cs::flatten_curve(f); }

__global__ void __launch_bounds__(cs::kSmallThreads) bin(const cs::Frame f) { cs::bin_curves(f); }

__global__ void __launch_bounds__(cs::kThreads, 4) raster_relaxed(const cs::Frame f) {
  CS_DYNAMIC_SHARED(memory);
  cs::raster_tile<false>(f, memory);
}

__global__ void __launch_bounds__(cs::kThreads, 3) raster_exact(const cs::Frame f) {
  CS_DYNAMIC_SHARED(memory);
  cs::raster_tile<true>(f, memory);
}

__global__ void __launch_bounds__(cs::kSmallThreads) update(const cs::Frame f) { cs::update_or_total(f); }
}
