// The skeletons of masks. raster/ndimage.py says what the function means.
#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

// For each set of neighbours, bit k for the k-th of east, southeast, south and so on around: whether a pixel with these
// may go, since it is no end and what is left hangs together as before (S. Yokoi, J. Toriwaki and T. Fukumura, "An
// Analysis of Topological Properties of Digitized Binary Pictures Using Local Features", 1975, whose number this is).
std::array<bool, 256> removable() {
  std::array<bool, 256> out{};
  for (int set = 0; set < 256; set++) {
    const auto off = [&](int k) { return 1 - (set >> (k % 8) & 1); };
    int number = 0, count = 0;
    for (int k = 0; k < 8; k += 2) number += off(k) - off(k) * off(k + 1) * off(k + 2);
    for (int k = 0; k < 8; k++) count += 1 - off(k);
    out[set] = number == 1 && count >= 2;
  }
  return out;
}
}  // namespace
}  // namespace cs

using namespace cs;

extern "C" {
// Thins a mask (height, width) whose border is 0, in place: pixels on its four sides go in turns (A. Rosenfeld, "A
// Characterization of Parallel Thinning Algorithms", 1975). Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_thin(int64_t height, int64_t width, uint8_t* mask) {
  return failed([&] {
    static const std::array<bool, 256> goes = removable();
    const int64_t around[8] = {1, width + 1, width, width - 1, -1, -width - 1, -width, 1 - width};
    std::vector<int64_t> edge, gone;  // pixels beside others that are not in the mask
    std::vector<uint8_t> on_edge(height * width, 0);
    const auto add = [&](int64_t i) {
      if (mask[i] && !on_edge[i]) on_edge[i] = 1, edge.push_back(i);
    };
    for (int64_t i = width; i < (height - 1) * width; i++)
      if (mask[i] && !(mask[i - 1] && mask[i + 1] && mask[i - width] && mask[i + width])) add(i);
    for (int64_t idle = 0, side = 0; idle < 4; side = (side + 2) % 8) {
      gone.clear();
      for (const int64_t i : edge) {
        if (mask[i + around[side]]) continue;
        int set = 0;
        for (int k = 0; k < 8; k++) set |= mask[i + around[k]] << k;
        if (goes[set]) gone.push_back(i);
      }
      for (const int64_t i : gone) mask[i] = 0;
      edge.erase(std::remove_if(edge.begin(), edge.end(), [&](int64_t i) { return !mask[i]; }), edge.end());
      for (const int64_t i : gone)
        for (int k = 0; k < 8; k += 2) add(i + around[k]);
      idle = gone.empty() ? idle + 1 : 0;
    }
  });
}
}
