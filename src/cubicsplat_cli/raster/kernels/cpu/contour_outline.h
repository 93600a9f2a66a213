// A contour while it is fitted: its points, their corners, and the pieces and outlines that lie along them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <new>
#include <numeric>
#include <utility>
#include <vector>

#include "cubic.h"
#include "tracing.h"

namespace cs {
namespace {

constexpr int64_t kRounds = 8;
constexpr double kLevelErrors = 2.0;  // standard errors a line may be off an axis to count as along it
constexpr double kLeastOff = 0.03;    // px, of one end against the other, that always count so
constexpr double kUnknownOff = 0.3;   // px, of a line that no points tell about
constexpr double kSteepest = 0.2;     // off the axis, per px along it, at most
// px that a tip goes on beyond its last point, at most: sides that meet at 5 degrees are half a px apart 6 px before.
constexpr double kLongestTip = 6.0;

enum Form : int32_t { kRing = -1, kCircle = 0, kEllipse = 1, kBox = 2 };

template <class Count>
Count checked(Count found) {
  if (found < 0) throw std::bad_alloc();
  return found;
}

// A loop of points with weights, 1/px^2, 0 where unknown.
struct Contour {
  std::vector<Point> at;
  std::vector<double> weights;
  std::vector<int64_t> known;  // hidden points that are corners

  int64_t count() const { return int64_t(at.size()); }
  const double* places() const { return &at[0].x; }

  // The weights, less for neighbouring points that err together.
  std::vector<double> independent() const;
};

// Corners of a loop: the first point after each, position, turn, and whether nothing may take it away.
struct Corners {
  std::vector<int64_t> index;
  std::vector<Point> at;
  std::vector<double> turns;
  std::vector<uint8_t> sure;

  explicit Corners(const Contour& contour) : index(contour.count()), at(contour.count()), turns(contour.count()) {
    resize(checked(
        cs_corners(contour.count(), contour.places(), contour.weights.data(), index.data(), &at[0].x, turns.data())));
    if (!contour.known.empty()) add(contour);
  }

  void keep_sure() {
    size_t left = 0;
    for (size_t k = 0; k < index.size(); k++)
      if (sure[k]) move(k, left++);
    resize(int64_t(left));
  }

 private:
  void resize(int64_t count) { index.resize(count), at.resize(count), turns.resize(count), sure.resize(count); }

  void move(size_t from, size_t to) {
    index[to] = index[from], at[to] = at[from], turns[to] = turns[from], sure[to] = sure[from];
  }

  // Puts corners right at known hidden points in place of those that were found where these points are hidden.
  void add(const Contour& contour) {
    const int64_t n = contour.count();
    const auto hidden = [&](int64_t i) { return contour.weights[i] <= 0.0; };
    // Every hidden run, with the point after it, bears the number of the visible points before it.
    int64_t visible = 0;
    for (int64_t i = 0; i < n; i++) visible += !hidden(i);
    std::vector<int64_t> run(n), number(n, -1);
    for (int64_t i = 0, before = 0; i < n; i++) run[i] = (before += !hidden(i)) % std::max<int64_t>(visible, 1);
    for (int64_t i = 0; i < n; i++) {
      const int64_t last = (i + n - 1) % n;
      if (hidden(i) || hidden(last)) number[i] = run[hidden(i) ? i : last];
    }
    std::vector<int64_t> replaced;
    for (const int64_t i : contour.known) replaced.push_back(number[i]);
    size_t left = 0;
    for (size_t k = 0; k < index.size(); k++)
      if (std::find(replaced.begin(), replaced.end(), number[index[k]]) == replaced.end()) move(k, left++);
    resize(int64_t(left));
    for (const int64_t i : contour.known)
      index.push_back(i), at.push_back(contour.at[i]), turns.push_back(0.0), sure.push_back(1);
    const Corners all = *this;
    std::vector<size_t> order(index.size());
    std::iota(order.begin(), order.end(), size_t(0));
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return index[a] < index[b]; });
    for (size_t k = 0; k < order.size(); k++) {
      index[k] = all.index[order[k]], at[k] = all.at[order[k]];
      turns[k] = all.turns[order[k]], sure[k] = all.sure[order[k]];
    }
  }
};

// A closed outline and the feet of points on it; the names are those of raster/cubics.py.
struct Pieces {
  std::vector<Point> anchors, incoming, outgoing;
  std::vector<uint8_t> lines, smooth, level;
  std::vector<int64_t> tied;  // x 2
  std::vector<int64_t> piece;
  std::vector<double> u;
  double chi = 0.0;

