// Contours fitted whole, from their points to primitives or rings of lines and cubics. How the choices are made is said in
// artwork/tracing/fitting.py.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <exception>
#include <limits>
#include <new>
#include <numeric>
#include <vector>

#include "abi.h"
#include "cubic.h"
#include "parallel.h"
#include "tracing.h"

namespace cs {
namespace {

constexpr int64_t kRounds = 8;
constexpr int64_t kFewestPoints = 8;  // below which a contour is a polygon
constexpr double kApart = 1e-6;       // px between points that are not the same
constexpr double kPlainMisfit = 1.2;  // mean squared residual of a primitive, in sigmas, at which nothing else is tried
constexpr double kTolerance = 0.3;    // px that lines are off the points where nothing else can be said of them
// Bends, radians, up to which pieces that are not both lines are joined smoothly: 12, 4 and 1.5 degrees; the first that
// pays.
constexpr double kSmoothest[] = {0.20943951023931956, 0.06981317007977318, 0.026179938779914945};
// Drawing programs sample edges on a grid of about quarter pixels, so the points of a nearly level or upright stretch err
// together as far as the stretch takes to cross a row of samples; they count as one.
constexpr double kGrid = 0.25, kFlattest = 0.01;  // px; slope
constexpr int64_t kSlopeReach = 3;                // points to either side
constexpr double kLevelErrors = 2.0;              // standard errors a line may be off an axis to count as along it
constexpr double kLeastOff = 0.03;                // px, of one end against the other, that always count so
constexpr double kUnknownOff = 0.3;               // px, of a line that no points tell about
constexpr double kSteepest = 0.2;                 // off the axis, per px along it, at most
constexpr double kStray = 0.1;                 // px by which an outline encloses more or less along its points, at most
constexpr double kFiner[] = {1.0, 4.0, 16.0};  // times the detail, where an outline has gone astray

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

  std::vector<double> independent() const {
    std::vector<double> out(count());
    cs_independent(count(), places(), weights.data(), out.data());
    return out;
  }
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

// A closed outline and the feet of points on it; the names are those of artwork/tracing/variables.py.
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

  bool all_lines() const { return std::find(lines.begin(), lines.end(), 0) == lines.end(); }
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
      const Point arrive = lines[before(i)] ? Point{here.x - last.x, here.y - last.y}
                                            : Point{-incoming[i].x, -incoming[i].y};
      const Point leave = lines[i] ? Point{next.x - here.x, next.y - here.y} : outgoing[i];
      const double bend = std::atan2(arrive.x * leave.y - arrive.y * leave.x, arrive.x * leave.x + arrive.y * leave.y);
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
  double cost = 0.0;

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
      out.controls[i] = {Point{a.x + on.x, a.y + on.y}, Point{b.x + in.x, b.y + in.y}};
      if (out.lines[i]) out.straighten(i);
    }
    return out;
  }

  double area() const {
    if (form == kBox) return 4.0 * values[2] * values[3] - (4.0 - kHalfTurn) * values[4] * values[4];
    if (form != kRing) return kHalfTurn * values[2] * values[form == kCircle ? 2 : 3];
    double sum = 0.0;
    for (size_t i = 0; i < anchors.size(); i++) {
      // Green's theorem for a cubic in Bernstein form.
      const Point p[4] = {anchors[i], controls[i][0], controls[i][1], anchors[(i + 1) % anchors.size()]};
      const auto cross = [&](int j, int k) { return p[j].x * p[k].y - p[j].y * p[k].x; };
      sum += 6.0 * cross(0, 1) + 3.0 * cross(0, 2) + cross(0, 3) + 3.0 * cross(1, 2) + 3.0 * cross(1, 3) +
             6.0 * cross(2, 3);
    }
    return sum / 20.0;
  }

 private:
  static constexpr double kHalfTurn = 3.141592653589793;

  // Brings the control points of a line to its thirds.
  void straighten(size_t i) {
    const Point a = anchors[i], b = anchors[(i + 1) % anchors.size()];
    const Point third{(b.x - a.x) / 3.0, (b.y - a.y) / 3.0};
    controls[i] = {Point{a.x + third.x, a.y + third.y}, Point{b.x - third.x, b.y - third.y}};
  }
};

// Few straight lines along a loop.
Outline few_lines(const std::vector<Point>& loop) {
  std::vector<Point> closed(loop), few;
  closed.push_back(loop[0]);
  std::vector<uint8_t> kept(closed.size(), 0);
  if (cs_fewer_points(int64_t(closed.size()), &closed[0].x, kTolerance, kept.data())) throw std::bad_alloc();
  for (size_t i = 0; i < loop.size(); i++)
    if (kept[i]) few.push_back(loop[i]);
  return Outline::polygon(few.size() >= 3 ? few : loop);
}

