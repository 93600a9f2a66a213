// Damped Gauss-Newton steps of the fit of a stack of shapes to a picture, through a blur where there is one.
//
// A crossing changes its own pixel, and a blur spreads that. So two crossings share as much as the blurs of their pixels
// overlap: the blur's autocorrelation at the distance between them. At a leak, opacity counts for more.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "parallel.h"
#include "sparse_cholesky.h"
#include "stack_picture.h"

namespace cs::stack {
namespace {

// Multiplications for each entry of a matrix, beyond which a factor of all takes longer than some twenty steps with its
// parts. Where many outlines lie close together it fills up.
constexpr double kMostAtOnce = 100.0;
constexpr size_t kAtOnce = 20000;  // crossings that a thread takes, some milliseconds' work
constexpr double kEnough = 3e-3;   // of the residual of a step, which is right to first order at best

using Block = std::array<double, 64>;

// A crossing of a piece that moves. slope: of the picture, weighted; pull: of half of the cost with the coverage.
struct Crossing {
  int32_t piece, x, y;
  double slope[4], trust, leak, pull;
  const double* change;
};

// Crossings by their pixels.
class Near {
 public:
  // reach: px along rows and columns to which pixels are near. The crossings must outlive this.
  Near(const std::vector<Crossing>& crossings, const CsGoal& goal, int reach)
      : crossings_(crossings), width_(goal.width), top_(goal.height), bottom_(-1), reach_(reach) {
    for (const Crossing& c : crossings) top_ = std::min(top_, c.y), bottom_ = std::max(bottom_, c.y);
    starts_.assign(size_t(std::max(bottom_ - top_ + 1, 0)) * width_ + 1, 0), order_.resize(crossings.size());
    const auto pixel_of = [&](const Crossing& c) { return size_t(c.y - top_) * width_ + c.x; };
    for (const Crossing& c : crossings) starts_[pixel_of(c)]++;
    std::partial_sum(starts_.begin(), starts_.end(), starts_.begin());
    for (size_t n = crossings.size(); n-- > 0;) order_[--starts_[pixel_of(crossings[n])]] = int32_t(n);
  }

  // Calls `call(b)` for the crossings near another one, row by row.
  template <class Call>
  void each(const Crossing& a, Call call) const {
    for (int row = std::max(top_, a.y - reach_); row <= std::min(bottom_, a.y + reach_); row++) {
      const size_t line = size_t(row - top_) * width_;
      const int32_t last = starts_[line + std::min(width_ - 1, a.x + reach_) + 1];
      for (int32_t n = starts_[line + std::max(0, a.x - reach_)]; n < last; n++) call(crossings_[order_[n]]);
    }
  }

 private:
  const std::vector<Crossing>& crossings_;
  int width_, top_, bottom_, reach_;
  std::vector<int32_t> starts_, order_;
};

class Equations {
 public:
  Equations(const CsPicture& picture, const CsUnknowns& unknowns)
      : picture_(picture), goal_(picture.goal), unknowns_(unknowns), gradient_(unknowns.variables, 0.0) {
    collect();
    if (goal_.reach > 0) pull_through_blur();
    overlap();
  }

  // Returns whether there is a step; writes it and its gradient.
  bool solve(double* step, double* gradient) {
    std::vector<sparse::Entry> entries = multiplied();
    std::vector<double> diagonal(unknowns_.variables, 0.0), x(unknowns_.variables, 0.0), y = x;
    for (const sparse::Entry& e : entries)
      if (e.row == e.column) diagonal[e.row] += e.value;
    for (int32_t v = 0; v < unknowns_.variables; v++)
      entries.push_back({v, v, unknowns_.keep + unknowns_.damping[v] * diagonal[v]});
    entries = sparse::summed(entries, unknowns_.variables);
    place(x, y);
    pull();
    std::copy(gradient_.begin(), gradient_.end(), gradient);
    for (double& value : gradient_) value = -value;
    const sparse::Factor whole(entries, sparse::Dissection(x, y, entries).order, kMostAtOnce * double(entries.size()));
    if (whole.positive()) whole.solve(gradient_);
    const bool solved = whole.positive() || (whole.dear() && iterated(entries, x, y));
    std::copy(gradient_.begin(), gradient_.end(), step);
    return solved;
  }

 private:
  // first, count: of its variables among those of all pieces. pull: of half of the cost with its control points.
  struct Piece {
    const double* cubic;
    size_t first, count;
    double pull[8];
  };

