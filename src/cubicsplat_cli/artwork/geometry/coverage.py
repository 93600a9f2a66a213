"""Exact coverage of pixels by shapes, by the native library.

A pixel's coverage is its area within the outlines. Cubics are cut into edges within a thousandth of a px of them.
"""

from __future__ import annotations

import ctypes
from ctypes import c_int32, c_int64, c_void_p
from functools import lru_cache

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import library


def coverage(cubics: np.ndarray, lines: np.ndarray, top: int, left: int, height: int, width: int) -> np.ndarray:
    """(height, width) float64 coverage, in [0, 1], of the pixels of a window by closed outlines.

    cubics: (S, 4, 2) px, of which some are lines (S,) bool. A loop of an outline that crosses itself is filled. Raises
    EngineError where the library or the memory is missing.
    """
    cubics, lines = np.ascontiguousarray(cubics, np.float64), np.ascontiguousarray(lines, bool)
    out = np.empty((height, width))
    _check(
        _library().cs_coverage(
            len(cubics), cubics.ctypes.data, lines.ctypes.data, left, top, width, height, out.ctypes.data
        )
    )
    return out


def _check(result: int) -> None:
    if result:
        raise EngineError("there is no memory for the shapes of the drawing; make the picture smaller")


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    lib = library()
    lib.cs_coverage.argtypes = [c_int64, c_void_p, c_void_p, *[c_int32] * 4, c_void_p]
    return lib
