"""Boundaries of masks by the native library."""

from __future__ import annotations

from ctypes import byref, c_int64, c_void_p

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import library

_ROOM = 64  # cracks beyond those around a mask's box


def traced(mask: np.ndarray) -> list[np.ndarray]:
    """The loops of cracks around a mask (H, W) bool, (n, 3) int64 x, y and direction (0 to 3: east, south, west, north)
    of each crack, the mask on its right; pixels connect along edges. In the order of the first pixels of the loops.

    Raises EngineError where the library or the memory is missing.
    """
    mask = np.ascontiguousarray(mask, dtype=bool)
    call = library().cs_trace
    call.restype = c_int64
    call.argtypes = [c_void_p, *[c_int64] * 3, *[c_void_p] * 3]
    room, count = 4 * sum(mask.shape) + _ROOM, c_int64(0)
    while True:
        cracks, ends = np.empty((room, 3), np.int64), np.empty(room, np.int64)
        loops = call(mask.ctypes.data, *mask.shape, room, cracks.ctypes.data, ends.ctypes.data, byref(count))
        if loops < 0:
            raise EngineError("there is no memory for the outlines of the drawing; make the picture smaller")
        if count.value <= room:
            return np.split(cracks[: count.value], ends[: loops - 1]) if loops else []
        room = count.value
