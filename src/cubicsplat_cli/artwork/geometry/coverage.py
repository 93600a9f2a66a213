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


def paint_labels(labels: np.ndarray, shapes: list[tuple[np.ndarray, np.ndarray]], numbers: list[int]) -> None:
    """Sets labels (H, W) uint16, in place, to the number of each shape, back to front, where that covers more than half
    of a pixel. shapes: the cubics (S, 4, 2) in px and lines (S,) bool of each. Raises EngineError where the library or
    the memory is missing.
    """
    if not shapes:
        return
    cubics = np.ascontiguousarray(np.concatenate([own for own, _ in shapes]), np.float64)
    lines = np.ascontiguousarray(np.concatenate([own for _, own in shapes]), bool)
    ends = np.cumsum([len(own) for _, own in shapes]).astype(np.int64)
    own = np.array(numbers, dtype=np.uint16)
    height, width = labels.shape
    given = (array.ctypes.data for array in (ends, own, cubics, lines))
    _check(_library().cs_paint_labels(len(shapes), *given, width, height, labels.ctypes.data))


def arrange(scores: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(n, K) an ink for each of K subpixels of n pixels, `counts` (n, P) of each, those first that would lose most by
    another one. scores: (n, K, P), more where an ink rather lies. Raises EngineError where the library is missing.
    """
    scores, counts = np.ascontiguousarray(scores, np.float64), np.ascontiguousarray(counts, np.int64)
    out = np.empty(scores.shape[:2], np.int64)
    _library().cs_arrange(*scores.shape, scores.ctypes.data, counts.ctypes.data, out.ctypes.data)
    return out


def _check(result: int) -> None:
    if result:
        raise EngineError("there is no memory for the shapes of the drawing; make the picture smaller")


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    lib = library()
    lib.cs_coverage.argtypes = [c_int64, c_void_p, c_void_p, *[c_int32] * 4, c_void_p]
    lib.cs_paint_labels.argtypes = [c_int32, *[c_void_p] * 4, c_int32, c_int32, c_void_p]
    lib.cs_arrange.argtypes, lib.cs_arrange.restype = [*[c_int64] * 3, *[c_void_p] * 3], None
    return lib
