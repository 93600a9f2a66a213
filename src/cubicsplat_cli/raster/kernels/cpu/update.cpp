// Stage update: pair gradients -> vertex gradients -> control-point gradients -> parameters.
//
// Every primitive gathers its own pairs in their fixed order, so the sums are the same for any number of threads.

#include <algorithm>
#include <cmath>

#include "frame.h"

namespace cs {
namespace {

// Gradient of one primitive's parameters; points are x, y interleaved.
struct Gathered {
  std::vector<float> vertices, points, paint;
  float colour[3], opacity, half_width, edge_width, importance;
};

void gather(const Frame& f, const Chunk& chunk, const Primitive& q, Gathered& g) {
  const uint32_t* const rings = chunk.ring_starts.data() + q.ring_index;
  g.vertices.assign(size_t(q.edges) * 2, 0.0f);
  for (float& c : g.colour) c = 0.0f;
  g.opacity = g.half_width = g.edge_width = g.importance = 0.0f;
  const size_t stride = f.scene.kinds ? paint_stride(f.scene.most_stops) : 0;
  g.paint.assign(stride, 0.0f);
  for (uint32_t i = q.pair_begin; i < q.pair_end; i++) {
    const Pair& pair = chunk.pairs[i];
    const PairGradient& seen = pair.gradient;
    for (int c = 0; c < 3; c++) g.colour[c] += seen.colour[c];
    g.opacity += seen.opacity;
    g.half_width += seen.half_width;
    g.edge_width += seen.edge_width;
    g.importance += seen.importance;
    for (size_t j = 0; j < stride; j++) g.paint[j] += chunk.paint_gradients[i * stride + j];
    const uint32_t* ring = rings;  // the edges of a pair are listed in ascending order
    for (uint32_t j = pair.edge_begin; j < pair.edge_begin + pair.edge_count; j++) {
      const EdgeGradient& e = chunk.edge_gradients[j];
      const uint32_t edge = chunk.edges[j];
      while (ring[1] <= edge) ring++;
      float* v = g.vertices.data() + 2 * edge;
      float* w = f.scene.closed && edge + 2 == ring[1] ? g.vertices.data() + 2 * ring[0] : v + 2;
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

// Transpose of the Bernstein weights of the vertices of one ring but the last; returns that one's gradient.
const float* pull_back_ring(const Frame& f, const Rings& rings, int r, const uint8_t* samples, const float* v,
                            float* points) {
  for (int m = rings.begin(r); m < rings.end(r); m++) {
    float *p0 = points + 6 * m, *p3 = points + 2 * rings.end_point(r, m, f.scene.closed);
    const float* w = f.weights(samples[m]);
    for (const float* end = w + 4 * samples[m]; w < end; w += 4, v += 2) spread_vertex(w, v, p0, p3);
  }
  return v;
}

// The same for a subdivided primitive, whose vertices know their segment and parameter.
const float* pull_back_subdivided(const Frame& f, const Rings& rings, const float* parameters, int r, uint32_t first,
                                  uint32_t end, const float* v, float* points) {
  for (uint32_t i = first; i + 1 < end; i++, v += 2) {
    int m = int(parameters[i]);
    float w[4];
    bernstein(parameters[i] - float(m), w);
    spread_vertex(w, v, points + 6 * m, points + 2 * rings.end_point(r, m, f.scene.closed));
  }
  return v;
}

// Vertex gradients -> control-point gradients. A closed ring's last vertex is its first one, which takes its gradient.
// parameters: of the primitive's vertices, only after subdivision.
void pull_back(const Frame& f, const Chunk& chunk, const Primitive& q, const float* parameters, int p, Gathered& g) {
  const Rings rings = f.rings(p);
  const uint32_t* starts = chunk.ring_starts.data() + q.ring_index;
  const uint8_t* samples = f.cubic_samples.data() + size_t(p) * f.scene.segments;
  g.points.assign(size_t(f.points_per_curve) * 2, 0.0f);
  for (int r = 0; r < rings.count; r++) {
    if (rings.begin(r) == rings.end(r)) continue;
    const float* v = g.vertices.data() + 2 * starts[0];
    v = f.settings.subdivide ? pull_back_subdivided(f, rings, parameters, r, starts[0], starts[1], v, g.points.data())
                             : pull_back_ring(f, rings, r, samples, v, g.points.data());
    if (!f.scene.closed)
      for (int c = 0; c < 2; c++) g.points[6 * size_t(rings.end(r)) + c] += v[c];
    starts++;
  }
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
  if (!f.scene.kinds) return;
  const size_t stops = size_t(kStopValues) * f.scene.most_stops;
  if (out.stops) std::copy(g.paint.begin(), g.paint.begin() + stops, out.stops + p * stops);
  if (out.frames) std::copy(g.paint.begin() + stops, g.paint.end(), out.frames + p * size_t(kFrameValues));
}

void step_points(const Frame& f, int p, const Gathered& g, const CsTraining& t, const AdanRates& r,
                 const AdanBias& bias) {
  const Rings rings = f.rings(p);
  const int k = f.points_per_curve * 2, used = 2 * (3 * rings.total() + (f.scene.closed ? 0 : 1));
  auto* moments = reinterpret_cast<AdanMoments*>(t.moments) + size_t(p) * (k + kPaints);
  for (int i = 0; i < used; i++) t.points[size_t(p) * k + i] -= adan(g.points[i], moments[i], r, bias, r.points);
}

AdanBias bias_of(const AdanRates& r, int age) {
  return {1.0f - std::pow(r.keep1, float(age)), 1.0f - std::pow(r.keep2, float(age)),
          std::sqrt(1.0f - std::pow(r.keep3, float(age))), age == 1};
}

// The same where the points follow from other values.
void step_tied(const Frame& f, int p, const Gathered& g, const CsTraining& t, const AdanRates& r) {
  const CsTied& tied = *t.tied;
  const AdanBias bias = bias_of(r, ++tied.ages[p]);
  const size_t first = 2 * size_t(p) * tied.count;
  auto* moments = reinterpret_cast<AdanMoments*>(tied.moments) + first;
  float *values = tied.values + first, *points = t.points + 2 * size_t(p) * f.points_per_curve;
  for (int i = 0; i < 2 * tied.count; i++) {
    float gradient = 0.0f;
    for (int j = 0; j < f.points_per_curve; j++) gradient += tied.map[j * tied.count + i / 2] * g.points[2 * j + i % 2];
    values[i] -= adan(gradient, moments[i], r, bias, r.points);
  }
  for (int j = 0; j < 2 * f.points_per_curve; j++) {
    points[j] = 0.0f;
    for (int i = 0; i < tied.count; i++) points[j] += tied.map[j / 2 * tied.count + i] * values[2 * i + j % 2];
  }
}

void add(const float* further, int p, Gathered& g) {
  if (!further) return;
  further += size_t(p) * g.points.size();
  for (size_t i = 0; i < g.points.size(); i++) g.points[i] += further[i];
}

// Whether all parameters are finite: one that is not makes the sum so.
bool finite(const Frame& f, int p, const CsTraining& t) {
  const float* points = t.points + 2 * size_t(p) * f.points_per_curve;
  float sum = t.opacities[p] + t.half_widths[p] + (t.edge_widths ? t.edge_widths[p] : 0.0f);
  for (int i = 0; i < 2 * f.points_per_curve; i++) sum += points[i];
  for (int c = 0; c < 3; c++) sum += t.colours[3 * size_t(p) + c];
  return std::isfinite(sum);
}

void step(const Frame& f, int p, const Gathered& g, const CsTraining& t) {
  const AdanRates common{t.rate_points, t.rate_colours, t.rate_opacities, t.rate_half_widths, t.rate_edge_widths,
                         t.keep1,       t.keep2,        t.keep3,          t.epsilon};
  const AdanRates r = scaled(common, t.rate_scale ? t.rate_scale + 5 * size_t(p) : nullptr);
  const AdanBias bias = bias_of(r, ++t.ages[p]);
  const size_t k = size_t(f.points_per_curve) * 2;
  auto* moments = reinterpret_cast<AdanMoments*>(t.moments) + p * (k + kPaints) + k;  // behind those of the points
  if (r.points != 0.0f) t.tied ? step_tied(f, p, g, t, r) : step_points(f, p, g, t, r, bias);
  if (r.colours != 0.0f)
    for (int c = 0; c < 3; c++) {
      float& x = t.colours[3 * size_t(p) + c];
      x = limit(x - adan(g.colour[c], moments[c], r, bias, r.colours), -kLogitLimit, kLogitLimit);
    }
  if (r.opacities != 0.0f) {
    float& o = t.opacities[p];
    o = limit(o - adan(g.opacity, moments[3], r, bias, r.opacities), -kLogitLimit, kLogitLimit);
  }
  if (t.edge_widths && r.edge_widths != 0.0f) {
    auto& edge_moments = reinterpret_cast<AdanMoments*>(t.edge_moments)[p];
    float& w = t.edge_widths[p];
    w = limit(w - adan(g.edge_width, edge_moments, r, bias, r.edge_widths), kMinEdgeWidth, kMaxEdgeWidth);
  }
  if (f.scene.closed || r.half_widths == 0.0f) return;
  float& h = t.half_widths[p];
  h = std::max(h - adan(g.half_width, moments[4], r, bias, r.half_widths), kMinHalfWidth);
}

}  // namespace

void update(Frame& f, int index, const CsGradients* out, const CsTraining* training) {
  const Chunk& chunk = f.chunks[index];
  const float* parameters = chunk.parameters.data();
  Gathered g;
  int last = std::min(f.scene.curves, (index + 1) * kChunk);
  for (int p = index * kChunk; p < last; p++) {
    const Primitive& q = f.primitives[p];
    gather(f, chunk, q, g);
    pull_back(f, chunk, q, parameters, p, g);
    if (f.settings.subdivide) parameters += q.edges;
    if (f.scene.logits) through_logits(q, g);
    if (out) write(f, p, g, *out);
    if (!training) continue;
    add(training->points_gradient, p, g);
    if (training->blunting) add(training->blunting->gradient, p, g);
    step(f, p, g, *training);
    if (!finite(f, p, *training)) f.broken = true;
  }
}

}  // namespace cs
