// All anchors, tangents and handles of an outline together, fitted to its points by damped Gauss-Newton. The variables
// and what is minimised are said in raster/cubics.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "cubic.h"
#include "outline_variables.h"

namespace cs {
namespace {

constexpr double kOutlying = 3.0;                    // standard errors beyond which a distance counts linearly
constexpr double kStiffness = 0.3;                   // 1/px^2, against steps that the points do not call for
constexpr double kEnough = 0.01, kLeastGain = 0.05;  // gains, relative and absolute, below which the fit has converged
constexpr int kSettlingRounds = 2, kTries = 4;
constexpr double kStart = 1e-3, kLeastDamping = 1e-6;

// Symmetric positive definite equations. Rows keep what lies between their first entry and the diagonal, where their
// factor lies too (A. George and J. Liu, "Computer Solution of Large Sparse Positive Definite Systems", 1981, chapter 4),
// so variables are numbered along the outline: only those of its last piece meet the first ones.
class Equations {
 public:
  Equations(const Joints& joints, const Outline& outline) : place_(joints.total, -1) {
    const std::vector<Point> directions = outline.directions(joints);
    parts_.resize(joints.pieces);
    int64_t count = 0;
    for (int64_t i = 0; i < joints.pieces; i++) {
      parts_[i].find(joints, outline, directions, i);
      for (const int64_t variable : parts_[i].variables)
        if (place_[variable] < 0) place_[variable] = count++;
    }
    for (int64_t& place : place_)  // what moves nothing
      if (place < 0) place = count++;
    first_.resize(count);
    for (int64_t i = 0; i < count; i++) first_[i] = i;
    for (const PieceJacobian& part : parts_) {
      int64_t least = count;
      for (const int64_t variable : part.variables) least = std::min(least, place_[variable]);
      for (const int64_t variable : part.variables)
        first_[place_[variable]] = std::min(first_[place_[variable]], least);
    }
    starts_.resize(count + 1);
    for (int64_t i = 0; i < count; i++) starts_[i + 1] = starts_[i] + i - first_[i] + 1;
    values_.assign(starts_[count], 0.0), slope_.assign(count, 0.0);
  }

  // Adds the Gram matrix (8 x 8) and gradient (8) of a piece's control points.
  void add(int64_t piece, const double* gram, const double* slope) {
    const PieceJacobian& part = parts_[piece];
    for (size_t k = 0; k < part.variables.size(); k++) {
      const double* own = &part.columns[8 * k];
      const int64_t i = place_[part.variables[k]];
      double weighted[8] = {};
      for (int p = 0; p < 8; p++) {
        slope_[i] += own[p] * slope[p];
        for (int q = 0; q < 8; q++) weighted[q] += own[p] * gram[8 * p + q];
      }
      for (size_t l = 0; l < part.variables.size(); l++) {
        const int64_t j = place_[part.variables[l]];
        if (j > i) continue;
        const double* other = &part.columns[8 * l];
        for (int q = 0; q < 8; q++) row(i)[j] += weighted[q] * other[q];
      }
    }
  }

  // The damped step of the variables.
  std::vector<double> step(double damping) const {
    Equations damped = *this;
    const int64_t count = int64_t(slope_.size());
    double most = 0.0;
    for (int64_t i = 0; i < count; i++) most = std::max(most, row(i)[i]);
    for (int64_t i = 0; i < count; i++) damped.row(i)[i] += damping * (row(i)[i] + 1e-4 * most) + kStiffness;
    const std::vector<double> solution = damped.solved();
    std::vector<double> out(count);
    for (int64_t variable = 0; variable < count; variable++) out[variable] = solution[place_[variable]];
    return out;
  }

 private:
  std::vector<PieceJacobian> parts_;
  std::vector<int64_t> place_, first_, starts_;  // of variables; of rows
  std::vector<double> values_, slope_;

  // A row, to be taken at its columns from the first one on.
  double* row(int64_t i) { return values_.data() + starts_[i] - first_[i]; }
  const double* row(int64_t i) const { return values_.data() + starts_[i] - first_[i]; }

