// Boundaries of masks, and local fits along chains of points: the loops over pixels and points of the artwork style's
// tracing. What is computed is said in raster/outlines.py.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "abi.h"
#include "cracks.h"
#include "local_fits.h"

namespace cs {
namespace {

struct Mask {
  const uint8_t* pixels;
  int64_t height, width;
  bool operator()(int64_t x, int64_t y) const {
    return x >= 0 && y >= 0 && x < width && y < height && pixels[y * width + x] != 0;
  }
};

// The loops of cracks around a mask, one after the other.
struct Loops {
  std::vector<Crack> cracks;
  std::vector<int64_t> ends;

  int64_t count() const { return int64_t(ends.size()); }

  explicit Loops(const Mask& mask) {
    // Every loop has a crack that runs east.
    std::vector<uint8_t> seen(mask.height * mask.width, 0);
    for (int64_t top = 0; top < mask.height; top++)
      for (int64_t left = 0; left < mask.width; left++) {
        if (!mask(left, top) || mask(left, top - 1) || seen[top * mask.width + left]) continue;
        follow(mask, left, top, mask.width, seen, cracks);
        ends.push_back(int64_t(cracks.size()));
      }
  }
};

constexpr int64_t kSmooth = 4;    // cracks to either side by which a border runs rather level or rather steep
constexpr int64_t kFewest = 4;    // points of a loop, below which each of its cracks is one
constexpr double kTangent = 6.0;  // rims: what touches the border, and does not cross it, still is not far away

// Which cracks on the canvas's border lie where the loop seems to leave it like something round, though it may never have
// reached it: a circle of radius r that touches the border is within the rim of it for the root of 2 r rim to either side,
// and after twice that four times as far away.
std::vector<uint8_t> leaving(const Crack* loop, int64_t count, const Positions& at) {
  std::vector<double> depth(count);
  std::vector<int64_t> before(count), after(count);
  int64_t low[2] = {loop->x, loop->y}, high[2] = {loop->x, loop->y}, first = -1, last = -1;
  for (int64_t n = 0; n < count; n++) {
    const double x = loop[n].middle(0), y = loop[n].middle(1);
    depth[n] = std::min(std::min(x, double(at.width) - x), std::min(y, double(at.height) - y));
    low[0] = std::min(low[0], loop[n].x), high[0] = std::max(high[0], loop[n].x);
    low[1] = std::min(low[1], loop[n].y), high[1] = std::max(high[1], loop[n].y);
    if (depth[n] != 0.0) first = first < 0 ? n : first, last = n;
  }
  std::vector<uint8_t> out(count, 0);
  if (first < 0) return out;
  // The cracks off the border before and after each, as far along the loop as they are.
  for (int64_t n = 0, off = last - count; n < count; n++) {
    before[n] = off;
    if (depth[n] != 0.0) off = n;
  }
  for (int64_t n = count, off = first + count; n-- > 0;) {
    if (depth[n] != 0.0) off = n;
    after[n] = off;
  }
  const auto reach = int64_t(std::sqrt(double(std::min(high[0] - low[0], high[1] - low[1])) * at.rim));
  const auto shallow = [&](int64_t n) { return depth[((n % count) + count) % count] <= kTangent * at.rim; };
  for (int64_t n = 0; n < count; n++)
    out[n] = depth[n] == 0.0 && ((after[n] - n <= reach && shallow(after[n] + reach)) ||
                                 (n - before[n] <= reach && shallow(before[n] - reach)));
  return out;
}

}  // namespace

void add_points(const Crack* loop, int64_t count, const Positions& at, std::vector<EdgePoint>& out) {
  const int64_t reach = std::min(kSmooth, (count - 1) / 2), window = 2 * reach + 1;
  const auto is_level = [&](int64_t n) { return loop[((n % count) + count) % count].d % 2 == 0; };
  std::vector<uint8_t> kept(count);
  int64_t level = 0, many = 0;
  for (int64_t n = -reach; n < reach; n++) level += is_level(n);
  for (int64_t n = 0; n < count; n++) {
    level += is_level(n + reach);
    kept[n] = is_level(n) == (2 * level >= window);
    many += kept[n];
    level -= is_level(n - reach);
  }
  if (many < kFewest) std::fill(kept.begin(), kept.end(), 1);
  const std::vector<uint8_t> leaves = at.rim > 0.0 ? leaving(loop, count, at) : std::vector<uint8_t>(count, 0);
  for (int64_t n = 0; n < count; n++) {
    if (!kept[n]) continue;
    const Crack& c = loop[n];
    EdgePoint point{c.middle(0), c.middle(1), 0.0, n};
    if (c.d % 2 == 0) {
      const int64_t place = c.y * at.width + c.x - (c.d == 2);
      point.y = at.rows[place], point.sigma = at.row_sigma[place];
    } else {
      const int64_t place = (c.y - (c.d == 3)) * (at.width + 1) + c.x;
      point.x = at.columns[place], point.sigma = at.column_sigma[place];
    }
    if (leaves[n]) point.sigma = std::max(point.sigma, 0.5 * at.rim);
    out.push_back(point);
  }
}

}  // namespace cs

