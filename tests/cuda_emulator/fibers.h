// Threads that run one at a time on stacks of their own and hand over by themselves.
#pragma once

#include <cstddef>
#include <cstdint>

namespace emulator {

#if defined(__x86_64__) && defined(__linux__) && !defined(EMULATOR_UCONTEXT)

// swapcontext() makes a system call each time; this does not, and the emulated warps meet very often.
struct Fiber {
  void* stack_pointer = nullptr;
};

extern "C" void emulator_switch(void** save, void* load);
__asm__(
    ".text\n"
    ".type emulator_switch,@function\n"
    "emulator_switch:\n"
    "  pushq %rbp\n  pushq %rbx\n  pushq %r12\n  pushq %r13\n  pushq %r14\n  pushq %r15\n"
    "  movq %rsp, (%rdi)\n"
    "  movq %rsi, %rsp\n"
    "  popq %r15\n  popq %r14\n  popq %r13\n  popq %r12\n  popq %rbx\n  popq %rbp\n"
    "  ret\n"
    ".size emulator_switch,.-emulator_switch\n");

inline void start(Fiber& fiber, unsigned char* stack, size_t bytes, void (*entry)()) {
  uintptr_t top = (reinterpret_cast<uintptr_t>(stack) + bytes) & ~uintptr_t(15);
  void** at = reinterpret_cast<void**>(top);
  *--at = nullptr;  // keeps the stack aligned as after a call
  *--at = reinterpret_cast<void*>(entry);
  for (int i = 0; i < 6; i++) *--at = nullptr;
  fiber.stack_pointer = at;
}

inline void hand_over(Fiber& from, Fiber& to) { emulator_switch(&from.stack_pointer, to.stack_pointer); }

#else

}  // namespace emulator
#include <ucontext.h>
namespace emulator {

struct Fiber {
  ucontext_t context;
};

inline void start(Fiber& fiber, unsigned char* stack, size_t bytes, void (*entry)()) {
  getcontext(&fiber.context);
  fiber.context.uc_stack.ss_sp = stack;
  fiber.context.uc_stack.ss_size = bytes;
  fiber.context.uc_link = nullptr;
  makecontext(&fiber.context, entry, 0);
}

inline void hand_over(Fiber& from, Fiber& to) { swapcontext(&from.context, &to.context); }

#endif

}  // namespace emulator
