// The regions of a picture: connected pixels of one fill colour.
#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

#include "abi.h"
#include "groups.h"

extern "C" {

// The parts of equal values >= -1, connected along the sides of pixels (height x width), numbered by their values and then
// their first pixels. Returns how many there are; -1 where there is no memory.
CS_EXPORT int64_t cs_components(const int32_t* values, int64_t height, int64_t width, int32_t* labels) {
  return cs::counted([&] {
    cs::Groups groups;
    std::vector<int32_t> value, numbers;  // of what a group is made of; of each such thing that of its group
    for (int64_t y = 0; y < height; y++)
      for (int64_t x = 0; x < width; x++) {
        const int64_t i = y * width + x;
        const bool left = x > 0 && values[i] == values[i - 1], above = y > 0 && values[i] == values[i - width];
        if (left || above) {
          labels[i] = labels[left ? i - 1 : i - width];
          if (left && above) groups.join(labels[i], labels[i - width]);
        } else {
          labels[i] = int32_t(groups.added());
          value.push_back(values[i]);
        }
      }
    const int64_t count = groups.numbered(numbers);
    std::vector<int32_t> own(count), order(count), place(count);
    for (size_t k = numbers.size(); k-- > 0;) own[numbers[k]] = value[k];
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int32_t a, int32_t b) { return own[a] < own[b]; });
    for (int64_t n = 0; n < count; n++) place[order[n]] = int32_t(n);
    for (int64_t i = 0; i < height * width; i++) labels[i] = place[numbers[labels[i]]];
    return count;
  });
}

// Of parts (n px), from 0 on: how many px each has, how many of these are marked, and the value of its last one.
CS_EXPORT void cs_part_facts(int64_t n, const int32_t* parts, const int32_t* values, const uint8_t* marked,
                             int64_t* sizes, int64_t* marks, int32_t* value) {
  for (int64_t i = 0; i < n; i++) {
    const int32_t part = parts[i];
    sizes[part]++, marks[part] += marked[i], value[part] = values[i];
  }
}
}
