"""Gradients fitted to pixels, and the colours that they have there, by the native library.

A gradient is given by its frame (2, 3), an affine map of px whose first coordinate is the parameter t, or whose length
is where it is radial, and by the knots (K,), ascending t, and colours (K, 4) of its stops, premultiplied levels.
Functions raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from ctypes import c_double, c_int64
from functools import partial
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.raster.cpu import doubles, native

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
    given = len(x), doubles(x), doubles(y), None, doubles(frame), radial, len(knots), doubles(knots), doubles(colours)
    out = np.empty((len(x), 4))
    _native("cs_shaded", *given, out, result=None)
    return out


def colours_off(frame: np.ndarray, radial: bool, knots: np.ndarray, colours: np.ndarray, pixels: Pixels) -> np.ndarray:
    """(n, 4) what a gradient has at pixels less what these have."""
    out = np.empty((len(pixels.x), 4))
    stops = len(knots), doubles(knots), doubles(colours)
    _native("cs_shaded", *_given(pixels), doubles(frame), radial, *stops, out, result=None)
    return out


def best_colours(frame: np.ndarray, radial: bool, knots: np.ndarray, pixels: Pixels) -> np.ndarray:
    """(K, 4) the colours of stops with which a gradient comes nearest to pixels, by least squares."""
    out = np.empty((len(knots), 4))
    _native("cs_shade_colours", *_given(pixels), doubles(frame), radial, len(knots), doubles(knots), out)
    return out


def best_stops(
    frame: np.ndarray, radial: bool, pixels: Pixels, most: int, price: float
) -> tuple[np.ndarray, np.ndarray]:
    """Knots (K,) and colours (K, 4) of the stops, 2 to `most`, with which a gradient comes nearest to pixels, each more
    than two for `price` levels^2 or more."""
    knots, colours = np.empty(most), np.empty((most, 4))
    given = doubles(frame), radial, most, float(price), knots, colours
    count = _native("cs_ramp", *_given(pixels), *given, result=c_int64)
    return knots[:count].copy(), colours[:count].copy()


def scatter(frame: np.ndarray, radial: bool, pixels: Pixels) -> float:
    """The mean square, levels^2, by which pixels differ from those that have about the same t."""
    return float(_native("cs_scatter", *_given(pixels), doubles(frame), radial, result=c_double))


def fitted(
    frame: np.ndarray, parameters: int, knots: np.ndarray, colours: np.ndarray, pixels: Pixels
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The frame, knots and colours of a gradient brought as near to pixels as they come, outliers counting little, by
    Levenberg's and Marquardt's method.

    parameters: of its geometry, 2 of a line, whose direction is free, 3 of a circle and 5 of an ellipse, of which the
    middle is, and of this one the shape.
    """
    frame, knots, colours = (np.array(a, dtype=np.float64, order="C") for a in (frame, knots, colours))
    _native("cs_fit_shade", *_given(pixels), frame, parameters, len(knots), knots, colours)
    return frame, knots, colours


def slopes(pixels: Pixels, size: int, fewest: int) -> tuple[np.ndarray, np.ndarray]:
    """Middles (b, 2), px, of blocks of size x size px, at least `fewest` of them in the pixels, and how colours change
    there (b, 4, 2), levels per px times the root of the pixels, so that each block counts as its errors allow."""
    room = len(pixels.x) // fewest
    middles, found = np.empty((room, 2)), np.empty((room, 4, 2))
    count = _native("cs_slopes", *_given(pixels), size, fewest, room, middles, found, result=c_int64)
    return middles[:count], found[:count]


def _given(pixels: Pixels) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    return len(pixels.x), doubles(pixels.x), doubles(pixels.y), doubles(pixels.values)
