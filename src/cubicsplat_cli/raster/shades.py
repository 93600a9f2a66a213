"""Areas of evenly changing colours, gradients fitted to them, the paints that edges blend, and the shadows of boxes, by
the native library.

A gradient is given by its frame (2, 4), and by the knots (K,), ascending t, and colours (K, 4) of its stops,
premultiplied levels. The frame's first three columns are an affine map of px to u, its last is the lean m. A linear
gradient has t = u[0], a radial one t = |u| + m . u: ellipses around the middle if m is 0, and otherwise the ellipses of
an SVG gradient whose focus is the place with u = 0 (conics with a common focus; |m| < 1 is how far the focus is on its
way from the middle to the rim). Pictures are (H, W, 4), premultiplied levels.

The shadow of a box is a blurred copy of it. A box is left, top, right, bottom and the half axes of its corners, px. A
layer is given by six numbers: dx, dy, px by which it is larger and rounder, the logarithm of its blur's sigma in px,
and the log-odds of its opacity. The light that several layers let through multiplies, as that of several shadows of one
card in CSS (Backgrounds and Borders, 6.1).
"""

from __future__ import annotations

from ctypes import c_double, c_int64
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cubicsplat_cli.raster.native import Out, bools, doubles, floats, int32s, int64s, native
from cubicsplat_cli.record import record

GradientArrays = tuple[np.ndarray, bool, np.ndarray, np.ndarray]  # frame, whether it is radial, knots, colours
ON_EDGE, IN_LARGE = 1, 2  # kinds of pixels: on an edge, and in a large part of one colour

_native, _shadows = partial(native, "gradients"), partial(native, "shadows")


class Pixels(NamedTuple):
    """x, y: (n,) px, n >= 1; values: (n, 4) premultiplied levels."""

    x: np.ndarray
    y: np.ndarray
    values: np.ndarray

    def some(self, index: np.ndarray) -> Pixels:
        """Return the pixels of an index or a mask."""
        return Pixels(self.x[index], self.y[index], self.values[index])

    @property
    def given(self) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        """Their number and the fields, as the library takes them."""
        return len(self.x), doubles(self.x), doubles(self.y), doubles(self.values)