  const CsPicture& picture_;
  const CsGoal& goal_;
  const CsUnknowns& unknowns_;
  std::vector<Piece> pieces_;
  std::vector<Crossing> crossings_;
  std::vector<int32_t> variables_;  // that move the pieces, one piece after the other
  std::vector<double> ways_;        // x 8: how they move its control points
  std::vector<double> gradient_, overlap_;
  std::vector<std::vector<double>> slopes_;

  // Outlines share little with each other, so some twenty steps suffice, each of which solves for all outlines alone.
  bool iterated(const std::vector<sparse::Entry>& entries, const std::vector<double>& x, const std::vector<double>& y) {
    std::vector<int32_t> outline(unknowns_.variables, 0);
    for (int32_t k = 0; k < unknowns_.outlines; k++) outline[unknowns_.start[k]] = unknowns_.start[k];
    std::partial_sum(outline.begin(), outline.end(), outline.begin(),
                     [](int32_t a, int32_t b) { return std::max(a, b); });
    std::vector<sparse::Entry> own;
    for (const sparse::Entry& e : entries)
      if (outline[e.row] == outline[e.column]) own.push_back(e);
    return sparse::iterate(entries, {own, sparse::Dissection(x, y, own).order}, kEnough, gradient_);
  }

  void collect() {
    std::vector<uint8_t> wanted(picture_.layers.size(), 0);
    const auto layer_of = [&](int32_t piece) {
      return std::upper_bound(picture_.starts.begin(), picture_.starts.end(), piece) - picture_.starts.begin() - 1;
    };
    for (int32_t k = 0; k < unknowns_.outlines; k++) wanted[layer_of(unknowns_.first[k])] = 1;
    slopes_ = slopes(picture_, wanted);
    int64_t row = 0;
    for (int32_t k = 0; k < unknowns_.outlines; k++) {
      const auto layer = layer_of(unknowns_.first[k]);
      const Trace& trace = *picture_.layers[layer];
      const int32_t first = unknowns_.first[k] - picture_.starts[layer];
      for (int32_t p = first; p < first + unknowns_.count[k]; p++, row += 8) {
        for (int64_t n = trace.starts[p]; n < trace.starts[p + 1]; n++)
          add(trace, n, &slopes_[layer][4 * n], int32_t(pieces_.size()));
        add_variables(&trace.cubics[8 * int64_t(p)], row, unknowns_.start[k]);
      }
    }
  }

  // A piece with the variables from `start` on that its rows of the sparse matrix, 8 from `first` on, have.
  void add_variables(const double* cubic, int64_t first, int32_t start) {
    Piece piece{cubic, variables_.size(), 0, {}};
    for (int r = 0; r < 8; r++)
      for (int64_t n = unknowns_.rows[first + r]; n < unknowns_.rows[first + r + 1]; n++) {
        const int32_t variable = start + unknowns_.column[n];
        const size_t k = std::find(variables_.begin() + piece.first, variables_.end(), variable) - variables_.begin();
        if (k == variables_.size()) variables_.push_back(variable), ways_.resize(ways_.size() + 8, 0.0);
        ways_[8 * k + r] += unknowns_.value[n];
      }
    piece.count = variables_.size() - piece.first;
    pieces_.push_back(piece);
  }

  void add(const Trace& trace, int64_t n, const double* slope, int32_t piece) {
    const int32_t pixel = trace.pixel[n];
    const Address from = trace.address[n];
    const double* colour = picture_.tiles[from.tile]->seen->data() + 4 * from.place;
    Crossing c{piece, pixel % goal_.width, pixel / goal_.width, {}, 0.0, 0.0, 0.0, &trace.change[8 * n]};
    double rest[4];
    c.trust = trust(goal_, pixel, residual(goal_, colour, pixel, rest));
    for (int k = 0; k < 4; k++) c.slope[k] = slope[k] * goal_.channels[k], c.pull += c.trust * rest[k] * c.slope[k];
    if (const double shown = leak(goal_, colour, pixel); shown > 0.0) {
      c.leak = std::sqrt(goal_.leak_weight) * slope[3];
      c.pull -= goal_.leak_weight * shown * slope[3];
    }
    crossings_.push_back(c);
  }

