// The numbers of moving curves between their knots, and Adam's steps of what the knots hold (Kingma and Ba, 2015).
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "frame.h"

namespace {

// Values of knots as a file has them: multiples of a step of each number, or as they are without steps.
float on_grid(float value, const double* steps, int64_t number) {
  return steps ? float(std::nearbyint(double(value) / steps[number]) * steps[number]) : value;
}

// `numbers` values on the line from the row first to the row last, a share of the way.
void between(int64_t numbers, const float* first, const float* last, float share, const double* steps, float* out) {
  for (int64_t i = 0; i < numbers; i++) {
    const float start = on_grid(first[i], steps, i);
    out[i] = share > 0.0f ? start + share * (on_grid(last[i], steps, i) - start) : start;
  }
}

struct Adam {
  double rate, keep_mean, keep_square, epsilon;
};

void step_knot(const Adam& adam, int64_t numbers, const float* gradient, float part, bool bounded, float* values,
               float* means, float* squares, int32_t& age) {
  age++;
  const float keep_mean = float(adam.keep_mean), keep_square = float(adam.keep_square);
  const float rate = float(adam.rate / (1.0 - std::pow(adam.keep_mean, age)));
  const float unbiased = float(1.0 / (1.0 - std::pow(adam.keep_square, age)));
  for (int64_t i = 0; i < numbers; i++) {
    const float g = part * gradient[i];
    means[i] = keep_mean * means[i] + (1.0f - keep_mean) * g;
    squares[i] = keep_square * squares[i] + (1.0f - keep_square) * g * g;
    const float moved = values[i] - rate * means[i] / (std::sqrt(unbiased * squares[i]) + float(adam.epsilon));
    values[i] = bounded ? std::clamp(moved, 0.0f, 1.0f) : moved;
  }
}

// Moves the knots around a frame, a row of each, by the gradient of what lies between them.
void step(const Adam& adam, const CsKnotTrack& track, int64_t curves, int64_t frame, int64_t curve,
          const float* gradient) {
  const int64_t at = frame * curves + curve;
  const float share = track.share[at];
  const auto move = [&](int64_t knot, float part) {
    const int64_t row = knot * curves + curve, begin = row * track.numbers;
    if (track.held && track.held[row]) return;
    step_knot(adam, track.numbers, gradient, part, track.bounded, track.values + begin, track.means + begin,
              track.squares + begin, track.ages[row]);
  };
  move(track.before[at], 1.0f - share);
  if (share > 0.0f) move(track.after[at], share);
}

// The curves of one frame, and the gradients of its loss.
class FrameCurves {
 public:
  FrameCurves(const CsScene& canvas, int64_t curves, const CsKnotTrack* tracks)
      : scene_(canvas), curves_(curves), tracks_(tracks), shape_(tracks[0].numbers), points_(curves * (shape_ - 1)),
        colours_(3 * curves), opacities_(curves), half_widths_(curves), of_points_(points_.size()),
        of_colours_(3 * curves), of_opacities_(curves), of_half_widths_(curves) {}

  // Of the curves that have an opacity.
  const CsScene& at(int64_t frame) {
    seen_.clear();
    std::vector<float> shape(shape_);
    for (int64_t curve = 0; curve < curves_; curve++) {
      const int64_t n = int64_t(seen_.size());
      value(3, frame, curve, &opacities_[n]);
      if (!(opacities_[n] > 0.0f)) continue;
      float offset[2];
      value(0, frame, curve, shape.data());
      value(1, frame, curve, offset);
      value(2, frame, curve, &colours_[3 * n]);
      for (int64_t i = 0; i < shape_ - 1; i++) points_[n * (shape_ - 1) + i] = shape[i] + offset[i % 2];
      half_widths_[n] = shape[shape_ - 1];
      seen_.push_back(curve);
    }
    scene_.curves = int32_t(seen_.size());
    scene_.points = points_.data(), scene_.colours = colours_.data();
    scene_.opacities = opacities_.data(), scene_.half_widths = half_widths_.data();
    return scene_;
  }

  CsGradients gradients() {
    for (auto* each : {&of_points_, &of_colours_, &of_opacities_, &of_half_widths_})
      std::fill(each->begin(), each->end(), 0.0f);
    CsGradients g{};
    g.points = of_points_.data(), g.colours = of_colours_.data();
    g.opacities = of_opacities_.data(), g.half_widths = of_half_widths_.data();
    return g;
  }

  // adams: of shapes and offsets, and of paints.
  void step_knots(int64_t frame, const Adam* adams) {
    std::vector<float> of_shape(shape_);
    for (size_t n = 0; n < seen_.size(); n++) {
      float of_offset[2] = {0.0f, 0.0f};
      for (int64_t i = 0; i < shape_ - 1; i++) of_offset[i % 2] += of_shape[i] = of_points_[n * (shape_ - 1) + i];
      of_shape[shape_ - 1] = of_half_widths_[n];
      const float* gradients[] = {of_shape.data(), of_offset, &of_colours_[3 * n], &of_opacities_[n]};
      for (int k = 0; k < 4; k++) step(adams[k / 2], tracks_[k], curves_, frame, seen_[n], gradients[k]);
    }
  }

 private:
  void value(int k, int64_t frame, int64_t curve, float* out) const {
    const CsKnotTrack& t = tracks_[k];
    const int64_t at = frame * curves_ + curve;
    const float *first = t.values + (t.before[at] * curves_ + curve) * t.numbers,
                *last = t.values + (t.after[at] * curves_ + curve) * t.numbers;
    between(t.numbers, first, last, t.share[at], t.steps, out);
  }

  CsScene scene_;
  int64_t curves_;
  const CsKnotTrack* tracks_;
  int64_t shape_;  // numbers of a shape: its points' coordinates and its half-width
  std::vector<int64_t> seen_;
  std::vector<float> points_, colours_, opacities_, half_widths_;
  std::vector<float> of_points_, of_colours_, of_opacities_, of_half_widths_;
};

}  // namespace

// found: curves x numbers, on the lines from values[before] to values[after], a share of the way; both are rows of
// `numbers` values.
CS_EXPORT void cs_between_knots(int64_t curves, int64_t numbers, const float* values, const int64_t* before,
                                const int64_t* after, const float* share, float* found) {
  for (int64_t curve = 0; curve < curves; curve++)
    between(numbers, values + numbers * before[curve], values + numbers * after[curve], share[curve], nullptr,
            found + numbers * curve);
}

void cs::step_frames(const CsScene& canvas, const CsImages& images, const CsFrameSteps& steps, const Draw& draw) {
  FrameCurves own(canvas, steps.curves, steps.tracks);
  CsImages each = images;
  for (int64_t i = 0; i < steps.count; i++) {
    each.target = steps.targets[i];
    const CsScene& scene = own.at(steps.frames[i]);
    draw(scene, each, own.gradients());
    const Adam adam{0.0, steps.keep_mean, steps.keep_square, steps.epsilon};
    Adam adams[] = {adam, adam};
    for (int k = 0; k < 2; k++) adams[k].rate = steps.rates[2 * i + k];
    own.step_knots(steps.frames[i], adams);
  }
}