  // Cholesky's decomposition in place, and the solution for the negative slope.
  std::vector<double> solved() {
    const int64_t count = int64_t(slope_.size());
    std::vector<double> x(count);
    for (int64_t i = 0; i < count; i++) {
      double *own = row(i), rest = -slope_[i];
      for (int64_t j = first_[i]; j <= i; j++) {
        const double* other = row(j);
        double sum = own[j];
        for (int64_t k = std::max(first_[i], first_[j]); k < j; k++) sum -= own[k] * other[k];
        own[j] = j == i ? std::sqrt(sum) : sum / other[j];
        if (j < i) rest -= own[j] * x[j];
      }
      x[i] = rest / own[i];
    }
    for (int64_t i = count - 1; i >= 0; i--) {
      x[i] /= row(i)[i];
      for (int64_t k = first_[i]; k < i; k++) x[k] -= row(i)[k] * x[i];
    }
    return x;
  }
};

// Points with their weights, and where they belong on an outline: the piece and parameter of the foot of each, by how far
// that is off along the normal, and this (x 2).
struct Feet {
  std::vector<int64_t> piece;
  std::vector<double> u, rest, normals;
};

struct Points {
  int64_t count;
  const double *places, *weights;

  // Brings the feet nearer: those beyond the end of their piece pass on to the next one, or before its start to the last
  // one, where the joint is smooth. Returns chi^2 with Huber's tails.
  double settle(const Joints& joints, const uint8_t* smooth, const Outline& outline, Feet& feet) const {
    const std::vector<double> cubics = outline.cubics(joints);
    double loss = 0.0;
    for (int64_t i = 0; i < count; i++) {
      const double* point = places + 2 * i;
      for (int round = 0; round < kSettlingRounds; round++) {
        const int64_t own = feet.piece[i];
        const double at = nearer(&cubics[8 * own], point, feet.u[i]);
        const bool on = at > 1.0 && smooth[joints.after(own)], back = at < 0.0 && smooth[own];
        feet.piece[i] = (own + on - back + joints.pieces) % joints.pieces;
        feet.u[i] = on ? 0.0 : back ? 1.0 : std::clamp(at, 0.0, 1.0);
      }
      const Place place(&cubics[8 * feet.piece[i]], feet.u[i]);
      const double speed = std::max(place.first.length(), kStill);
      const double x = -place.first.y / speed, y = place.first.x / speed;
      feet.normals[2 * i] = x, feet.normals[2 * i + 1] = y;
      feet.rest[i] = (place.at.x - point[0]) * x + (place.at.y - point[1]) * y;
      const double size = std::fabs(feet.rest[i]) * std::sqrt(weights[i]);
      loss += size <= kOutlying ? size * size : kOutlying * (2.0 * size - kOutlying);
    }
    return loss;
  }

  // The normal equations of the distances over the variables.
  Equations equations(const Joints& joints, const Outline& outline, const Feet& feet) const {
    std::vector<double> gram(64 * joints.pieces, 0.0), slope(8 * joints.pieces, 0.0);
    for (int64_t i = 0; i < count; i++) {
      const double size = std::fabs(feet.rest[i]) * std::sqrt(weights[i]);
      const double weight = weights[i] * std::min(1.0, kOutlying / std::max(size, 1e-12));
      if (weight == 0.0) continue;
      const double t = feet.u[i], v = 1.0 - t, b[4] = {v * v * v, 3.0 * v * v * t, 3.0 * v * t * t, t * t * t};
      double row[8];
      for (int k = 0; k < 8; k++) row[k] = b[k / 2] * feet.normals[2 * i + k % 2];
      double *own = &gram[64 * feet.piece[i]], *pull = &slope[8 * feet.piece[i]];
      for (int p = 0; p < 8; p++) {
        pull[p] += weight * feet.rest[i] * row[p];
        for (int q = 0; q < 8; q++) own[8 * p + q] += weight * row[p] * row[q];
      }
    }
    Equations out(joints, outline);
    for (int64_t piece = 0; piece < joints.pieces; piece++) out.add(piece, &gram[64 * piece], &slope[8 * piece]);
    return out;
  }
};

double refine(const Joints& joints, const uint8_t* smooth, const Points& points, int rounds, Outline& outline,
              Feet& feet) {
  outline = outline.moved(joints, std::vector<double>(joints.total, 0.0));
  double best = points.settle(joints, smooth, outline, feet), damping = kStart;
  for (int round = 0; round < rounds; round++) {
    const Equations equations = points.equations(joints, outline, feet);
    const double before = best;
    for (int attempt = 0; attempt < kTries && best == before; attempt++) {
      Outline trial = outline.moved(joints, equations.step(damping));
      Feet found = feet;
      const double value = points.settle(joints, smooth, trial, found);
      if (value < best)
        best = value, outline = std::move(trial), feet = std::move(found);
      else
        damping *= 8.0;
    }
    if (!(best < before) || before - best < kEnough * best + kLeastGain) break;
    damping = std::max(damping / 5.0, kLeastDamping);
  }
  return best;
}

}  // namespace
}  // namespace cs

