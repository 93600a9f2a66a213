// The best division of a run of points between two corners into lines and cubics, by dynamic programming. What pieces cost
// is said in tests/outline_loops.py (`laid_out`).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "piece_fit.h"
#include "sections.h"

namespace cs {
namespace {

constexpr double kWidestTurn = 3.490658503988659;  // radians of one cubic, all bends added: 200 degrees
constexpr int kLineParameters = 2, kCubicParameters = 5;
constexpr int kBendParameters = 4;  // of a line after a line where no corner was found

// A piece of a division: from which of the points, and the node there, on; and its handles, relative to its ends.
struct Piece {
  int64_t first;
  bool line, level;
  Point at;
  double handles[4];
};

struct Division {
  std::vector<Piece> pieces;
  double cost;  // nats
};

class Divider {
 public:
  Divider(const Section& run, double price)
      : run_(run), price_(price), nodes_(nodes_of(run)), last_(int64_t(nodes_.size()) - 1) {
    // Only points that tell something are sampled: a few that show between hidden ones must not be missed.
    rank_.resize(nodes_.size());
    size_t next = 0;
    for (int64_t i = 0; i < int64_t(run.at.size()); i++) {
      for (; next < nodes_.size() && nodes_[next].index <= i; next++) rank_[next] = int64_t(telling_.size());
      if (run.weights[i] > 0.0) telling_.push_back(i);
    }
    for (; next < nodes_.size(); next++) rank_[next] = int64_t(telling_.size());
    if (telling_.empty()) telling_.push_back(0);
  }

  Division divide() {
    // The whole run as a single piece, where no two could be cheaper.
    if (run_.corners) {
      const Fitted whole = fitted(0, last_, INFINITY, INFINITY);
      const bool line = whole.line <= whole.cubic;
      const double most = price_ * (kLineParameters + kCubicParameters + !line);
      if (std::min(whole.line, whole.cubic) <= most)
        return {{piece(0, last_, line, whole.control)}, std::min(whole.line, whole.cubic)};
    }
    return cheapest();
  }

 private:
  struct Fitted {
    double line, cubic, control[8];  // costs, nats, and the cubic
  };

  // The cheapest way to a node whose last piece is a line (kind 0) or a cubic (kind 1).
  struct Reached {
    double cost = INFINITY;
    int64_t first = 0;
    int before = 0;  // the kind of the piece before
    double control[8] = {};
  };

  const Section& run_;
  double price_;
  std::vector<Node> nodes_;
  int64_t last_;
  std::vector<int64_t> rank_, telling_;  // of each node, how many telling points come before it; and those points

  // The costs of the best line and the best cubic from one node to another, infinite where the misfits alone cost as much
  // as what may be paid.
  Fitted fitted(int64_t first, int64_t last, double most_line, double most_cubic) const {
    const bool starts = run_.corners && first == 0, stops = run_.corners && last == last_;
    const double line = price_ * kLineParameters, cubic = price_ * (kCubicParameters + starts - nodes_[last].level);
    Fitted out{INFINITY, INFINITY, {}};
    if (!(line < most_line || cubic < most_cubic)) return out;
    Sampled sampled;
    const int64_t nodes[2] = {first, last}, low = rank_[first], count = rank_[last] - low;
    for (int e = 0; e < 2; e++) {
      const Node& node = nodes_[nodes[e]];
      sampled.ends[e] = node.at, sampled.tangents[e] = node.tangent;
      std::copy(node.errors.begin(), node.errors.end(), sampled.errors[e]);
    }
    sampled.share = double(count) / kSamples;
    for (int k = 0; k < kSamples; k++) {
      const int64_t place = int64_t(double(low) + double(count) * ((k + 0.5) / kSamples));
      const int64_t own = telling_[std::min(place, int64_t(telling_.size()) - 1)];
      sampled.x[k] = run_.at[own].x, sampled.y[k] = run_.at[own].y;
      sampled.single[k] = run_.weights[own], sampled.weights[k] = run_.weights[own] * sampled.share;
    }
    if (line < most_line) {
      const Point way = sampled.ends[1] - sampled.ends[0];
      out.line = 0.5 * sampled.line() + line;
      if (!starts) out.line += strain(way, sampled.tangents[0], sampled.errors[0][1]);
      if (!stops) out.line += strain(way, sampled.tangents[1], sampled.errors[1][1]);
    }
    if (cubic < most_cubic) {
      sampled.start();
      out.cubic = 0.5 * sampled.exact(out.control) + cubic;
    }
    return out;
  }

