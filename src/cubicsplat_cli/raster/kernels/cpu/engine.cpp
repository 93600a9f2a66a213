// The C interface: checks, the thread pool, and the order of the stages.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "frame.h"

namespace cs {

#define CS_DECLARE_ISA(name)            \
  namespace name {                      \
  size_t tile_scratch(const TileTask&); \
  void raster_tile(const TileTask&);    \
  }
CS_DECLARE_ISA(generic)
#ifdef CS_HAVE_AVX2
CS_DECLARE_ISA(avx2)
#endif
#ifdef CS_HAVE_AVX512
CS_DECLARE_ISA(avx512)
#endif
#ifdef CS_HAVE_NEON
CS_DECLARE_ISA(neon)
#endif

namespace {

struct Isa {
  const char* name;
  ScratchFunction scratch;
  TileFunction raster;
};

// What this build holds and this machine can run, best first.
std::vector<Isa> available() {
  std::vector<Isa> list;
#ifdef CS_HAVE_AVX512
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
      __builtin_cpu_supports("avx512vl"))
    list.push_back({"avx512", avx512::tile_scratch, avx512::raster_tile});
#endif
#ifdef CS_HAVE_AVX2
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
    list.push_back({"avx2", avx2::tile_scratch, avx2::raster_tile});
#endif
#ifdef CS_HAVE_NEON
  list.push_back({"neon", neon::tile_scratch, neon::raster_tile});  // part of every 64-bit ARM
#endif
  list.push_back({"generic", generic::tile_scratch, generic::raster_tile});
  return list;
}

// Threads that share out the indices of one loop at a time; the caller is one of them.
class Pool {
 public:
  explicit Pool(int threads) {
    for (int i = 1; i < threads; i++) workers_.emplace_back([this, i] { serve(i); });
  }

  ~Pool() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      stopping_ = true;
    }
    wake_.notify_all();
    for (std::thread& t : workers_) t.join();
  }

  int threads() const { return int(workers_.size()) + 1; }

  // Calls body(index, thread) for every index below count. Rethrows the first exception of a body.
  void run(int count, const std::function<void(int, int)>& body) {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      body_ = &body;
      count_ = count;
      next_ = 0;
      busy_ = int(workers_.size());
      failure_ = nullptr;
      generation_++;
    }
    wake_.notify_all();
    work(0);
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [this] { return busy_ == 0; });
    if (failure_) std::rethrow_exception(failure_);
  }

 private:
  void work(int thread) {
    try {
      for (int i; (i = next_.fetch_add(1)) < count_;) (*body_)(i, thread);
    } catch (...) {
      std::lock_guard<std::mutex> lock(mutex_);
      if (!failure_) failure_ = std::current_exception();
      next_ = count_;
    }
  }

  void serve(int thread) {
    uint64_t seen = 0;
    for (;;) {
      {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, [&] { return stopping_ || generation_ != seen; });
        if (stopping_) return;
        seen = generation_;
      }
      work(thread);
      std::lock_guard<std::mutex> lock(mutex_);
      if (--busy_ == 0) done_.notify_one();
    }
  }

  std::vector<std::thread> workers_;
  std::mutex mutex_;
  std::condition_variable wake_, done_;
  const std::function<void(int, int)>* body_ = nullptr;
  std::atomic<int> next_{0};
  int count_ = 0, busy_ = 0;
  uint64_t generation_ = 0;
  bool stopping_ = false;
  std::exception_ptr failure_;
};

struct Scratch {
  std::unique_ptr<char[]> memory;
  size_t bytes = 0;

  char* reserve(size_t need) {
    if (need > bytes) {
      memory.reset(new char[need + 64]);
      bytes = need;
    }
    return reinterpret_cast<char*>((reinterpret_cast<uintptr_t>(memory.get()) + 63) & ~uintptr_t(63));
  }
};

}  // namespace
}  // namespace cs