  int64_t count() const { return int64_t(lines.size()); }
  int64_t after(int64_t i) const { return (i + 1) % count(); }
  int64_t before(int64_t i) const { return (i + count() - 1) % count(); }

  int64_t variables() const {
    return checked(cs_count_variables(count(), count(), lines.data(), smooth.data(), level.data(), tied.data()));
  }

  int64_t parameters() const {
    int64_t out = 0;
    for (int64_t i = 0; i < count(); i++) out += 2 + (lines[i] ? 0 : 4) - smooth[i];
    return out;
  }

  void refine(const Contour& contour) {
    chi = checked(cs_refine(count(), count(), lines.data(), smooth.data(), level.data(), tied.data(), &anchors[0].x,
                            &incoming[0].x, &outgoing[0].x, contour.count(), contour.places(), contour.weights.data(),
                            piece.data(), u.data(), kRounds));
  }

  // Whether nothing but straight lines meet at an anchor.
  bool between_lines(int64_t i) const { return lines[i] && lines[before(i)]; }

  // The smooth joints between a line and a cubic free to bend.
  void loosen() {
    for (int64_t i = 0; i < count(); i++)
      if (smooth[i] && lines[i] != lines[before(i)]) smooth[i] = level[i] = 0;
  }

  // Joints that bend by less than so many radians smooth again, but those between lines.
  void tighten(double widest) {
    std::vector<uint8_t> found(smooth);
    for (int64_t i = 0; i < count(); i++) {
      if (between_lines(i)) continue;
      const Point here = anchors[i], last = anchors[before(i)], next = anchors[after(i)];
      const Point arrive = lines[before(i)] ? here - last : incoming[i] * -1.0;
      const Point leave = lines[i] ? next - here : outgoing[i];
      const double bend = std::atan2(cross(arrive, leave), dot(arrive, leave));
      found[i] |= std::fabs(bend) < widest;
    }
    smooth = found;
  }

  // Lines that are level or upright within their standard errors exactly so.
  void align(const std::vector<double>& weights) {
    std::vector<double> known(count(), 0.0);
    for (size_t n = 0; n < weights.size(); n++) known[piece[n]] += weights[n];
    for (int64_t i = 0; i < count(); i++) {
      if (!lines[i]) continue;
      const int64_t j = after(i);
      const double across[2] = {std::fabs(anchors[j].x - anchors[i].x), std::fabs(anchors[j].y - anchors[i].y)};
      const int c = across[1] < across[0];
      const double off = known[i] > 0.0 ? std::max(kLevelErrors * std::sqrt(12.0 / known[i]), kLeastOff) : kUnknownOff;
      if (across[c] <= std::min(off, kSteepest * across[1 - c])) tie(2 * i + c, 2 * j + c);
    }
    std::vector<int64_t> numbers(tied);
    std::sort(numbers.begin(), numbers.end());
    numbers.erase(std::unique(numbers.begin(), numbers.end()), numbers.end());
    for (int64_t& own : tied) own = std::lower_bound(numbers.begin(), numbers.end(), own) - numbers.begin();
  }

 private:
  // Makes one variable of those of two coordinates along the same axis, in the middle of all that have it.
  void tie(int64_t one, int64_t other) {
    const int64_t own = tied[one], its = tied[other];
    if (own == its) return;
    double sum = 0.0;
    int64_t many = 0;
    double* values = &anchors[0].x;
    for (size_t k = 0; k < tied.size(); k++) {
      if (tied[k] == its) tied[k] = own;
      if (tied[k] == own) sum += values[k], many++;
    }
    for (size_t k = 0; k < tied.size(); k++)
      if (tied[k] == own) values[k] = sum / double(many);
  }
};

// What a contour was fitted with: a primitive by its values, or a ring.
struct Outline {
  Form form = kRing;
  std::array<double, 6> values{};
  std::vector<Point> anchors;
  std::vector<std::array<Point, 2>> controls;
  std::vector<uint8_t> lines, smooth;
  double cost = 0.0, away = 0.0;  // nats; px, the sum of the distances of its points

  static Outline polygon(const std::vector<Point>& at) {
    Outline out;
    out.anchors = at, out.controls.resize(at.size());
    out.lines.assign(at.size(), 1), out.smooth.assign(at.size(), 0);
    for (size_t i = 0; i < at.size(); i++) out.straighten(i);
    return out;
  }

