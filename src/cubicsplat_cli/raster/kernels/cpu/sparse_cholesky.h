// Solves sparse symmetric positive definite systems, whose variables lie in the plane and share something with near ones.
//
// The order of elimination is a nested dissection: what lies on one side of a line across the middle is eliminated first,
// then what lies on the other side, and what connects them last. Then the matrix is L D L' with a sparse L, found row by
// row: row k of L solves a triangular system whose nonzeros are the ancestors of those of row k in the elimination tree.
#pragma once

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

namespace cs::sparse {

struct Entry {
  int32_t row, column;  // in either triangle
  double value;
};

// The same entries, of `count` variables, in one triangle and each only once.
inline std::vector<Entry> summed(const std::vector<Entry>& entries, int32_t count) {
  std::vector<int64_t> ends(size_t(count) + 1, 0);
  for (const Entry& e : entries) ends[std::min(e.row, e.column) + 1]++;
  std::partial_sum(ends.begin(), ends.end(), ends.begin());
  std::vector<std::pair<int32_t, double>> sorted(entries.size());  // column and value, by row
  for (const Entry& e : entries) sorted[ends[std::min(e.row, e.column)]++] = {std::max(e.row, e.column), e.value};
  std::vector<Entry> out;
  out.reserve(entries.size() / 2);
  std::vector<int64_t> place(count, -1);  // of each column in the last row that has it
  int64_t n = 0;
  for (int32_t row = 0; row < count; row++)
    for (const int64_t first = int64_t(out.size()); n < ends[row]; n++) {
      const auto [column, value] = sorted[n];
      if (place[column] < first) place[column] = int64_t(out.size()), out.push_back({row, column, 0.0});
      out[place[column]].value += value;
    }
  return out;
}

class Dissection {
 public:
  // x, y: of each variable.
  Dissection(const std::vector<double>& x, const std::vector<double>& y, const std::vector<Entry>& entries)
      : at_{&x, &y}, starts_(x.size() + 1, 0), label_(x.size(), 0) {
    for (const Entry& e : entries) starts_[e.row]++, starts_[e.column]++;
    std::partial_sum(starts_.begin(), starts_.end(), starts_.begin());
    neighbours_.resize(starts_.back());
    for (const Entry& e : entries) neighbours_[--starts_[e.row]] = e.column, neighbours_[--starts_[e.column]] = e.row;
    std::vector<int32_t> all(x.size());
    std::iota(all.begin(), all.end(), 0);
    divide(all.data(), all.data() + all.size());
  }

  std::vector<int32_t> order;  // the variables as they are eliminated

 private:
  static constexpr int64_t kFew = 24;  // variables that are not divided

  const std::vector<double>* at_[2];
  std::vector<int64_t> starts_;
  std::vector<int32_t> neighbours_, label_;
  int32_t labels_ = 0;

  void divide(int32_t* first, int32_t* last) {
    if (last - first <= kFew) return void(order.insert(order.end(), first, last));
    double low[2], high[2];
    for (int c = 0; c < 2; c++) {
      const auto ends = std::minmax_element(first, last, [&](int32_t a, int32_t b) { return at(c, a) < at(c, b); });
      low[c] = at(c, *ends.first), high[c] = at(c, *ends.second);
    }
    const int across = high[0] - low[0] >= high[1] - low[1] ? 0 : 1;
    int32_t* const middle = first + (last - first) / 2;
    std::nth_element(first, middle, last, [&](int32_t a, int32_t b) {
      return at(across, a) != at(across, b) ? at(across, a) < at(across, b) : a < b;
    });
    const int32_t beyond = ++labels_;
    for (int32_t* p = middle; p < last; p++) label_[*p] = beyond;
    int32_t* const border = std::stable_partition(first, middle, [&](int32_t v) {
      for (int64_t n = starts_[v]; n < starts_[v + 1]; n++)
        if (label_[neighbours_[n]] == beyond) return false;
      return true;
    });
    divide(first, border);
    divide(middle, last);
    order.insert(order.end(), border, middle);
  }

