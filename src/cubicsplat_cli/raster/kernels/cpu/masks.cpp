// Parts of masks and of arrays of labels, and distances. raster/ndimage.py says what each function means.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "abi.h"
#include "groups.h"

namespace cs {
namespace {

// Pixels next to each other in a row, and the number of their part.
struct Run {
  int64_t start, stop, row, part;
};

// The runs of a mask (height, width), those that touch in the same group; diagonally too where reach is 1.
std::vector<Run> runs_of(int64_t height, int64_t width, const uint8_t* mask, int64_t reach, Groups& groups) {
  std::vector<Run> runs;
  size_t above = 0;  // the first run of the row above that may still touch
  for (int64_t y = 0; y < height; y++) {
    const uint8_t* row = mask + y * width;
    const size_t first = runs.size();
    for (int64_t x = 0; x < width; x++) {
      if (!row[x]) continue;
      const int64_t start = x;
      while (x < width && row[x]) x++;
      const int64_t own = groups.added();
      while (above < first && runs[above].stop + reach <= start) above++;
      for (size_t k = above; k < first && runs[k].start < x + reach; k++) groups.join(runs[k].part, own);
      runs.push_back({start, x, y, own});
    }
    above = first;
  }
  return runs;
}

// Extends the boxes (count, 4), top, left, bottom and right, to labels 1 to count.
template <class T>
void boxes(int64_t height, int64_t width, const T* labels, int64_t count, int64_t* out) {
  for (int64_t y = 0; y < height; y++) {
    const T* row = labels + y * width;
    for (int64_t x = 0; x < width;) {
      const T label = row[x];
      const int64_t start = x;
      while (x < width && row[x] == label) x++;
      if (label < 1 || label > count) continue;
      int64_t* box = out + 4 * (label - 1);
      if (!box[2]) box[0] = y, box[1] = start;
      box[1] = std::min(box[1], start), box[2] = y + 1, box[3] = std::max(box[3], x);
    }
  }
}

// A mask with a margin of `high` rows and `wide` columns on all sides.
struct Padded {
  int64_t height, width, high, wide;
  std::vector<uint8_t> bytes;

  Padded(int64_t h, int64_t w, int64_t high, int64_t wide, uint8_t border)
      : height(h), width(w), high(high), wide(wide), bytes((h + 2 * high) * (w + 2 * wide), border) {}
  uint8_t* at(int64_t y, int64_t x) { return &bytes[(y + high) * (width + 2 * wide) + x + wide]; }
};

// One step of the dilation of `from` by a structure (2 high + 1, 2 wide + 1), where the mask is.
void dilate(Padded& from, const uint8_t* structure, const uint8_t* mask, Padded& to) {
  for (int64_t y = 0; y < from.height; y++) {
    uint8_t* __restrict out = to.at(y, 0);
    const uint8_t* own = from.at(y, 0);
    std::fill(out, out + from.width, uint8_t(0));
    for (int64_t dy = -from.high; dy <= from.high; dy++)
      for (int64_t dx = -from.wide; dx <= from.wide; dx++) {
        if (!structure[(dy + from.high) * (2 * from.wide + 1) + dx + from.wide]) continue;
        const uint8_t* in = from.at(y + dy, dx);
        for (int64_t x = 0; x < from.width; x++) out[x] |= in[x];
      }
    if (mask)
      for (int64_t x = 0; x < from.width; x++)
        if (!mask[y * from.width + x]) out[x] = own[x];
  }
}

// The squares of the distances along a row to what is `depths` below or above it: the lower envelope of parabolas
// (A. Meijster, J. Roerdink and W. Hesselink, "A General Algorithm for Computing Distance Transforms in Linear Time",
// 2000, whose separations are these). far: a depth that stands for nothing there.
void envelope(int64_t width, const int64_t* depths, int64_t far, std::vector<std::pair<int64_t, int64_t>>& parabolas,
              double* out) {
  const auto value = [&](int64_t x, int64_t at) { return (x - at) * (x - at) + depths[at] * depths[at]; };
  parabolas.clear();  // where each has its vertex, and the first pixel where it is the least
  for (int64_t at = 0; at < width; at++) {
    if (depths[at] == far) continue;
    int64_t first = 0;
    while (!parabolas.empty()) {
      const auto [other, from] = parabolas.back();
      if (value(from, at) < value(from, other)) {
        parabolas.pop_back();
        continue;
      }
      const int64_t rise = at * at - other * other + depths[at] * depths[at] - depths[other] * depths[other];
      first = 1 + rise / (2 * (at - other));
      break;
    }
    if (first < width) parabolas.push_back({at, parabolas.empty() ? 0 : first});
  }
  if (parabolas.empty()) std::fill(out, out + width, std::numeric_limits<double>::infinity());
  for (size_t k = 0; k < parabolas.size(); k++) {
    const int64_t stop = k + 1 < parabolas.size() ? parabolas[k + 1].second : width;
    for (int64_t x = parabolas[k].second; x < stop; x++) out[x] = std::sqrt(double(value(x, parabolas[k].first)));
  }
}

// Lowers the distances in a row to one more than those of its neighbours before it in the direction of `step`, 1 or -1,
// and in the row before that, where there is one.
void nearer(int64_t width, bool inner, int64_t step, int32_t* row) {
  const int32_t* before = row - step * width;
  for (int64_t x = 0; x < width; x++) {
    const int64_t i = step * x;
    int32_t least = row[i] - 1;
    if (x) least = std::min(least, row[i - step]);
    if (inner) {
      least = std::min(least, before[i]);
      if (x) least = std::min(least, before[i - step]);
      if (x + 1 < width) least = std::min(least, before[i + step]);
    }
    row[i] = least + 1;
  }
}

}  // namespace
}  // namespace cs

