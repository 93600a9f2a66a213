// Runs of points divided into lines and cubics, and the feet of points on cubics. What pieces cost is said in
// tests/outline_loops.py (`laid_out`).
#include <cstdint>

#include "abi.h"
#include "divide.h"

extern "C" {

// out: cubics x count parameters, one Newton step from u towards the feet of the points (x 2) on the cubics (x 8).
CS_EXPORT void cs_nearer(int64_t cubics, int64_t count, const double* control, const double* points, const double* u,
                         double* out) {
  using namespace cs;
  for (int64_t n = 0; n < cubics; n++)
    for (int64_t i = n * count; i < (n + 1) * count; i++) out[i] = nearer(control + 8 * n, points + 2 * i, u[i]);
}

// Divides a run of points with weights between two corners: see `divided_run` in raster/cubics.py. at, along, bend, errors:
// the local fits, count (x 2 but for bend); ends, tangents, end_errors: 2 x 2. sizes to from_corner: room for count + 2
// pieces. Returns how many there are, -1 where there is no memory.
CS_EXPORT int64_t cs_divide(int64_t count, const double* at, const double* along, const double* bend,
                            const double* errors, const double* weights, const double* ends, const double* tangents,
                            const double* end_errors, double price, int64_t* sizes, double* anchors, double* handles,
                            uint8_t* lines, uint8_t* level, uint8_t* from_corner, double* cost) {
  using namespace cs;
  return counted([&] {
    Section run;
    run.corners = true;
    run.weights.assign(weights, weights + count), run.bend.assign(bend, bend + count);
    for (int64_t i = 0; i < count; i++) {
      run.at.push_back({at[2 * i], at[2 * i + 1]}), run.along.push_back({along[2 * i], along[2 * i + 1]});
      run.known_to.push_back({errors[2 * i], errors[2 * i + 1]});
    }
    for (int e = 0; e < 2; e++) {
      run.ends[e] = {ends[2 * e], ends[2 * e + 1]}, run.tangents[e] = {tangents[2 * e], tangents[2 * e + 1]};
      run.errors[e] = {end_errors[2 * e], end_errors[2 * e + 1]};
    }
    const Division division = divided(run, price);
    *cost = division.cost;
    PieceArrays out{sizes, anchors, handles, lines, level, from_corner};
    out.write(division, count, true);
    return out.count;
  });
}
}
