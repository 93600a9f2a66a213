"""Areas of evenly changing colours, gradients fitted to them, and the paints that edges blend, by the native library.

A gradient is given by its frame (2, 4), and by the knots (K,), ascending t, and colours (K, 4) of its stops,
premultiplied levels. The frame's first three columns are an affine map of px to u, its last is the lean m. A linear
gradient has t = u[0], a radial one t = |u| + m . u: ellipses around the middle where m is 0, and otherwise those of an
SVG gradient whose focus is where u is 0 (conics with a common focus; |m| < 1 is how far the focus is on its way from
the middle to the rim).
Pictures are (H, W, 4), premultiplied levels. Functions raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from ctypes import c_double, c_int64
from functools import partial
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.raster.cpu import doubles, floats, int32s, int64s, native

_native = partial(native, "gradients")


class Pixels(NamedTuple):
    """x, y: (n,) px, n >= 1; values: (n, 4) premultiplied levels."""

    x: np.ndarray
    y: np.ndarray
    values: np.ndarray

    def some(self, index: np.ndarray) -> Pixels:
        """Those of an index or a mask."""
        return Pixels(self.x[index], self.y[index], self.values[index])


def colours_at(
    frame: np.ndarray, radial: bool, knots: np.ndarray, colours: np.ndarray, x: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """(n, 4) what a gradient has at places x, y (n,)."""
    given = len(x), doubles(x), doubles(y), None, _map(frame), radial, len(knots), doubles(knots), doubles(colours)
    out = np.empty((len(x), 4))
    _native("cs_shaded", *given, out, result=None)
    return out


def colours_off(frame: np.ndarray, radial: bool, knots: np.ndarray, colours: np.ndarray, pixels: Pixels) -> np.ndarray:
    """(n, 4) what a gradient has at pixels less what these have."""
    out = np.empty((len(pixels.x), 4))
    stops = len(knots), doubles(knots), doubles(colours)
    _native("cs_shaded", *_given(pixels), _map(frame), radial, *stops, out, result=None)
    return out


def best_colours(frame: np.ndarray, radial: bool, knots: np.ndarray, pixels: Pixels) -> np.ndarray:
    """(K, 4) the colours of stops with which a gradient comes nearest to pixels, by least squares."""
    out = np.empty((len(knots), 4))
    _native("cs_shade_colours", *_given(pixels), _map(frame), radial, len(knots), doubles(knots), out)
    return out


def best_stops(
    frame: np.ndarray, radial: bool, pixels: Pixels, most: int, price: float
) -> tuple[np.ndarray, np.ndarray]:
    """Knots (K,) and colours (K, 4) of the stops, 2 to `most`, with which a gradient comes nearest to pixels, each more
    than two for `price` levels^2 or more."""
    knots, colours = np.empty(most), np.empty((most, 4))
    given = _map(frame), radial, most, float(price), knots, colours
    count = _native("cs_ramp", *_given(pixels), *given, result=c_int64)
    return knots[:count].copy(), colours[:count].copy()


def scatter(frame: np.ndarray, radial: bool, pixels: Pixels) -> float:
    """The mean square, levels^2, by which pixels differ from those that have about the same t."""
    return float(_native("cs_scatter", *_given(pixels), _map(frame), radial, result=c_double))


def fitted(
    frame: np.ndarray, parameters: int, knots: np.ndarray, colours: np.ndarray, pixels: Pixels
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The frame, knots and colours of a gradient brought as near to pixels as they come, outliers counting little, by
    Levenberg's and Marquardt's method.

    parameters: of its geometry, 2 of a line, whose direction is free, 3 of a circle and 5 of an ellipse, of which the
    middle is, and of this one the shape, and 7 of an ellipse with a focus, of which the lean is too.
    """
    frame, knots, colours = (np.array(a, dtype=np.float64, order="C") for a in (_map(frame), knots, colours))
    _native("cs_fit_shade", *_given(pixels), frame, parameters, len(knots), knots, colours)
    return frame, knots, colours


def slopes(pixels: Pixels, size: int, fewest: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of blocks of size x size px, at least `fewest` of them in the pixels: middles (b, 2), px; how colours change
    there (b, 4, 2), levels per px times the block's weight, so that it counts as its errors allow; mean values (b, 4);
    and the weights (b,), roots of the pixels times their spread in px^2."""
    room = len(pixels.x) // fewest
    out = np.empty((room, 2)), np.empty((room, 4, 2)), np.empty((room, 4)), np.empty(room)
    count = _native("cs_slopes", *_given(pixels), size, fewest, room, *out, result=c_int64)
    middles, changes, means, weights = (array[:count] for array in out)
    return middles, changes, means, weights


def _map(frame: np.ndarray) -> np.ndarray:
    if frame.shape != (2, 4):
        raise ValueError(f"frame must have shape (2, 4), not {frame.shape}")
    return doubles(frame)


def _given(pixels: Pixels) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    return len(pixels.x), doubles(pixels.x), doubles(pixels.y), doubles(pixels.values)


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