  double at(int axis, int32_t v) const { return (*at_[axis])[v]; }
};

// Solves the system for `values`, in place; false where the matrix is not positive definite. order: of elimination.
inline bool solve(const std::vector<Entry>& entries, const std::vector<int32_t>& order, std::vector<double>& values) {
  const int32_t n = int32_t(order.size());
  std::vector<int32_t> place(n), parent(n, -1), mark(n), row, pattern(n);
  std::vector<int64_t> starts(n + 1, 0), l_starts(n + 1, 0);
  for (int32_t k = 0; k < n; k++) place[order[k]] = k;
  // The upper triangle by columns.
  const auto ends = [&](const Entry& e) { return std::minmax(place[e.row], place[e.column]); };
  for (const Entry& e : entries) starts[std::max(place[e.row], place[e.column])]++;
  std::partial_sum(starts.begin(), starts.end(), starts.begin());
  std::vector<double> value(entries.size());
  row.resize(entries.size());
  for (const Entry& e : entries) {
    const auto [low, high] = ends(e);
    const int64_t at = --starts[high];
    row[at] = low, value[at] = e.value;
  }
  // The rows above k that row k of L reaches: up the elimination tree from its own, until one is reached again.
  const auto climb = [&](int32_t k, int32_t i, auto visit) {
    for (; mark[i] != k; i = parent[i]) visit(i), mark[i] = k;
  };
  std::vector<int64_t> count(n, 0);
  for (int32_t k = 0; k < n; k++) {
    mark[k] = k;
    for (int64_t p = starts[k]; p < starts[k + 1]; p++)
      climb(k, row[p], [&](int32_t i) {
        if (parent[i] < 0) parent[i] = k;
        count[i]++;
      });
  }
  for (int32_t k = 0; k < n; k++) l_starts[k + 1] = l_starts[k] + count[k];
  std::vector<int32_t> l_row(l_starts[n]);
  std::vector<double> l_value(l_starts[n]), diagonal(n), sums(n, 0.0);
  std::fill(count.begin(), count.end(), 0);
  std::fill(mark.begin(), mark.end(), -1);
  std::vector<int32_t> path;
  for (int32_t k = 0; k < n; k++) {
    int32_t top = n;
    mark[k] = k;
    for (int64_t p = starts[k]; p < starts[k + 1]; p++) {
      sums[row[p]] += value[p];
      path.clear();
      climb(k, row[p], [&](int32_t i) { path.push_back(i); });
      while (!path.empty()) pattern[--top] = path.back(), path.pop_back();
    }
    diagonal[k] = sums[k], sums[k] = 0.0;
    for (; top < n; top++) {
      const int32_t i = pattern[top];
      const double sum = sums[i], share = sum / diagonal[i];
      sums[i] = 0.0;
      const int64_t end = l_starts[i] + count[i]++;
      for (int64_t p = l_starts[i]; p < end; p++) sums[l_row[p]] -= l_value[p] * sum;
      diagonal[k] -= share * sum;
      l_row[end] = k, l_value[end] = share;
    }
    if (!(diagonal[k] > 0.0)) return false;
  }
  std::vector<double> x(n);
  for (int32_t k = 0; k < n; k++) x[k] = values[order[k]];
  for (int32_t k = 0; k < n; k++)
    for (int64_t p = l_starts[k]; p < l_starts[k + 1]; p++) x[l_row[p]] -= l_value[p] * x[k];
  for (int32_t k = n; k-- > 0;) {
    x[k] /= diagonal[k];
    for (int64_t p = l_starts[k]; p < l_starts[k + 1]; p++) x[k] -= l_value[p] * x[l_row[p]];
  }
  for (int32_t k = 0; k < n; k++) values[order[k]] = x[k];
  return true;
}

}  // namespace cs::sparse