struct CsEngine {
  explicit CsEngine(int threads, const cs::Isa& chosen) : pool(threads), isa(chosen), scratch(threads) {}

  cs::Pool pool;
  cs::Isa isa;
  cs::Frame frame;
  std::vector<cs::Scratch> scratch;
  std::string error;
  double timings[4] = {0, 0, 0, 0};
  CsRun* best = nullptr;  // where a step keeps the best curves

  void raster_tile(int index, int thread) {
    cs::Frame& f = frame;
    cs::TileTask task;
    task.scene = &f.scene;
    task.settings = &f.settings;
    task.images = &f.images;
    task.tile_x = index % f.tiles_x;
    task.tile_y = index / f.tiles_x;
    task.backward = f.backward;
    task.pairs = f.pairs_of(index);
    task.next_pairs = f.pairs_of(index + 1);
    task.pairs_behind = f.pairs_of(index + 2);
    task.next_x = (index + 1) % f.tiles_x;
    task.next_y = (index + 1) / f.tiles_x;
    task.primitives = f.primitives.data();
    task.chunks = f.views.data();
    task.chunk_size = cs::kChunk;
    task.loss = &f.tile_loss[index];
    task.background = &f.tile_background[size_t(index) * 4];
    task.scratch = scratch[thread].reserve(isa.scratch(task));
    isa.raster(task);
  }

  void raster_strip(int index, int thread) {
    const int end = std::min((index + 1) * cs::kStrip, frame.tiles());
    for (int i = index * cs::kStrip; i < end; i++) raster_tile(i, thread);
  }

  void run(const CsScene& scene, const CsSettings& settings, const CsImages& images, bool backward,
           const CsGradients* gradients, const CsTraining* training) {
    using Clock = std::chrono::steady_clock;
    Clock::time_point marks[5];
    marks[0] = Clock::now();
    cs::prepare(frame, scene, settings, images, backward);
    pool.run(frame.chunk_count(), [this](int i, int) { cs::flatten(frame, i); });
    marks[1] = Clock::now();
    cs::bin(frame);
    marks[2] = Clock::now();
    pool.run((frame.tiles() + cs::kStrip - 1) / cs::kStrip, [this](int i, int thread) { raster_strip(i, thread); });
    marks[3] = Clock::now();
    add_losses();
    keep_best();
    if (backward) pool.run(frame.chunk_count(), [&](int i, int) { cs::update(frame, i, gradients, training); });
    marks[4] = Clock::now();
    for (int i = 0; i < 4; i++) timings[i] = std::chrono::duration<double>(marks[i + 1] - marks[i]).count();
    total(gradients);
  }

  // Brings the penalty's gradient up to date, of which each is good for a few steps.
  void blunt(const CsScene& scene, const CsSettings& settings, const CsImages& images, cs::Blunting& blunting) {
    if (blunting.left-- > 0) return;
    blunting.left = blunting.every - 1;
    cs::prepare(frame, scene, settings, images, true);
    pool.run(frame.chunk_count(), [&](int i, int) { cs::blunt(frame, i, blunting); });
  }

  void step(const CsScene& scene, const CsSettings& settings, const CsImages& images, const CsGradients* gradients,
            const CsTraining& training, CsRun* run_of) {
    if (training.blunting) blunt(scene, settings, images, *training.blunting);
    best = run_of;
    frame.broken = false;
    run(scene, settings, images, true, gradients, &training);
    if (training.blunting && images.loss) training.blunting->loss = *images.loss;
    if (!training.shared_opacity || scene.curves == 0) return;
    double sum = 0.0;
    for (int p = 0; p < scene.curves; p++) sum += training.opacities[p];
    std::fill(training.opacities, training.opacities + scene.curves, float(sum / scene.curves));
  }

