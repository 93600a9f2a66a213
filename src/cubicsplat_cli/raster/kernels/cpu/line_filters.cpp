// Filters along one axis of an array (outer, length, inner). Sums are taken in the order in which scipy.ndimage takes
// them, so that they agree to the last bit. raster/ndimage.py says what each function means.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "abi.h"

namespace cs {
namespace {

enum Operation : int32_t { kSmallest, kLargest, kMean, kSum };
enum Kind : int32_t { kByte, kInt32, kInt64, kFloat, kDouble };
enum Mode : int32_t { kReflect, kNearest, kConstant };

constexpr int64_t kBuffer = 1 << 18;  // bytes of a block of extended lines, which stay in a core's cache
constexpr int64_t kLeastWidth = 16;   // columns of a block
constexpr int64_t kChunk = 512;       // sums under way at once

// The lines along an axis, and how many values each is extended by before and after its own.
struct Lines {
  int64_t outer, length, inner, before, after;
  int32_t mode;

  // Where the value at position i of an extended line is, -1 where it is 0.
  int64_t source(int64_t i) const {
    if (i >= 0 && i < length) return i;
    if (mode == kConstant) return -1;
    if (mode == kNearest) return i < 0 ? 0 : length - 1;
    const int64_t period = 2 * length, at = (i % period + period) % period;
    return at < length ? at : period - 1 - at;
  }
};

// Copies rows of so many values, which begin every so many values; at once where they lie side by side on both sides.
template <class From, class To>
void copy_rows(int64_t rows, int64_t width, int64_t from_step, const From* from, int64_t to_step, To* to) {
  if (from_step == width && to_step == width) width *= rows, rows = 1;
  for (int64_t r = 0; r < rows; r++) std::copy(from + r * from_step, from + r * from_step + width, to + r * to_step);
}

// Hands blocks of extended lines to filter(width, extended, result): (before + length + after, width) values in, and
// (length, width) out, which take their place.
template <class Work, class T, class Filter>
void filter_blocks(const Lines& lines, T* values, const Filter& filter) {
  const int64_t rows = lines.before + lines.length + lines.after, inner = lines.inner;
  const int64_t most = std::min(inner, std::max(kLeastWidth, kBuffer / int64_t(sizeof(Work)) / rows));
  std::vector<Work> extended(rows * most), result(lines.length * most);
  std::vector<int64_t> beyond;
  for (int64_t i = -lines.before; i < lines.length + lines.after; i++)
    if (i < 0 || i >= lines.length) beyond.push_back(i);
  for (int64_t o = 0; o < lines.outer; o++)
    for (int64_t first = 0; first < inner; first += most) {
      const int64_t width = std::min(most, inner - first);
      T* own = values + o * lines.length * inner + first;
      Work* middle = &extended[lines.before * width];
      copy_rows(lines.length, width, inner, own, width, middle);
      for (const int64_t i : beyond) {
        const int64_t source = lines.source(i);
        Work* to = middle + i * width;
        source < 0 ? std::fill(to, to + width, Work(0)) : copy_rows(1, width, inner, own + source * inner, width, to);
      }
      filter(width, extended.data(), result.data());
      copy_rows(lines.length, width, width, result.data(), inner, own);
    }
}

template <bool kLargest, class T>
void better(int64_t count, const T* __restrict a, const T* __restrict b, T* __restrict out) {
  for (int64_t i = 0; i < count; i++) out[i] = (kLargest ? a[i] < b[i] : b[i] < a[i]) ? b[i] : a[i];
}

// The extremes of `size` neighbours, by those of 2, 4, 8 ... of them.
template <bool kLargest, class T>
void extremes(const Lines& lines, T* values) {
  const int64_t rows = lines.before + lines.length + lines.after, size = lines.before + lines.after + 1;
  std::vector<T> spare;
  filter_blocks<T>(lines, values, [&](int64_t width, T* extended, T* result) {
    spare.resize(rows * width);
    T *from = extended, *to = spare.data();
    int64_t span = 1, count = rows * width;
    for (; 2 * span <= size; span *= 2) {
      count -= span * width;
      better<kLargest>(count, from, from + span * width, to);
      std::swap(from, to);
    }
    better<kLargest>(lines.length * width, from, from + (size - span) * width, result);
  });
}

// The means of `size` neighbours, by running sums.
template <class T>
void means(const Lines& lines, T* values) {
  const int64_t size = lines.before + lines.after + 1;
  filter_blocks<double>(lines, values, [&](int64_t width, double* extended, double* result) {
    for (int64_t c = 0; c < width; c++) {
      double sum = 0.0;
      for (int64_t r = 0; r < size; r++) sum += extended[r * width + c];
      result[c] = sum;
    }
    double single = result[0];  // in a register, without which the sums of a lone line wait for the memory
    for (int64_t r = 1; r < lines.length && width == 1; r++)
      result[r] = single += extended[r + size - 1] - extended[r - 1];
    for (int64_t r = 1; r < lines.length && width > 1; r++) {
      const double *first = extended + (r - 1) * width, *last = first + size * width, *sum = result + (r - 1) * width;
      double* __restrict next = result + r * width;
      for (int64_t c = 0; c < width; c++) next[c] = sum[c] + (last[c] - first[c]);
    }
    for (int64_t i = 0; i < lines.length * width; i++) result[i] /= double(size);
  });
}

// Which weights of a correlation are alike: those at the same distance before and after the middle.
enum class Symmetry { kNone, kEven, kOdd };

Symmetry symmetry(const std::vector<double>& weights) {
  const size_t half = weights.size() / 2;
  if (weights.size() % 2 == 0) return Symmetry::kNone;
  bool even = true, odd = true;
  for (size_t k = 1; k <= half; k++) {
    const double before = weights[half - k], after = weights[half + k];
    even &= std::fabs(after - before) <= std::numeric_limits<double>::epsilon();
    odd &= std::fabs(after + before) <= std::numeric_limits<double>::epsilon();
  }
  return even ? Symmetry::kEven : odd ? Symmetry::kOdd : Symmetry::kNone;
}

template <class T>
void correlations(const Lines& lines, const std::vector<double>& weights, T* values) {
  const Symmetry kind = symmetry(weights);
  const int64_t half = lines.before, last = int64_t(weights.size()) - 1;
  filter_blocks<double>(lines, values, [&](int64_t width, double* extended, double* result) {
    for (int64_t start = 0; start < lines.length * width; start += kChunk) {
      const int64_t count = std::min(kChunk, lines.length * width - start);
      double sums[kChunk];
      const auto add = [&](int64_t k) {
        const double *a = extended + start + k * width, *b = extended + start + (last - k) * width, w = weights[k];
        if (kind == Symmetry::kEven)
          for (int64_t i = 0; i < count; i++) sums[i] += (a[i] + b[i]) * w;
        else if (kind == Symmetry::kOdd)
          for (int64_t i = 0; i < count; i++) sums[i] += (a[i] - b[i]) * w;
        else
          for (int64_t i = 0; i < count; i++) sums[i] += a[i] * w;
      };
      const int64_t first = kind == Symmetry::kNone ? last : half;
      const double* middle = extended + start + first * width;
      for (int64_t i = 0; i < count; i++) sums[i] = middle[i] * weights[first];
      for (int64_t k = 0; k < first; k++) add(k);
      std::copy(sums, sums + count, result + start);
    }
  });
}

template <class T>
void filter(int32_t operation, const Lines& lines, const double* weights, T* values) {
  if (operation == kSmallest) extremes<false>(lines, values);
  if (operation == kLargest) extremes<true>(lines, values);
  if (operation == kMean) means(lines, values);
  if (operation == kSum) correlations(lines, {weights, weights + lines.before + lines.after + 1}, values);
}

}  // namespace
}  // namespace cs

using namespace cs;

extern "C" {
// In place. weights: (before + after + 1,) of sums, else null. Returns 0, or 1 without memory.
CS_EXPORT int32_t cs_filter_lines(int64_t operation, int64_t kind, int64_t mode, int64_t outer, int64_t length,
                                  int64_t inner, int64_t before, int64_t after, const double* weights, void* values) {
  return failed([&] {
    const Lines lines{outer, length, inner, before, after, int32_t(mode)};
    if (kind == kByte) filter(int32_t(operation), lines, weights, static_cast<uint8_t*>(values));
    if (kind == kInt32) filter(int32_t(operation), lines, weights, static_cast<int32_t*>(values));
    if (kind == kInt64) filter(int32_t(operation), lines, weights, static_cast<int64_t*>(values));
    if (kind == kFloat) filter(int32_t(operation), lines, weights, static_cast<float*>(values));
    if (kind == kDouble) filter(int32_t(operation), lines, weights, static_cast<double*>(values));
  });
}
}