// The loop laid out between its corners: the points in the order of the pieces, and these with their feet, refined.
Pieces laid_out(Contour& contour, const Corners& corners, double price) {
  const int64_t n = contour.count(), room = 2 * n + 2;
  const std::vector<double> weights = contour.independent();
  std::vector<uint8_t> kept(corners.index.size()), from_corner(room);
  std::vector<int64_t> sizes(room);
  std::vector<double> chosen(n);
  std::vector<std::array<Point, 2>> handles(room);
  Pieces out;
  out.anchors.resize(room), out.lines.resize(room), out.level.resize(room);
  int64_t start = 0;
  const int64_t count = checked(cs_lay_out(n, contour.places(), weights.data(), int64_t(corners.index.size()),
                                           corners.index.data(), reinterpret_cast<const double*>(corners.at.data()),
                                           corners.turns.data(), corners.sure.data(), price, kept.data(), &start,
                                           chosen.data(), sizes.data(), &out.anchors[0].x, &handles[0][0].x,
                                           out.lines.data(), out.level.data(), from_corner.data()));
  out.anchors.resize(count), out.lines.resize(count), out.level.resize(count);
  out.incoming.resize(count), out.outgoing.resize(count), out.smooth.resize(count), out.tied.resize(2 * count);
  std::iota(out.tied.begin(), out.tied.end(), int64_t(0));
  for (int64_t i = 0; i < count; i++) {
    out.outgoing[i] = handles[i][0], out.incoming[i] = handles[out.before(i)][1];
    out.smooth[i] = !out.between_lines(i) && !from_corner[i], out.level[i] &= out.smooth[i];
    for (int64_t k = 0; k < sizes[i]; k++)
      out.piece.push_back(i), out.u.push_back((double(k) + 0.5) / double(sizes[i]));
  }
  const Contour before = contour;
  for (int64_t i = 0; i < n; i++) {
    const int64_t own = (start + i) % n;
    contour.at[i] = before.at[own], contour.weights[i] = chosen[own];
  }
  out.loosen();
  out.refine(contour);
  return out;
}

// Takes more regular pieces, if what they lose is worth less than the parameters they save; whether they were cheaper or
// no more regular.
bool taken_if_cheaper(Pieces& best, Pieces trial, const Contour& contour, double price) {
  const int64_t saved = best.variables() - trial.variables();
  if (saved <= 0) return true;
  trial.refine(contour);
  if (!(0.5 * (trial.chi - best.chi) <= price * double(saved))) return false;
  best = std::move(trial);
  return true;
}

Outline fitted_between(Contour contour, const Corners& corners, double price) {
  Pieces best = laid_out(contour, corners, price);
  for (const double widest : kSmoothest) {
    Pieces trial = best;
    trial.tighten(widest);
    if (taken_if_cheaper(best, std::move(trial), contour, price)) break;
  }
  Pieces level = best;
  level.align(contour.weights);
  taken_if_cheaper(best, std::move(level), contour, price);
  Outline out = Outline::of(best);
  out.cost = 0.5 * best.chi + price * double(best.parameters());
  return out;
}

bool there_and_back(const Outline& ring) {
  return ring.anchors.size() < 3 && std::find(ring.lines.begin(), ring.lines.end(), 0) == ring.lines.end();
}

Outline fitted_ring(const Contour& contour, double price) {
  Corners corners(contour);
  Outline ring = fitted_between(contour, corners, price);
  if (!there_and_back(ring)) return ring;
  // There and back again encloses nothing: the thin tips were no corners.
  corners.keep_sure();
  ring = fitted_between(contour, corners, price);
  if (!there_and_back(ring)) return ring;
  Outline lines = few_lines(contour.at);
  lines.cost = ring.cost;
  return lines;
}

Outline fitted(const Contour& contour, double price) {
  if (contour.count() < kFewestPoints) return Outline::polygon(contour.at);
  Outline primitive;
  // What has corners that nobody sees is none of those primitives that would do.
  if (contour.known.empty()) {
    int32_t form[3];
    double told[2];
    const std::vector<double> weights = contour.independent();
    if (checked(cs_nearest_primitive(contour.count(), contour.places(), weights.data(), price, form,
                                     primitive.values.data(), told))) {
      primitive.form = Form(form[0]), primitive.cost = told[0];
      if (told[1] <= kPlainMisfit) return primitive;
    }
  }
  Outline ring = fitted_ring(contour, price);
  return primitive.form != kRing && primitive.cost <= ring.cost ? primitive : ring;
}

