// Loops whose turns any thread may take.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace cs {
namespace {

// How many of the threads are worth starting for so many turns, each of which does at least `least`.
inline int64_t worth_starting(int64_t threads, int64_t turns, int64_t least) {
  return std::clamp<int64_t>(turns / least, 1, std::max<int64_t>(threads, 1));
}

// Calls body(index) once for every index below count, on up to so many threads, this one among them. Which thread takes
// which is left to chance, so a body writes only what is its index's own. Rethrows the first exception of a body.
template <class Body>
void each_index(int64_t count, int64_t threads, const Body& body) {
  std::atomic<int64_t> next{0};
  std::exception_ptr failure;
  std::mutex mutex;
  const auto work = [&] {
    try {
      for (int64_t i; (i = next.fetch_add(1)) < count;) body(i);
    } catch (...) {
      std::lock_guard<std::mutex> lock(mutex);
      if (!failure) failure = std::current_exception();
      next = count;
    }
  };
  std::vector<std::thread> others;
  try {
    for (int64_t n = 1; n < std::min(threads, count); n++) others.emplace_back(work);
  } catch (const std::system_error&) {
    // The machine has no more threads: those that there are do the work.
  }
  work();
  for (std::thread& thread : others) thread.join();
  if (failure) std::rethrow_exception(failure);
}

}  // namespace
}  // namespace cs
