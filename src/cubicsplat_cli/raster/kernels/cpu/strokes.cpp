// The outlines of strokes: offset curves on both sides, caps and joins, as SVG's rules for stroking have them, and how
// they move with the centre line. raster/strokes.py says what each function means.
//
// Offsets of a cubic are cubics through exact offset points with exact tangents and speeds (Hermite), of parts that
// turn by so little that they are true to a few thousandths of the width.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "cubic.h"

namespace cs {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kMostTurn = 25.0 * kPi / 180.0;  // of a part of a cubic
constexpr double kStraight = 0.3 * kPi / 180.0;   // a joint that turns by less needs no join
constexpr double kMiterLimit = 4.0;               // SVG's own: of the length of a miter over the width
constexpr double kShort = 1e-9;                   // px: no length
constexpr int64_t kMostParts = 64;

Point normal(Point way) { return {-way.y, way.x}; }
// Radians from one direction to another, positive from x to y.
double turn(Point a, Point b) { return std::atan2(cross(a, b), dot(a, b)); }

enum Cap { kButt, kRound, kSquare, kClosed, kOneSide };
enum Join { kMiter, kRoundJoin, kBevel };

// A piece of an outline, and the pieces of the centre line that it depends on, the same one twice but at a joint.
struct Piece {
  Point at[4];
  uint8_t line;
  int64_t first, last;
};

struct Line {
  int64_t count;
  const Point (*cubics)[4];
  const uint8_t* lines;
  const int64_t* parts;
  const double* turns;
};

struct Style {
  double half;
  int64_t cap, join;
};

// Unit tangents at both ends of a cubic; where a handle has no length, those of what follows it.
void tangents(const Point* p, Point* out) {
  for (int end = 0; end < 2; end++) {
    const Point& from = end ? p[3] : p[0];
    Point way = (end ? p[2] : p[1]) - from;
    for (int k = 2; k < 4 && way.length() <= kShort; k++) way = (end ? p[3 - k] : p[k]) - from;
    out[end] = way * ((end ? -1.0 : 1.0) / std::max(way.length(), kLeast));
  }
}

// The number of cubics of an arc, of an eighth of a turn at most.
int64_t eighths(double by) { return std::max<int64_t>(1, int64_t(std::ceil(std::fabs(by) / (0.25 * kPi + 1e-9)))); }

class StrokeOutline {
 public:
  std::vector<Piece> pieces;
  std::vector<int64_t> ends;  // of its rings

  void around(const Line& line, Style style) {
    pieces.clear(), ends.clear();
    side(line, style.half, style);
    if (style.cap == kOneSide) return close();
    if (style.cap == kClosed) close();
    const int64_t last = line.count - 1;
    Point end[2], start[2];
    tangents(line.cubics[last], end), tangents(line.cubics[0], start);
    if (style.cap != kClosed) cap(line.cubics[last][3], end[1], style, last);
    const size_t back = pieces.size();
    side(line, -style.half, style);
    std::reverse(pieces.begin() + back, pieces.end());
    for (size_t k = back; k < pieces.size(); k++) std::reverse(pieces[k].at, pieces[k].at + 4);
    if (style.cap != kClosed) cap(line.cubics[0][0], start[0] * -1.0, style, 0);
    close();
  }

 private:
  void straight(Point a, Point b, int64_t first, int64_t last) {
    pieces.push_back({{a, a + (b - a) * (1.0 / 3.0), a + (b - a) * (2.0 / 3.0), b}, 1, first, last});
  }

  // Ends a ring, each piece of which ends where the next begins.
  void close() {
    const int64_t first = ends.empty() ? 0 : ends.back(), count = int64_t(pieces.size()) - first;
    for (int64_t k = 0; k < count; k++) pieces[first + k].at[3] = pieces[first + (k + 1) % count].at[0];
    ends.push_back(int64_t(pieces.size()));
  }

