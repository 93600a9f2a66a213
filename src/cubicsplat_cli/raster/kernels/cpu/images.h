// The block's share of the pictures that a step reads and writes: H x W x C in memory, one vector a channel here.
#pragma once

#include "block.h"

namespace cs {
namespace CS_ISA {

// The pixels of one block that lie inside the picture.
struct Window {
  int columns, rows;
  size_t first, stride;  // in values of a picture

  Window(const TileTask& task, const Block& b) {
    const int x = task.tile_x * kTile + int(b.left), y = task.tile_y * kTile + int(b.top);
    columns = clipped(task.scene->width - x);
    rows = clipped(task.scene->height - y);
    stride = size_t(task.scene->width) * task.scene->channels;
    first = size_t(y) * stride + size_t(x) * task.scene->channels;
  }

  bool empty() const { return columns <= 0 || rows <= 0; }
  bool whole() const { return columns == kBlock && rows == kBlock; }

  // Calls visit(lane, index of the pixel's first value).
  template <int C, class Visit>
  CS_INLINE void each_pixel(Visit&& visit) const {
    for (int y = 0; y < rows; y++)
      for (int x = 0; x < columns; x++) visit(y * kBlock + x, first + y * stride + size_t(x) * C);
  }

  // 1 inside, 0 outside.
  Lanes inside() const {
    if (whole()) return Lanes(1.0f);
    const Mask m = (CS_ISA::columns() < Lanes(float(columns))) & (CS_ISA::rows() < Lanes(float(rows)));
    return select(m, Lanes(1.0f), Lanes(0.0f));
  }

  template <int C>
  CS_INLINE void load(const float* image, Lanes* planes) const {
    if (whole()) {
      const float* const at = image + first;
      const float* const rows[kBlock] = {at, at + stride, at + 2 * stride, at + 3 * stride};
      return load_pixels<C>(rows, planes);
    }
    float values[C][kLanes] = {};
    each_pixel<C>([&](int lane, size_t at) {
      for (int c = 0; c < C; c++) values[c][lane] = image[at + c];
    });
    for (int c = 0; c < C; c++) planes[c] = Lanes::load(values[c]);
  }

  // Of a picture of one channel, 0 outside.
  Lanes plane(const float* values, int channels) const {
    float lanes[kLanes] = {};
    for (int y = 0; y < rows; y++)
      for (int x = 0; x < columns; x++) lanes[y * kBlock + x] = values[(first + y * stride) / channels + x];
    return Lanes::load(lanes);
  }

  template <int C>
  CS_INLINE void store(float* image, const Lanes* planes) const {
    float values[C][kLanes];
    for (int c = 0; c < C; c++) planes[c].store(values[c]);
    each_pixel<C>([&](int lane, size_t at) {
      for (int c = 0; c < C; c++) image[at + c] = values[c][lane];
    });
  }

 private:
  static int clipped(int left) { return left < kBlock ? left : kBlock; }
};

// Asks for the next tile's row j of a picture of several channels: the rows lie far apart.
CS_INLINE void ask_for_next_row(const TileTask& task, const float* image, int j) {
  const int left = task.next_x * kTile, y = task.next_y * kTile + j;
  if (!image || y >= task.scene->height) return;
  const int columns = task.scene->width - left < kTile ? task.scene->width - left : kTile;
  const size_t first = (size_t(y) * task.scene->width + left) * task.scene->channels;
  ask_for(image + first, size_t(columns) * task.scene->channels * sizeof(float));
}

}  // namespace CS_ISA
}  // namespace cs
