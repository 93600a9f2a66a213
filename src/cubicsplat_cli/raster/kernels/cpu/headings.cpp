// Where outlines are heading at their ends, and by how much they turn where they pass a meeting point. What this is for is
// said in artwork/layers/ways.py and artwork/layers/stacking.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "cracks.h"
#include "local_fits.h"

namespace cs {
namespace {

// px along an outline from its end up to which points are left out, being biased there; points at least.
constexpr double kNearest = 1.5;
constexpr int64_t kFewest = 4;

// Where an outline ends, the unit tangent onwards and its standard error in radians, how it bends there in 1/px, and the
// mean squared residual of a smooth end in sigmas.
struct Heading {
  Point at, tangent;
  double error, bend, misfit;
};

// Of an outline from its end on, `reach` px of which are looked at. False where too few points are known.
bool heading(int64_t count, const double* points, const double* sigma, double reach, Heading& out) {
  Moments sums;
  double along = 0.0;
  int64_t near = 0;
  if (count < kFewest) return false;
  for (int64_t i = 0; i < count; i++) {
    const double* p = points + 2 * i;
    if (i > 0) along += std::hypot(p[0] - p[-2], p[1] - p[-1]);
    if (along > reach) break;
    if (along < kNearest) continue;
    sums.add(along / reach, 1.0 / (sigma[i] * sigma[i]), p[0] - points[0], p[1] - points[1]), near++;
  }
  if (near < kFewest) return false;
  Polynomial curve(2);
  const double misfit = curve.fit(sums), speed = std::max(std::hypot(curve.of[1][0], curve.of[1][1]), 1e-9);
  out.at = {points[0] + curve.of[0][0], points[1] + curve.of[0][1]};
  out.tangent = {-curve.of[1][0] / speed, -curve.of[1][1] / speed};
  out.error = std::sqrt(curve.variance[1]) / speed;
  out.bend = 2.0 * std::fabs(curve.of[2][1] * out.tangent.x - curve.of[2][0] * out.tangent.y) / (speed * speed);
  out.misfit = misfit / double(std::max<int64_t>(near - 3, 1));
  return true;
}

}  // namespace
}  // namespace cs

extern "C" {

// out: place (2), unit tangent (2), its standard error, bend and misfit of the end of an outline of points (x 2) from there
// on: see `Heading`. Returns whether it is known.
CS_EXPORT int64_t cs_heading(int64_t count, const double* points, const double* sigma, double reach, double* out) {
  cs::Heading found;
  if (!cs::heading(count, points, sigma, reach, found)) return 0;
  const double values[7] = {found.at.x,  found.at.y, found.tangent.x, found.tangent.y,
                            found.error, found.bend, found.misfit};
  std::copy(values, values + 7, out);
  return 1;
}

// By how much loops turn where what lies beside them changes: see `passings` in raster/borders.py. cracks: x 3, x, y and
// direction, all loops' one after the other; beside: of each crack; loops: their number, ends and owners. reach: px from
// which headings are taken, the first whose misfit is at most `most`; least: standard error beyond that of the points.
// places (x 5), turns (x 2): room for one of each crack. Returns how many are known, -1 where there is no memory.
CS_EXPORT int64_t cs_passings(const int64_t* cracks, const int64_t* beside, int64_t loops, const int64_t* ends,
                              const int64_t* owners, int64_t height, int64_t width, const double* rows,
                              const double* row_sigma, const double* columns, const double* column_sigma, double rim,
                              int64_t reaches, const double* reach, double most, double least, int64_t* places,
                              double* turns) {
  using namespace cs;
  return counted([&] {
    std::vector<Crack> loop;
    std::vector<EdgePoint> points;
    std::vector<int64_t> own;
    std::vector<double> arm, known;
    int64_t found = 0;
    for (int64_t k = 0, start = 0; k < loops; start = ends[k++]) {
      const int64_t count = ends[k] - start, *around = beside + start;
      loop.clear(), points.clear();
      for (int64_t n = 0; n < count; n++) {
        const int64_t* c = cracks + 3 * (start + n);
        loop.push_back({c[0], c[1], int(c[2])});
      }
      add_points(loop.data(), count, {rows, row_sigma, columns, column_sigma, height, width, rim}, points);
      own.assign(count, -1);
      for (size_t i = 0; i < points.size(); i++) own[points[i].crack] = int64_t(i);
      for (int64_t behind = 0; behind < count; behind++) {
        const int64_t next = (behind + 1) % count;
        if (around[behind] == around[next] || around[behind] < 0 || around[next] < 0) continue;
        Heading arms[2];
        bool smooth = true;
        for (int side = 0; side < 2 && smooth; side++) {
          const int64_t first = side ? next : behind, step = side ? 1 : count - 1;
          arm.clear(), known.clear();
          int64_t crack = first;
          for (int64_t n = 0; n < std::min<int64_t>(count, int64_t(2.0 * reach[0]) + 4); n++) {
            if (around[crack] != around[first]) break;
            if (const int64_t i = own[crack]; i >= 0)
              arm.push_back(points[i].x), arm.push_back(points[i].y), known.push_back(points[i].sigma);
            crack = (crack + step) % count;
          }
          smooth = false;
          for (int64_t n = 0; n < reaches && !smooth; n++)
            smooth = heading(int64_t(known.size()), arm.data(), known.data(), reach[n], arms[side]) &&
                     arms[side].misfit <= most;
        }
        if (!smooth) continue;
        // Both head into the meeting point: straight on is opposite.
        const Point u = arms[0].tangent, v = arms[1].tangent;
        const int64_t place[5] = {owners[k], around[behind], around[next], loop[next].x, loop[next].y};
        std::copy(place, place + 5, places + 5 * found);
        turns[2 * found] = 3.141592653589793 - std::acos(std::clamp(dot(u, v), -1.0, 1.0));
        turns[2 * found + 1] = std::sqrt(arms[0].error * arms[0].error + arms[1].error * arms[1].error + least * least);
        found++;
      }
    }
    return found;
  });
}
}