  static Outline of(const Pieces& pieces) {
    Outline out;
    out.anchors = pieces.anchors, out.controls.resize(pieces.anchors.size());
    out.lines = pieces.lines, out.smooth = pieces.smooth;
    for (size_t i = 0; i < out.anchors.size(); i++) {
      const size_t j = (i + 1) % out.anchors.size();
      const Point a = out.anchors[i], b = out.anchors[j], on = pieces.outgoing[i], in = pieces.incoming[j];
      out.controls[i] = {a + on, b + in};
      if (out.lines[i]) out.straighten(i);
    }
    return out;
  }

  // Brings back the anchors that have gone farther beyond the points of their loop than a tip can be seen: where two
  // sides are nearly parallel, these do not tell where they meet. Hidden points may have a corner as far away as they
  // are many.
  void shorten(const Contour& loop) {
    const int64_t n = loop.count();
    const auto hidden = [&](int64_t i) { return loop.weights[(i % n + n) % n] <= 0.0; };
    bool moved = false;
    int64_t beside = 0;  // the point that the last anchor is near, from which on the next one's lies
    for (size_t i = 0; i < anchors.size(); i++) {
      const Point here = anchors[i];
      int64_t tried = 0;
      while (tried < n && (loop.at[beside] - here).length() > kLongestTip) beside = (beside + 1) % n, tried++;
      if (tried < n) continue;
      int64_t nearest = 0;
      double least = HUGE_VAL;
      for (int64_t k = 0; k < n; k++) {
        const double away = (loop.at[k] - here).length();
        if (away < least) least = away, nearest = k;
      }
      double most = kLongestTip;
      for (int64_t k = nearest - 1; hidden(k) && nearest - k < n; k--) most += 1.0;
      for (int64_t k = nearest; hidden(k) && k - nearest < n; k++) most += 1.0;
      if (least <= most) continue;
      const Point from = loop.at[nearest], to = from + (here - from) * most / least;
      move(i, to - here);
      moved = true;
    }
    if (moved) straighten();
  }

  // Brings back the anchors that lie beyond another side of the ring: where a part is about a pixel thin, a corner on
  // its one side is sought where the flanks meet, which may be on its other side. Crossed sides stay crossed afterwards,
  // since no small step frees them.
  void uncross() {
    const size_t n = anchors.size();
    std::vector<Crossing> first(n, Crossing{HUGE_VAL, {}}), last(n, Crossing{-1.0, {}});
    const auto note = [&](size_t i, double t, Point at) {
      if (t < first[i].t) first[i] = {t, at};
      if (t > last[i].t) last[i] = {t, at};
    };
    each_crossing([&](size_t i, double t, size_t k, double u, Point at) { note(i, t, at), note(k, u, at); });
    bool moved = false;
    for (size_t i = 0; i < n; i++) {
      // Of the side that comes in the first crossing, of that which goes out the last one: beyond lies the anchor.
      const Crossing &in = first[(i + n - 1) % n], &out = last[i];
      const Point here = anchors[i];
      if (!(in.t < HUGE_VAL && out.t >= 0.0) || !((in.at - out.at).length() < kLongestTip)) continue;
      const Point middle = (in.at + out.at) * 0.5;
      const double away = (here - middle).length();
      if (!(away < kLongestTip)) continue;
      const double back = 1.0 + kClear / std::max(away, kClear);
      move(i, (middle - here) * back);
      moved = true;
    }
    if (moved) straighten();
  }

  // Whether the ring crosses itself.
  bool crosses() const {
    bool found = false;
    each_crossing([&](size_t, double, size_t, double, Point) { found = true; });
    return found;
  }

  // The sum of the distances of points from their feet, px.
  double astray(const Contour& points, const Pieces& feet) const {
    double out = 0.0;
    for (size_t k = 0; k < points.at.size(); k++) {
      const int64_t i = feet.piece[k];
      const Point p[4] = {anchors[i], controls[i][0], controls[i][1], anchors[(i + 1) % anchors.size()]};
      out += (points.at[k] - Place(&p[0].x, feet.u[k]).at).length();
    }
    return out;
  }

  double area() const {
    if (form == kBox) return 4.0 * values[2] * values[3] - (4.0 - kHalfTurn) * values[4] * values[4];
    if (form != kRing) return kHalfTurn * values[2] * values[form == kCircle ? 2 : 3];
    double sum = 0.0;
    for (size_t i = 0; i < anchors.size(); i++) {
      const Point p[4] = {anchors[i], controls[i][0], controls[i][1], anchors[(i + 1) % anchors.size()]};
      sum += swept(&p[0].x);
    }
    return sum / 20.0;
  }