extern "C" {

// The number of the variables of an outline of so many anchors and pieces (as many where it is closed, else one less).
// lines: pieces; smooth, level: anchors; tied: anchors x 2, the variable of each coordinate, -1 for none. -1 where there
// is no memory.
CS_EXPORT int64_t cs_count_variables(int64_t anchors, int64_t pieces, const uint8_t* lines, const uint8_t* smooth,
                                     const uint8_t* level, const int64_t* tied) {
  return cs::counted([&] { return cs::Joints(anchors, pieces, lines, smooth, level, tied).total; });
}

// The control points, pieces x 8, of an outline of handles relative to its anchors; those of a line lie at its thirds.
CS_EXPORT void cs_outline_cubics(int64_t anchors, int64_t pieces, const uint8_t* lines, const double* at,
                                 const double* incoming, const double* outgoing, double* cubics) {
  for (int64_t i = 0; i < pieces; i++) {
    const int64_t start = 2 * i, end = 2 * ((i + 1) % anchors);
    for (int c = 0; c < 2; c++) {
      const double a = at[start + c], b = at[end + c], third = (b - a) / 3.0;
      double* out = cubics + 8 * i + c;
      out[0] = a, out[2] = a + (lines[i] ? third : outgoing[start + c]);
      out[4] = b + (lines[i] ? -third : incoming[end + c]), out[6] = b;
    }
  }
}

// Moves an outline, as in `cs_refine`, by a step of its variables; cubics: of where it comes to lie, as
// `cs_outline_cubics` gives them. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_move_outline(int64_t anchors, int64_t pieces, const uint8_t* lines, const uint8_t* smooth,
                                  const uint8_t* level, const int64_t* tied, const double* step, double* at,
                                  double* incoming, double* outgoing, double* cubics) {
  using namespace cs;
  return failed([&] {
    const Joints joints(anchors, pieces, lines, smooth, level, tied);
    const Outline outline(anchors, at, incoming, outgoing);
    outline.moved(joints, {step, step + joints.total}).write(at, incoming, outgoing);
    cs_outline_cubics(anchors, pieces, lines, at, incoming, outgoing, cubics);
  });
}

// How the control points of an outline move with its variables, as a sparse matrix by rows, 8 to a piece. starts: 8 x
// pieces + 1; columns, values: room for 8 entries a row. -1 where there is no memory, else their number.
CS_EXPORT int64_t cs_outline_jacobian(int64_t anchors, int64_t pieces, const uint8_t* lines, const uint8_t* smooth,
                                      const uint8_t* level, const int64_t* tied, const double* at,
                                      const double* incoming, const double* outgoing, int32_t* starts, int32_t* columns,
                                      double* values) {
  using namespace cs;
  return counted([&] {
    const Joints joints(anchors, pieces, lines, smooth, level, tied);
    const Outline outline(anchors, at, incoming, outgoing);
    const std::vector<Point> directions = outline.directions(joints);
    PieceJacobian part;
    std::vector<size_t> order;
    int32_t count = 0;
    for (int64_t piece = 0; piece < pieces; piece++) {
      part.find(joints, outline, directions, piece);
      order.resize(part.variables.size());
      for (size_t k = 0; k < order.size(); k++) order[k] = k;
      std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return part.variables[a] < part.variables[b]; });
      for (int row = 0; row < 8; row++) {
        starts[8 * piece + row] = count;
        for (const size_t k : order) {
          if (part.columns[8 * k + row] == 0.0) continue;
          columns[count] = int32_t(part.variables[k]), values[count++] = part.columns[8 * k + row];
        }
      }
    }
    starts[8 * pieces] = count;
    return count;
  });
}

// Fits an outline to points (x 2) in at most `rounds` steps. at, incoming, outgoing: anchors x 2, the anchors and the
// handles before and after them, relative to them; piece, u: where each point belongs. All are brought up to date.
// Returns chi^2, -1 where there is no memory.
CS_EXPORT double cs_refine(int64_t anchors, int64_t pieces, const uint8_t* lines, const uint8_t* smooth,
                           const uint8_t* level, const int64_t* tied, double* at, double* incoming, double* outgoing,
                           int64_t count, const double* points, const double* weights, int64_t* piece, double* u,
                           int64_t rounds) {
  using namespace cs;
  return counted([&] {
    const Joints joints(anchors, pieces, lines, smooth, level, tied);
    Outline outline(anchors, at, incoming, outgoing);
    Feet feet{{piece, piece + count}, {u, u + count}, std::vector<double>(count), std::vector<double>(2 * count)};
    const double chi = refine(joints, smooth, {count, points, weights}, int(rounds), outline, feet);
    outline.write(at, incoming, outgoing);
    std::copy(feet.piece.begin(), feet.piece.end(), piece), std::copy(feet.u.begin(), feet.u.end(), u);
    return chi;
  });
}
}