// Whether an outline encloses what a loop of points does, to a tenth of a px along them.
bool sound(const std::vector<Point>& loop, const Outline& outline) {
  double area = 0.0, length = 0.0;
  for (size_t i = 0; i < loop.size(); i++) {
    const Point a = loop[i], b = loop[(i + 1) % loop.size()];
    area += 0.5 * (a.x * b.y - b.x * a.y), length += std::hypot(b.x - a.x, b.y - a.y);
  }
  return std::fabs(std::fabs(outline.area()) - std::fabs(area)) <= kStray * length + 1.0;
}

}  // namespace
}  // namespace cs

extern "C" {

// out: the weights of a loop of points (x 2), less where neighbours err together: see `independent` in
// raster/contours.py.
CS_EXPORT void cs_independent(int64_t count, const double* points, const double* weights, double* out) {
  using namespace cs;
  for (int64_t i = 0; i < count; i++) {
    const double* a = points + 2 * ((i + count - kSlopeReach % count) % count);
    const double* b = points + 2 * ((i + kSlopeReach) % count);
    const double x = std::fabs(b[0] - a[0]), y = std::fabs(b[1] - a[1]);
    const double slope = std::min(x, y) / std::max(std::max(x, y), 1e-9);
    out[i] = weights[i] / (1.0 + kGrid / std::max(slope, kFlattest));
  }
}

// Fits an outline to each of some loops of points (x 2): see `fitted_contours` in raster/contours.py. ends: loops, where
// the points of each end; weights: 1/px^2; known: whether a hidden point is a corner; prices: loops, of a parameter, nats.
// astray: whether loops are fitted ever closer to their points where their outline has gone astray. form: loops, of a
// primitive, -1 for a ring; values: loops x 6; pieces: loops; anchors, controls, lines, smooth: of rings, room for 2 x
// points + 2 pieces a loop. Returns the number of loops that have fewer than three different points; -1 where there is no
// memory.
CS_EXPORT int64_t cs_fit_contours(int64_t loops, const int64_t* ends, const double* points, const double* weights,
                                  const uint8_t* known, const double* prices, int64_t astray, int64_t threads,
                                  int32_t* form, double* values, int64_t* pieces, double* anchors, double* controls,
                                  uint8_t* lines, uint8_t* smooth) {
  using namespace cs;
  const auto first = [&](int64_t k) { return k > 0 ? ends[k - 1] : 0; };
  const auto fit = [&](int64_t k) {
    Contour contour;
    std::vector<Point> all;
    for (int64_t n = first(k); n < ends[k]; n++) {
      const int64_t last = n > first(k) ? n - 1 : ends[k] - 1;
      const Point here{points[2 * n], points[2 * n + 1]};
      all.push_back(here);
      if (!(std::hypot(here.x - points[2 * last], here.y - points[2 * last + 1]) > kApart)) continue;
      if (known[n]) contour.known.push_back(contour.count());
      contour.at.push_back(here), contour.weights.push_back(weights[n]);
    }
    pieces[k] = -1;
    if (contour.count() < 3) return;
    Outline found = fitted(contour, prices[k]);
    for (int finer = 1; astray && finer <= 3 && !sound(all, found); finer++)
      found = finer < 3 ? fitted(contour, prices[k] / kFiner[finer]) : few_lines(all);
    form[k] = found.form, pieces[k] = int64_t(found.anchors.size());
    std::copy(found.values.begin(), found.values.end(), values + 6 * k);
    const int64_t place = 2 * first(k) + 2 * k;
    for (int64_t i = 0; i < pieces[k]; i++) {
      const Point own[3] = {found.anchors[i], found.controls[i][0], found.controls[i][1]};
      double* control = controls + 4 * (place + i);
      anchors[2 * (place + i)] = own[0].x, anchors[2 * (place + i) + 1] = own[0].y;
      control[0] = own[1].x, control[1] = own[1].y, control[2] = own[2].x, control[3] = own[2].y;
      lines[place + i] = found.lines[i], smooth[place + i] = found.smooth[i];
    }
  };
  try {
    // The longest loops first, so that no thread begins one when the others are done.
    std::vector<int64_t> order(loops);
    std::iota(order.begin(), order.end(), int64_t(0));
    std::stable_sort(order.begin(), order.end(),
                     [&](int64_t a, int64_t b) { return ends[a] - first(a) > ends[b] - first(b); });
    each_index(loops, threads, [&](int64_t n) { fit(order[n]); });
  } catch (const std::exception&) {
    return -1;
  }
  return std::count(pieces, pieces + loops, -1);
}
}
