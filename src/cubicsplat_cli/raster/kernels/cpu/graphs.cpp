// Groups of things that are linked. raster/sparse.py says what each function means.
#include <algorithm>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "groups.h"

namespace cs {
namespace {

// Strongly connected groups of a directed graph (R. Tarjan, "Depth-First Search and Linear Graph Algorithms", 1972),
// without recursion.
class Search {
 public:
  Search(int64_t count, int64_t links, const int64_t* from, const int64_t* to)
      : starts_(count + 1, 0), ends_(links), seen_(count, -1), lowest_(count) {
    for (int64_t k = 0; k < links; k++) starts_[from[k] + 1]++;
    for (int64_t i = 0; i < count; i++) starts_[i + 1] += starts_[i];
    next_.assign(starts_.begin(), starts_.end() - 1);
    for (int64_t k = 0; k < links; k++) ends_[next_[from[k]]++] = to[k];
    next_.assign(starts_.begin(), starts_.end() - 1);
  }

  // Numbers the groups in any order. Returns how many there are.
  int64_t number(int32_t* out) {
    const int64_t count = int64_t(seen_.size());
    std::fill(out, out + count, -1);
    for (int64_t root = 0; root < count; root++)
      if (seen_[root] < 0) visit(root, out);
    return groups_;
  }

 private:
  std::vector<int64_t> starts_, ends_, next_, seen_, lowest_, path_, open_;
  int64_t visited_ = 0, groups_ = 0;

  void enter(int64_t i) {
    seen_[i] = lowest_[i] = visited_++;
    path_.push_back(i), open_.push_back(i);
  }

  void visit(int64_t root, int32_t* out) {
    for (enter(root); !path_.empty();) {
      const int64_t i = path_.back();
      if (next_[i] < starts_[i + 1]) {
        const int64_t other = ends_[next_[i]++];
        if (seen_[other] < 0)
          enter(other);
        else if (out[other] < 0)
          lowest_[i] = std::min(lowest_[i], seen_[other]);
        continue;
      }
      path_.pop_back();
      if (!path_.empty()) lowest_[path_.back()] = std::min(lowest_[path_.back()], lowest_[i]);
      if (lowest_[i] == seen_[i]) close(i, out);
    }
  }

  void close(int64_t i, int32_t* out) {
    for (int64_t last = -1; last != i; open_.pop_back()) last = open_.back(), out[last] = int32_t(groups_);
    groups_++;
  }
};

}  // namespace
}  // namespace cs

using namespace cs;

// Each returns how many groups there are, or -1 without memory.
extern "C" {
CS_EXPORT int64_t cs_linked(int64_t count, int64_t links, const int64_t* first, const int64_t* second, int32_t* out) {
  return counted([&] {
    Groups groups(count);
    for (int64_t k = 0; k < links; k++) groups.join(first[k], second[k]);
    std::vector<int32_t> numbers;
    const int64_t found = groups.numbered(numbers);
    std::copy(numbers.begin(), numbers.end(), out);
    return found;
  });
}

CS_EXPORT int64_t cs_linked_both_ways(int64_t count, int64_t links, const int64_t* from, const int64_t* to,
                                      int32_t* out) {
  return counted([&] { return Search(count, links, from, to).number(out); });
}
}