  void arc(Point middle, Point start, double by, int64_t count, int64_t first, int64_t last) {
    const Point spoke = start - middle;
    const double radius = std::max(spoke.length(), kLeast), from = std::atan2(spoke.y, spoke.x);
    const double reach = 4.0 / 3.0 * std::tan(by / count / 4.0);
    for (int64_t k = 0; k < count; k++) {
      const double angles[2] = {from + by * k / count, from + by * (k + 1) / count};
      Point unit[2];
      for (int e = 0; e < 2; e++) unit[e] = {std::cos(angles[e]), std::sin(angles[e])};
      const Point way[4] = {unit[0], unit[0] + normal(unit[0]) * reach, unit[1] - normal(unit[1]) * reach, unit[1]};
      Piece piece{{}, 0, first, last};
      for (int e = 0; e < 4; e++) piece.at[e] = middle + way[e] * radius;
      pieces.push_back(piece);
    }
  }

  // The offset of all pieces, reach px to the side of the normal (-y, x), with joins.
  void side(const Line& line, double reach, Style style) {
    for (int64_t i = 0; i < line.count; i++) {
      const int64_t next = (i + 1) % line.count;
      Point own[2], following[2];
      tangents(line.cubics[i], own), tangents(line.cubics[next], following);
      offset(line.cubics[i], line.lines[i], reach, own, line.parts[i], i);
      if (line.turns[i] != 0.0 && (next || style.cap == kClosed || style.cap == kOneSide))
        join(line.cubics[i][3], own[1], following[0], reach, style.join, line.turns[i], i, next);
    }
  }

  void offset(const Point* p, bool line, double reach, const Point* ends_of, int64_t count, int64_t owner) {
    if (line) {
      const Point by = normal(ends_of[0]) * reach;
      return straight(p[0] + by, p[3] + by, owner, owner);
    }
    std::vector<Point> places(count + 1), slopes(count + 1);
    std::vector<double> speeds(count + 1), turning(count + 1);
    double fastest = 0.0;
    for (int64_t k = 0; k <= count; k++) {
      const Place here(&p->x, double(k) / count);
      places[k] = here.at;
      speeds[k] = std::max(here.first.length(), kLeast), turning[k] = cross(here.first, here.second);
      slopes[k] = here.first * (1.0 / std::max(speeds[k], kShort));
      fastest = std::max(fastest, speeds[k]);
    }
    slopes[0] = ends_of[0], slopes[count] = ends_of[1];
    for (int64_t k = 0; k <= count; k++) {
      places[k] = places[k] + normal(slopes[k]) * reach;
      // Where a handle has no length the curve stops for a moment, and its bend there is not known.
      const double bend = speeds[k] > 1e-3 * fastest ? turning[k] / (speeds[k] * speeds[k] * speeds[k]) : 0.0;
      slopes[k] = slopes[k] * (speeds[k] * (1.0 - bend * reach) / (3.0 * count));
    }
    for (int64_t k = 0; k < count; k++)
      pieces.push_back(
          {{places[k], places[k] + slopes[k], places[k + 1] - slopes[k + 1], places[k + 1]}, 0, owner, owner});
  }

  // What fills the gap between the offsets of two pieces; on the inner side the way over the joint itself. planned:
  // about the angle by which the line turns, which says what it is made of.
  void join(Point at, Point before, Point after, double reach, int64_t kind, double planned, int64_t i, int64_t next) {
    const Point a = at + normal(before) * reach, b = at + normal(after) * reach;
    if (planned * reach > 0.0) return straight(a, at, i, next), straight(at, b, i, next);
    if (kind == kRoundJoin) return arc(at, a, turn(before, after), eighths(planned), i, next);
    if (kind != kMiter || 1.0 > kMiterLimit * std::max(std::cos(0.5 * planned), kShort)) return straight(a, b, i, next);
    const Point middle = normal(before) + normal(after);
    const double stretch = 1.0 / std::max(std::cos(0.5 * turn(before, after)), kShort);
    const Point tip = at + middle * (reach * stretch / std::max(middle.length(), kShort));
    straight(a, tip, i, next), straight(tip, b, i, next);
  }

  // From the left side of an end (that of the normal) around to its right.
  void cap(Point at, Point way, Style style, int64_t owner) {
    const Point out = way * style.half, a = at + normal(out), b = at - normal(out);
    if (style.cap == kRound) return arc(at, a, -kPi, eighths(kPi), owner, owner);
    if (style.cap == kButt) return straight(a, b, owner, owner);
    straight(a, a + out, owner, owner), straight(a + out, b + out, owner, owner), straight(b + out, b, owner, owner);
  }
};
}  // namespace
}  // namespace cs

using namespace cs;

