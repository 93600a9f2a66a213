// What is asked of a stack as it is drawn: its picture, its crossings, and by how much it is better than another one.

#include "stack.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "parallel.h"
#include "stack_picture.h"

namespace cs::stack {
namespace {

double cost(const CsPicture& picture, Address at, int64_t pixel, bool leaks) {
  const Tile& tile = *picture.tiles[at.tile];
  const double shown = leaks ? leak(picture.goal, tile.seen->data() + 4 * at.place, pixel) : 0.0;
  return tile.misfit[at.place] + picture.goal.leak_weight * shown * shown;
}

// The pieces of each group, one group after the other, and where those of each begin.
struct Groups {
  std::vector<int32_t> pieces;
  std::vector<int64_t> starts;

  Groups(const int32_t* of, int64_t count, int64_t groups) : starts(groups + 1, 0) {
    for (int64_t n = 0; n < count; n++)
      if (of[n] >= 0) starts[of[n] + 1]++;
    for (int64_t k = 0; k < groups; k++) starts[k + 1] += starts[k];
    std::vector<int64_t> next(starts.begin(), starts.end() - 1);
    pieces.resize(starts.back());
    for (int64_t n = 0; n < count; n++)
      if (of[n] >= 0) pieces[next[of[n]]++] = int32_t(n);
  }
};

class Growth {
 public:
  Growth(const CsPicture& before, const CsPicture& after, int32_t spread, bool leaks)
      : before_(before), after_(after), spread_(spread), leaks_(leaks), first_(before.tiles.size(), -1) {
    int64_t pixels = 0;
    for (size_t n = 0; n < first_.size(); n++)
      if (before.tiles[n] != after.tiles[n]) first_[n] = pixels, pixels += kTile * kTile;
    counted_.assign(pixels, -1);
  }

  void add(const CsPicture& picture, int32_t piece, int32_t group, double& sum) {
    const int width = picture.goal.width, height = picture.goal.height;
    each_pixel(picture, piece, [&](int32_t pixel, Address at) {
      if (spread_ == 0) return count(pixel, at, group, sum);
      const int x = pixel % width, y = pixel / width;
      for (int j = std::max(y - spread_, 0); j <= std::min(y + spread_, height - 1); j++)
        for (int i = std::max(x - spread_, 0); i <= std::min(x + spread_, width - 1); i++)
          count(j * width + i, picture.at(i, j), group, sum);
    });
  }

 private:
  const CsPicture &before_, &after_;
  int32_t spread_;
  bool leaks_;
  std::vector<int64_t> first_;    // of the pixels of each tile that differs, among all of them; -1 for the others
  std::vector<int32_t> counted_;  // the group that has counted a pixel last

  void count(int32_t pixel, Address at, int32_t group, double& sum) {
    if (first_[at.tile] < 0) return;
    int32_t& counted = counted_[first_[at.tile] + at.place];
    if (counted == group) return;
    counted = group;
    sum += cost(after_, at, pixel, leaks_) - cost(before_, at, pixel, leaks_);
  }
};

}  // namespace
}  // namespace cs::stack