 private:
  static constexpr double kHalfTurn = 3.141592653589793;
  static constexpr size_t kSides = 8;     // of the polyline of a piece in which crossings are sought
  static constexpr double kClear = 0.25;  // px before the side that was crossed
  static constexpr double kEnd = 1e-3;    // of a piece, where it meets the next

  // A place of a piece: its parameter, and where that is.
  struct Crossing {
    double t;
    Point at;
  };

  using Side = std::array<Point, kSides + 1>;

  std::vector<Side> flattened() const {
    std::vector<Side> out(anchors.size());
    for (size_t i = 0; i < anchors.size(); i++) {
      const Point p[4] = {anchors[i], controls[i][0], controls[i][1], anchors[(i + 1) % anchors.size()]};
      for (size_t k = 0; k <= kSides; k++) out[i][k] = Place(&p[0].x, double(k) / kSides).at;
    }
    return out;
  }

  // Tells two pieces and their parameters where they cross, and where that is; not where one goes on from the other.
  template <class Tell>
  void each_crossing(Tell tell) const {
    const size_t n = anchors.size();
    const std::vector<Side> sides = flattened();
    for (const auto& [i, k] : overlapping(sides)) {
      const bool onward = k == (i + 1) % n, backward = i == (k + 1) % n;
      each_crossing(sides[i], sides[k], [&, i = i, k = k](double t, double u, Point at) {
        const bool shared = (onward && t > 1.0 - kEnd && u < kEnd) || (backward && u > 1.0 - kEnd && t < kEnd);
        if (!shared) tell(i, t, k, u, at);
      });
    }
  }

  // The pairs of pieces whose boxes overlap.
  static std::vector<std::pair<size_t, size_t>> overlapping(const std::vector<Side>& sides) {
    struct Box {
      double left, right, top, bottom;
      size_t piece;
    };
    std::vector<Box> boxes;
    for (size_t i = 0; i < sides.size(); i++) {
      Box box{HUGE_VAL, -HUGE_VAL, HUGE_VAL, -HUGE_VAL, i};
      for (const Point& at : sides[i]) {
        box.left = std::min(box.left, at.x), box.right = std::max(box.right, at.x);
        box.top = std::min(box.top, at.y), box.bottom = std::max(box.bottom, at.y);
      }
      boxes.push_back(box);
    }
    std::sort(boxes.begin(), boxes.end(), [](const Box& a, const Box& b) { return a.left < b.left; });
    std::vector<std::pair<size_t, size_t>> out;
    for (size_t i = 0; i < boxes.size(); i++)
      for (size_t k = i + 1; k < boxes.size() && boxes[k].left <= boxes[i].right; k++)
        if (boxes[k].top <= boxes[i].bottom && boxes[i].top <= boxes[k].bottom)
          out.emplace_back(boxes[i].piece, boxes[k].piece);
    return out;
  }

  // Tells the parameters of both pieces where their polylines cross, and where that is.
  template <class Tell>
  static void each_crossing(const Side& a, const Side& b, Tell tell) {
    for (size_t i = 0; i < kSides; i++)
      for (size_t k = 0; k < kSides; k++) {
        const Point way = a[i + 1] - a[i], other = b[k + 1] - b[k], gap = b[k] - a[i];
        const double across = cross(way, other);
        if (across == 0.0) continue;
        const double t = cross(gap, other) / across, u = cross(gap, way) / across;
        if (t >= 0.0 && t < 1.0 && u >= 0.0 && u < 1.0)
          tell((double(i) + t) / kSides, (double(k) + u) / kSides, a[i] + way * t);
      }
  }

  // Moves an anchor with its handles.
  void move(size_t i, Point step) {
    const size_t last = (i + anchors.size() - 1) % anchors.size();
    for (Point* own : {&anchors[i], &controls[i][0], &controls[last][1]}) *own = *own + step;
  }

  // Brings the control points of all lines to their thirds.
  void straighten() {
    for (size_t i = 0; i < anchors.size(); i++)
      if (lines[i]) straighten(i);
  }

  // Brings the control points of a line to its thirds.
  void straighten(size_t i) {
    const Point a = anchors[i], b = anchors[(i + 1) % anchors.size()];
    const Point third = (b - a) / 3.0;
    controls[i] = {a + third, b - third};
  }
};

}  // namespace
}  // namespace cs
