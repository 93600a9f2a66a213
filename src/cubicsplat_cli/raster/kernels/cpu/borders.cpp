// The map of the borders between regions: which touch, which enclose others, and the loops of cracks around them.
// raster/borders.py says what each function means.
#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

#include "abi.h"
#include "cracks.h"

namespace cs {
namespace {

struct Labels {
  const int32_t* of;
  int64_t height, width;
  int64_t at(int64_t x, int64_t y) const {
    return x >= 0 && y >= 0 && x < width && y < height ? of[y * width + x] : -1;
  }
};

// Two labels that touch, and how many cracks they share.
struct Pair {
  int64_t first, second, cracks;
};

// Every pair either way round, ascending.
std::vector<Pair> touching(const Labels& labels, int64_t count) {
  const auto each_crack = [&](const auto& visit) {
    for (int64_t y = 0; y < labels.height; y++) {
      const int32_t* row = labels.of + y * labels.width;
      for (int64_t x = 0; x < labels.width; x++) {
        if (x > 0 && row[x] != row[x - 1]) visit(row[x], row[x - 1]), visit(row[x - 1], row[x]);
        if (y > 0 && row[x] != row[x - labels.width])
          visit(row[x], row[x - labels.width]), visit(row[x - labels.width], row[x]);
      }
    }
  };
  std::vector<int64_t> ends(count + 1, 0);
  each_crack([&](int32_t own, int32_t) { ends[own + 1]++; });
  std::partial_sum(ends.begin(), ends.end(), ends.begin());
  std::vector<int32_t> beside(ends[count]);
  each_crack([&](int32_t own, int32_t other) { beside[ends[own]++] = other; });
  std::vector<Pair> pairs;
  for (int64_t own = 0, k = 0; own < count; own++) {
    std::sort(beside.begin() + k, beside.begin() + ends[own]);
    for (int64_t first = k; k < ends[own]; first = k) {
      while (k < ends[own] && beside[k] == beside[first]) k++;
      pairs.push_back({own, beside[first], k - first});
    }
  }
  return pairs;
}

// The innermost region that encloses each: the last one that all ways from the canvas's border lead through, by a
// depth-first search from there (J. Hopcroft and R. Tarjan, "Efficient Algorithms for Graph Manipulation", 1973).
void enclose(const Labels& labels, int64_t count, int64_t pairs, const int64_t* first, const int64_t* second,
             int32_t* around) {
  std::vector<int64_t> next(count + 1, 0), number(count, -1), earliest(count), before(count, -1), order, path;
  for (int64_t k = 0; k < pairs; k++) next[first[k] + 1]++;
  std::partial_sum(next.begin(), next.end(), next.begin());
  const std::vector<int64_t> end(next.begin() + 1, next.end());
  std::vector<uint8_t> outermost(count, 0);
  const int32_t* last = labels.of + (labels.height - 1) * labels.width;
  for (int64_t x = 0; x < labels.width; x++) outermost[labels.of[x]] = outermost[last[x]] = 1;
  for (int64_t y = 0; y < labels.height; y++)
    outermost[labels.of[y * labels.width]] = outermost[labels.of[(y + 1) * labels.width - 1]] = 1;
  const auto enter = [&](int64_t region, int64_t from) {
    number[region] = int64_t(order.size()), before[region] = from;
    earliest[region] = outermost[region] ? -1 : number[region];
    order.push_back(region), path.push_back(region);
  };
  for (int64_t root = 0; root < count; root++) {
    if (!outermost[root] || number[root] >= 0) continue;
    for (enter(root, -1); !path.empty();) {
      const int64_t region = path.back();
      if (next[region] < end[region]) {
        const int64_t other = second[next[region]++];
        if (number[other] < 0)
          enter(other, region);
        else
          earliest[region] = std::min(earliest[region], number[other]);
        continue;
      }
      path.pop_back();
      if (!path.empty()) earliest[path.back()] = std::min(earliest[path.back()], earliest[region]);
    }
  }
  // What is found below a region, and leads to nothing that was found earlier, is enclosed by it.
  for (const int64_t region : order) {
    const int64_t from = before[region];
    around[region] = from < 0 ? -1 : earliest[region] >= number[from] ? int32_t(from) : around[from];
  }
}

}  // namespace
}  // namespace cs

