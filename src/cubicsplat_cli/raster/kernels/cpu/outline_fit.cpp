// All anchors, tangents and handles of an outline together, fitted to its points by damped Gauss-Newton. The variables are
// those of artwork/tracing/variables.py; what is minimised is in artwork/tracing/refine.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <vector>

#include "abi.h"
#include "cubic.h"

namespace cs {
namespace {

constexpr double kLargestStep = 3.0, kLargestTurn = 0.5;  // px, radians
constexpr double kLongestHandle = 1.2;  // of the distance between its piece's ends; longer ones do not grow
constexpr double kShrunk = 0.2;         // of its length that a handle keeps at least in a step
constexpr double kOutlying = 3.0;       // standard errors beyond which a distance counts linearly
constexpr double kStiffness = 0.3;      // 1/px^2, against steps that the points do not call for
constexpr double kEnough = 0.01, kLeastGain = 0.05;  // gains, relative and absolute, below which the fit has converged
constexpr int kSettlingRounds = 2, kTries = 4;
constexpr double kStart = 1e-3, kLeastDamping = 1e-6;

struct Vector {
  double x = 0.0, y = 0.0;
  Vector operator+(Vector o) const { return {x + o.x, y + o.y}; }
  Vector operator-(Vector o) const { return {x - o.x, y - o.y}; }
  Vector operator*(double f) const { return {x * f, y * f}; }
  double length() const { return std::max(std::hypot(x, y), 1e-12); }
};

struct Joint {
  bool after_line, before_line, long_in, long_out;
  int64_t angle = -1, length_in = -1, length_out = -1, vector_in = -1, vector_out = -1;  // variables; -1: none
};

// What stays the same of an outline: its joints, and the variables that move them.
struct Joints {
  int64_t anchors, pieces, total;
  const uint8_t* lines;
  const int64_t* tied;  // anchors x 2
  std::vector<Joint> of;

  Joints(int64_t anchors, int64_t pieces, const uint8_t* lines, const uint8_t* smooth, const uint8_t* level,
         const int64_t* tied)
      : anchors(anchors), pieces(pieces), total(0), lines(lines), tied(tied), of(anchors) {
    std::vector<uint8_t> turning(anchors), free_in(anchors), free_out(anchors);
    for (int64_t i = 0; i < anchors; i++) {
      const bool closed = anchors == pieces, has_in = closed || i > 0, has_out = closed || i < anchors - 1;
      const bool line_in = has_in && lines[std::min(before(i), pieces - 1)], curve_in = has_in && !line_in;
      const bool line_out = has_out && lines[std::min(i, pieces - 1)], curve_out = has_out && !line_out;
      const bool soft = smooth[i] && !(line_in && line_out);
      Joint& joint = of[i];
      joint.after_line = soft && line_in && curve_out, joint.before_line = soft && line_out && curve_in;
      joint.long_in = soft && curve_in, joint.long_out = soft && curve_out;
      turning[i] = soft && !line_in && !line_out && !level[i];
      free_in[i] = !soft && curve_in, free_out[i] = !soft && curve_out;
      total = std::max({total, tied[2 * i] + 1, tied[2 * i + 1] + 1});
    }
    const auto number = [&](const auto& has, int64_t Joint::*variable, int64_t width) {
      for (int64_t i = 0; i < anchors; i++)
        if (has(i)) of[i].*variable = total, total += width;
    };
    number([&](int64_t i) { return turning[i]; }, &Joint::angle, 1);
    number([&](int64_t i) { return of[i].long_in; }, &Joint::length_in, 1);
    number([&](int64_t i) { return of[i].long_out; }, &Joint::length_out, 1);
    number([&](int64_t i) { return free_in[i]; }, &Joint::vector_in, 2);
    number([&](int64_t i) { return free_out[i]; }, &Joint::vector_out, 2);
  }

  int64_t before(int64_t i) const { return (i + anchors - 1) % anchors; }
  int64_t after(int64_t i) const { return (i + 1) % anchors; }
};

// Where an outline lies.
struct Outline {
  std::vector<Vector> anchors, incoming, outgoing;

  std::vector<double> cubics(const Joints& joints) const {
    std::vector<double> out;
    out.reserve(8 * joints.pieces);
    for (int64_t i = 0; i < joints.pieces; i++) {
      const Vector a = anchors[i], b = anchors[joints.after(i)], third = (b - a) * (1.0 / 3.0);
      const Vector first = joints.lines[i] ? a + third : a + outgoing[i];
      const Vector second = joints.lines[i] ? b - third : b + incoming[joints.after(i)];
      for (const Vector p : {a, first, second, b}) out.push_back(p.x), out.push_back(p.y);
    }
    return out;
  }

