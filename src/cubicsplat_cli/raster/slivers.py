"""The gradient of the penalty on slivers, by the native library."""

from __future__ import annotations

from ctypes import c_float, c_int32, c_void_p

import numpy as np

from cubicsplat_cli.raster.cpu import library


def slivers(
    points: np.ndarray,
    ring_ends: np.ndarray | None,
    edges: int,
    thinnest: float,
    opposite: float,
    size: tuple[int, int],
) -> np.ndarray:
    """(N, 3M, 2) float32 for closed curves of as many points, px, with weight 1: see `photo.slivers`.

    edges: of a segment. thinnest: px. opposite: the cosine below which two edges are two sides. size:
    width and height of the canvas, px. ring_ends: as in `Scene`. Raises EngineError where the library is missing.
    """
    points = np.ascontiguousarray(points, np.float32)
    ends = None if ring_ends is None else np.ascontiguousarray(ring_ends, np.int32)
    found = np.empty_like(points)
    call = library().cs_slivers
    call.restype = None
    call.argtypes = [c_void_p, c_int32, c_int32, c_void_p, c_int32, c_int32, *[c_float] * 4, c_void_p]
    call(
        points.ctypes.data, points.shape[0], points.shape[1] // 3, None if ends is None else ends.ctypes.data,
        0 if ends is None else ends.shape[1], edges, thinnest, opposite, *size, found.ctypes.data,
    )  # fmt: skip
    return found