  // Keeps the curves if there were none as good before.
  void keep_best() {
    if (!best || !best->points || !(*frame.images.loss < best->least)) return;
    const CsScene& s = frame.scene;
    const size_t n = s.curves;
    best->least = *frame.images.loss;
    std::copy(s.points, s.points + n * frame.points_per_curve * 2, best->points);
    std::copy(s.colours, s.colours + 3 * n, best->colours);
    std::copy(s.opacities, s.opacities + n, best->opacities);
    std::copy(s.half_widths, s.half_widths + n, best->half_widths);
    if (s.edge_widths && best->edge_widths) std::copy(s.edge_widths, s.edge_widths + n, best->edge_widths);
  }

  void add_losses() {
    if (!frame.images.loss || !frame.images.target) return;
    double loss = 0.0;
    for (double l : frame.tile_loss) loss += l;
    *frame.images.loss = loss;
  }

  // Sums over the tiles, in their order.
  void total(const CsGradients* gradients) {
    if (!frame.backward || !gradients || !gradients->background) return;
    for (int c = 0; c < frame.scene.channels; c++) {
      double g = 0.0;
      for (int t = 0; t < frame.tiles(); t++) g += frame.tile_background[size_t(t) * 4 + c];
      gradients->background[c] = float(g);
    }
  }
};

namespace {

// Whether the table of ring ends is one: rising, at least one segment per curve, none more than there is room for.
bool has_rings(const CsScene& s) {
  if (s.rings < 1 || (!s.closed && s.rings != 1)) return false;
  for (int p = 0; p < s.curves; p++) {
    const int32_t* ends = s.ring_ends + size_t(p) * s.rings;
    if (ends[0] < 1 || ends[s.rings - 1] > s.segments) return false;
    for (int r = 1; r < s.rings; r++)
      if (ends[r] < ends[r - 1]) return false;
  }
  return true;
}

// Whether every curve's fill is one: flat, or a gradient with as many stops as there is room for, at least one.
bool has_paints(const CsScene& s) {
  if (s.most_stops < 1 || !s.counts || !s.frames || !s.offsets || !s.stops) return false;
  for (int p = 0; p < s.curves; p++) {
    if (s.kinds[p] < cs::kFlat || s.kinds[p] > cs::kRadial) return false;
    if (s.kinds[p] != cs::kFlat && (s.counts[p] < 1 || s.counts[p] > s.most_stops)) return false;
  }
  return true;
}

// What the caller (cpu.py) has to guarantee; null when all is well.
const char* fault(const CsScene& s, const CsSettings& t, const CsImages& images, bool backward) {
  if (s.curves < 0 || s.segments < 1 || s.width < 1 || s.height < 1) return "scene sizes must be positive";
  if (s.channels != 3 && s.channels != 4) return "channels must be 3 or 4";
  if (t.samples < 1 || t.samples > cs::kMaxSamples) return "samples must lie between 1 and 64";
  if (s.ring_ends && !has_rings(s)) return "ring_ends must rise along each curve, from 1 to the number of segments";
  if (s.kinds && !has_paints(s))
    return "gradients need a kind from 0 to 2 and from 1 to as many stops as there is room for";
  int rings = s.ring_ends ? s.rings : 1;
  if (int64_t(s.segments) * t.samples + rings > cs::kMostVertices) return "a curve may have at most 1073741823 edges";
  if (!(t.edge_width > 0.0f)) return "edge_width must be positive";
  if (t.subdivide && !(t.tolerance > 0.0f)) return "subdivision needs a tolerance";
  if (backward && !images.target && !images.gradient) return "a backward pass needs a target or an incoming gradient";
  if (t.importance == 2 && !images.target) return "leave-one-out importance needs a target";
  return nullptr;
}

template <class Body>
int32_t guarded(CsEngine* e, const CsScene* scene, const CsSettings* settings, const CsImages* images, bool backward,
                const Body& body) {
  const char* wrong = fault(*scene, *settings, *images, backward);
  if (wrong) {
    e->error = wrong;
    return 1;
  }
  try {
    e->best = nullptr;
    body();
    return 0;
  } catch (const std::bad_alloc&) {
    e->error = "out of memory";
  } catch (const std::exception& x) {
    e->error = x.what();
  }
  return 1;
}

}  // namespace

