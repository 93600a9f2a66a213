// What is held of an outline while its variables move it, and the numbers of these. raster/cubics.py says what each
// function means.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "abi.h"
#include "outline_variables.h"

namespace cs {
namespace {

constexpr double kSame = 1e-9;      // px
constexpr double kMostBend = 0.05;  // tangent of the angle by which a joint that is called smooth may be off

// The variable of each coordinate (anchors x 2): one for both ends of a level or upright line, -1 where fixed.
void tie(int64_t anchors, int64_t pieces, const double* at, const uint8_t* lines, const uint8_t* fixed, int64_t* tied) {
  for (int64_t k = 0; k < 2 * anchors; k++) tied[k] = k;
  for (int64_t i = 0; i < pieces; i++)
    for (int c = 0; lines[i] && c < 2; c++) {
      const int64_t own = 2 * i + c, next = 2 * ((i + 1) % anchors) + c;
      if (!(std::fabs(at[next] - at[own]) < kSame)) continue;
      if (next > own)
        tied[next] = tied[own];  // to which nothing else is tied yet
      else
        std::replace(tied, tied + 2 * anchors, int64_t(tied[next]), int64_t(tied[own]));
    }
  std::vector<int64_t> number(2 * anchors, -1);
  for (int64_t k = 0; k < 2 * anchors; k++) number[tied[k]] = 0;
  // What is tied to the border is on it.
  for (int64_t k = 0; k < 2 * anchors; k++)
    if (fixed && fixed[k]) number[tied[k]] = -1;
  int64_t count = 0;
  for (int64_t& each : number)
    if (each == 0) each = count++;
  for (int64_t k = 0; k < 2 * anchors; k++) tied[k] = number[tied[k]];
}

}  // namespace
}  // namespace cs

extern "C" {

CS_EXPORT int32_t cs_tie(int64_t anchors, int64_t pieces, const double* at, const uint8_t* lines, int64_t* tied) {
  return cs::failed([&] { cs::tie(anchors, pieces, at, lines, nullptr, tied); });
}

// A ring of `count` anchors: controls x 2 x 2. pins: of x, and behind so many of these of y. on_border: px. at: its anchors, incoming,
// outgoing: room for its handles; smooth: what it says of its joints; these and level, tied become those of what is held.
CS_EXPORT int32_t cs_hold_ring(int64_t count, const double* controls, const uint8_t* lines, int64_t width,
                               int64_t height, double on_border, int64_t pins_x, int64_t pins_y, const double* pins,
                               double* at, double* incoming, double* outgoing, uint8_t* smooth, uint8_t* level,
                               int64_t* tied) {
  using namespace cs;
  return failed([&] {
    std::vector<uint8_t> fixed(2 * count, 0);
    for (int64_t k = 0; k < 2 * count; k++) {
      const int64_t before = (k / 2 + count - 1) % count;
      outgoing[k] = controls[4 * (k / 2) + k % 2] - at[k], incoming[k] = controls[4 * before + 2 + k % 2] - at[k];
      for (const double border : {0.0, double(k % 2 ? height : width)})
        if (std::fabs(at[k] - border) < on_border) at[k] = border, fixed[k] = 1;
      for (int64_t n = k % 2 ? pins_x : 0; n < (k % 2 ? pins_x + pins_y : pins_x); n++)
        fixed[k] |= std::fabs(at[k] - pins[n]) < kSame;
    }
    for (int64_t i = 0; i < count; i++) {
      const double *out = outgoing + 2 * i, *in = incoming + 2 * i;
      const double cross = out[0] * in[1] - out[1] * in[0], dot = out[0] * in[0] + out[1] * in[1];
      smooth[i] &= !(std::fabs(cross) > kMostBend * std::fabs(dot) || dot > 0.0);
      const auto along = [&](int c) { return std::fabs(out[1 - c]) < kSame && std::fabs(in[1 - c]) < kSame; };
      level[i] = smooth[i] && (along(0) || along(1));
    }
    tie(count, count, at, lines, fixed.data(), tied);
    const Joints joints(count, count, lines, smooth, level, tied);
    const Outline outline(count, at, incoming, outgoing);
    outline.moved(joints, std::vector<double>(joints.total, 0.0)).write(at, incoming, outgoing);
  });
}

// numbers: anchors x 5, the variables of each joint: see `JointNumbers` in raster/cubics.py.
CS_EXPORT int32_t cs_number_joints(int64_t anchors, int64_t pieces, const uint8_t* lines, const uint8_t* smooth,
                                   const uint8_t* level, const int64_t* tied, int64_t* numbers) {
  return cs::failed([&] {
    for (const cs::Joint& joint : cs::Joints(anchors, pieces, lines, smooth, level, tied).of)
      for (const int64_t number : {joint.angle, joint.length_in, joint.length_out, joint.vector_in, joint.vector_out})
        *numbers++ = number;
  });
}
}