  Division cheapest() const {
    std::vector<std::array<Reached, 2>> best(nodes_.size());
    best[0][1].cost = 0.0;
    std::vector<double> turned(nodes_.size(), 0.0);  // radians up to each node, all bends added
    int64_t lowest = 0;
    for (int64_t last = 1; last <= last_; last++) {
      const Point a = nodes_[last - 1].tangent, b = nodes_[last].tangent;
      turned[last] = turned[last - 1] + std::fabs(std::atan2(cross(a, b), dot(a, b)));
      while (turned[last] - turned[lowest] > kWidestTurn && lowest < last - 1) lowest++;
      reach(best, last - 1, last);
      for (int64_t first = lowest; first < last - 1; first++) reach(best, first, last);
    }
    Division out;
    int64_t node = last_;
    int kind = best[node][1].cost < best[node][0].cost;
    out.cost = best[node][kind].cost;
    while (node > 0) {
      const Reached& reached = best[node][kind];
      out.pieces.push_back(piece(reached.first, node, kind == 0, reached.control));
      node = reached.first, kind = reached.before;
    }
    std::reverse(out.pieces.begin(), out.pieces.end());
    return out;
  }

  // Goes from one node to another, if that is cheaper than the ways known to it.
  void reach(std::vector<std::array<Reached, 2>>& best, int64_t first, int64_t last) const {
    double before[2];  // what it costs to get to the first node, to go on by a line and by a cubic
    int kinds[2];
    for (int kind = 0; kind < 2; kind++) {
      const double line = best[first][0].cost + (kind == 0 ? kBendParameters * price_ : 0.0),
                   cubic = best[first][1].cost;
      kinds[kind] = cubic < line, before[kind] = std::min(line, cubic);
    }
    // Misfits are never below 0, so most pairs need not be fitted.
    const double most[2] = {best[last][0].cost - before[0], best[last][1].cost - before[1]};
    const Fitted found = fitted(first, last, most[0], most[1]);
    const double costs[2] = {found.line, found.cubic};
    for (int kind = 0; kind < 2; kind++) {
      if (!(costs[kind] < most[kind])) continue;
      Reached& reached = best[last][kind];
      reached.cost = before[kind] + costs[kind], reached.first = first, reached.before = kinds[kind];
      if (kind == 1) std::copy(found.control, found.control + 8, reached.control);
    }
  }

  Piece piece(int64_t first, int64_t last, bool line, const double* control) const {
    const Node &a = nodes_[first], &b = nodes_[last];
    Piece out{a.index, line, a.level, a.at, {}};
    const double way[2] = {b.at.x - a.at.x, b.at.y - a.at.y};
    for (int c = 0; c < 2; c++) {
      out.handles[c] = line ? way[c] / 3.0 : control[2 + c] - control[c];
      out.handles[2 + c] = line ? -way[c] / 3.0 : control[4 + c] - control[6 + c];
    }
    return out;
  }
};

inline Division divided(const Section& run, double price) { return Divider(run, price).divide(); }

// Where the pieces of divisions are written, one after the other; see `Division` in raster/cubics.py.
struct PieceArrays {
  int64_t* sizes;
  double *anchors, *handles;
  uint8_t *lines, *level, *from_corner;
  int64_t count = 0;

  // stop: the point at which the last piece ends.
  void write(const Division& division, int64_t stop, bool from) {
    for (size_t k = 0; k < division.pieces.size(); k++, count++) {
      const Piece& piece = division.pieces[k];
      sizes[count] = (k + 1 < division.pieces.size() ? division.pieces[k + 1].first : stop) - piece.first;
      lines[count] = piece.line, level[count] = piece.level, from_corner[count] = from && k == 0;
      anchors[2 * count] = piece.at.x, anchors[2 * count + 1] = piece.at.y;
      std::copy(piece.handles, piece.handles + 4, handles + 4 * count);
    }
  }
};

}  // namespace
}  // namespace cs
