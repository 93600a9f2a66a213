// Runs a program's kernels on the CPU, block after block, and finds misuse of barriers: see README.md.

#include "cuda_shim.h"

#include <algorithm>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>
#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

#include "fibers.h"

namespace emulator {
namespace {

constexpr unsigned kLanes = 32;
constexpr size_t kStackBytes = 128 * 1024;

enum class State { ready, waiting, done };

// A place in the source where a thread waits.
struct Stop {
  Meeting kind;
  const char* file;
  int line;

  bool operator==(const Stop& other) const { return kind == other.kind && line == other.line && file == other.file; }
  bool of_block() const { return kind == Meeting::syncthreads || kind == Meeting::syncthreads_or; }
};

struct Thread {
  Fiber fiber;
  State state = State::ready;
  Stop stop{};
  uint64_t value = 0, result = 0;
  int argument = 0;
  std::unique_ptr<unsigned char[]> stack;
};

struct Machine {
  Fiber scheduler;
  std::vector<Thread> threads;
  unsigned current = 0, count = 0;
  Index block{};
  std::unique_ptr<unsigned char[]> shared;
  void (*kernel)(const void*) = nullptr;
  const void* frame = nullptr;
  std::string error;
  unsigned order = 0;  // 0: as numbered; else the seed of the order in which ready threads run
} machine;

void run_thread() {
  machine.kernel(machine.frame);
  machine.threads[machine.current].state = State::done;
  hand_over(machine.threads[machine.current].fiber, machine.scheduler);
}

std::string describe(const Stop& stop) {
  static const char* const names[] = {"__syncthreads",   "__syncthreads_or", "__syncwarp", "vote",
                                      "__shfl_xor_sync", "__shfl_up_sync",   "__shfl_sync"};
  const char* slash = std::strrchr(stop.file, '/');
  return std::string(names[int(stop.kind)]) + " at " + (slash ? slash + 1 : stop.file) + ":" +
         std::to_string(stop.line);
}

void fail(const std::string& what) {
  if (machine.error.empty())
    machine.error = "block (" + std::to_string(machine.block.x) + ", " + std::to_string(machine.block.y) + "): " + what;
}

// Have the threads first .. first + count - 1 all come to one stop? Reports those that can never meet.
bool all_arrived(unsigned first, unsigned count) {
  const Thread& leader = machine.threads[first];
  for (unsigned i = first; i < first + count; i++) {
    const Thread& t = machine.threads[i];
    if (t.state != State::waiting || !(t.stop == leader.stop)) return false;
  }
  return true;
}

void release_warp(unsigned first) {
  Thread* lanes = &machine.threads[first];
  uint64_t votes = 0;
  for (unsigned i = 0; i < kLanes; i++) votes |= uint64_t(lanes[i].value & 1) << i;
  for (unsigned i = 0; i < kLanes; i++) {
    Thread& t = lanes[i];
    unsigned source = i;
    switch (t.stop.kind) {
      case Meeting::shuffle_xor: source = i ^ unsigned(t.argument); break;
      case Meeting::shuffle_up: source = i >= unsigned(t.argument) ? i - unsigned(t.argument) : i; break;
      case Meeting::shuffle: source = unsigned(t.argument) % kLanes; break;
      default: break;
    }
    t.result = t.stop.kind == Meeting::ballot ? votes : lanes[source].value;
  }
  for (unsigned i = 0; i < kLanes; i++) lanes[i].state = State::ready;
}

void release_block() {
  uint64_t any = 0;
  for (unsigned i = 0; i < machine.count; i++) any |= machine.threads[i].value;
  for (unsigned i = 0; i < machine.count; i++) {
    machine.threads[i].result = any;
    machine.threads[i].state = State::ready;
  }
}

// Runs the ready threads of a warp until each waits or is done. Returns whether any ran.
bool run_warp(unsigned first, const std::vector<unsigned>& lanes) {
  bool ran = false;
  for (unsigned lane : lanes) {
    Thread& t = machine.threads[first + lane];
    if (t.state != State::ready) continue;
    machine.current = first + lane;
    hand_over(machine.scheduler, t.fiber);
    ran = true;
  }
  if (machine.threads[first].state == State::waiting && !machine.threads[first].stop.of_block() &&
      all_arrived(first, kLanes)) {
    release_warp(first);
    ran = true;
  }
  return ran;
}

void report_deadlock() {
  std::string text = "threads wait for each other:";
  int listed = 0;
  for (unsigned i = 0; i < machine.count && listed < 4; i++) {
    const Thread& t = machine.threads[i];
    if (i > 0 && t.state == machine.threads[i - 1].state && t.stop == machine.threads[i - 1].stop) continue;
    text += " from thread " + std::to_string(i) + " on " + (t.state == State::done ? "done" : describe(t.stop)) + ";";
    listed++;
  }
  fail(text);
}

std::vector<unsigned> shuffled(unsigned count) {
  std::vector<unsigned> order(count);
  for (unsigned i = 0; i < count; i++) order[i] = i;
  for (unsigned i = count; machine.order && i > 1; i--) {
    machine.order = machine.order * 1664525u + 1013904223u;
    std::swap(order[i - 1], order[(machine.order >> 16) % i]);
  }
  return order;
}

void run_block() {
  for (unsigned i = 0; i < machine.count; i++) {
    Thread& t = machine.threads[i];
    t.state = State::ready;
    start(t.fiber, t.stack.get(), kStackBytes, run_thread);
  }
  while (machine.error.empty()) {
    bool ran = false;
    for (unsigned warp : shuffled(machine.count / kLanes)) ran |= run_warp(warp * kLanes, shuffled(kLanes));
    if (ran) continue;
    unsigned done = 0;
    for (unsigned i = 0; i < machine.count; i++) done += machine.threads[i].state == State::done;
    if (done == machine.count) return;
    if (done == 0 && machine.threads[0].stop.of_block() && all_arrived(0, machine.count))
      release_block();
    else
      report_deadlock();
  }
}

}  // namespace

Index thread_index() { return {machine.current, 0, 0}; }
Index block_index() { return machine.block; }
unsigned char* dynamic_shared() { return machine.shared.get(); }

uint64_t meet(Meeting kind, unsigned mask, uint64_t value, int argument, const char* file, int line) {
  Thread& t = machine.threads[machine.current];
  if (mask != 0xffffffffu) fail("only whole warps are emulated, not the mask " + std::to_string(mask));
  t.stop = {kind, file, line};
  t.value = value;
  t.argument = argument;
  t.state = State::waiting;
  hand_over(t.fiber, machine.scheduler);
  return t.result;
}

}  // namespace emulator

