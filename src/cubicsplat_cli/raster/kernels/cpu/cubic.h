// A cubic near a parameter, and the feet of points on it.
#pragma once

#include <algorithm>
#include <cmath>

namespace cs {

constexpr double kConvex = 0.3;  // of the squared speed: the least curvature of the distance that Newton's step trusts
constexpr double kLeast = 1e-12;
constexpr double kStill = 1e-9;  // px per parameter, below which a curve has no direction

struct Point {
  double x = 0.0, y = 0.0;
  Point operator+(Point o) const { return {x + o.x, y + o.y}; }
  Point operator-(Point o) const { return {x - o.x, y - o.y}; }
  Point operator*(double f) const { return {x * f, y * f}; }
  Point operator/(double f) const { return {x / f, y / f}; }
  double length() const { return std::hypot(x, y); }
};

inline double dot(Point a, Point b) { return a.x * b.x + a.y * b.y; }
inline double cross(Point a, Point b) { return a.x * b.y - a.y * b.x; }

// A cubic of control points p[8] near a parameter.
struct Place {
  double basis[4];
  Point at, first, second;  // the point and the derivatives

  Place(const double* p, double u) {
    const double v = 1.0 - u, b[4] = {v * v * v, 3.0 * v * v * u, 3.0 * v * u * u, u * u * u};
    const double slopes[3] = {3.0 * v * v, 6.0 * v * u, 3.0 * u * u}, bends[2] = {6.0 * v, 6.0 * u};
    std::copy(b, b + 4, basis);
    for (int k = 0; k < 4; k++) at.x += b[k] * p[2 * k], at.y += b[k] * p[2 * k + 1];
    double step[6];
    for (int k = 0; k < 6; k++) step[k] = p[k + 2] - p[k];
    for (int k = 0; k < 3; k++) first.x += slopes[k] * step[2 * k], first.y += slopes[k] * step[2 * k + 1];
    for (int k = 0; k < 2; k++) {
      second.x += bends[k] * (step[2 * k + 2] - step[2 * k]);
      second.y += bends[k] * (step[2 * k + 3] - step[2 * k + 1]);
    }
  }
};

// Twenty times the area that a cubic of control points p[8] sweeps as seen from the origin: Green's theorem in Bernstein
// form.
inline double swept(const double* p) {
  const auto cross = [&](int j, int k) { return p[2 * j] * p[2 * k + 1] - p[2 * j + 1] * p[2 * k]; };
  return 6.0 * cross(0, 1) + 3.0 * cross(0, 2) + cross(0, 3) + 3.0 * cross(1, 2) + 3.0 * cross(1, 3) +
         6.0 * cross(2, 3);
}

// One Newton step towards the foot of a point. Where the distance is not convex, the Gauss-Newton step still leads downhill.
inline double nearer(const double* cubic, const double* point, double u) {
  const Place place(cubic, u);
  const Point rest = place.at - Point{point[0], point[1]};
  const double along = dot(rest, place.first), speed = dot(place.first, place.first);
  const double bend = speed + rest.x * place.second.x + rest.y * place.second.y;
  return u - along / std::max(bend > kConvex * speed ? bend : speed, kLeast);
}

}  // namespace cs
