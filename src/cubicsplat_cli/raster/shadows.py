"""The shadows of boxes, blurred copies of them, at pixels, and their fit to what is seen, by the native library.

A box is left, top, right, bottom and the half axes of its corners, px. A layer is given by six numbers: dx, dy, px by
which it is larger and rounder, the logarithm of its blur's sigma in px, and the log-odds of its opacity. Layers
multiply what they let through, as several shadows of one card do in CSS (Backgrounds and Borders, 6.1). Functions raise
EngineError where the library or the memory is missing.
"""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_int32, c_int64, c_void_p
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import library


def shadow_box(box: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """The box (6,) of a layer's shadow before it is blurred."""
    box, numbers, out = _doubles(box), _doubles(numbers), np.empty(6)
    _library().cs_shadow_box(box.ctypes.data, numbers.ctypes.data, out.ctypes.data)
    return out


def shadow_window(box: np.ndarray, numbers: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(h, w) the share of light that layers (k, 6) leave at rows y (h,) and columns x (w,), px."""
    box, numbers, x, y = _doubles(box), _doubles(numbers), _doubles(x), _doubles(y)
    out = np.empty((len(y), len(x)))
    given = len(y), y.ctypes.data, len(x), x.ctypes.data, out.ctypes.data
    _checked(_library().cs_shadow_window(box.ctypes.data, len(numbers), numbers.ctypes.data, *given))
    return out


@dataclass(frozen=True)
class ShadedPixels:
    """Pixels in the shade of boxes (b, 6) that have the same layers. rows, columns: (n,); open: (b, n) bool, whether
    the shadow of a box falls on the pixel."""

    boxes: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    open: np.ndarray

    def light(self, numbers: np.ndarray) -> np.ndarray:
        """(n,) the share of light that layers (k, 6) leave each pixel."""
        numbers, out, given = _doubles(numbers), np.ones(len(self.rows)), self._given()
        at = self._at(given)
        _checked(_library().cs_shadow_light(*at, len(numbers), numbers.ctypes.data, out.ctypes.data))
        return out

    def fitted(
        self, numbers: np.ndarray, seen: np.ndarray, through: np.ndarray, scale: float
    ) -> tuple[np.ndarray, float]:
        """Layers (k, 6) as near as they come, from those given, to how much each pixel is seen darkened (n,), and the
        mean square in levels^2 that is left. through: (n,) light that other shadows leave; scale: levels of a whole
        shade."""
        numbers, given = np.array(numbers, dtype=np.float64, order="C"), self._given()
        seen, through = _doubles(seen), _doubles(through)
        told = seen.ctypes.data, through.ctypes.data, scale
        left = float(_library().cs_fit_shadows(*self._at(given), *told, len(numbers), numbers.ctypes.data))
        _checked(left < 0)
        return numbers, left

    def _given(self) -> tuple[np.ndarray, ...]:
        rows, columns = (np.ascontiguousarray(a, dtype=np.int64) for a in (self.rows, self.columns))
        return _doubles(self.boxes), rows, columns, np.ascontiguousarray(self.open, dtype=bool)

    def _at(self, given: tuple[np.ndarray, ...]) -> tuple[int, ...]:
        boxes, *pixels = (array.ctypes.data for array in given)
        return len(self.boxes), boxes, len(self.rows), *pixels


def _checked(failed: bool) -> None:
    if failed:
        raise EngineError("there is no memory for the shadows of the drawing; make the picture smaller")


def _doubles(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=np.float64)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    lib = library()
    pixels: list[type[c_int32 | c_int64 | c_void_p]] = [c_int32, c_void_p, c_int64, *[c_void_p] * 3]
    lib.cs_shadow_box.restype, lib.cs_shadow_box.argtypes = None, [c_void_p] * 3
    lib.cs_shadow_window.argtypes = [c_void_p, c_int32, c_void_p, c_int64, c_void_p, c_int64, c_void_p, c_void_p]
    lib.cs_shadow_light.argtypes = [*pixels, c_int32, c_void_p, c_void_p]
    lib.cs_fit_shadows.argtypes = [*pixels, c_void_p, c_void_p, c_double, c_int32, c_void_p]
    lib.cs_fit_shadows.restype = c_double
    return lib