  // What pulls at a pixel of the sharp picture is what the blur carries from there, which stays on the canvas: beyond its
  // border the picture goes on as it ends.
  void pull_through_blur() {
    int left = goal_.width, top = goal_.height, right = -1, bottom = -1;
    for (const Crossing& c : crossings_) {
      left = std::min(left, c.x), right = std::max(right, c.x);
      top = std::min(top, c.y), bottom = std::max(bottom, c.y);
    }
    if (right < 0) return;
    left = std::max(left - goal_.reach, 0), right = std::min(right + goal_.reach, goal_.width - 1);
    top = std::max(top - goal_.reach, 0), bottom = std::min(bottom + goal_.reach, goal_.height - 1);
    const int width = right - left + 1, height = bottom - top + 1;
    std::vector<double> pulls(size_t(4) * width * height);
    for (int y = top; y <= bottom; y++)
      for (int x = left; x <= right; x++) {
        const int64_t pixel = int64_t(y) * goal_.width + x;
        const Address from = picture_.at(x, y);
        double* pull = &pulls[4 * (size_t(y - top) * width + x - left)];
        const double* colour = picture_.tiles[from.tile]->seen->data() + 4 * from.place;
        const double part = trust(goal_, pixel, residual(goal_, colour, pixel, pull));
        for (int k = 0; k < 4; k++) pull[k] *= part;
      }
    spread(pulls.data(), height, int64_t(width), width, 1, left, goal_.width);
    spread(pulls.data(), width, 1, height, int64_t(width), top, goal_.height);
    for (Crossing& c : crossings_) {
      const double* pull = &pulls[4 * (size_t(c.y - top) * width + c.x - left)];
      c.pull = 0.0;
      for (int k = 0; k < 4; k++) c.pull += pull[k] * c.slope[k];
    }
  }

  // Along `lines` rows or columns, `next` pixels apart, of `length` pixels, `step` apart, from pixel `start` of `whole` on.
  void spread(double* values, int lines, int64_t next, int length, int64_t step, int start, int whole) const {
    std::vector<double> line(size_t(4) * length);
    for (int j = 0; j < lines; j++) {
      double* first = values + 4 * next * j;
      std::fill(line.begin(), line.end(), 0.0);
      for (int i = 0; i < length; i++)
        for (int d = -goal_.reach; d <= goal_.reach; d++) {
          const int to = std::clamp(start + i + d, 0, whole - 1) - start;
          if (to < 0 || to >= length) continue;
          for (int k = 0; k < 4; k++) line[4 * to + k] += goal_.taps[std::abs(d)] * first[4 * step * i + k];
        }
      for (int i = 0; i < length; i++)
        for (int k = 0; k < 4; k++) first[4 * step * i + k] = line[4 * i + k];
    }
  }

  // By how much the blurs of two pixels overlap that are 0, 1, ... px apart along a row or column.
  void overlap() {
    const auto tap = [&](int at) { return std::abs(at) <= goal_.reach ? goal_.taps[std::abs(at)] : 0.0; };
    for (int apart = 0; apart <= 2 * goal_.reach; apart++) {
      double sum = 0.0;
      for (int at = -goal_.reach; at <= goal_.reach; at++) sum += tap(at) * tap(at + apart);
      overlap_.push_back(sum);
    }
  }

  // The Gram matrix of the variables, each entry in one of the triangles: piece by piece, so that the few blocks of one
  // stay near.
  std::vector<sparse::Entry> multiplied() const {
    const Near near(crossings_, goal_, int(overlap_.size()) - 1);
    // Parts of the crossings, each of whole pieces.
    std::vector<size_t> ends;
    for (size_t n = 0; n < crossings_.size(); n++)
      if (const bool last = n + 1 == crossings_.size(); last || crossings_[n + 1].piece != crossings_[n].piece)
        if (last || n + 1 - (ends.empty() ? 0 : ends.back()) >= kAtOnce) ends.push_back(n + 1);
    std::vector<std::vector<sparse::Entry>> parts(ends.size());
    each_index(int64_t(ends.size()), goal_.threads,
               [&](int64_t part) { multiply(near, part > 0 ? ends[part - 1] : 0, ends[part], parts[part]); });
    if (parts.size() == 1) return std::move(parts[0]);
    std::vector<sparse::Entry> out;
    size_t count = 0;
    for (const auto& part : parts) count += part.size();
    out.reserve(count + size_t(unknowns_.variables));
    for (auto& part : parts) out.insert(out.end(), part.begin(), part.end()), part = {};
    return out;
  }

