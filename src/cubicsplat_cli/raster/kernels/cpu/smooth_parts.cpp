// Where the colours of a picture change evenly, and how much they change in each of its parts.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

constexpr int kLevels = 256, kFine = 16;  // of a channel, and how many steps of a level are told apart

// The values of a picture with one px more on all sides, which goes on as straight as it ends.
std::vector<float> extended(int64_t height, int64_t width, const float* levels) {
  const int64_t wide = 4 * (width + 2);
  std::vector<float> out(wide * (height + 2));
  for (int64_t y = 0; y < height; y++)
    std::copy(levels + 4 * width * y, levels + 4 * width * (y + 1), &out[wide * (y + 1) + 4]);
  const auto go_on = [&](int64_t at, int64_t step, bool longer) {
    for (int k = 0; k < 4; k++)
      out[at + k] = longer ? 2.0f * out[at + step + k] - out[at + 2 * step + k] : out[at + step + k];
  };
  for (int64_t x = 1; x <= width; x++) {
    go_on(4 * x, wide, height > 1);
    go_on(wide * (height + 1) + 4 * x, -wide, height > 1);
  }
  for (int64_t y = 0; y < height + 2; y++) {
    go_on(wide * y, 4, width > 1);
    go_on(wide * y + 4 * (width + 1), -4, width > 1);
  }
  return out;
}

// Levels between which all but a share of so many values at either end lie, of the widest channel.
class Range {
 public:
  Range() : counts_(4 * kLevels * kFine) {}

  template <class Value>
  void add(const Value* value) {
    for (int k = 0; k < 4; k++)
      counts_[kLevels * kFine * k + std::clamp(int(double(value[k]) * kFine + 0.5), 0, kLevels * kFine - 1)]++;
    total_++;
  }

  double trimmed(double share) const {
    double most = 0.0;
    const int64_t skipped = int64_t(share * double(total_ - 1));
    for (int k = 0; k < 4; k++) {
      const int64_t* own = &counts_[kLevels * kFine * k];
      int low = 0, high = kLevels * kFine - 1;
      for (int64_t passed = own[low]; passed <= skipped;) passed += own[++low];
      for (int64_t passed = own[high]; passed <= skipped;) passed += own[--high];
      most = std::max(most, double(high - low) / kFine);
    }
    return most;
  }

 private:
  std::vector<int64_t> counts_;
  int64_t total_ = 0;
};

}  // namespace
}  // namespace cs

extern "C" {

// Of every pixel of a picture (height x width x 4), levels, the greatest second difference of all channels and four
// directions, and the greatest difference between opposite neighbours. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_bends(int64_t height, int64_t width, const float* levels, float* bends, float* steps) {
  return cs::failed([&] {
    const std::vector<float> around = cs::extended(height, width, levels);
    const int64_t wide = 4 * (width + 2), offsets[4] = {4, wide, wide + 4, wide - 4};
    for (int64_t y = 0; y < height; y++)
      for (int64_t x = 0; x < width; x++) {
        const float* own = &around[wide * (y + 1) + 4 * (x + 1)];
        float bend = 0.0f, step = 0.0f;
        for (const int64_t offset : offsets)
          for (int k = 0; k < 4; k++) {
            const float after = own[k + offset], before = own[k - offset];
            bend = std::max(bend, std::fabs(after - 2.0f * own[k] + before));
            step = std::max(step, std::fabs(after - before));
          }
        bends[y * width + x] = bend, steps[y * width + x] = step;
      }
  });
}

// Of `count` parts, numbered from 1 on, of a picture (height x width x 4): pixels, first and last row and column (x 4), and
// levels between the least and the greatest value of the widest channel. Pixels of other numbers belong to none.
CS_EXPORT void cs_part_spreads(int64_t height, int64_t width, const float* levels, const int32_t* parts, int64_t count,
                               int64_t* sizes, int64_t* boxes, float* spreads) {
  std::fill(sizes, sizes + count, 0), std::fill(spreads, spreads + count, 0.0f);
  const float least = std::numeric_limits<float>::lowest(), most = std::numeric_limits<float>::max();
  std::vector<float> ends(8 * count);
  for (int64_t i = 0; i < count; i++) {
    int64_t* box = boxes + 4 * i;
    box[0] = height, box[1] = -1, box[2] = width, box[3] = -1;
    std::fill(&ends[8 * i], &ends[8 * i] + 4, most), std::fill(&ends[8 * i] + 4, &ends[8 * i] + 8, least);
  }
  for (int64_t y = 0; y < height; y++)
    for (int64_t x = 0; x < width; x++) {
      const int64_t part = parts[y * width + x] - 1;
      if (part < 0 || part >= count) continue;
      sizes[part]++;
      int64_t* box = boxes + 4 * part;
      box[0] = std::min(box[0], y), box[1] = std::max(box[1], y);
      box[2] = std::min(box[2], x), box[3] = std::max(box[3], x);
      for (int k = 0; k < 4; k++) {
        const float value = levels[4 * (y * width + x) + k];
        ends[8 * part + k] = std::min(ends[8 * part + k], value);
        ends[8 * part + 4 + k] = std::max(ends[8 * part + 4 + k], value);
      }
    }
  for (int64_t i = 0; i < count; i++)
    for (int k = 0; k < 4 && sizes[i]; k++) spreads[i] = std::max(spreads[i], ends[8 * i + 4 + k] - ends[8 * i + k]);
}

// Levels between which all values (n x 4) lie but a share of them at either end, of the widest channel; below 0 without
// memory.
CS_EXPORT double cs_trimmed_range(int64_t n, const double* values, double share) {
  return cs::counted([&] {
    cs::Range range;
    for (int64_t i = 0; i < n; i++) range.add(values + 4 * i);
    return range.trimmed(share);
  });
}
}
