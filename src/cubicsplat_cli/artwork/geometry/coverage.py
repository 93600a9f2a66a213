"""Exact coverage of pixels by shapes, by the native library.

A pixel's coverage is its area within the outlines. Cubics are cut into edges within a thousandth of a px of them.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.raster.cpu import doubles, native


def coverage(cubics: np.ndarray, lines: np.ndarray, top: int, left: int, height: int, width: int) -> np.ndarray:
    """(height, width) float64 coverage, in [0, 1], of the pixels of a window by closed outlines.

    cubics: (S, 4, 2) px, of which some are lines (S,) bool. A loop of an outline that crosses itself is filled. Raises
    EngineError where the library or the memory is missing.
    """
    out = np.empty((height, width))
    given = len(cubics), doubles(cubics), np.ascontiguousarray(lines, bool)
    native("shapes", "cs_coverage", *given, left, top, width, height, out)
    return out