  // Unit tangents of the smooth joints.
  std::vector<Vector> directions(const Joints& joints) const {
    std::vector<Vector> out(anchors.size());
    for (int64_t i = 0; i < joints.anchors; i++) {
      const Joint& joint = joints.of[i];
      Vector d = joint.long_out ? outgoing[i] : incoming[i] * -1.0;
      if (joint.long_in && joint.long_out)
        d = outgoing[i] * (1.0 / outgoing[i].length()) - incoming[i] * (1.0 / incoming[i].length());
      if (joint.after_line) d = anchors[i] - anchors[joints.before(i)];
      if (joint.before_line) d = anchors[joints.after(i)] - anchors[i];
      out[i] = d * (1.0 / d.length());
    }
    return out;
  }

  // The outline after a step of the variables.
  Outline moved(const Joints& joints, const std::vector<double>& step) const {
    const auto by = [&](int64_t variable) {
      return variable < 0 ? 0.0 : std::clamp(step[variable], -kLargestStep, kLargestStep);
    };
    const std::vector<Vector> directions = this->directions(joints);
    Outline out = *this;
    for (int64_t i = 0; i < joints.anchors; i++)
      out.anchors[i] = anchors[i] + Vector{by(joints.tied[2 * i]), by(joints.tied[2 * i + 1])};
    for (int64_t i = 0; i < joints.anchors; i++) {
      const Joint& joint = joints.of[i];
      const Vector last = out.anchors[i] - out.anchors[joints.before(i)];
      const Vector next = out.anchors[joints.after(i)] - out.anchors[i];
      const double turn = std::clamp(by(joint.angle), -kLargestTurn, kLargestTurn);
      Vector d{std::cos(turn) * directions[i].x - std::sin(turn) * directions[i].y,
               std::sin(turn) * directions[i].x + std::cos(turn) * directions[i].y};
      if (joint.after_line) d = last * (1.0 / last.length());
      if (joint.before_line) d = next * (1.0 / next.length());
      const double came_in = std::hypot(incoming[i].x, incoming[i].y), came_out = std::hypot(outgoing[i].x, outgoing[i].y);
      if (joint.long_in) out.incoming[i] = d * -std::max(came_in + by(joint.length_in), kShrunk * came_in);
      else if (joint.vector_in >= 0) out.incoming[i] = incoming[i] + Vector{by(joint.vector_in), by(joint.vector_in + 1)};
      if (joint.long_out) out.outgoing[i] = d * std::max(came_out + by(joint.length_out), kShrunk * came_out);
      else if (joint.vector_out >= 0) out.outgoing[i] = outgoing[i] + Vector{by(joint.vector_out), by(joint.vector_out + 1)};
      shorten(out.incoming[i], std::max(kLongestHandle * std::hypot(last.x, last.y), came_in));
      shorten(out.outgoing[i], std::max(kLongestHandle * std::hypot(next.x, next.y), came_out));
    }
    return out;
  }

 private:
  static void shorten(Vector& handle, double longest) { handle = handle * std::min(1.0, longest / handle.length()); }
};

// How the 8 coordinates of a piece's control points move with some of the variables.
struct PieceJacobian {
  std::vector<int64_t> variables;
  std::vector<double> columns;  // x 8

  void clear() { variables.clear(), columns.clear(); }

  void add(int64_t variable, int row, double share) {
    if (variable < 0) return;
    size_t k = std::find(variables.begin(), variables.end(), variable) - variables.begin();
    if (k == variables.size()) variables.push_back(variable), columns.resize(columns.size() + 8, 0.0);
    columns[8 * k + row] += share;
  }

  void find(const Joints& joints, const Outline& outline, const std::vector<Vector>& directions, int64_t piece) {
    clear();
    const int64_t start = piece, end = joints.after(piece);
    const double near = joints.lines[piece] ? 2.0 / 3.0 : 1.0, far = 1.0 - near;
    for (int c = 0; c < 2; c++) {
      const int64_t a = joints.tied[2 * start + c], b = joints.tied[2 * end + c];
      add(a, c, 1.0), add(b, 6 + c, 1.0);
      add(a, 2 + c, near), add(b, 4 + c, near);
      if (joints.lines[piece]) add(b, 2 + c, far), add(a, 4 + c, far);
    }
    if (joints.lines[piece]) return;
    const Joint &out = joints.of[start], &in = joints.of[end];
    add_handle(joints, outline, directions[start], 2, start, out.after_line ? joints.before(start) : -1, out.vector_out,
               out.length_out, out.angle, outline.outgoing[start], 1.0);
    add_handle(joints, outline, directions[end], 4, end, in.before_line ? joints.after(end) : -1, in.vector_in,
               in.length_in, in.angle, outline.incoming[end], -1.0);
  }