extern "C" {

// Parabolas along a chain, about every point, over the longest of the half-windows that is believed: see `parabolas` in
// raster/outlines.py.
CS_EXPORT void cs_parabolas(int64_t count, const double* points, const double* weights, const double* along,
                            int64_t kinds, const int64_t* halves, const double* most, double* terms, double* errors,
                            int64_t* windows) {
  using namespace cs;
  for (int64_t i = 0; i < count; i++)
    windows[i] = parabola(count, points, weights, along, i, {kinds, halves, most}, terms + 6 * i, errors + 2 * i);
}

// The contours of a part (high x wide bytes) with its corner at (left, top): see `contours_of` in raster/outlines.py.
// told: x 2 of each loop, the px^2 that it encloses, below 0 for a hole, and how many cracks it has; points: room x 2.
// Returns the number of loops; *count: of the points, of which those beyond the room are missing. -1 where there is no
// memory.
CS_EXPORT int64_t cs_contours(const uint8_t* part, const uint8_t* shown, int64_t high, int64_t wide, int64_t top,
                              int64_t left, int64_t height, int64_t width, const double* rows, const double* row_sigma,
                              const double* columns, const double* column_sigma, double rim, int64_t room,
                              double* points, double* sigma, int64_t* ends, double* told, int64_t* count) {
  using namespace cs;
  return counted([&] {
    Loops loops({part, high, wide});
    std::vector<uint8_t> seen;
    for (const Crack& c : loops.cracks) seen.push_back(shown[(c.y + kRight[c.d][1]) * wide + c.x + kRight[c.d][0]]);
    for (Crack& c : loops.cracks) c.x += left, c.y += top;
    std::vector<EdgePoint> found;
    *count = 0;
    for (int64_t k = 0, first = 0; k < loops.count(); first = loops.ends[k++]) {
      const Crack* loop = &loops.cracks[first];
      found.clear();
      add_points(loop, loops.ends[k] - first, {rows, row_sigma, columns, column_sigma, height, width, rim}, found);
      for (const EdgePoint& point : found) {
        if (*count < room) {
          const Crack& c = loop[point.crack];
          const bool visible = seen[first + point.crack] != 0;
          points[2 * *count] = visible ? point.x : c.middle(0),
                     points[2 * *count + 1] = visible ? point.y : c.middle(1);
          sigma[*count] = visible ? point.sigma : std::numeric_limits<double>::infinity();
        }
        ++*count;
      }
      const int64_t many = loops.ends[k] - first;
      if (k < room)
        ends[k] = *count, told[2 * k] = 0.5 * double(twice_enclosed(loop, loop + many)), told[2 * k + 1] = double(many);
    }
    return loops.count();
  });
}

// The method of Ramer, Douglas and Peucker: kept (count) is set at the first and last point of a chain (x 2), and where
// another one is more than `tolerance` off the straight line between those kept. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_fewer_points(int64_t count, const double* points, double tolerance, uint8_t* kept) {
  return cs::failed([&] {
    std::vector<std::pair<int64_t, int64_t>> left{{0, count - 1}};
    kept[0] = kept[count - 1] = 1;
    while (!left.empty()) {
      const auto [first, last] = left.back();
      left.pop_back();
      const double *a = points + 2 * first, *b = points + 2 * last;
      const double x = b[0] - a[0], y = b[1] - a[1], length = std::hypot(x, y), square = length * length;
      double most = -1.0;
      int64_t farthest = first;
      for (int64_t n = first + 1; n < last; n++) {
        const double u = points[2 * n] - a[0], v = points[2 * n + 1] - a[1], along = u * x + v * y;
        // From the line where a point lies beside it, from the nearer one of its ends elsewhere.
        const bool beside = along > 0.0 && along < square;
        const double gap = beside ? std::fabs(v * x - u * y) / std::max(length, 1e-300)
                                  : std::min(std::hypot(u, v), std::hypot(u - x, v - y));
        if (gap > most) most = gap, farthest = n;
      }
      if (most > tolerance) {
        kept[farthest] = 1;
        left.push_back({first, farthest}), left.push_back({farthest, last});
      }
    }
  });
}
}
