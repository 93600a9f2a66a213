// Carries out calls of the C interface for a process of another architecture: reads each from stdin, with all that
// its structures point to, and writes back what has become of that. See tests/arm/emulated_arm.py for the other side.

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "abi.h"

namespace {

enum Function : int32_t { render, gradients, run };
enum Part { scene, settings, images, gradient, training, steps, parts };

void read(void* to, size_t bytes) {
  if (bytes && std::fread(to, bytes, 1, stdin) != 1) std::exit(0);  // the other side has gone
}

template <class T>
T read() {
  T value;
  read(&value, sizeof value);
  return value;
}

void write(const void* from, size_t bytes) {
  if (bytes && std::fwrite(from, bytes, 1, stdout) != 1) std::exit(1);
}

std::vector<char> read_bytes() {
  std::vector<char> bytes(read<uint64_t>());
  read(bytes.data(), bytes.size());
  return bytes;
}

int32_t call(CsEngine* engine, Function function, std::vector<char>* part) {
  const auto* s = reinterpret_cast<CsScene*>(part[scene].data());
  const auto* t = reinterpret_cast<CsSettings*>(part[settings].data());
  const auto* i = reinterpret_cast<CsImages*>(part[images].data());
  const auto* g = reinterpret_cast<CsGradients*>(part[gradient].data());
  if (function == render) return cs_render(engine, s, t, i);
  if (function == gradients) return cs_gradients(engine, s, t, i, g);
  return cs_run(engine, s, t, i, g, reinterpret_cast<CsTraining*>(part[training].data()),
                reinterpret_cast<CsRun*>(part[steps].data()));
}

void serve(CsEngine* engine) {
  const auto function = read<Function>();
  std::vector<char> part[parts];
  for (auto& p : part) p = read_bytes();
  std::vector<std::vector<char>> buffers(read<uint64_t>());
  for (auto& buffer : buffers) {
    const auto owner = read<uint64_t>(), place = read<uint64_t>();
    buffer = read_bytes();
    const void* at = buffer.data();
    std::memcpy(part[owner].data() + place, &at, sizeof at);
  }
  const int32_t status = call(engine, function, part);
  const std::string error = cs_error(engine);
  const uint64_t length = error.size();
  double seconds[4];
  int64_t counts[4];
  cs_timings(engine, seconds);
  cs_counts(engine, counts);
  write(&status, sizeof status);
  write(&length, sizeof length);
  write(error.data(), length);
  write(seconds, sizeof seconds);
  write(counts, sizeof counts);
  for (const auto& buffer : buffers) write(buffer.data(), buffer.size());
  std::fflush(stdout);
}

}  // namespace

// Arguments: threads, instruction set.
int main(int count, char** arguments) {
  CsEngine* engine = count == 3 ? cs_create(std::atoi(arguments[1]), arguments[2]) : nullptr;
  const char ready = engine ? 'y' : 'n';
  write(&ready, 1);
  std::fflush(stdout);
  while (engine) serve(engine);
  return 1;
}
