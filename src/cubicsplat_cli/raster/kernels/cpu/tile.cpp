// Stage raster, one tile: block by block coverage and compositing front to back, the loss, and the way back.
//
// A block's pixels stay in registers, what it keeps of the primitives stays in the nearest cache.
// Compiled once per instruction set (CS_ISA names the namespace); no standard containers here, see tile.h.

#ifndef CS_ISA
#error "CS_ISA must name the instruction set this file is compiled for"
#endif

#include "images.h"
#include "fill.h"

namespace cs {
namespace CS_ISA {
namespace {

// Final colour F of a block's pixels, its error against the target, dL/dF, and the pixels' factors in the loss.
template <int C>
struct Finished {
  Lanes colour[C], error[C], gradient[C], factor;

  Finished() : factor(1.0f) {
    for (int c = 0; c < C; c++) colour[c] = error[c] = gradient[c] = Lanes(0.0f);
  }
};

// What errors cost: all the same, by the settings; or by the metric of each pixel, of three channels.
class ByPenalty {
 public:
  ByPenalty(const TileTask& task, const Window&) : settings_(*task.settings) {}
  Penalty of() const { return {settings_.squares, settings_.robust, settings_.knee}; }

 private:
  const CsSettings& settings_;
};

class ByMetric {
 public:
  ByMetric(const TileTask& task, const Window& window) {
    if (window.empty()) return;
    window.template load<3>(task.images->metric, metric_.rows);
    window.template load<3>(task.images->metric + task.scene->height * window.stride, metric_.rows + 3);
  }
  const Metric<Lanes>& of() const { return metric_; }

 private:
  Metric<Lanes> metric_;
};

template <int C, class Fill, class Costs>
class BlockWork {
 public:
  BlockWork(const TileTask& task, const Outlines& outlines, Record* records, int number)
      : task_(task), outlines_(outlines), records_(records), block_(number), window_(task, block_),
        costs_(task, window_) {}

  bool empty() const { return window_.empty(); }

  // Adds to the loss and the background's gradient.
  void run(Lanes& loss, Lanes* background) {
    Finished<C> done;
    forward(done);
    if (task_.images->target) loss = fused(pixel_loss<C>(done.error, costs_.of()), done.factor, loss);
    if (!task_.backward) return;
    for (int c = 0; c < C; c++) background[c] = fused(transmittance_, done.gradient[c], background[c]);
    backward(done);
  }

 private:
  const TileTask& task_;
  const Outlines& outlines_;
  Record* records_;  // of the mixed pairs, in their order
  const Block block_;
  const Window window_;
  const Costs costs_;
  Lanes transmittance_, accumulated_[C];
  uint32_t visited_;  // pairs, in the order of the visible ones, before every pixel was finished

  bool mixed(const Outline& o) const { return o.mixed >> block_.number & 1; }

  void start() {
    transmittance_ = window_.inside();
    for (Lanes& a : accumulated_) a = Lanes(0.0f);
  }

  CS_INLINE void cover(const Outline& o, Record& r) const {
    const bool exact = task_.settings->exact;
    if (task_.scene->closed)
      cover_block_by_fill(o, block_, exact, r);
    else
      cover_block_by_stroke(o, block_, exact, r);
  }

  void forward(Finished<C>& done) {
    start();
    Record* next = records_;
    visited_ = 0;
    outlines_.each_visible(block_, [&](const Outline& o) {
      const Fill fill(task_, o, block_);
      Lanes coverage(1.0f);
      if (mixed(o)) {
        cover(o, *next);
        coverage = next++->cover.coverage;
      }
      const Lanes alpha = minimum(fill.opacity * coverage, Lanes(kMaxAlpha));
      composite<C>(alpha, fill.colour, transmittance_, accumulated_);
      visited_++;
      return any(transmittance_ >= Lanes(kMinTransmittance));
    });
    finish(done);
  }

