// Draws stacks of shapes in double precision: only the tiles in which something has changed.

#include "stack_picture.h"

#include <algorithm>
#include <cmath>
#include <new>

#include "parallel.h"
#include "stack_matches.h"

namespace cs::stack {
namespace {

constexpr int64_t kLeastPieces = 64,
                  kLeastTiles = 24;  // traced and drawn in about half a millisecond, which a thread is worth

// The part of the canvas that pieces may reach.
Window window_of(const CsGoal& goal, const std::vector<double>& cubics) {
  double low[2] = {1e9, 1e9}, high[2] = {-1e9, -1e9};
  for (size_t n = 0; n < cubics.size(); n += 2)
    for (int c = 0; c < 2; c++) low[c] = std::min(low[c], cubics[n + c]), high[c] = std::max(high[c], cubics[n + c]);
  const auto bounded = [](double v, int most) { return int(std::clamp(v, 0.0, double(most))); };
  const int left = bounded(std::floor(low[0]), goal.width), right = bounded(std::ceil(high[0]), goal.width);
  const int top = bounded(std::floor(low[1]), goal.height), bottom = bounded(std::ceil(high[1]), goal.height);
  return {left, top, std::max(right - left, 0), std::max(bottom - top, 0), {}};
}

// Sorts the crossings of a trace by the tile that they are in: runs of them, since neighbours mostly share theirs.
void sort_by_tile(Trace& trace, const CsPicture& picture) {
  const int64_t count = int64_t(trace.pixel.size());
  std::vector<std::pair<int32_t, int64_t>> runs;  // the tile and the first crossing
  trace.address.reserve(count), trace.by_tile.reserve(count);
  for (int64_t n = 0; n < count; n++) {
    trace.address.push_back(picture.at(trace.pixel[n] % picture.goal.width, trace.pixel[n] / picture.goal.width));
    if (n == 0 || trace.address[n].tile != trace.address[n - 1].tile) runs.push_back({trace.address[n].tile, n});
  }
  std::sort(runs.begin(), runs.end());
  for (const auto& [tile, first] : runs) {
    if (trace.tiles.empty() || trace.tiles.back() != tile)
      trace.tiles.push_back(tile), trace.tile_starts.push_back(int64_t(trace.by_tile.size()));
    for (int64_t n = first; n < count && trace.address[n].tile == tile; n++) trace.by_tile.push_back(n);
  }
  trace.tile_starts.push_back(count);
}

// Turns what crossings change where the sum of winding numbers is below zero, in order of rows and columns.
void turn(Trace& trace, const std::vector<Turned>& below, int width) {
  if (below.empty()) return;
  for (size_t n = 0; n < trace.pixel.size(); n++) {
    const int x = trace.pixel[n] % width, y = trace.pixel[n] / width;
    const auto after = std::upper_bound(below.begin(), below.end(), std::pair(y, x),
                                        [](auto at, const Turned& own) { return at < std::pair(own.row, own.first); });
    if (after == below.begin() || !after[-1].has(x, y)) continue;
    for (int k = 0; k < 8; k++) trace.change[8 * n + k] *= -1.0;
  }
}

std::shared_ptr<const Trace> traced(const CsStack& s, int first, int last, const CsPicture& picture) {
  auto trace = std::make_shared<Trace>();
  trace->cubics.assign(s.cubics + 8 * int64_t(first), s.cubics + 8 * int64_t(last));
  trace->signs.assign(s.signs + first, s.signs + last), trace->lines.assign(s.lines + first, s.lines + last);
  Window w = window_of(picture.goal, trace->cubics);
  // Room for about what is crossed; where outlines reach beyond the canvas it is too much.
  double length = 0.0;
  for (size_t n = 2; n < trace->cubics.size(); n++)
    if (n % 8 > 1) length += std::fabs(trace->cubics[n] - trace->cubics[n - 2]);
  const size_t room = size_t(std::min(length, 1e6)) + 2 * trace->lines.size();
  trace->pixel.reserve(room), trace->t.reserve(room), trace->change.reserve(8 * room), w.edges.reserve(2 * room);
  Crossings crossings(*trace, picture.goal.width, picture.goal.height);
  Tracer tracer(w, crossings, picture.goal.grid);
  for (int64_t n = 0; n < trace->pieces(); n++)
    tracer.piece(&trace->cubics[8 * n], trace->lines[n] != 0, trace->signs[n]);
  std::vector<Turned> below;
  w.finish(trace->spans, trace->rows, below);
  turn(*trace, below, picture.goal.width);
  trace->left = w.left, trace->top = w.top, trace->right = w.left + w.width, trace->bottom = w.top + w.height;
  sort_by_tile(*trace, picture);
  return trace;
}

// Traces the layers of a stack that are not known from an earlier picture.
void trace(CsPicture& picture, const CsStack& stack) {
  std::vector<int> fresh;
  int64_t pieces = 0;
  const auto first = [&](int layer) { return layer > 0 ? stack.ends[layer - 1] : 0; };
  for (int i = 0; i < stack.layers; i++)
    if (!picture.layers[picture.own[i]]) fresh.push_back(i), pieces += stack.ends[i] - first(i);
  each_index(int64_t(fresh.size()), worth_starting(picture.goal.threads, pieces, kLeastPieces), [&](int64_t n) {
    const int i = fresh[n];
    picture.layers[picture.own[i]] = traced(stack, first(i), stack.ends[i], picture);
  });
}

// The tiles in which a picture differs from its base, or an earlier one over the same base.
Mask adopt_over(CsPicture& picture, const CsStack& stack, const CsPicture& old) {
  Mask dirty(old.tiles.size(), 0);
  const bool paired = old.base == stack.base && old.own == picture.own;
  std::vector<uint8_t> known(stack.layers, 0);
  for (int i = 0, first = 0; paired && i < stack.layers; first = stack.ends[i++])
    if (same(stack, i, first, old, old.own[i])) known[i] = 1, picture.layers[old.own[i]] = old.layers[old.own[i]];
  trace(picture, stack);
  Differences differences(picture, dirty);
  for (int i = 0; i < stack.layers; i++) {
    const int k = picture.own[i];
    if (known[i]) continue;
    if (paired && std::equal(stack.fills + 4 * i, stack.fills + 4 * i + 4, &old.fills[4 * k]))
      differences.mark(*picture.layers[k], *old.layers[k]);
    else
      differences.mark(*picture.layers[k]), paired ? differences.mark(*old.layers[k]) : void();
  }
  return dirty;
}

// The tiles in which a picture differs from an earlier one, whose layers that lie the same it takes over.
Mask adopt(CsPicture& picture, const CsStack& stack, const CsPicture& old) {
  const Matches matches(stack, old);
  for (int i = 0; i < stack.layers; i++)
    if (matches.of[i] >= 0) picture.layers[i] = old.layers[matches.of[i]];
  trace(picture, stack);
  Mask dirty(old.tiles.size(), 0);
  Differences differences(picture, dirty);
  int first = 0, begin = 0;  // layers here and there from which on nothing has been compared
  for (int i = 0; i <= stack.layers; i++) {
    const int match = i < stack.layers ? matches.of[i] : int(old.layers.size());
    if (match < 0) continue;
    const bool paired = i - first == match - begin;
    for (int n = 0; n < i - first; n++) {
      const Trace &fresh = *picture.layers[first + n], &before = *old.layers[paired ? begin + n : 0];
      const double* fill = &picture.fills[4 * (first + n)];
      if (paired && std::equal(fill, fill + 4, &old.fills[4 * (begin + n)]))
        differences.mark(fresh, before);
      else
        differences.mark(fresh), paired ? differences.mark(before) : void();
    }
    for (int n = begin; !paired && n < match; n++) differences.mark(*old.layers[n]);
    first = i + 1, begin = match + 1;
  }
  return dirty;
}

// The layers, from the lowest on, that may cover each of some tiles.
std::vector<std::vector<int>> covering(const CsPicture& picture, const Mask& wanted) {
  std::vector<std::vector<int>> found(wanted.size());
  for (int k = 0; k < int(picture.layers.size()); k++) {
    const Trace& trace = *picture.layers[k];
    // An edge right on the border between two pixels crosses the one beyond.
    const int right = std::min(trace.right, picture.goal.width - 1),
              bottom = std::min(trace.bottom, picture.goal.height - 1);
    for (int j = trace.top / kTile; j <= bottom / kTile; j++)
      for (int i = trace.left / kTile; i <= right / kTile; i++) {
        const size_t tile = size_t(j) * picture.across() + i;
        if (wanted[tile]) found[tile].push_back(k);
      }
  }
  return found;
}

// Calls `paint(place, count, covered)` for the runs of pixels in a tile that a layer covers.
template <class Paint>
void each_run(const Trace& trace, int left, int top, Paint paint) {
  for (int row = std::max(top, trace.top); row < std::min(top + kTile, trace.bottom); row++) {
    const Span* begin = trace.spans.data() + trace.rows[row - trace.top];
    const Span* end = trace.spans.data() + trace.rows[row - trace.top + 1];
    begin = std::lower_bound(begin, end, left, [](const Span& span, int x) { return span.last <= x; });
    for (; begin < end && begin->first < left + kTile; begin++) {
      const int from = std::max(begin->first, left), to = std::min(begin->last, left + kTile);
      paint((row - top) * kTile + from - left, to - from, begin->covered);
    }
  }
}

void lay(const Trace& trace, const double* fill, int left, int top, double* colours) {
  each_run(trace, left, top, [&](int place, int count, float covered) {
    const double share = covered, passes = 1.0 - fill[3] * share;
    double add[4];
    for (int k = 0; k < 4; k++) add[k] = share * fill[k];
    for (double* p = colours + 4 * place; count > 0; count--, p += 4)
      for (int k = 0; k < 4; k++) p[k] = p[k] * passes + add[k];
  });
}

// A tile through the goal's blur, which goes on beyond the canvas as it ends.
std::shared_ptr<const Colours> blurred(const CsPicture& picture, int number) {
  const CsGoal& goal = picture.goal;
  const int r = goal.reach, side = kTile + 2 * r;
  const int left = number % picture.across() * kTile, top = number / picture.across() * kTile;
  std::vector<double> along(size_t(4) * side * kTile, 0.0);
  std::vector<const double*> row(side);
  for (int j = 0; j < side; j++) {
    const int y = std::clamp(top + j - r, 0, goal.height - 1);
    for (int i = 0; i < side; i++) {
      const Address from = picture.at(std::clamp(left + i - r, 0, goal.width - 1), y);
      row[i] = picture.tiles[from.tile]->sharp->data() + 4 * from.place;
    }
    for (int i = 0; i < kTile; i++)
      for (int d = -r; d <= r; d++)
        for (int k = 0; k < 4; k++)
          along[4 * (size_t(j) * kTile + i) + k] += goal.taps[std::abs(d)] * row[i + r + d][k];
  }
  auto out = std::make_shared<Colours>();
  out->fill(0.0);
  for (int j = 0; j < kTile; j++)
    for (int d = -r; d <= r; d++)
      for (int n = 0; n < 4 * kTile; n++)
        (*out)[size_t(4) * kTile * j + n] += goal.taps[std::abs(d)] * along[size_t(4) * kTile * (j + r + d) + n];
  return out;
}

void compare(const CsPicture& picture, int number, Tile& tile) {
  const CsGoal& goal = picture.goal;
  const int left = number % picture.across() * kTile, top = number / picture.across() * kTile;
  tile.cost = 0.0;
  for (int y = top; y < std::min(top + kTile, goal.height); y++)
    for (int x = left; x < std::min(left + kTile, goal.width); x++) {
      const int64_t pixel = int64_t(y) * goal.width + x;
      const int place = (y - top) * kTile + x - left;
      const double* colour = tile.seen->data() + 4 * place;
      double rest[4];
      tile.misfit[place] = misfit(goal, pixel, residual(goal, colour, pixel, rest));
      const double shown = leak(goal, colour, pixel);
      tile.cost += tile.misfit[place] + goal.leak_weight * shown * shown;
    }
}

// Calls `call(tile)` for the tiles that are wanted, on several threads.
template <class Call>
void each_wanted(const CsPicture& picture, const Mask& wanted, Call call) {
  std::vector<int> numbers;
  for (int n = 0; n < int(wanted.size()); n++)
    if (wanted[n]) numbers.push_back(n);
  const int64_t count = int64_t(numbers.size());
  each_index(count, worth_starting(picture.goal.threads, count, kLeastTiles), [&](int64_t n) { call(numbers[n]); });
}

void paint(CsPicture& picture, const Mask& dirty) {
  const std::vector<std::vector<int>> layers = covering(picture, dirty);
  const int across = picture.across();
  Mask stale = dirty;
  each_wanted(picture, dirty, [&](int n) {
    auto colours = std::make_shared<Colours>();
    colours->fill(0.0);
    for (const int k : layers[n])
      lay(*picture.layers[k], &picture.fills[4 * k], n % across * kTile, n / across * kTile, colours->data());
    auto tile = std::make_shared<Tile>();
    tile->sharp = tile->seen = colours;
    if (picture.goal.reach == 0) compare(picture, n, *tile);
    picture.tiles[n] = tile;
  });
  if (picture.goal.reach == 0) return;
  const int reach = (picture.goal.reach + kTile - 1) / kTile;
  for (int n = 0; n < int(dirty.size()); n++)
    for (int j = -reach; dirty[n] && j <= reach; j++)
      for (int i = -reach; i <= reach; i++) {
        const int x = n % across + i, y = n / across + j;
        if (x >= 0 && y >= 0 && x < across && y < picture.down()) stale[y * across + x] = 1;
      }
  std::vector<std::shared_ptr<const Tile>> seen(picture.tiles);
  each_wanted(picture, stale, [&](int n) {
    auto tile = std::make_shared<Tile>();
    tile->sharp = picture.tiles[n]->sharp, tile->seen = blurred(picture, n);
    compare(picture, n, *tile);
    seen[n] = tile;
  });
  picture.tiles = std::move(seen);
}

// The layers of a stack, among those of its base; those of its own are still to be traced.
void arrange(CsPicture& picture, const CsStack& stack) {
  picture.starts.assign(1, 0);
  picture.base = stack.base;
  const int below = stack.base != nullptr ? int(stack.base->layers.size()) : 0;
  const auto add = [&](std::shared_ptr<const Trace> trace, const double* fill, int32_t end) {
    picture.layers.push_back(std::move(trace));
    picture.fills.insert(picture.fills.end(), fill, fill + 4), picture.starts.push_back(end);
  };
  int next = 0;  // layer of the base
  for (int i = 0; i < stack.layers; i++) {
    for (; stack.base != nullptr && next <= stack.beneath[i]; next++)
      add(stack.base->layers[next], &stack.base->fills[4 * next], picture.starts.back());
    picture.own.push_back(int32_t(picture.layers.size()));
    add(nullptr, stack.fills + 4 * i, stack.ends[i]);
  }
  for (; next < below; next++) add(stack.base->layers[next], &stack.base->fills[4 * next], picture.starts.back());
}

CsPicture* drawn(const CsGoal& goal, const CsStack& stack, const CsPicture* previous) {
  auto picture = std::make_unique<CsPicture>();
  picture->goal = goal;
  arrange(*picture, stack);
  if (previous == nullptr) previous = stack.base;
  Mask dirty(size_t(picture->across()) * picture->down(), 1);
  if (previous != nullptr) {
    dirty = stack.base != nullptr ? adopt_over(*picture, stack, *previous) : adopt(*picture, stack, *previous);
    picture->tiles = previous->tiles;
  } else {
    trace(*picture, stack);
    picture->tiles.resize(dirty.size());
  }
  paint(*picture, dirty);
  return picture.release();
}

}  // namespace

std::vector<std::vector<double>> slopes(const CsPicture& picture, const std::vector<uint8_t>& wanted) {
  std::vector<std::vector<double>> out(picture.layers.size());
  Mask tiles(picture.tiles.size(), 0);
  for (size_t k = 0; k < out.size(); k++) {
    if (!wanted[k]) continue;
    out[k].resize(4 * picture.layers[k]->pixel.size());
    for (const int32_t tile : picture.layers[k]->tiles) tiles[tile] = 1;
  }
  const std::vector<std::vector<int>> layers = covering(picture, tiles);
  each_wanted(picture, tiles, [&](int n) {
    Colours colours;
    std::array<float, kTile * kTile> open;
    const int left = n % picture.across() * kTile, top = n / picture.across() * kTile;
    const auto crossings = [&](int layer, auto call) {
      const Trace& trace = *picture.layers[layer];
      const auto found = std::lower_bound(trace.tiles.begin(), trace.tiles.end(), n);
      if (!wanted[layer] || found == trace.tiles.end() || *found != n) return;
      const int64_t* number = &trace.tile_starts[found - trace.tiles.begin()];
      for (int64_t i = number[0]; i < number[1]; i++)
        call(&out[layer][4 * trace.by_tile[i]], trace.address[trace.by_tile[i]].place);
    };
    colours.fill(0.0), open.fill(1.0f);
    for (const int layer : layers[n]) {
      const double* fill = &picture.fills[4 * layer];
      crossings(layer, [&](double* slope, int place) {
        for (int k = 0; k < 4; k++) slope[k] = fill[k] - fill[3] * colours[4 * place + k];
      });
      lay(*picture.layers[layer], fill, left, top, colours.data());
    }
    for (size_t i = layers[n].size(); i-- > 0;) {
      const int layer = layers[n][i];
      crossings(layer, [&](double* slope, int place) {
        for (int k = 0; k < 4; k++) slope[k] *= open[place];
      });
      const float opacity = float(picture.fills[4 * layer + 3]);
      each_run(*picture.layers[layer], left, top, [&](int place, int count, float covered) {
        for (int p = place; p < place + count; p++) open[p] *= 1.0f - opacity * covered;
      });
    }
  });
  return out;
}

}  // namespace cs::stack

extern "C" {

CsPicture* cs_stack_draw(const CsGoal* goal, const CsStack* stack, const CsPicture* previous) {
  try {
    return cs::stack::drawn(*goal, *stack, previous);
  } catch (const std::bad_alloc&) {
    return nullptr;
  }
}

void cs_stack_free(CsPicture* picture) { delete picture; }
}
