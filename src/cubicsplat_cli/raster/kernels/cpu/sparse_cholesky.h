// Solves sparse symmetric positive definite systems, whose variables lie in the plane and share something with near ones.
//
// The order of elimination is a nested dissection: what lies on one side of a line across the middle is eliminated first,
// then what lies on the other side, and what connects them last. Then the matrix is L D L' with a sparse L, found row by
// row: row k of L solves a triangular system whose nonzeros are the ancestors of those of row k in the elimination tree.
// Where a factor fills up with many times what the matrix has, the system is solved step by step.
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

// The factor of a matrix.
class Factor {
 public:
  // order: of elimination. most: multiplications that it may take; of a matrix that takes more there is none.
  Factor(const std::vector<Entry>& entries, std::vector<int32_t> order, double most = 1e300)
      : order_(std::move(order)), n_(int32_t(order_.size())), starts_(n_ + 1, 0), diagonal_(n_) {
    std::vector<int32_t> place(n_), parent(n_, -1), mark(n_), row, pattern(n_);
    std::vector<int64_t> starts(n_ + 1, 0);
    for (int32_t k = 0; k < n_; k++) place[order_[k]] = k;
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
    std::vector<int64_t> count(n_, 0);
    double work = 0.0;
    for (int32_t k = 0; k < n_ && !dear_; k++) {
      mark[k] = k;
      for (int64_t p = starts[k]; p < starts[k + 1]; p++)
        climb(k, row[p], [&](int32_t i) {
          if (parent[i] < 0) parent[i] = k;
          work += double(++count[i]);
        });
      dear_ = work > most;
    }
    positive_ = !dear_;
    if (dear_) return;
    for (int32_t k = 0; k < n_; k++) starts_[k + 1] = starts_[k] + count[k];
    row_.resize(starts_[n_]), value_.resize(starts_[n_]);
    std::vector<double> sums(n_, 0.0);
    std::fill(count.begin(), count.end(), 0);
    std::fill(mark.begin(), mark.end(), -1);
    std::vector<int32_t> path;
    for (int32_t k = 0; k < n_ && positive_; k++) {
      int32_t top = n_;
      mark[k] = k;
      for (int64_t p = starts[k]; p < starts[k + 1]; p++) {
        sums[row[p]] += value[p];
        path.clear();
        climb(k, row[p], [&](int32_t i) { path.push_back(i); });
        while (!path.empty()) pattern[--top] = path.back(), path.pop_back();
      }
      diagonal_[k] = sums[k], sums[k] = 0.0;
      for (; top < n_; top++) {
        const int32_t i = pattern[top];
        const double sum = sums[i], share = sum / diagonal_[i];
        sums[i] = 0.0;
        const int64_t end = starts_[i] + count[i]++;
        for (int64_t p = starts_[i]; p < end; p++) sums[row_[p]] -= value_[p] * sum;
        diagonal_[k] -= share * sum;
        row_[end] = k, value_[end] = share;
      }
      positive_ = diagonal_[k] > 0.0;
    }
  }

  // Whether the matrix is known to be positive definite: only then it has a factor.
  bool positive() const { return positive_; }

  // Whether it would take too much to find one.
  bool dear() const { return dear_; }

  // Solves the system for `values`, in place.
  void solve(std::vector<double>& values) const {
    std::vector<double> x(n_);
    for (int32_t k = 0; k < n_; k++) x[k] = values[order_[k]];
    for (int32_t k = 0; k < n_; k++) {
      const double own = x[k];
      for (int64_t p = starts_[k]; p < starts_[k + 1]; p++) x[row_[p]] -= value_[p] * own;
    }
    for (int32_t k = n_; k-- > 0;) {
      double own = x[k] / diagonal_[k];
      for (int64_t p = starts_[k]; p < starts_[k + 1]; p++) own -= value_[p] * x[row_[p]];
      x[k] = own;
    }
    for (int32_t k = 0; k < n_; k++) values[order_[k]] = x[k];
  }

 private:
  std::vector<int32_t> order_;
  int32_t n_;
  std::vector<int64_t> starts_;  // of the columns of L
  std::vector<int32_t> row_;
  std::vector<double> value_, diagonal_;
  bool positive_ = true, dear_ = false;
};

// A symmetric matrix by the rows of one triangle, times vectors.
class Rows {
 public:
  // entries: of the upper triangle by rows, each once, as `summed` gives them.
  Rows(const std::vector<Entry>& entries, size_t count) : ends_(count, 0) {
    column_.reserve(entries.size()), value_.reserve(entries.size());
    for (const Entry& e : entries) ends_[e.row]++, column_.push_back(e.column), value_.push_back(e.value);
    std::partial_sum(ends_.begin(), ends_.end(), ends_.begin());
  }

  void multiply(const std::vector<double>& x, std::vector<double>& out) const {
    std::fill(out.begin(), out.end(), 0.0);
    int64_t n = 0;
    for (size_t row = 0; row < ends_.size(); row++) {
      const double own = x[row];
      double sum = out[row];
      for (; n < ends_[row]; n++) {
        const int32_t column = column_[n];
        sum += value_[n] * x[column];
        // The diagonal counts once: what is added to it here is written over.
        out[column] += value_[n] * own;
      }
      out[row] = sum;
    }
  }

 private:
  std::vector<int64_t> ends_;
  std::vector<int32_t> column_;
  std::vector<double> value_;
};

// Solves a system for `values`, in place, until the residual is `enough` of what it was, in the norm of the preconditioner;
// false where the matrix is not positive definite. Method: conjugate gradients (M. Hestenes and E. Stiefel, "Methods of
// Conjugate Gradients for Solving Linear Systems", 1952), preconditioned by the factor of a part of the matrix. entries: as
// `summed` gives them.
inline bool iterate(const std::vector<Entry>& entries, const Factor& part, double enough, std::vector<double>& values) {
  constexpr int kMost = 200;  // steps
  const size_t n = values.size();
  if (!part.positive()) return false;
  const auto dot = [n](const std::vector<double>& a, const std::vector<double>& b) {
    double sum = 0.0;
    for (size_t k = 0; k < n; k++) sum += a[k] * b[k];
    return sum;
  };
  const Rows rows(entries, n);
  std::vector<double> x(n, 0.0), rest = values, ahead = rest, way, product(n);
  part.solve(ahead);
  way = ahead;
  double size = dot(rest, ahead);
  const double least = enough * enough * size;
  for (int step = 0; step < kMost && size > least; step++) {
    rows.multiply(way, product);
    const double curved = dot(way, product);
    if (!(curved > 0.0)) return false;
    for (size_t k = 0; k < n; k++) x[k] += size / curved * way[k], rest[k] -= size / curved * product[k];
    ahead = rest;
    part.solve(ahead);
    const double next = dot(rest, ahead);
    for (size_t k = 0; k < n; k++) way[k] = ahead[k] + next / size * way[k];
    size = next;
  }
  values = x;
  return true;
}

}  // namespace cs::sparse