 private:
  // other: the anchor at the other end of the line that the handle continues, -1 where it continues none.
  void add_handle(const Joints& joints, const Outline& outline, Vector d, int row, int64_t anchor, int64_t other,
                  int64_t vector, int64_t length, int64_t angle, Vector handle, double sign) {
    const double along[2] = {d.x, d.y}, across[2] = {-d.y, d.x}, size = std::hypot(handle.x, handle.y);
    const Vector line = other < 0 ? Vector{} : outline.anchors[anchor] - outline.anchors[other];
    const double lever = size / std::max(std::hypot(line.x, line.y), 1e-6);
    for (int c = 0; c < 2; c++) {
      add(vector < 0 ? -1 : vector + c, row + c, 1.0);
      add(length, row + c, sign * along[c]);
      add(angle, row + c, sign * size * across[c]);
      for (int e = 0; other >= 0 && e < 2; e++) {
        const double turned = lever * across[c] * across[e];
        add(joints.tied[2 * anchor + e], row + c, turned);
        add(joints.tied[2 * other + e], row + c, -turned);
      }
    }
  }
};

// Symmetric positive definite equations. Rows keep what lies between their first entry and the diagonal, where their
// factor lies too (A. George and J. Liu, "Computer Solution of Large Sparse Positive Definite Systems", 1981, chapter 4),
// so variables are numbered along the outline: only those of its last piece meet the first ones.
class Equations {
 public:
  Equations(const Joints& joints, const Outline& outline) : place_(joints.total, -1) {
    const std::vector<Vector> directions = outline.directions(joints);
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

  // Brings the feet nearer, see `nearer_feet`. Returns chi^2 with Huber's tails.
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
      const double speed = std::max(std::hypot(place.first.x, place.first.y), kStill);
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

double refine(const Joints& joints, const uint8_t* smooth, const Points& points, int rounds, Outline& outline, Feet& feet) {
  outline = outline.moved(joints, std::vector<double>(joints.total, 0.0));
  double best = points.settle(joints, smooth, outline, feet), damping = kStart;
  for (int round = 0; round < rounds; round++) {
    const Equations equations = points.equations(joints, outline, feet);
    const double before = best;
    for (int attempt = 0; attempt < kTries && best == before; attempt++) {
      Outline trial = outline.moved(joints, equations.step(damping));
      Feet found = feet;
      const double value = points.settle(joints, smooth, trial, found);
      if (value < best) best = value, outline = std::move(trial), feet = std::move(found);
      else damping *= 8.0;
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
  try {
    return cs::Joints(anchors, pieces, lines, smooth, level, tied).total;
  } catch (const std::exception&) {
    return -1;
  }
}

// Fits an outline to points (x 2) in at most `rounds` steps. at, incoming, outgoing: anchors x 2, the anchors and the
// handles before and after them, relative to them; piece, u: where each point belongs. All are brought up to date.
// Returns chi^2, -1 where there is no memory.
CS_EXPORT double cs_refine(int64_t anchors, int64_t pieces, const uint8_t* lines, const uint8_t* smooth,
                           const uint8_t* level, const int64_t* tied, double* at, double* incoming, double* outgoing,
                           int64_t count, const double* points, const double* weights, int64_t* piece, double* u,
                           int32_t rounds) {
  using namespace cs;
  try {
    const Joints joints(anchors, pieces, lines, smooth, level, tied);
    Outline outline;
    const auto pairs = [&](const double* values) {
      std::vector<Vector> out(anchors);
      for (int64_t i = 0; i < anchors; i++) out[i] = {values[2 * i], values[2 * i + 1]};
      return out;
    };
    outline.anchors = pairs(at), outline.incoming = pairs(incoming), outline.outgoing = pairs(outgoing);
    Feet feet{{piece, piece + count}, {u, u + count}, std::vector<double>(count), std::vector<double>(2 * count)};
    const double chi = refine(joints, smooth, {count, points, weights}, rounds, outline, feet);
    for (int64_t i = 0; i < anchors; i++) {
      at[2 * i] = outline.anchors[i].x, at[2 * i + 1] = outline.anchors[i].y;
      incoming[2 * i] = outline.incoming[i].x, incoming[2 * i + 1] = outline.incoming[i].y;
      outgoing[2 * i] = outline.outgoing[i].x, outgoing[2 * i + 1] = outline.outgoing[i].y;
    }
    std::copy(feet.piece.begin(), feet.piece.end(), piece), std::copy(feet.u.begin(), feet.u.end(), u);
    return chi;
  } catch (const std::exception&) {
    return -1.0;
  }
}
}
