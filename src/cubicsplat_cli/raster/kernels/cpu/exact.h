// Exact area coverage of fills, one row of pixels at a time: horizontally exact on sub-scanlines.
#pragma once

#include "lanes.h"

namespace cs {
namespace CS_ISA {

// Crossings of one sub-scanline, sorted by x; room for as many as the primitive has edges.
struct SubRow {
  float* x;
  float* direction;
  int count;
  float left;  // winding number at the tile's left side

  void insert(float at, float towards) {
    int i = count++;
    for (; i > 0 && x[i - 1] > at; i--) {
      x[i] = x[i - 1];
      direction[i] = direction[i - 1];
    }
    x[i] = at;
    direction[i] = towards;
  }
};

// An edge by both of its ends: an end computed as start + direction could round to the other side of a sub-scanline than
// the next edge's start, and the winding number would leak along the whole row.
struct BandEdge {
  float ax, ay, bx, by;
};

// Edges come in relative to the tile's corner; the tile is one row of lanes wide.
struct FillArea {
  SubRow rows[kExactRows];

  void start() {
    for (SubRow& s : rows) {
      s.count = 0;
      s.left = 0.0f;
    }
  }

  // Number of sub-scanlines of the row that lie above y.
  static CS_INLINE int above(float y, float row) {
    float k = (y - row) * float(kExactRows) + 0.5f;
    return k <= 0.0f ? 0 : (k >= float(kExactRows) ? kExactRows : int(k));
  }

  void add(const BandEdge& e, float row) {
    bool up = e.by < e.ay;
    float top = up ? e.by : e.ay, bottom = up ? e.ay : e.by;
    int first = above(top, row), last = above(bottom, row);
    if (first >= last) return;
    float direction = up ? -1.0f : 1.0f, step = (e.bx - e.ax) / (e.by - e.ay);
    bool left = e.ax <= 0.0f && e.bx <= 0.0f;
    for (int k = first; k < last; k++) {
      if (left)
        rows[k].left += direction;
      else
        rows[k].insert(e.ax + (row + (float(k) + 0.5f) / kExactRows - e.ay) * step, direction);
    }
  }

  // Mean over the sub-scanlines of the length, in each pixel, of where the winding number is not zero.
  Lanes area() const {
    const Lanes right = lane_numbers() + Lanes(1.0f);
    Lanes sum(0.0f);
    float full = 0.0f;
    for (const SubRow& s : rows) {
      float number = s.left;
      if (number != 0.0f) full += 1.0f;
      for (int i = 0; i < s.count; i++) {
        bool before = number != 0.0f, after = (number += s.direction[i]) != 0.0f;
        if (before == after) continue;
        Lanes beyond = minimum(maximum(right - Lanes(s.x[i]), Lanes(0.0f)), Lanes(1.0f));
        sum = after ? sum + beyond : sum - beyond;
      }
    }
    Lanes mean = (sum + Lanes(full)) * Lanes(1.0f / kExactRows);
    return minimum(maximum(mean, Lanes(0.0f)), Lanes(1.0f));
  }
};

}  // namespace CS_ISA
}  // namespace cs