extern "C" {
// parts: (count,) into how many parts the offset of each piece is cut; turns: (count,) radians by which the line turns
// from each to the next, 0 where that needs no join.
CS_EXPORT void cs_plan_offset(int64_t count, const double* cubics, const uint8_t* lines, int64_t* parts,
                              double* turns) {
  const auto* p = reinterpret_cast<const Point(*)[4]>(cubics);
  for (int64_t i = 0; i < count; i++) {
    Point own[2], next[2];
    tangents(p[i], own), tangents(p[(i + 1) % count], next);
    const double by = turn(own[1], next[0]);
    turns[i] = std::fabs(by) < kStraight ? 0.0 : by;
    double all = 0.0;
    const Point* before = nullptr;
    Point ways[3];
    for (int k = 0; k < 3; k++) {
      ways[k] = p[i][k + 1] - p[i][k];
      if (ways[k].length() <= kShort) continue;
      if (before) all += std::fabs(turn(*before, ways[k]));
      before = &ways[k];
    }
    parts[i] = lines[i] ? 1 : std::clamp<int64_t>(int64_t(std::ceil(all / kMostTurn)), 1, kMostParts);
  }
}

// cap, join: as numbered above. points: room for (n, 4, 2), straight: (n,), and ends of two rings, the
// second 0 where there is one. Returns n, or -1 without memory.
CS_EXPORT int64_t cs_offset(int64_t count, const double* cubics, const uint8_t* lines, const int64_t* parts,
                            const double* turns, double half, int64_t cap, int64_t join, double* points,
                            uint8_t* straight, int64_t* ends) {
  return counted([&] {
    StrokeOutline outline;
    outline.around({count, reinterpret_cast<const Point(*)[4]>(cubics), lines, parts, turns}, {half, cap, join});
    for (const Piece& piece : outline.pieces) {
      for (const Point& at : piece.at) *points++ = at.x, *points++ = at.y;
      *straight++ = piece.line;
    }
    std::copy(outline.ends.begin(), outline.ends.end(), ends);
    return int64_t(outline.pieces.size());
  });
}

// How the coordinates of the outline's points move with those of the centre line, by differences of `step` px. No two
// pieces that are neighbours have one colour, so all of a colour are moved at once. rows, columns, values: room for
// (128 n,) derivatives that are not 0. Returns how many there are, or -1 without memory.
CS_EXPORT int64_t cs_offset_slopes(int64_t count, const double* cubics, const uint8_t* lines, const int64_t* parts,
                                   const double* turns, double half, int64_t cap, int64_t join, double step,
                                   int64_t* rows, int64_t* columns, double* values) {
  return counted([&] {
    std::vector<double> moved(cubics, cubics + 8 * count);
    const Line line{count, reinterpret_cast<const Point(*)[4]>(moved.data()), lines, parts, turns};
    StrokeOutline still, now;
    still.around(line, {half, cap, join});
    const auto colour_of = [&](int64_t i) { return count % 2 && i + 1 == count ? 2 : i % 2; };
    int64_t found = 0;
    for (int64_t colour = 0; colour < 3; colour++)
      for (int64_t k = 0; k < 8; k++) {
        for (int64_t i = 0; i < count; i++)
          if (colour_of(i) == colour) moved[8 * i + k] += step;
        now.around(line, {half, cap, join});
        int64_t first = 0;
        for (const int64_t end : still.ends) {
          for (int64_t n = first; n < end; n++)
            for (int64_t q = 0; q < 4; q++) {
              // The end of each piece is the start of the next.
              const Piece& owner = still.pieces[q < 3 ? n : n + 1 < end ? n + 1 : first];
              const int64_t own = colour_of(owner.first) == colour ? owner.first : owner.last;
              if (colour_of(own) != colour) continue;
              const Point change = (now.pieces[n].at[q] - still.pieces[n].at[q]) * (1.0 / step);
              for (int c = 0; c < 2; c++) {
                const double value = c ? change.y : change.x;
                if (std::fabs(value) <= 1e-12) continue;
                rows[found] = 8 * n + 2 * q + c, columns[found] = 8 * own + k, values[found++] = value;
              }
            }
          first = end;
        }
        std::copy(cubics, cubics + 8 * count, moved.begin());
      }
    return found;
  });
}
}