extern "C" {

// Shared memory starts as NaN in every block, so that reading what was not written shows. Returns the error, or null.
const char* emulator_launch(const char* name, unsigned blocks_x, unsigned blocks_y, unsigned threads, size_t shared,
                            const void* frame, unsigned order) {
  auto& m = emulator::machine;
  m.error.clear();
  m.kernel = nullptr;
  for (const emulator::Kernel* entry = emulator::kKernels; entry->name; entry++)
    if (std::strcmp(entry->name, name) == 0) m.kernel = entry->run;
  if (!m.kernel || threads == 0 || threads % emulator::kLanes || blocks_x == 0 || blocks_y == 0)
    emulator::fail(std::string("cannot launch ") + name);
  m.frame = frame;
  m.count = threads;
#if defined(EMULATOR_APPROXIMATE) && defined(__SSE2__)
  const unsigned control = _mm_getcsr();
  _mm_setcsr(control | 0x8040u);  // numbers too small for the normal format are zero, as with --ftz=true
#endif
  m.order = order;
  while (m.threads.size() < threads) {
    m.threads.emplace_back();
    m.threads.back().stack.reset(new unsigned char[emulator::kStackBytes]);
  }
  for (m.block.y = 0; m.block.y < blocks_y; m.block.y++)
    for (m.block.x = 0; m.block.x < blocks_x && m.error.empty(); m.block.x++) {
      m.shared.reset(new unsigned char[shared + 16]);
      std::memset(m.shared.get(), 0xff, shared);
      emulator::run_block();
    }
#if defined(EMULATOR_APPROXIMATE) && defined(__SSE2__)
  _mm_setcsr(control);
#endif
  return m.error.empty() ? nullptr : m.error.c_str();
}
}
