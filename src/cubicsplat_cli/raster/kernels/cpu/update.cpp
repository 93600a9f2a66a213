// Stage update: pair gradients -> vertex gradients -> control-point gradients -> parameters.
//
// Every primitive gathers its own pairs in their fixed order, so the sums are the same for any number of threads.

#include <algorithm>
#include <cmath>

#include "../shared/curve.h"
#include "frame.h"

namespace cs {
namespace {

// Gradient of one primitive's parameters; points are x, y interleaved.
struct Gathered {
  std::vector<float> vertices, points;
  float colour[3], opacity, half_width, edge_width, importance;
};

void gather(const Frame& f, const Chunk& chunk, const Primitive& q, Gathered& g) {
  g.vertices.assign(size_t(q.edges + 1) * 2, 0.0f);
  for (float& c : g.colour) c = 0.0f;
  g.opacity = g.half_width = g.edge_width = g.importance = 0.0f;
  for (uint32_t i = q.pair_begin; i < q.pair_end; i++) {
    const Pair& pair = chunk.pairs[i];
    const PairGradient& seen = pair.gradient;
    for (int c = 0; c < 3; c++) g.colour[c] += seen.colour[c];
    g.opacity += seen.opacity;
    g.half_width += seen.half_width;
    g.edge_width += seen.edge_width;
    g.importance += seen.importance;
    for (uint32_t j = pair.edge_begin; j < pair.edge_begin + pair.edge_count; j++) {
      const EdgeGradient& e = chunk.edge_gradients[j];
      float* v = g.vertices.data() + 2 * chunk.edges[j];
      float* w = f.scene.closed && chunk.edges[j] + 1 == q.edges ? g.vertices.data() : v + 2;
      v[0] += e.start_x;
      v[1] += e.start_y;
      w[0] += e.end_x;
      w[1] += e.end_y;
    }
  }
}

void spread_vertex(const float* w, const float* v, float* p0, float* p3) {
  for (int c = 0; c < 2; c++) {
    for (int j = 0; j < 3; j++) p0[2 * j + c] += w[j] * v[c];
    p3[c] += w[3] * v[c];
  }
}

// The same as pull_back for a subdivided primitive, whose vertices know their segment and parameter.
void pull_back_subdivided(const Frame& f, const Primitive& q, int p, Gathered& g) {
  int k = f.points_per_curve, vertices = q.edges + (f.scene.closed ? 0 : 1);
  const float* parameters = f.parameters.data() + size_t(p) * f.vertex_stride;
  for (int i = 0; i < vertices; i++) {
    int m = std::min(int(parameters[i]), f.scene.segments - 1);
    float w[4];
    bernstein(parameters[i] - float(m), w);
    spread_vertex(w, g.vertices.data() + 2 * i, g.points.data() + 6 * m, g.points.data() + 2 * ((3 * m + 3) % k));
  }
}

// Transpose of the polyline's matrix of Bernstein weights.
void pull_back(const Frame& f, const Primitive& q, int p, Gathered& g) {
  int k = f.points_per_curve;
  g.points.assign(size_t(k) * 2, 0.0f);
  if (f.settings.subdivide) return pull_back_subdivided(f, q, p, g);
  const float *weights = f.weights(q.samples), *v = g.vertices.data();
  for (int m = 0; m < f.scene.segments; m++) {
    float *p0 = g.points.data() + 6 * m, *p3 = g.points.data() + 2 * ((3 * m + 3) % k);
    for (int s = 0; s < q.samples; s++, v += 2) spread_vertex(weights + 4 * s, v, p0, p3);
  }
  if (!f.scene.closed)
    for (int c = 0; c < 2; c++) g.points[2 * (k - 1) + c] += v[c];
}

void through_logits(const Primitive& q, Gathered& g) {
  for (int c = 0; c < 3; c++) g.colour[c] *= q.colour[c] * (1.0f - q.colour[c]);
  g.opacity *= q.opacity * (1.0f - q.opacity);
}

void write(const Frame& f, int p, const Gathered& g, const CsGradients& out) {
  size_t k = size_t(f.points_per_curve) * 2;
  if (out.points) std::copy(g.points.begin(), g.points.end(), out.points + p * k);
  if (out.colours) std::copy(g.colour, g.colour + 3, out.colours + 3 * size_t(p));
  if (out.opacities) out.opacities[p] = g.opacity;
  if (out.half_widths) out.half_widths[p] = g.half_width;
  if (out.edge_widths) out.edge_widths[p] = g.edge_width;
  if (out.importance) out.importance[p] = g.importance;
}

void step(const Frame& f, int p, const Gathered& g, const CsTraining& t) {
  const AdanRates r{t.rate_points, t.rate_colours, t.rate_opacities, t.rate_half_widths, t.rate_edge_widths,
                    t.keep1,       t.keep2,        t.keep3,          t.epsilon};
  float age = float(++t.ages[p]);
  const AdanBias bias{1.0f - std::pow(r.keep1, age), 1.0f - std::pow(r.keep2, age),
                      std::sqrt(1.0f - std::pow(r.keep3, age)), t.ages[p] == 1};
  int k = f.points_per_curve * 2;
  auto* moments = reinterpret_cast<AdanMoments*>(t.moments) + size_t(p) * (k + 5);
  const float* further = t.points_gradient ? t.points_gradient + size_t(p) * k : nullptr;
  for (int i = 0; i < k; i++) {
    float gradient = g.points[i] + (further ? further[i] : 0.0f);
    t.points[size_t(p) * k + i] -= adan(gradient, moments[i], r, bias, r.points);
  }
  for (int c = 0; c < 3; c++) {
    float& x = t.colours[3 * size_t(p) + c];
    x = limit(x - adan(g.colour[c], moments[k + c], r, bias, r.colours), -kLogitLimit, kLogitLimit);
  }
  float& o = t.opacities[p];
  o = limit(o - adan(g.opacity, moments[k + 3], r, bias, r.opacities), -kLogitLimit, kLogitLimit);
  if (t.edge_widths) {
    auto& edge_moments = reinterpret_cast<AdanMoments*>(t.edge_moments)[p];
    float& w = t.edge_widths[p];
    w = limit(w - adan(g.edge_width, edge_moments, r, bias, r.edge_widths), kMinEdgeWidth, kMaxEdgeWidth);
  }
  if (f.scene.closed) return;
  float& h = t.half_widths[p];
  h = std::max(h - adan(g.half_width, moments[k + 4], r, bias, r.half_widths), kMinHalfWidth);
}

}  // namespace

void update(const Frame& f, int index, const CsGradients* out, const CsTraining* training) {
  const Chunk& chunk = f.chunks[index];
  Gathered g;
  int last = std::min(f.scene.curves, (index + 1) * kChunk);
  for (int p = index * kChunk; p < last; p++) {
    const Primitive& q = f.primitives[p];
    gather(f, chunk, q, g);
    pull_back(f, q, p, g);
    if (f.scene.logits) through_logits(q, g);
    if (out) write(f, p, g, *out);
    if (training) step(f, p, g, *training);
  }
}

}  // namespace cs
