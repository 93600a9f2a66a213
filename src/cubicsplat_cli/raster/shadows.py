"""The shadows of boxes, blurred copies of them, at pixels, and their fit to darkened pixels, by the native library.

A box is left, top, right, bottom and the half axes of its corners, px. A layer is given by six numbers: dx, dy, px by
which it is larger and rounder, the logarithm of its blur's sigma in px, and the log-odds of its opacity. The light that
several layers let through multiplies, as that of several shadows of one card in CSS (Backgrounds and Borders, 6.1).
Functions raise EngineError if the library or the memory is missing.
"""

from __future__ import annotations

from ctypes import c_double
from functools import partial
from typing import Any

import numpy as np

from cubicsplat_cli.raster.native import Out, bools, doubles, int64s, native
from cubicsplat_cli.record import record

_native = partial(native, "shadows")


def shadow_box(box: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return the box (6,) of a layer's shadow before it is blurred."""
    return _native("cs_shadow_box", doubles(box), doubles(numbers), Out(6), result=None)


def shadow_window(box: np.ndarray, numbers: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (h, w): the share of light that layers (k, 6) leave at rows y (h,) and columns x (w,), px."""
    places = len(y), doubles(y), len(x), doubles(x)
    return _native("cs_shadow_window", doubles(box), len(numbers), doubles(numbers), *places, Out((len(y), len(x))))


@record
class ShadedPixels:
    """Pixels in the shade of boxes (b, 6) that have the same layers. rows, columns: (n,); open: (b, n) bool, true if
    the shadow of a box falls on the pixel."""

    boxes: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    open: np.ndarray

    def light(self, numbers: np.ndarray) -> np.ndarray:
        """Return (n,): the share of light that layers (k, 6) leave each pixel."""
        out = np.ones(len(self.rows))
        _native("cs_shadow_light", *self._given(), len(numbers), doubles(numbers), out)
        return out

    def fitted(
        self, numbers: np.ndarray, seen: np.ndarray, through: np.ndarray, scale: float
    ) -> tuple[np.ndarray, float]:
        """Fit layers (k, 6) to how much each pixel is darkened: seen (n,). Return them, and the mean square in levels^2
        that remains. numbers: to start from; through: (n,) light that other shadows leave; scale: levels of a whole
        shade."""
        numbers = np.array(numbers, dtype=np.float64, order="C")
        given = *self._given(), doubles(seen), doubles(through), float(scale), len(numbers), numbers
        return numbers, _native("cs_fit_shadows", *given, result=c_double)

    def _given(self) -> tuple[Any, ...]:
        pixels = len(self.rows), int64s(self.rows), int64s(self.columns), bools(self.open)
        return len(self.boxes), doubles(self.boxes), *pixels
