// The regions of a picture: connected pixels of one fill colour, what they touch, and what they enclose.
#include <algorithm>
#include <cstdint>
#include <exception>
#include <numeric>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

int32_t root_of(std::vector<int32_t>& parent, int32_t i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

}  // namespace
}  // namespace cs

extern "C" {

// The parts of equal values >= -1, connected along the sides of pixels (height x width), numbered by their values and then
// their first pixels. Returns how many there are; -1 where there is no memory.
CS_EXPORT int64_t cs_components(const int32_t* values, int64_t height, int64_t width, int32_t* labels) {
  using namespace cs;
  try {
    std::vector<int32_t> parent, value;
    for (int64_t y = 0; y < height; y++)
      for (int64_t x = 0; x < width; x++) {
        const int64_t i = y * width + x;
        const bool left = x > 0 && values[i] == values[i - 1], above = y > 0 && values[i] == values[i - width];
        if (left) {
          labels[i] = labels[i - 1];
          if (!above) continue;
          // The smaller one stays, so that parts keep the order of their first pixels.
          const int32_t a = root_of(parent, labels[i - 1]), b = root_of(parent, labels[i - width]);
          parent[std::max(a, b)] = std::min(a, b);
        } else if (above) {
          labels[i] = labels[i - width];
        } else {
          labels[i] = int32_t(parent.size());
          parent.push_back(labels[i]), value.push_back(values[i]);
        }
      }
    std::vector<int32_t> roots;
    for (int32_t k = 0; k < int32_t(parent.size()); k++)
      if (parent[k] == k) roots.push_back(k);
    std::stable_sort(roots.begin(), roots.end(), [&](int32_t a, int32_t b) { return value[a] < value[b]; });
    std::vector<int32_t> number(parent.size());
    for (size_t n = 0; n < roots.size(); n++) number[roots[n]] = int32_t(n);
    for (size_t k = 0; k < parent.size(); k++) number[k] = number[root_of(parent, int32_t(k))];
    for (int64_t i = 0; i < height * width; i++) labels[i] = number[labels[i]];
    return int64_t(roots.size());
  } catch (const std::exception&) {
    return -1;
  }
}

// What a mask (height x width) encloses without being it, connected along the sides of pixels. Returns 1 where there is no
// memory.
CS_EXPORT int32_t cs_holes(const uint8_t* mask, int64_t height, int64_t width, uint8_t* holes) {
  try {
    for (int64_t i = 0; i < height * width; i++) holes[i] = !mask[i];
    std::vector<int64_t> left;
    const auto reach = [&](int64_t i) {
      if (holes[i]) holes[i] = 0, left.push_back(i);
    };
    for (int64_t x = 0; x < width; x++) reach(x), reach((height - 1) * width + x);
    for (int64_t y = 0; y < height; y++) reach(y * width), reach(y * width + width - 1);
    while (!left.empty()) {
      const int64_t i = left.back(), x = i % width;
      left.pop_back();
      if (i >= width) reach(i - width);
      if (i + width < height * width) reach(i + width);
      if (x > 0) reach(i - 1);
      if (x + 1 < width) reach(i + 1);
    }
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}
}
