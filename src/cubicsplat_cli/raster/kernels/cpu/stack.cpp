// What is asked of a stack as it is drawn: its picture, its crossings, and by how much it is better than another one.

#include "stack.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <vector>

#include "stack_picture.h"

namespace cs::stack {
namespace {

const Colours& seen(const CsPicture& picture, int64_t pixel) { return *picture.tiles[picture.tile_of(pixel)]->seen; }

double cost(const CsPicture& picture, int64_t pixel, bool leaks) {
  const Tile& tile = *picture.tiles[picture.tile_of(pixel)];
  const int place = picture.place_of(pixel);
  const double shown = leaks ? leak(picture.goal, tile.seen->data() + 4 * place, pixel) : 0.0;
  return tile.misfit[place] + picture.goal.leak_weight * shown * shown;
}

// Calls `call(pixel)` for the pixels that a piece crosses, some of them twice.
template <class Call>
void each_pixel(const CsPicture& picture, int32_t piece, Call call) {
  const auto next = std::upper_bound(picture.starts.begin(), picture.starts.end(), piece);
  const int64_t layer = next - picture.starts.begin() - 1, own = piece - picture.starts[layer];
  const Trace& trace = *picture.layers[layer];
  for (int64_t n = trace.starts[own]; n < trace.starts[own + 1]; n++) call(int64_t(trace.pixel[n]));
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
      : before_(before), after_(after), spread_(spread), leaks_(leaks),
        counted_(size_t(before.goal.width) * before.goal.height, -1) {}

  void add(const CsPicture& picture, int32_t piece, int32_t group, double& sum) {
    const int width = picture.goal.width, height = picture.goal.height;
    each_pixel(picture, piece, [&](int64_t pixel) {
      const int x = int(pixel % width), y = int(pixel / width);
      for (int j = std::max(y - spread_, 0); j <= std::min(y + spread_, height - 1); j++)
        for (int i = std::max(x - spread_, 0); i <= std::min(x + spread_, width - 1); i++) {
          const int64_t at = int64_t(j) * width + i;
          if (counted_[at] == group) continue;
          counted_[at] = group;
          const int tile = picture.tile_of(at);
          if (before_.tiles[tile] != after_.tiles[tile]) sum += cost(after_, at, leaks_) - cost(before_, at, leaks_);
        }
    });
  }

 private:
  const CsPicture &before_, &after_;
  int32_t spread_;
  bool leaks_;
  std::vector<int32_t> counted_;  // the group that has counted a pixel last
};

}  // namespace
}  // namespace cs::stack

extern "C" {

void cs_stack_picture(const CsPicture* picture, double* image, double* misfit) {
  for (int64_t pixel = 0; pixel < int64_t(picture->goal.width) * picture->goal.height; pixel++) {
    const int place = picture->place_of(pixel);
    const double* colour = cs::stack::seen(*picture, pixel).data() + 4 * place;
    std::copy(colour, colour + 4, image + 4 * pixel);
    misfit[pixel] = picture->tiles[picture->tile_of(pixel)]->misfit[place];
  }
}

double cs_stack_cost(const CsPicture* picture) {
  double sum = 0.0;
  for (const auto& tile : picture->tiles) sum += tile->cost;
  return sum;
}

int64_t cs_stack_crossings(const CsPicture* picture, const CsCrossings* out) {
  int64_t count = 0;
  for (const auto& layer : picture->layers) count += int64_t(layer->pixel.size());
  if (out == nullptr) return count;
  try {
    const auto slopes = cs::stack::slopes(*picture, std::vector<uint8_t>(picture->layers.size(), 1));
    int64_t first = 0;
    for (size_t k = 0; k < slopes.size(); k++) {
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
  } catch (const std::exception&) {
    return -1;
  }
  return count;
}

int32_t cs_stack_growth(const CsPicture* before, const CsPicture* after, const int32_t* group_before,
                        const int32_t* group_after, int64_t groups, int32_t spread, int32_t leaks, double* growth) {
  try {
    const cs::stack::Groups old(group_before, before->starts.back(), groups),
        fresh(group_after, after->starts.back(), groups);
    cs::stack::Growth pixels(*before, *after, spread, leaks != 0);
    for (int64_t k = 0; k < groups; k++) {
      growth[k] = 0.0;
      for (int64_t n = old.starts[k]; n < old.starts[k + 1]; n++)
        pixels.add(*before, old.pieces[n], int32_t(k), growth[k]);
      for (int64_t n = fresh.starts[k]; n < fresh.starts[k + 1]; n++)
        pixels.add(*after, fresh.pieces[n], int32_t(k), growth[k]);
    }
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}

void cs_stack_changed(const CsPicture* before, const CsPicture* after, const int32_t* group, double least,
                      uint8_t* changed) {
  for (int32_t piece = 0; piece < after->starts.back(); piece++) {
    if (group[piece] < 0 || changed[group[piece]]) continue;
    cs::stack::each_pixel(*after, piece, [&](int64_t pixel) {
      const int tile = after->tile_of(pixel), place = after->place_of(pixel);
      if (before->tiles[tile] == after->tiles[tile]) return;
      for (int k = 0; k < 4; k++)
        if (std::fabs((*after->tiles[tile]->seen)[4 * place + k] - (*before->tiles[tile]->seen)[4 * place + k]) > least)
          changed[group[piece]] = 1;
    });
  }
}
}
