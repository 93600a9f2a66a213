"""The shadows of boxes, blurred copies of them, at pixels, and their fit to what is seen, by the native library.

A box is left, top, right, bottom and the half axes of its corners, px. A layer is given by six numbers: dx, dy, px by
which it is larger and rounder, the logarithm of its blur's sigma in px, and the log-odds of its opacity. Layers
multiply what they let through, as several shadows of one card do in CSS (Backgrounds and Borders, 6.1). Functions raise
EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from ctypes import c_double
from functools import partial
from typing import Any

import numpy as np

from cubicsplat_cli.raster.cpu import bools, doubles, int64s, native
from cubicsplat_cli.record import record

_native = partial(native, "shadows")


def shadow_box(box: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """The box (6,) of a layer's shadow before it is blurred."""
    out = np.empty(6)
    _native("cs_shadow_box", doubles(box), doubles(numbers), out, result=None)
    return out


def shadow_window(box: np.ndarray, numbers: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(h, w) the share of light that layers (k, 6) leave at rows y (h,) and columns x (w,), px."""
    out = np.empty((len(y), len(x)))
    places = len(y), doubles(y), len(x), doubles(x)
    _native("cs_shadow_window", doubles(box), len(numbers), doubles(numbers), *places, out)
    return out


@record
class ShadedPixels:
    """Pixels in the shade of boxes (b, 6) that have the same layers. rows, columns: (n,); open: (b, n) bool, whether
    the shadow of a box falls on the pixel."""

    boxes: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    open: np.ndarray

    def light(self, numbers: np.ndarray) -> np.ndarray:
        """(n,) the share of light that layers (k, 6) leave each pixel."""
        out = np.ones(len(self.rows))
        _native("cs_shadow_light", *self._given(), len(numbers), doubles(numbers), out)
        return out

    def fitted(
        self, numbers: np.ndarray, seen: np.ndarray, through: np.ndarray, scale: float
    ) -> tuple[np.ndarray, float]:
        """Layers (k, 6) as near as they come, from those given, to how much each pixel is seen darkened (n,), and the
        mean square in levels^2 that is left. through: (n,) light that other shadows leave; scale: levels of a whole
        shade."""
        numbers = np.array(numbers, dtype=np.float64, order="C")
        told = doubles(seen), doubles(through), float(scale)
        left = _native("cs_fit_shadows", *self._given(), *told, len(numbers), numbers, result=c_double)
        return numbers, float(left)

    def _given(self) -> tuple[Any, ...]:
        rows, columns = (int64s(a) for a in (self.rows, self.columns))
        open_to = bools(self.open)
        return len(self.boxes), doubles(self.boxes), len(rows), rows, columns, open_to