def colours_at(gradient: GradientArrays, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the colours (n, 4) of a gradient at places x, y (n,)."""
    given = len(x), doubles(x), doubles(y), None, *_given(gradient)
    return _native("cs_shaded", *given, Out((len(x), 4)), result=None)


def colours_off(gradient: GradientArrays, pixels: Pixels) -> np.ndarray:
    """Return the colours (n, 4) of a gradient at pixels less those of the pixels."""
    return _native("cs_shaded", *pixels.given, *_given(gradient), Out((len(pixels.x), 4)), result=None)


def misfits(gradient: GradientArrays, pixels: Pixels, ends: np.ndarray, space: np.ndarray) -> np.ndarray:
    """Return the sums (g,) of the squares of the colours of a gradient less those of groups of pixels, of which each
    ends at ends (g,) int64, in a space: rows of RGBA times a matrix (4, 4)."""
    groups = doubles(space), len(ends), int64s(ends)
    return _native("cs_shade_misfits", *pixels.given, *_given(gradient), *groups, Out(len(ends)), result=None)


def reach(gradient: GradientArrays, pixels: Pixels) -> tuple[np.ndarray, np.ndarray]:
    """Return (2,) the least and greatest t of pixels; and (2, 2) for the first stop and the last one the sums of the
    squared differences of the pixels beyond it from its colour, and from the ramp carried on."""
    return _native("cs_shade_reach", *pixels.given, *_given(gradient), Out(2), Out((2, 2)), result=None)


def best_colours(frame: np.ndarray, radial: bool, knots: np.ndarray, pixels: Pixels) -> np.ndarray:
    """Return the colours (K, 4) of stops with which a gradient comes nearest to pixels, by least squares."""
    given = *pixels.given, _map(frame), radial, len(knots), doubles(knots)
    return _native("cs_shade_colours", *given, Out((len(knots), 4)))


def best_stops(
    frame: np.ndarray, radial: bool, pixels: Pixels, most: int, price: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the knots (K,) and colours (K, 4) of the stops, 2 to `most`, with which a gradient comes nearest to
    pixels. Each stop after the second gains `price` levels^2 or more."""
    given = *pixels.given, _map(frame), radial, most, float(price)
    return _native("cs_ramp", *given, Out(most), Out((most, 4)), result=c_int64)


def scatter(frame: np.ndarray, radial: bool, pixels: Pixels) -> float:
    """Return the mean square, levels^2, of the differences of pixels from other pixels with about the same t."""
    return _native("cs_scatter", *pixels.given, _map(frame), radial, result=c_double)


def fitted(
    frame: np.ndarray, parameters: int, knots: np.ndarray, colours: np.ndarray, pixels: Pixels
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the frame, knots and colours of a gradient brought as near to pixels as possible by Levenberg's and
    Marquardt's method; outliers count little.

    parameters: the number that its geometry has: 2 of a line, with a free direction; 3 of a circle, with a free middle;
    5 of an ellipse, with a free middle and shape; and 7 of an ellipse with a focus, whose lean is free too.
    """
    frame, knots, colours = (np.array(a, dtype=np.float64, order="C") for a in (_map(frame), knots, colours))
    _native("cs_fit_shade", *pixels.given, frame, parameters, len(knots), knots, colours)
    return frame, knots, colours


def slopes(pixels: Pixels, size: int, fewest: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Measure blocks of size x size px with at least `fewest` of the pixels. Return their middles (b, 2), px; the
    changes of colour there (b, 4, 2), levels per px times the block's weight, so that it counts as its errors allow;
    mean values (b, 4); and the weights (b,), roots of the pixels times their spread in px^2."""
    room = len(pixels.x) // fewest
    out = Out((room, 2)), Out((room, 4, 2)), Out((room, 4)), Out(room)
    return _native("cs_slopes", *pixels.given, size, fewest, room, *out, result=c_int64)


def grown(
    levels: np.ndarray, kinds: np.ndarray, gradient: GradientArrays, inside: np.ndarray, off: float,
    edges: tuple[float, float, np.ndarray, np.ndarray], *, on: bool,
) -> np.ndarray:  # fmt: skip
    """Grow an area, inside (H, W) bool, in place and return it: by connected pixels of a picture (H, W, 4) within 5 px
    that a gradient explains. on: again and again as long as it grows, but into pixels IN_LARGE only the first time.

    kinds: (H, W) uint8, ON_EDGE, IN_LARGE or 0. off: levels by which a channel may differ. edges: how pixels ON_EDGE
    may differ too: the most levels in a space, the most of the mean of such pixels in a window of 5 px in another one,
    and the matrices (4, 4) that take rows of RGBA to these spaces.
    """
    unlike, mean, space, means = edges
    given = *kinds.shape, floats(levels), kinds, *_given(gradient)
    tolerance = float(off), float(unlike), float(mean), doubles(space), doubles(means)
    _native("cs_grow_shade", *given, *tolerance, on, inside)
    return inside


def _given(gradient: GradientArrays) -> tuple[Any, ...]:
    """Return a gradient as the library takes it."""
    frame, radial, knots, colours = gradient
    return _map(frame), radial, len(knots), doubles(knots), doubles(colours)


def _map(frame: np.ndarray) -> np.ndarray:
    if frame.shape != (2, 4):
        raise ValueError(f"frame must have shape (2, 4), not {frame.shape}")
    return doubles(frame)


def bends_and_steps(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two (H, W) float32: the greatest second difference at each pixel, in levels, of all channels and four
    directions; and the greatest difference of opposite neighbours. Beyond its border a picture goes on straight."""
    size = levels.shape[:2]
    return _native("cs_bends", *size, floats(levels), Out(size, np.float32), Out(size, np.float32))


def part_spreads(levels: np.ndarray, parts: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measure parts 1 to `count` of a picture, parts (H, W) int32. Return their pixels (count,), boxes (count, 4) as
    first and last row and column, and levels (count,) between the least and greatest value of the widest channel."""
    out = Out(count, np.int64), Out((count, 4), np.int64), Out(count, np.float32)
    return _native("cs_part_spreads", *parts.shape, floats(levels), int32s(parts), count, *out, result=None)


def trimmed_range(values: np.ndarray, share: float) -> float:
    """Return the levels, to a sixteenth, between which all of values (n, 4), n >= 1, lie but a share at either end, in
    the widest channel."""
    return _native("cs_trimmed_range", len(values), doubles(values), float(share), result=c_double)


def nearest_paints(paint: np.ndarray, pixels: np.ndarray, reach: int, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the different paints >= 0 of a map (H, W) int32 nearest to pixels (n,), numbers in reading order, within
    `reach` px to all sides: (n, slots) int32, -1 in slots that are left, and the pixels (n, slots) that have them."""
    shape = len(pixels), slots
    given = int32s(paint), *paint.shape, len(pixels), int64s(pixels), reach, slots
    return _native("cs_near", *given, Out(shape, np.int32), Out(shape, np.int64))


def blends(
    values: np.ndarray, paints: np.ndarray, colours: np.ndarray, others: np.ndarray, three: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Explain values (n, 4) as blends of two of their paints (n, slots), or if `three` of three, by least squares.
    Return the blends (n, 4) with other colours in place of the paints', and the levels (n,) that no blend explains, inf
    without paints. paints: in order of preference, the nearest first, -1 for none; colours, others: (n, slots, 4)."""
    given = doubles(values), int32s(paints), doubles(colours), doubles(others), three
    return _native("cs_blends", *paints.shape, *given, Out(values.shape), Out(len(values)), result=None)


def shadow_box(box: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return the box (6,) of a layer's shadow before it is blurred."""
    return _shadows("cs_shadow_box", doubles(box), doubles(numbers), Out(6), result=None)


def shadow_window(box: np.ndarray, numbers: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (h, w): the share of light that layers (k, 6) leave at rows y (h,) and columns x (w,), px."""
    places = len(y), doubles(y), len(x), doubles(x)
    return _shadows("cs_shadow_window", doubles(box), len(numbers), doubles(numbers), *places, Out((len(y), len(x))))


@record
class ShadowSamples:
    """Samples of the shadows of boxes (b, 6) with the same layers. rows, columns: (n,) of the pixels; open: (b, n)
    bool, true if the shadow of a box falls on the pixel; seen: (n,) how much each is darkened; through: (n,) light that
    other shadows leave it; scale: levels of full shade."""

    boxes: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    open: np.ndarray
    seen: np.ndarray
    through: np.ndarray
    scale: float

    def every(self, few: int) -> ShadowSamples:
        """Return one sample of so many."""
        places = self.rows[::few], self.columns[::few], self.open[:, ::few]
        return ShadowSamples(self.boxes, *places, self.seen[::few], self.through[::few], self.scale)

    def light(self, numbers: np.ndarray) -> np.ndarray:
        """Return (n,): the share of light that layers (k, 6) leave each pixel."""
        out = np.ones(len(self.rows))
        _shadows("cs_shadow_light", *self._given(), len(numbers), doubles(numbers), out)
        return out

    def fitted(self, numbers: np.ndarray) -> tuple[np.ndarray, float]:
        """Return layers (k, 6) fitted to the samples, from `numbers` on, and the mean square, in levels^2, left."""
        numbers = np.array(numbers, dtype=np.float64, order="C")
        seen = doubles(self.seen), doubles(self.through), float(self.scale)
        return numbers, _shadows("cs_fit_shadows", *self._given(), *seen, len(numbers), numbers, result=c_double)

    def _given(self) -> tuple[Any, ...]:
        pixels = len(self.rows), int64s(self.rows), int64s(self.columns), bools(self.open)
        return len(self.boxes), doubles(self.boxes), *pixels
