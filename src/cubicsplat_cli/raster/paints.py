"""Areas of evenly changing colours, and the paints that edges blend, by the native library.

Pictures are (H, W, 4), premultiplied levels. Functions raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from ctypes import c_double
from functools import partial

import numpy as np

from cubicsplat_cli.raster.cpu import doubles, floats, int32s, int64s, native

_native = partial(native, "gradients")


def bends_and_steps(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each pixel (H, W) float32 the greatest second difference, in levels, of all channels and four directions, and
    the greatest difference between opposite neighbours. Beyond its border a picture goes on as straight as it ends."""
    levels = floats(levels)
    height, width = levels.shape[:2]
    bends, steps = (np.empty((height, width), np.float32) for _ in range(2))
    _native("cs_bends", height, width, levels, bends, steps)
    return bends, steps


def part_spreads(levels: np.ndarray, parts: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of parts 1 to `count` of a picture: pixels (count,), boxes (count, 4) as first and last row and column, and
    levels (count,) between the least and the greatest value of the widest channel. parts: (H, W) int32."""
    levels = floats(levels)
    parts = int32s(parts)
    sizes, boxes, spreads = np.empty(count, np.int64), np.empty((count, 4), np.int64), np.empty(count, np.float32)
    _native("cs_part_spreads", *parts.shape, levels, parts, count, sizes, boxes, spreads, result=None)
    return sizes, boxes, spreads


def trimmed_range(values: np.ndarray, share: float) -> float:
    """Levels, to a sixteenth, between which all of values (n, 4), n >= 1, lie but a share at either end, of the widest
    channel."""
    return float(_native("cs_trimmed_range", len(values), doubles(values), float(share), result=c_double))


def nearest_paints(paint: np.ndarray, pixels: np.ndarray, reach: int, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """The different paints at least 0 of a map (H, W) int32 nearest to pixels (n,), numbers in reading order, within
    `reach` px to all sides: (n, slots) int32, -1 where there are fewer, and the pixels (n, slots) where they are."""
    paint, pixels = int32s(paint), int64s(pixels)
    found, places = np.empty((len(pixels), slots), np.int32), np.empty((len(pixels), slots), np.int64)
    _native("cs_near", paint, *paint.shape, len(pixels), pixels, reach, slots, found, places)
    return found, places


def blends(
    values: np.ndarray, paints: np.ndarray, colours: np.ndarray, others: np.ndarray, three: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Values (n, 4) as blends of two of their paints (n, slots), or where `three` of three, by least squares: what they
    are (n, 4) with other colours in the paints' place, and the levels (n,) that no blend explains, infinite where there
    are no paints. paints: nearest first, which are preferred, -1 for none; colours, others: (n, slots, 4)."""
    values, colours, others = doubles(values), doubles(colours), doubles(others)
    paints = int32s(paints)
    flat, left = np.empty_like(values), np.empty(len(values))
    _native("cs_blends", *paints.shape, values, paints, colours, others, three, flat, left, result=None)
    return flat, left