  // Adds the entries of the pieces of some crossings.
  void multiply(const Near& near, size_t n, size_t last, std::vector<sparse::Entry>& out) const {
    std::vector<int32_t> place(pieces_.size(), -1), others;
    std::vector<Block> blocks;  // of the piece and each of the others
    while (n < last) {
      const int32_t piece = crossings_[n].piece;
      for (; n < crossings_.size() && crossings_[n].piece == piece; n++) {
        const Crossing& a = crossings_[n];
        near.each(a, [&](const Crossing& b) {
          if (b.piece < piece) return;
          if (place[b.piece] < 0)
            place[b.piece] = int32_t(others.size()), others.push_back(b.piece), blocks.push_back({});
          double alike = a.leak * b.leak;
          const double shared = overlap_[std::abs(b.y - a.y)] * overlap_[std::abs(b.x - a.x)];
          const double weight = shared * std::sqrt(a.trust * b.trust);
          for (int k = 0; k < 4; k++) alike += weight * a.slope[k] * b.slope[k];
          double* block = blocks[place[b.piece]].data();
          for (int p = 0; p < 8; p++)
            for (int q = 0; q < 8; q++) block[8 * p + q] += alike * a.change[p] * b.change[q];
        });
      }
      for (size_t k = 0; k < others.size(); k++) project(piece, others[k], blocks[k], out), place[others[k]] = -1;
      others.clear(), blocks.clear();
    }
  }

  void pull() {
    for (const Crossing& c : crossings_)
      for (int r = 0; r < 8; r++) pieces_[c.piece].pull[r] += c.pull * c.change[r];
    for (const Piece& piece : pieces_)
      for (size_t k = piece.first; k < piece.first + piece.count; k++)
        for (int r = 0; r < 8; r++) gradient_[variables_[k]] += piece.pull[r] * ways_[8 * k + r];
  }

  // Adds the entries of the variables of two pieces, which count both ways round.
  void project(int32_t i, int32_t j, const Block& block, std::vector<sparse::Entry>& out) const {
    const Piece &one = pieces_[i], &other = pieces_[j];
    for (size_t b = other.first; b < other.first + other.count; b++) {
      double half[8] = {};
      for (int q = 0; q < 8; q++)
        for (int p = 0; p < 8; p++) half[p] += block[8 * p + q] * ways_[8 * b + q];
      for (size_t a = one.first; a < one.first + one.count; a++) {
        const int32_t row = variables_[a], column = variables_[b];
        if (i == j && row > column) continue;
        double value = 0.0;
        for (int p = 0; p < 8; p++) value += ways_[8 * a + p] * half[p];
        out.push_back({row, column, i != j && row == column ? 2.0 * value : value});
      }
    }
  }

  // Where the variables are: in the middle of what they move.
  void place(std::vector<double>& x, std::vector<double>& y) const {
    std::vector<double> shares(x.size(), 0.0);
    for (const Piece& piece : pieces_)
      for (size_t k = piece.first; k < piece.first + piece.count; k++) {
        const int32_t v = variables_[k];
        for (int p = 0; p < 4; p++) x[v] += piece.cubic[2 * p], y[v] += piece.cubic[2 * p + 1];
        shares[v] += 4.0;
      }
    for (size_t v = 0; v < x.size(); v++) x[v] /= std::max(shares[v], 1.0), y[v] /= std::max(shares[v], 1.0);
  }
};

}  // namespace
}  // namespace cs::stack

extern "C" {

int32_t cs_stack_step(const CsPicture* picture, const CsUnknowns* unknowns, double chance, double* step,
                      double* gradient, double* moves, double* misfits) {
  return cs::failed([&] {
    if (!cs::stack::Equations(*picture, *unknowns).solve(step, gradient))
      std::fill(step, step + unknowns->variables, 0.0);
    int64_t row = 0;
    for (int32_t k = 0; k < unknowns->outlines; k++) {
      moves[k] = misfits[k] = 0.0;
      for (int32_t piece = unknowns->first[k]; piece < unknowns->first[k] + unknowns->count[k]; piece++)
        cs::stack::each_pixel(*picture, piece, [&](int32_t, cs::stack::Address at) {
          misfits[k] += picture->tiles[at.tile]->misfit[at.place] + chance;
        });
      for (const int64_t end = row + 8 * int64_t(unknowns->count[k]); row < end; row++) {
        double sum = 0.0;
        for (int64_t n = unknowns->rows[row]; n < unknowns->rows[row + 1]; n++)
          sum += unknowns->value[n] * step[unknowns->start[k] + unknowns->column[n]];
        moves[k] = std::max(moves[k], std::fabs(sum));
      }
    }
  });
}
}
