// An outline as its free variables move it: anchors, directions of smooth joints, handle lengths, handles at corners. What
// its joints keep is said in raster/cubics.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "cubic.h"

namespace cs {
namespace {

constexpr double kLargestStep = 3.0, kLargestTurn = 0.5;  // px, radians
constexpr double kLongestHandle = 1.2;  // of the distance between its piece's ends; longer ones do not grow
constexpr double kShrunk = 0.2;         // of its length that a handle keeps at least in a step

Point unit(Point way) { return way * (1.0 / std::max(way.length(), kLeast)); }

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
    const auto number = [&](const auto& has, int64_t Joint::* variable, int64_t width) {
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
  std::vector<Point> anchors, incoming, outgoing;

  // From arrays x 2, and back to them.
  Outline(int64_t count, const double* at, const double* in, const double* out)
      : anchors(pairs(count, at)), incoming(pairs(count, in)), outgoing(pairs(count, out)) {}

  void write(double* at, double* in, double* out) const {
    for (size_t i = 0; i < anchors.size(); i++) {
      at[2 * i] = anchors[i].x, at[2 * i + 1] = anchors[i].y;
      in[2 * i] = incoming[i].x, in[2 * i + 1] = incoming[i].y;
      out[2 * i] = outgoing[i].x, out[2 * i + 1] = outgoing[i].y;
    }
  }

  std::vector<double> cubics(const Joints& joints) const {
    std::vector<double> out;
    out.reserve(8 * joints.pieces);
    for (int64_t i = 0; i < joints.pieces; i++) {
      const Point a = anchors[i], b = anchors[joints.after(i)], third = (b - a) * (1.0 / 3.0);
      const Point first = joints.lines[i] ? a + third : a + outgoing[i];
      const Point second = joints.lines[i] ? b - third : b + incoming[joints.after(i)];
      for (const Point p : {a, first, second, b}) out.push_back(p.x), out.push_back(p.y);
    }
    return out;
  }

  // Unit tangents of the smooth joints.
  std::vector<Point> directions(const Joints& joints) const {
    std::vector<Point> out(anchors.size());
    for (int64_t i = 0; i < joints.anchors; i++) {
      const Joint& joint = joints.of[i];
      Point d = joint.long_out ? outgoing[i] : incoming[i] * -1.0;
      if (joint.long_in && joint.long_out) d = unit(outgoing[i]) - unit(incoming[i]);
      if (joint.after_line) d = anchors[i] - anchors[joints.before(i)];
      if (joint.before_line) d = anchors[joints.after(i)] - anchors[i];
      out[i] = unit(d);
    }
    return out;
  }

  // The outline after a step of the variables.
  Outline moved(const Joints& joints, const std::vector<double>& step) const {
    const auto by = [&](int64_t variable) {
      return variable < 0 ? 0.0 : std::clamp(step[variable], -kLargestStep, kLargestStep);
    };
    const std::vector<Point> directions = this->directions(joints);
    Outline out = *this;
    for (int64_t i = 0; i < joints.anchors; i++)
      out.anchors[i] = anchors[i] + Point{by(joints.tied[2 * i]), by(joints.tied[2 * i + 1])};
    for (int64_t i = 0; i < joints.anchors; i++) {
      const Joint& joint = joints.of[i];
      const Point last = out.anchors[i] - out.anchors[joints.before(i)];
      const Point next = out.anchors[joints.after(i)] - out.anchors[i];
      const double turn = std::clamp(by(joint.angle), -kLargestTurn, kLargestTurn);
      Point d{std::cos(turn) * directions[i].x - std::sin(turn) * directions[i].y,
              std::sin(turn) * directions[i].x + std::cos(turn) * directions[i].y};
      if (joint.after_line) d = unit(last);
      if (joint.before_line) d = unit(next);
      const double came_in = incoming[i].length(), came_out = outgoing[i].length();
      const int64_t in = joint.vector_in, on = joint.vector_out;
      if (joint.long_in)
        out.incoming[i] = d * -std::max(came_in + by(joint.length_in), kShrunk * came_in);
      else if (in >= 0)
        out.incoming[i] = incoming[i] + Point{by(in), by(in + 1)};
      if (joint.long_out)
        out.outgoing[i] = d * std::max(came_out + by(joint.length_out), kShrunk * came_out);
      else if (on >= 0)
        out.outgoing[i] = outgoing[i] + Point{by(on), by(on + 1)};
      shorten(out.incoming[i], std::max(kLongestHandle * last.length(), came_in));
      shorten(out.outgoing[i], std::max(kLongestHandle * next.length(), came_out));
    }
    return out;
  }

 private:
  static std::vector<Point> pairs(int64_t count, const double* values) {
    std::vector<Point> out(count);
    for (int64_t i = 0; i < count; i++) out[i] = {values[2 * i], values[2 * i + 1]};
    return out;
  }

  static void shorten(Point& handle, double longest) {
    handle = handle * std::min(1.0, longest / std::max(handle.length(), kLeast));
  }
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

  void find(const Joints& joints, const Outline& outline, const std::vector<Point>& directions, int64_t piece) {
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
  void add_handle(const Joints& joints, const Outline& outline, Point d, int row, int64_t anchor, int64_t other,
                  int64_t vector, int64_t length, int64_t angle, Point handle, double sign) {
    const double along[2] = {d.x, d.y}, across[2] = {-d.y, d.x}, size = handle.length();
    const Point line = other < 0 ? Point{} : outline.anchors[anchor] - outline.anchors[other];
    const double lever = size / std::max(line.length(), 1e-6);
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

}  // namespace
}  // namespace cs