using namespace cs;

extern "C" {

// Numbers the parts of a mask from 1 on, in the order of their first pixels. Returns how many, or -1 without memory.
CS_EXPORT int64_t cs_label(int64_t height, int64_t width, const uint8_t* mask, int64_t diagonally, int32_t* out) {
  return counted([&] {
    Groups groups;
    const std::vector<Run> runs = runs_of(height, width, mask, diagonally ? 1 : 0, groups);
    std::vector<int32_t> numbers;
    const int64_t count = groups.numbered(numbers);
    std::fill(out, out + height * width, 0);
    for (const Run& run : runs)
      std::fill(out + run.row * width + run.start, out + run.row * width + run.stop, numbers[run.part] + 1);
    return count;
  });
}

// The parts of a mask that hold any of some pixels. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_propagate(int64_t height, int64_t width, const uint8_t* pixels, const uint8_t* mask,
                               int64_t diagonally, uint8_t* out) {
  return failed([&] {
    Groups groups;
    const std::vector<Run> runs = runs_of(height, width, mask, diagonally ? 1 : 0, groups);
    std::vector<int32_t> numbers;
    std::vector<uint8_t> linked(groups.numbered(numbers));
    for (const Run& run : runs) {
      const uint8_t* row = pixels + run.row * width;
      if (std::any_of(row + run.start, row + run.stop, [](uint8_t p) { return p != 0; })) linked[numbers[run.part]] = 1;
    }
    for (const Run& run : runs)
      std::fill(out + run.row * width + run.start, out + run.row * width + run.stop, linked[numbers[run.part]]);
  });
}

CS_EXPORT void cs_boxes(int64_t height, int64_t width, const void* labels, int64_t large, int64_t count, int64_t* out) {
  std::fill(out, out + 4 * count, int64_t(0));
  if (large)
    boxes(height, width, static_cast<const int64_t*>(labels), count, out);
  else
    boxes(height, width, static_cast<const int32_t*>(labels), count, out);
}

// rounds: how often; mask: what alone may change, or null. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_dilate(int64_t height, int64_t width, const uint8_t* in, int64_t high, int64_t wide,
                            const uint8_t* structure, const uint8_t* mask, int64_t rounds, int64_t border,
                            uint8_t* out) {
  return failed([&] {
    Padded from(height, width, high, wide, uint8_t(border)), to = from;
    for (int64_t y = 0; y < height; y++) std::copy(in + y * width, in + (y + 1) * width, from.at(y, 0));
    for (int64_t round = 0; round < rounds; round++) {
      dilate(from, structure, mask, to);
      std::swap(from.bytes, to.bytes);
    }
    for (int64_t y = 0; y < height; y++) std::copy(from.at(y, 0), from.at(y, 0) + width, out + y * width);
  });
}

// Distances to the nearest pixel outside a mask, infinite without one. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_distances(int64_t height, int64_t width, const uint8_t* mask, double* out) {
  return failed([&] {
    const int64_t far = height + width;
    std::vector<int64_t> depths(height * width);
    for (int64_t y = 0; y < height; y++)
      for (int64_t x = 0, i = y * width; x < width; x++, i++)
        depths[i] = !mask[i] ? 0 : y ? std::min(far, depths[i - width] + 1) : far;
    for (int64_t i = (height - 1) * width - 1; i >= 0; i--) depths[i] = std::min(depths[i], depths[i + width] + 1);
    std::vector<std::pair<int64_t, int64_t>> parabolas;
    for (int64_t y = 0; y < height; y++) envelope(width, &depths[y * width], far, parabolas, out + y * width);
  });
}

// The greater of the distances along rows and columns to the nearest pixel outside a mask, -1 without one.
CS_EXPORT void cs_chessboard(int64_t height, int64_t width, const uint8_t* mask, int32_t* out) {
  const int32_t far = int32_t(height + width);
  for (int64_t i = 0; i < height * width; i++) out[i] = mask[i] ? far : 0;
  // From the neighbours before each pixel, in the order of reading, then from those after it.
  for (int64_t y = 0; y < height; y++) nearer(width, y > 0, 1, out + y * width);
  for (int64_t y = height - 1; y >= 0; y--) nearer(width, y + 1 < height, -1, out + (y + 1) * width - 1);
  if (height && width && out[0] == far) std::fill(out, out + height * width, -1);
}
}
