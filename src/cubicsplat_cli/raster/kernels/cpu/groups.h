#pragma once
#include <cstdint>
#include <vector>

namespace cs {

// Things in groups that are joined one by one (R. Tarjan, "Efficiency of a Good But Not Linear Set Union Algorithm", 1975).
class Groups {
 public:
  explicit Groups(int64_t count = 0) {
    while (int64_t(first_.size()) < count) added();
  }

  // The index of one thing more, which is alone.
  int64_t added() {
    first_.push_back(int64_t(first_.size()));
    return first_.back();
  }

  void join(int64_t a, int64_t b) {
    a = first(a), b = first(b);
    (a < b ? first_[b] : first_[a]) = a < b ? a : b;
  }

  // Numbers the groups from 0 on in the order of their first things. Returns how many there are.
  int64_t numbered(std::vector<int32_t>& numbers) {
    int32_t count = 0;
    numbers.resize(first_.size());
    for (size_t i = 0; i < first_.size(); i++)
      numbers[i] = first_[i] == int64_t(i) ? count++ : numbers[size_t(first(int64_t(i)))];
    return count;
  }

 private:
  std::vector<int64_t> first_;  // of each an earlier one of its group, or itself

  int64_t first(int64_t i) {
    while (first_[i] != i) i = first_[i] = first_[first_[i]];
    return i;
  }
};

}  // namespace cs