int32_t cs_abi_version() { return 18; }

const char* cs_isa_names() {
  static const std::string names = [] {
    std::string text;
    for (const cs::Isa& isa : cs::available()) text += (text.empty() ? "" : ",") + std::string(isa.name);
    return text;
  }();
  return names.c_str();
}

CsEngine* cs_create(int32_t threads, const char* isa) {
  if (threads < 1) return nullptr;
  try {
    for (const cs::Isa& candidate : cs::available())
      if (!isa || std::strcmp(isa, candidate.name) == 0) return new CsEngine(threads, candidate);
  } catch (const std::exception&) {
    return nullptr;  // the header's promise for a machine that has no more memory or threads
  }
  return nullptr;
}

void cs_destroy(CsEngine* e) { delete e; }
const char* cs_error(const CsEngine* e) { return e->error.c_str(); }
const char* cs_isa(const CsEngine* e) { return e->isa.name; }

int32_t cs_render(CsEngine* e, const CsScene* scene, const CsSettings* settings, const CsImages* images) {
  return guarded(e, scene, settings, images, false,
                 [&] { e->run(*scene, *settings, *images, false, nullptr, nullptr); });
}

int32_t cs_gradients(CsEngine* e, const CsScene* scene, const CsSettings* settings, const CsImages* images,
                     const CsGradients* gradients) {
  return guarded(e, scene, settings, images, true,
                 [&] { e->run(*scene, *settings, *images, true, gradients, nullptr); });
}

int32_t cs_step_frames(CsEngine* e, const CsScene* canvas, const CsSettings* settings, const CsImages* images,
                       const CsFrameSteps* steps) {
  return guarded(e, canvas, settings, images, false, [&] {
    cs::step_frames(*canvas, *images, *steps,
                    [&](const CsScene& scene, const CsImages& with, const CsGradients& gradients) {
                      e->run(scene, *settings, with, true, &gradients, nullptr);
                    });
  });
}

int32_t cs_run(CsEngine* e, const CsScene* scene, const CsSettings* settings, const CsImages* images,
               const CsGradients* gradients, const CsTraining* training, CsRun* run) {
  return guarded(e, scene, settings, images, true, [&] {
    using Clock = std::chrono::steady_clock;
    const auto begin = Clock::now();
    CsSettings own = *settings;
    CsImages seen = *images;
    CsTraining rated = *training;
    for (run->done = 0; run->done < run->count;) {
      const float* pace = run->paces + 6 * size_t(run->done);
      own.edge_width = pace[0];
      rated.rate_points = pace[1], rated.rate_colours = pace[2], rated.rate_opacities = pace[3];
      rated.rate_half_widths = pace[4], rated.rate_edge_widths = pace[5];
      seen.loss = run->losses + run->done++;
      e->step(*scene, own, seen, gradients, rated, run);
      const bool late = std::chrono::duration<double>(Clock::now() - begin).count() >= run->seconds;
      if (late || e->frame.broken || !std::isfinite(*seen.loss)) break;
    }
  });
}

void cs_timings(const CsEngine* e, double* seconds) { std::memcpy(seconds, e->timings, sizeof e->timings); }

void cs_counts(const CsEngine* e, int64_t* counts) {
  for (int i = 0; i < 4; i++) counts[i] = 0;
  for (const cs::Chunk& c : e->frame.chunks) {
    counts[0] += c.skipped;
    for (const cs::Pair& p : c.pairs) {
      bool boundary = p.kind == cs::PairKind::boundary;
      counts[boundary ? 2 : 1]++;
      counts[3] += p.edge_count;
    }
  }
}
