// What a stack has in common with one that was drawn before, and where the two differ.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <unordered_map>
#include <utility>
#include <vector>

#include "stack_picture.h"

namespace cs::stack {
namespace {

using Mask = std::vector<uint8_t>;  // of tiles

// Whether a layer of a stack, whose pieces begin with the `first`, is the same as one of an earlier picture.
inline bool same(const CsStack& stack, int layer, int first, const CsPicture& old, int other) {
  const Trace& trace = *old.layers[other];
  const int64_t count = stack.ends[layer] - first;
  return trace.pieces() == count &&
         std::equal(stack.fills + 4 * layer, stack.fills + 4 * layer + 4, &old.fills[4 * other]) &&
         std::equal(stack.lines + first, stack.lines + first + count, trace.lines.begin()) &&
         std::equal(stack.signs + first, stack.signs + first + count, trace.signs.begin()) &&
         std::equal(trace.cubics.begin(), trace.cubics.end(), stack.cubics + 8 * int64_t(first));
}

// The layers of an earlier picture that lie the same in a stack: of each layer the number there, or -1; they ascend.
class Matches {
 public:
  Matches(const CsStack& stack, const CsPicture& old) : stack_(stack), old_(old) {
    std::unordered_map<uint64_t, std::vector<int>> known;
    for (int k = 0; k < int(old.layers.size()); k++) {
      const Trace& trace = *old.layers[k];
      known[hash(trace.cubics.data(), trace.pieces(), &old.fills[4 * k])].push_back(k);
    }
    int next = 0;
    for (int i = 0, first = 0; i < stack.layers; first = stack.ends[i++]) {
      int match = -1;
      const auto found = known.find(
          hash(stack.cubics + 8 * int64_t(first), stack.ends[i] - first, &stack.fills[4 * i]));
      for (size_t n = 0; found != known.end() && n < found->second.size() && match < 0; n++)
        if (found->second[n] >= next && same(stack_, i, first, old_, found->second[n])) match = found->second[n];
      if (match >= 0) next = match + 1;
      of.push_back(match);
    }
  }

  std::vector<int> of;

 private:
  const CsStack& stack_;
  const CsPicture& old_;

  static uint64_t hash(const double* cubics, int64_t pieces, const double* fill) {
    uint64_t sum = 1469598103934665603u;
    const auto take = [&](const double* values, int64_t count) {
      for (int64_t n = 0; n < count; n++) {
        uint64_t bits;
        std::memcpy(&bits, values + n, sizeof bits);
        sum = (sum ^ bits) * 1099511628211u;
        sum ^= sum >> 29;
      }
    };
    take(cubics, 8 * pieces), take(fill, 4);
    return sum;
  }
};

// Marks the tiles in which two layers differ.
class Differences {
 public:
  Differences(const CsPicture& picture, Mask& dirty) : across_(picture.across()), dirty_(dirty) {}

  void mark(const Trace& trace) {
    static const Trace nothing;
    mark(trace, nothing);
  }

  void mark(const Trace& a, const Trace& b) {
    const bool both = !a.rows.empty() && !b.rows.empty();
    const int top = a.rows.empty() ? b.top : both ? std::min(a.top, b.top) : a.top;
    const int bottom = std::max(a.bottom, b.bottom);
    for (int row = top; row < bottom; row++) {
      const auto [i, a_end] = spans(a, row);
      const auto [k, b_end] = spans(b, row);
      mark(row, i, a_end, k, b_end);
    }
  }

 private:
  int across_;
  Mask& dirty_;

  static std::pair<const Span*, const Span*> spans(const Trace& trace, int row) {
    if (row < trace.top || row >= trace.bottom) return {nullptr, nullptr};
    const Span* all = trace.spans.data();
    return {all + trace.rows[row - trace.top], all + trace.rows[row - trace.top + 1]};
  }

  void mark(int row, const Span* a, const Span* a_end, const Span* b, const Span* b_end) {
    constexpr int kNever = 1 << 30;
    for (int x = 0; a < a_end || b < b_end;) {
      const auto covered = [&](const Span* s, const Span* end) { return s < end && s->first <= x ? s->covered : 0.0f; };
      const auto changes = [&](const Span* s, const Span* end) {
        return s >= end ? kNever : s->first <= x ? s->last : s->first;
      };
      const int next = std::min(changes(a, a_end), changes(b, b_end));
      if (covered(a, a_end) != covered(b, b_end))
        for (int i = x / kTile; i <= (next - 1) / kTile; i++) dirty_[size_t(row / kTile) * across_ + i] = 1;
      x = next;
      if (a < a_end && a->last <= x) a++;
      if (b < b_end && b->last <= x) b++;
    }
  }
};

}  // namespace
}  // namespace cs::stack
