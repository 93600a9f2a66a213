// The normal equations of the fit of a stack of shapes to a picture, through a blur where there is one.
//
// A crossing changes its own pixel, and a blur spreads that. So two crossings share as much as the blurs of their pixels
// overlap: the blur's autocorrelation at the distance between them.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <utility>
#include <vector>

#include "stack.h"
#include "stack_misfit.h"

namespace cs {
namespace {

// Gram matrices of pairs of pieces, found by their numbers.
class PiecePairs {
 public:
  explicit PiecePairs(CsEquations* out) : out_(out), known_(out->pieces) { out_->count = 0; }

  double* block(int i, int j) {
    for (const auto& [other, index] : known_[i])
      if (other == j) return index < out_->room ? out_->blocks + 64 * index : nullptr;
    const int64_t index = out_->count++;
    known_[i].push_back({j, index});
    if (index >= out_->room) return nullptr;
    out_->first[index] = i, out_->second[index] = j;
    std::fill(out_->blocks + 64 * index, out_->blocks + 64 * (index + 1), 0.0);
    return out_->blocks + 64 * index;
  }

 private:
  CsEquations* out_;
  std::vector<std::vector<std::pair<int, int64_t>>> known_;
};

// The crossings in the order of their pixels, row by row, and where those of each pixel begin.
struct ByPixel {
  std::vector<int64_t> order;
  std::vector<int32_t> starts;

  ByPixel(const CsCrossings& c, int64_t pixels) : order(c.count), starts(pixels + 1, 0) {
    for (int64_t n = 0; n < c.count; n++) starts[c.pixel[n] + 1]++;
    for (int64_t p = 0; p < pixels; p++) starts[p + 1] += starts[p];
    std::vector<int32_t> next(starts.begin(), starts.end() - 1);
    for (int64_t n = 0; n < c.count; n++) order[next[c.pixel[n]]++] = n;
  }
};

// What the misfit pulls at the pixel of each crossing, in the sharp picture (x 4), and by how much less pixels count that
// are far off.
struct Pulls {
  std::vector<double> pull, trust;

  Pulls(const CsFit& fit, const double* image, const CsCrossings& c, int width, int height)
      : pull(4 * c.count), trust(c.count) {
    if (fit.reach == 0) {
      for (int64_t n = 0; n < c.count; n++) trust[n] = pulled(fit, image, c.pixel[n], &pull[4 * n]);
      return;
    }
    const int64_t pixels = int64_t(width) * height;
    std::vector<double> all(4 * pixels), trusted(pixels);
    for (int64_t pixel = 0; pixel < pixels; pixel++) trusted[pixel] = pulled(fit, image, pixel, &all[4 * pixel]);
    blur(fit, all.data(), width, height, true);
    for (int64_t n = 0; n < c.count; n++) {
      trust[n] = trusted[c.pixel[n]];
      std::copy(&all[4 * int64_t(c.pixel[n])], &all[4 * int64_t(c.pixel[n])] + 4, &pull[4 * n]);
    }
  }

 private:
  static double pulled(const CsFit& fit, const double* image, int64_t pixel, double* pull) {
    const double size = residual(fit, image, pixel, pull);
    const double trust = size <= fit.bound ? 1.0 : fit.bound / size;
    for (int k = 0; k < 4; k++) pull[k] *= trust * fit.channels[k];
    return trust;
  }
};

// By how much the blurs of two pixels overlap that are 0, 1, ... px apart along a row or column.
std::vector<double> overlaps(const CsFit& fit) {
  if (fit.reach == 0) return {1.0};
  const auto tap = [&](int at) { return std::abs(at) <= fit.reach ? fit.taps[std::abs(at)] : 0.0; };
  std::vector<double> found;
  for (int apart = 0; apart <= 2 * fit.reach; apart++) {
    double sum = 0.0;
    for (int at = -fit.reach; at <= fit.reach; at++) sum += tap(at) * tap(at + apart);
    found.push_back(sum);
  }
  return found;
}

void add_products(const CsCrossings& c, const CsFit& fit, double weight, int64_t m, int64_t n, PiecePairs& pairs) {
  const double *a = c.change + 8 * m, *b = c.change + 8 * n;
  double alike = 0.0;
  for (int k = 0; k < 4; k++) alike += c.slope[4 * m + k] * c.slope[4 * n + k] * fit.channels[k] * fit.channels[k];
  double* block = pairs.block(c.piece[m], c.piece[n]);
  if (block == nullptr) return;
  for (int p = 0; p < 8; p++)
    for (int q = 0; q < 8; q++) block[8 * p + q] += weight * alike * a[p] * b[q];
}

void equations(const CsFit& fit, const double* image, const CsCrossings& c, CsEquations* out) {
  PiecePairs pairs(out);
  std::fill(out->gradient, out->gradient + 8 * int64_t(out->pieces), 0.0);
  const int width = out->width, height = out->height;
  const ByPixel sorted(c, int64_t(width) * height);
  const Pulls pulls(fit, image, c, width, height);
  const std::vector<double> overlap = overlaps(fit);
  const int reach = int(overlap.size()) - 1;
  for (const int64_t m : sorted.order) {
    const int64_t pixel = c.pixel[m];
    const int x = int(pixel % width), y = int(pixel / width);
    double pull = 0.0;
    for (int k = 0; k < 4; k++) pull += c.slope[4 * m + k] * pulls.pull[4 * m + k];
    for (int p = 0; p < 8; p++) out->gradient[8 * int64_t(c.piece[m]) + p] += pull * c.change[8 * m + p];
    for (int row = std::max(0, y - reach); row <= std::min(height - 1, y + reach); row++) {
      const int64_t from = int64_t(row) * width + std::max(0, x - reach);
      const int64_t to = int64_t(row) * width + std::min(width - 1, x + reach);
      for (int64_t at = sorted.starts[from]; at < sorted.starts[to + 1]; at++) {
        const int64_t n = sorted.order[at];
        if (c.piece[n] < c.piece[m]) continue;
        const double shared = overlap[std::abs(row - y)] * overlap[std::abs(int(c.pixel[n] % width) - x)];
        const double trust = std::sqrt(pulls.trust[m] * pulls.trust[n]);
        add_products(c, fit, shared * trust, m, n, pairs);
      }
    }
  }
}

}  // namespace
}  // namespace cs

extern "C" {

int32_t cs_stack_equations(const CsFit* fit, const double* image, const CsCrossings* crossings, CsEquations* out) {
  try {
    cs::equations(*fit, image, *crossings, out);
  } catch (const std::exception&) {
    return 1;
  }
  return 0;
}
}
