// Contours fitted whole, from their points to primitives or rings of lines and cubics. How the choices are made is said in
// artwork/geometry/fitting.py.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <new>
#include <numeric>
#include <vector>

#include "abi.h"
#include "contour_outline.h"
#include "parallel.h"
#include "tracing.h"

namespace cs {
namespace {

constexpr int64_t kFewestPoints = 8;  // below which a contour is a polygon
constexpr double kApart = 1e-6;       // px between points that are not the same
constexpr double kPlainMisfit = 1.2;  // mean squared residual of a primitive, in sigmas, at which nothing else is tried
constexpr double kStraight = 0.02;    // px that the points of a line are off it, by what is systematic in them
constexpr double kTolerance = 0.3;    // px that lines are off the points where nothing else can be said of them
// Bends, radians, up to which pieces that are not both lines are joined smoothly: 12, 4 and 1.5 degrees; the first that
// pays.
constexpr double kSmoothest[] = {0.20943951023931956, 0.06981317007977318, 0.026179938779914945};
// Drawing programs sample edges on a grid of about quarter pixels, so the points of a nearly level or upright stretch err
// together as far as the stretch takes to cross a row of samples; they count as one.
constexpr double kGrid = 0.25, kFlattest = 0.01;  // px; slope
constexpr int64_t kSlopeReach = 3;                // points to either side
constexpr double kStray = 0.1;                 // px by which an outline encloses more or less along its points, at most
constexpr double kFiner[] = {1.0, 4.0, 16.0};  // times the detail, where an outline has gone astray

// Few straight lines along a loop, so many px about its points, and nearer to those of one that is thinner than that.
Outline few_lines(const std::vector<Point>& loop, double tolerance) {
  std::vector<Point> closed(loop), few;
  closed.push_back(loop[0]);
  for (; few.size() < 3 && tolerance > kApart; tolerance *= 0.25) {
    std::vector<uint8_t> kept(closed.size(), 0);
    if (cs_fewer_points(int64_t(closed.size()), &closed[0].x, tolerance, kept.data())) throw std::bad_alloc();
    few.clear();
    for (size_t i = 0; i < loop.size(); i++)
      if (kept[i]) few.push_back(loop[i]);
  }
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

Outline fitted_between(const Contour& loop, const Corners& corners, double price) {
  Contour contour = loop;
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
  out.shorten(loop);
  out.uncross();
  out.away = out.astray(contour, best);
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
  Outline lines = few_lines(contour.at, kTolerance);
  lines.cost = ring.cost;
  return lines;
}

Outline fitted(const Contour& contour, double price) {
  if (contour.count() < kFewestPoints) return few_lines(contour.at, kStraight);
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

// px^2 that an outline may enclose more or less than a loop of points, and lie off these: a tenth of a px along them.
double allowed(const std::vector<Point>& loop) {
  double length = 0.0;
  for (size_t i = 0; i < loop.size(); i++) length += (loop[(i + 1) % loop.size()] - loop[i]).length();
  return kStray * length + 1.0;
}

// Whether an outline encloses what a loop of points does.
bool sound(const std::vector<Point>& loop, const Outline& outline) {
  double area = 0.0;
  for (size_t i = 0; i < loop.size(); i++) area += 0.5 * cross(loop[i], loop[(i + 1) % loop.size()]);
  return std::fabs(std::fabs(outline.area()) - std::fabs(area)) <= allowed(loop);
}

// Drawing programs sample edges on a grid of about quarter pixels. So the points of a nearly level or upright stretch
// err together over the length that it takes to cross a row of samples, and count as one.
std::vector<double> Contour::independent() const {
  std::vector<double> out(count());
  for (int64_t i = 0, n = count(); i < n; i++) {
    const Point &a = at[(i + n - kSlopeReach % n) % n], &b = at[(i + kSlopeReach) % n];
    const double x = std::fabs(b.x - a.x), y = std::fabs(b.y - a.y);
    const double slope = std::min(x, y) / std::max(std::max(x, y), 1e-9);
    out[i] = weights[i] / (1.0 + kGrid / std::max(slope, kFlattest));
  }
  return out;
}

}  // namespace
}  // namespace cs

extern "C" {

// Fits an outline to each of some loops of points (x 2): see `fitted_contours` in raster/outlines.py. ends: loops, where
// the points of each end; weights: 1/px^2; known: whether a hidden point is a corner; prices: loops, of a parameter, nats.
// astray: loops, whether one is fitted ever closer to its points where its outline has gone astray. form: loops, of a
// primitive, -1 for a ring; values: loops x 6; pieces: loops; anchors, controls, lines, smooth: of rings, room for 2 x
// points + 2 pieces a loop; doubtful: loops, whether a ring lies off its points or crosses itself. Returns the number of
// loops that have fewer than three different points; -1 where there is no memory.
CS_EXPORT int64_t cs_fit_contours(int64_t loops, const int64_t* ends, const double* points, const double* weights,
                                  const uint8_t* known, const double* prices, const uint8_t* astray, int64_t threads,
                                  int32_t* form, double* values, int64_t* pieces, double* anchors, double* controls,
                                  uint8_t* lines, uint8_t* smooth, uint8_t* doubtful) {
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
    for (int finer = 1; astray[k] && finer <= 3 && !sound(all, found); finer++)
      found = finer < 3 ? fitted(contour, prices[k] / kFiner[finer]) : few_lines(all, kTolerance);
    form[k] = found.form, pieces[k] = int64_t(found.anchors.size());
    doubtful[k] = found.form == kRing && (found.away > allowed(all) || found.crosses());
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
  return counted([&] {
    // The longest loops first, so that no thread begins one when the others are done.
    std::vector<int64_t> order(loops);
    std::iota(order.begin(), order.end(), int64_t(0));
    std::stable_sort(order.begin(), order.end(),
                     [&](int64_t a, int64_t b) { return ends[a] - first(a) > ends[b] - first(b); });
    each_index(loops, threads, [&](int64_t n) { fit(order[n]); });
    return std::count(pieces, pieces + loops, -1);
  });
}
}