extern "C" {

constexpr int64_t kLeastPieces = 512;  // whose pixels are compared in about a millisecond, which a thread is worth

void cs_stack_picture(const CsPicture* picture, double* image, double* misfit) {
  const int width = picture->goal.width;
  for (int y = 0; y < picture->goal.height; y++)
    for (int x = 0; x < width; x += cs::stack::kTile) {
      const int64_t pixel = int64_t(y) * width + x, count = std::min(cs::stack::kTile, width - x);
      const cs::stack::Address at = picture->at(x, y);
      const cs::stack::Tile& tile = *picture->tiles[at.tile];
      std::copy_n(tile.seen->data() + 4 * at.place, 4 * count, image + 4 * pixel);
      std::copy_n(tile.misfit.data() + at.place, count, misfit + pixel);
    }
}

void cs_stack_uppermost(const CsPicture* picture, int64_t left, int64_t top, int64_t width, int64_t height,
                        double least, int32_t* out) {
  std::fill(out, out + width * height, -1);
  const int64_t right = left + width, bottom = top + height;
  for (size_t k = 0; k < picture->layers.size(); k++) {
    const cs::stack::Trace& trace = *picture->layers[k];
    if (trace.left >= right || trace.right <= left) continue;
    for (int64_t row = std::max<int64_t>(top, trace.top); row < std::min<int64_t>(bottom, trace.bottom); row++) {
      const cs::stack::Span* end = trace.spans.data() + trace.rows[row - trace.top + 1];
      for (const cs::stack::Span* s = trace.spans.data() + trace.rows[row - trace.top]; s < end; s++)
        if (s->covered >= least && s->first < right && s->last > left)
          std::fill(out + (row - top) * width + std::max<int64_t>(s->first - left, 0),
                    out + (row - top) * width + std::min<int64_t>(s->last - left, width), int32_t(k));
    }
  }
}

double cs_stack_cost(const CsPicture* picture) {
  double sum = 0.0;
  for (const auto& tile : picture->tiles) sum += tile->cost;
  return sum;
}

int64_t cs_stack_crossings(const CsPicture* picture, const CsCrossings* out) {
  int64_t count = 0;
  for (const int32_t k : picture->own) count += int64_t(picture->layers[k]->pixel.size());
  if (out == nullptr) return count;
  return cs::counted([&] {
    std::vector<uint8_t> wanted(picture->layers.size(), 0);
    for (const int32_t k : picture->own) wanted[k] = 1;
    const auto slopes = cs::stack::slopes(*picture, wanted);
    int64_t first = 0;
    for (const int32_t k : picture->own) {
      const cs::stack::Trace& trace = *picture->layers[k];
      for (int64_t p = 0; p < trace.pieces(); p++)
        std::fill(out->piece + first + trace.starts[p], out->piece + first + trace.starts[p + 1],
                  picture->starts[k] + p);
      std::copy(trace.pixel.begin(), trace.pixel.end(), out->pixel + first);
      std::copy(trace.t.begin(), trace.t.end(), out->t + first);
      std::copy(trace.change.begin(), trace.change.end(), out->change + 8 * first);
      std::copy(slopes[k].begin(), slopes[k].end(), out->slope + 4 * first);
      first += int64_t(trace.pixel.size());
    }
    return count;
  });
}

int32_t cs_stack_growth(const CsPicture* before, const CsPicture* after, const int32_t* group_before,
                        const int32_t* group_after, int64_t groups, int64_t spread, int64_t leaks, double* growth) {
  return cs::failed([&] {
    const cs::stack::Groups old(group_before, before->starts.back(), groups),
        fresh(group_after, after->starts.back(), groups);
    const int64_t parts = cs::worth_starting(before->goal.threads, int64_t(old.pieces.size()), kLeastPieces);
    cs::each_index(parts, parts, [&](int64_t part) {
      cs::stack::Growth pixels(*before, *after, int32_t(spread), leaks != 0);
      for (int64_t k = part * groups / parts; k < (part + 1) * groups / parts; k++) {
        growth[k] = 0.0;
        for (int64_t n = old.starts[k]; n < old.starts[k + 1]; n++)
          pixels.add(*before, old.pieces[n], int32_t(k), growth[k]);
        for (int64_t n = fresh.starts[k]; n < fresh.starts[k + 1]; n++)
          pixels.add(*after, fresh.pieces[n], int32_t(k), growth[k]);
      }
    });
  });
}

void cs_stack_changed(const CsPicture* before, const CsPicture* after, const int32_t* group, double least,
                      uint8_t* changed) {
  for (int32_t piece = 0; piece < after->starts.back(); piece++) {
    if (group[piece] < 0 || changed[group[piece]]) continue;
    cs::stack::each_pixel(*after, piece, [&](int32_t, cs::stack::Address at) {
      const cs::stack::Tile &old = *before->tiles[at.tile], &fresh = *after->tiles[at.tile];
      if (&old == &fresh) return;
      for (int k = 4 * at.place; k < 4 * at.place + 4; k++)
        if (std::fabs((*fresh.seen)[k] - (*old.seen)[k]) > least) changed[group[piece]] = 1;
    });
  }
}
}