  // Final colour, the picture and the loss's gradient; T is left as it is for the background's gradient.
  void finish(Finished<C>& done) {
    const CsImages& images = *task_.images;
    Lanes ground[C];
    for (int c = 0; c < C; c++) ground[c] = Lanes(task_.scene->background[c]);
    if (images.ground) window_.template load<C>(images.ground, ground);
    for (int c = 0; c < C; c++) done.colour[c] = fused(transmittance_, ground[c], accumulated_[c]);
    if (images.image) window_.template store<C>(images.image, done.colour);
    if (images.gradient) window_.template load<C>(images.gradient, done.gradient);
    if (!images.target) return;
    Lanes target[C];
    window_.template load<C>(images.target, target);
    const Lanes inside = window_.inside();
    for (int c = 0; c < C; c++) done.error[c] = (done.colour[c] - target[c]) * inside;
    if (images.weights) done.factor = window_.plane(images.weights, C);
    if (!images.gradient) {
      pixel_loss_gradient<C>(done.error, costs_.of(), done.gradient);
      for (int c = 0; c < C; c++) done.gradient[c] = done.gradient[c] * done.factor;
    }
  }

  void backward(const Finished<C>& done) {
    start();
    Backward<Lanes> pixel{transmittance_, Lanes(0.0f)};
    for (int c = 0; c < C; c++) pixel.behind = fused(done.colour[c], done.gradient[c], pixel.behind);
    const Record* next = records_;
    uint32_t left = visited_;
    outlines_.each_visible(block_, [&](const Outline& o) {
      const Record* record = mixed(o) ? next++ : nullptr;
      return_to(o, record, done, pixel);
      return --left > 0;
    });
  }

  CS_INLINE void return_to(const Outline& o, const Record* record, const Finished<C>& done, Backward<Lanes>& pixel) {
    const Fill fill(task_, o, block_);
    const Lanes coverage = record ? record->cover.coverage : Lanes(1.0f);
    const Lanes raw = fill.opacity * coverage, alpha = minimum(raw, Lanes(kMaxAlpha));
    Lanes weight, d_alpha = composite_backward<C>(alpha, fill.colour, done.gradient, pixel, weight);
    d_alpha = select(raw > Lanes(kMaxAlpha), Lanes(0.0f), d_alpha);
    fill.give_back(task_, o, block_, {weight, d_alpha, coverage, done.gradient});
    if (task_.settings->importance) o.pair->gradient.importance += sum(importance(alpha, weight, fill, done));
    if (!record) return;
    const Lanes d_coverage = d_alpha * fill.opacity;
    add_cover_gradient(*task_.scene, o, *record, d_coverage);
    pull_edges(o, block_, *record, d_coverage);
  }

  CS_INLINE Lanes importance(Lanes alpha, Lanes weight, const Fill& fill, const Finished<C>& done) {
    if (task_.settings->importance == 1) return weight * done.factor;
    return leave_one_out<C>(alpha, weight, fill.colour, done.colour, done.error, costs_.of(), accumulated_) *
           done.factor;
  }
};

template <int C, class Fill, class Costs>
void raster(const TileTask& task) {
  Arena arena{task.scratch};
  const Outlines outlines = Gatherer(task, arena).run();
  Record* records = arena.take<Record>(task.pairs.count);
  Lanes loss(0.0f), background[C];
  for (Lanes& b : background) b = Lanes(0.0f);
  for (int number = 0; number < kBlocks; number++) {
    BlockWork<C, Fill, Costs> work(task, outlines, records, number);
    if (!work.empty()) work.run(loss, background);
    ask_for_next_row(task, task.images->target, number);
  }
  if (task.backward)
    for (uint32_t i = 0; i < outlines.count; i++) outlines.list[i].sums->add_to(outlines.list[i].pair->gradient);
  *task.loss = sum(loss);
  for (int c = 0; c < C; c++) task.background[c] = sum(background[c]);
}

}  // namespace

// Scratch memory that a tile takes.
size_t tile_scratch(const TileTask& task) {
  return Gatherer::scratch(task) + aligned(task.pairs.count * sizeof(Record)) + 64;
}

void raster_tile(const TileTask& task) {
  const bool flat = !task.scene->kinds;
  if (task.scene->channels == 4)
    flat ? raster<4, FlatFill, ByPenalty>(task) : raster<4, GradientFill, ByPenalty>(task);
  else if (task.images->metric)
    flat ? raster<3, FlatFill, ByMetric>(task) : raster<3, GradientFill, ByMetric>(task);
  else
    flat ? raster<3, FlatFill, ByPenalty>(task) : raster<3, GradientFill, ByPenalty>(task);
}

}  // namespace CS_ISA
}  // namespace cs