extern "C" {

// pairs: room x 3, the two labels and the cracks that they share. Returns the number of pairs, of which those beyond the
// room are missing; -1 where there is no memory.
CS_EXPORT int64_t cs_touching(const int32_t* labels, int64_t height, int64_t width, int64_t count, int64_t room,
                              int64_t* pairs) {
  using namespace cs;
  return counted([&] {
    const std::vector<Pair> found = touching({labels, height, width}, count);
    for (size_t k = 0; k < found.size() && int64_t(k) < room; k++)
      pairs[3 * k] = found[k].first, pairs[3 * k + 1] = found[k].second, pairs[3 * k + 2] = found[k].cracks;
    return int64_t(found.size());
  });
}

// around: of each label, by the two of every pair as of cs_touching. 1 where there is no memory, else 0.
CS_EXPORT int32_t cs_enclosing(const int32_t* labels, int64_t height, int64_t width, int64_t count, int64_t pairs,
                               const int64_t* first, const int64_t* second, int32_t* around) {
  return cs::failed([&] { cs::enclose({labels, height, width}, count, pairs, first, second, around); });
}

// cracks: x 3, x, y and direction; beside: of each; ends, owners: of the loops. There is room for all. Returns the number
// of loops; -1 where there is no memory.
CS_EXPORT int64_t cs_loops(const int32_t* labels, int64_t height, int64_t width, int64_t* cracks, int64_t* beside,
                           int64_t* ends, int64_t* owners) {
  using namespace cs;
  return counted([&] {
    const Labels map{labels, height, width};
    struct Loop {
      int64_t owner, twice, first, end;
    };
    std::vector<Loop> loops;
    std::vector<Crack> found;
    std::vector<uint8_t> seen(height * width, 0);
    for (int64_t y = 0; y < height; y++)
      for (int64_t x = 0; x < width; x++) {
        const int64_t own = map.at(x, y), first = int64_t(found.size());
        if (map.at(x, y - 1) == own || seen[y * width + x]) continue;
        follow([&](int64_t u, int64_t v) { return map.at(u, v) == own; }, x, y, width, seen, found);
        loops.push_back(
            {own, twice_enclosed(&found[first], found.data() + found.size()), first, int64_t(found.size())});
      }
    std::stable_sort(loops.begin(), loops.end(), [](const Loop& a, const Loop& b) {
      return a.owner != b.owner ? a.owner < b.owner : a.twice > b.twice;
    });
    int64_t count = 0;
    for (size_t k = 0; k < loops.size(); ends[k] = count, owners[k] = loops[k].owner, k++)
      for (int64_t n = loops[k].first; n < loops[k].end; n++, count++) {
        const Crack& c = found[n];
        cracks[3 * count] = c.x, cracks[3 * count + 1] = c.y, cracks[3 * count + 2] = c.d;
        beside[count] = map.at(c.x + kLeft[c.d][0], c.y + kLeft[c.d][1]);
      }
    return int64_t(loops.size());
  });
}

// several: (height - 1) x (width - 1), 1 where three or more labels meet at the corner of four pixels, else 0.
CS_EXPORT void cs_meeting(const int32_t* labels, int64_t height, int64_t width, uint8_t* several) {
  for (int64_t y = 0; y + 1 < height; y++)
    for (int64_t x = 0; x + 1 < width; x++) {
      const int32_t *upper = labels + y * width + x, *lower = upper + width;
      const int32_t a = upper[0], b = upper[1], c = lower[0], d = lower[1];
      *several++ = (a != b) + (c != a && c != b) + (d != a && d != b && d != c) >= 2;
    }
}
}
