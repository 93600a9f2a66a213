"""Gradients fitted to pixels, and the colours that they have there, by the native library.

A gradient is given by its frame (2, 3), an affine map of px whose first coordinate is the parameter t, or whose length
is where it is radial, and by the knots (K,), ascending t, and colours (K, 4) of its stops, premultiplied levels.
Functions raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_int32, c_int64, c_void_p
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import library


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
    x, y = _doubles(x), _doubles(y)
    frame, knots, colours = _doubles(frame), _doubles(knots), _doubles(colours)
    out = np.empty((len(x), 4))
    given = (a.ctypes.data for a in (knots, colours, out))
    _library().cs_shaded(len(x), x.ctypes.data, y.ctypes.data, None, frame.ctypes.data, radial, len(knots), *given)
    return out


def colours_off(frame: np.ndarray, radial: bool, knots: np.ndarray, colours: np.ndarray, pixels: Pixels) -> np.ndarray:
    """(n, 4) what a gradient has at pixels less what these have."""
    arrays = [*map(_doubles, pixels), _doubles(frame)]
    knots, colours, out = _doubles(knots), _doubles(colours), np.empty((len(pixels.x), 4))
    given = (a.ctypes.data for a in (knots, colours, out))
    _library().cs_shaded(len(out), *(a.ctypes.data for a in arrays), radial, len(knots), *given)
    return out


def best_colours(frame: np.ndarray, radial: bool, knots: np.ndarray, pixels: Pixels) -> np.ndarray:
    """(K, 4) the colours of stops with which a gradient comes nearest to pixels, by least squares."""
    arrays, knots = [*map(_doubles, pixels), _doubles(frame)], _doubles(knots)
    out = np.empty((len(knots), 4))
    at = (a.ctypes.data for a in arrays)
    _checked(_library().cs_shade_colours(len(pixels.x), *at, radial, len(knots), knots.ctypes.data, out.ctypes.data))
    return out


def best_stops(
    frame: np.ndarray, radial: bool, pixels: Pixels, most: int, price: float
) -> tuple[np.ndarray, np.ndarray]:
    """Knots (K,) and colours (K, 4) of the stops, 2 to `most`, with which a gradient comes nearest to pixels, each more
    than two for `price` levels^2 or more."""
    arrays = [*map(_doubles, pixels), _doubles(frame)]
    knots, colours = np.empty(most), np.empty((most, 4))
    at = (a.ctypes.data for a in arrays)
    count = _library().cs_ramp(len(pixels.x), *at, radial, most, price, knots.ctypes.data, colours.ctypes.data)
    _checked(count == 0)
    return knots[:count].copy(), colours[:count].copy()


def scatter(frame: np.ndarray, radial: bool, pixels: Pixels) -> float:
    """The mean square, levels^2, by which pixels differ from those that have about the same t."""
    arrays = [*map(_doubles, pixels), _doubles(frame)]
    found = float(_library().cs_scatter(len(pixels.x), *(a.ctypes.data for a in arrays), radial))
    _checked(found < 0)
    return found


def fitted(
    frame: np.ndarray, parameters: int, knots: np.ndarray, colours: np.ndarray, pixels: Pixels
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The frame, knots and colours of a gradient brought as near to pixels as they come, outliers counting little, by
    Levenberg's and Marquardt's method.

    parameters: of its geometry, 2 of a line, whose direction is free, 3 of a circle and 5 of an ellipse, of which the
    middle is, and of this one the shape.
    """
    arrays = [_doubles(array) for array in pixels]
    frame, knots, colours = (np.array(a, dtype=np.float64, order="C") for a in (frame, knots, colours))
    at = (a.ctypes.data for a in (*arrays, frame))
    given = parameters, len(knots), knots.ctypes.data, colours.ctypes.data
    _checked(_library().cs_fit_shade(len(pixels.x), *at, *given))
    return frame, knots, colours


def slopes(pixels: Pixels, size: int, fewest: int) -> tuple[np.ndarray, np.ndarray]:
    """Middles (b, 2), px, of blocks of size x size px, at least `fewest` of them in the pixels, and how colours change
    there (b, 4, 2), levels per px times the root of the pixels, so that each block counts as its errors allow."""
    arrays, room = [_doubles(array) for array in pixels], len(pixels.x) // fewest
    middles, found = np.empty((room, 2)), np.empty((room, 4, 2))
    at = (a.ctypes.data for a in arrays)
    call = _library().cs_slopes
    count = int(call(len(pixels.x), *at, size, fewest, room, middles.ctypes.data, found.ctypes.data))
    _checked(count < 0)
    return middles[:count], found[:count]


def _checked(failed: bool) -> None:
    if failed:
        raise EngineError("there is no memory for the gradients of the drawing; make the picture smaller")


def _doubles(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=np.float64)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    lib = library()
    pixels: list[type[c_int64 | c_void_p]] = [c_int64, *[c_void_p] * 3]
    lib.cs_shaded.restype = None
    lib.cs_shaded.argtypes = [*pixels, c_void_p, c_int32, c_int32, *[c_void_p] * 3]
    lib.cs_shade_colours.argtypes = [*pixels, c_void_p, c_int32, c_int32, *[c_void_p] * 2]
    lib.cs_ramp.argtypes = [*pixels, c_void_p, c_int32, c_int32, c_double, *[c_void_p] * 2]
    lib.cs_scatter.argtypes, lib.cs_scatter.restype = [*pixels, c_void_p, c_int32], c_double
    lib.cs_fit_shade.argtypes = [*pixels, c_void_p, c_int32, c_int32, *[c_void_p] * 2]
    lib.cs_slopes.argtypes, lib.cs_slopes.restype = [*pixels, *[c_int64] * 3, *[c_void_p] * 2], c_int64
    return lib
