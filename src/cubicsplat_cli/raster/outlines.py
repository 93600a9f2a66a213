"""Boundaries of masks, local fits along chains of points, and primitives fitted to points, by the native library."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import byref, c_double, c_int32, c_int64, c_void_p
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import library

CIRCLE, ELLIPSE, BOX = 0, 1, 2
_NO_MEMORY = "there is no memory for the outlines of the drawing; make the picture smaller"
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
            raise EngineError(_NO_MEMORY)
        if count.value <= room:
            return np.split(cracks[: count.value], ends[: loops - 1]) if loops else []
        room = count.value


def kept_points(points: np.ndarray, tolerance: float) -> np.ndarray:
    """(n,) bool: the points (n, 2) of a chain, n >= 1, between which no other is more than `tolerance` off the straight
    line, the first and the last among them. Raises EngineError where the library or the memory is missing.
    """
    points, kept = _doubles(points), np.zeros(len(points), dtype=bool)
    call = library().cs_fewer_points
    call.argtypes = [c_int64, c_void_p, c_double, c_void_p]
    if call(len(points), points.ctypes.data, tolerance, kept.ctypes.data):
        raise EngineError(_NO_MEMORY)
    return kept


def flanks(
    points: np.ndarray,
    weights: np.ndarray,
    along: np.ndarray,
    places: np.ndarray,
    farthest: np.ndarray,
    gap: float,
    kinds: Sequence[tuple[int, int, float]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of m places along a chain the run of points after each, extrapolated to it: at (m, 2) px, unit tangents (m, 2),
    their standard errors (m,) in radians, inf where there is no run, and the first points (m,) of the runs.

    points: (n, 2) px; weights: (n,) 1/px^2; along: (n,) and places: (m,), arc lengths, px. Runs start `gap` px after
    their place, and within `farthest` (m,) px. kinds: from the shortest run on its points less one, the degree of its
    polynomial, 1 or 2, and the mean squared residual across it, in squared sigmas, up to which it is believed; the
    longest one is taken before the first that is not. Raises EngineError where the library is missing.
    """
    arrays = [_doubles(a) for a in (points, weights, along, places, farthest)]
    lengths, degrees = (np.array([kind[c] for kind in kinds], np.int64) for c in (0, 1))
    most = np.array([kind[2] for kind in kinds], np.float64)
    m = len(places)
    found = np.empty((m, 2)), np.empty((m, 2)), np.empty(m), np.empty(m, np.int64)
    call = library().cs_flanks
    call.restype = None
    call.argtypes = [c_int64, *[c_void_p] * 3, c_int64, *[c_void_p] * 2, c_double, c_int64, *[c_void_p] * 7]
    chain, at = [a.ctypes.data for a in arrays[:3]], [a.ctypes.data for a in arrays[3:]]
    call(len(points), *chain, m, *at, gap, len(kinds), *(a.ctypes.data for a in (lengths, degrees, most, *found)))
    return found


def parabolas(
    points: np.ndarray, weights: np.ndarray, along: np.ndarray, kinds: Sequence[tuple[int, float]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parabolas in arc length about every point of a chain: coefficients (n, 3, 2) of 1, s and s^2, the standard errors
    (n, 2) of the first two, and the half-windows (n,) in points.

    points: (n, 2) px; weights: (n,) 1/px^2, 0 where unknown; along: (n,) arc lengths, px. kinds: half-windows from the
    shortest on, and up to which mean squared residual, in squared sigmas, each is believed; the longest one is taken
    before the first that is not. Raises EngineError where the library is missing.
    """
    arrays = [_doubles(a) for a in (points, weights, along)]
    halves, most = np.array([half for half, _ in kinds], np.int64), np.array([limit for _, limit in kinds], np.float64)
    n = len(points)
    found = np.empty((n, 3, 2)), np.empty((n, 2)), np.empty(n, np.int64)
    call = library().cs_parabolas
    call.restype = None
    call.argtypes = [c_int64, *[c_void_p] * 3, c_int64, *[c_void_p] * 5]
    call(n, *(a.ctypes.data for a in arrays), len(kinds), *(a.ctypes.data for a in (halves, most, *found)))
    return found


@dataclass(frozen=True)
class Form:
    """Which values a primitive has. kind: CIRCLE (middle, radius), ELLIPSE (middle, half-axes) or BOX (middle, half
    sides); rounded: of a box, whether the radius of its corners comes next; turned: whether an angle comes last."""

    kind: int
    rounded: bool = False
    turned: bool = False


def fitted_values(
    form: Form, start: np.ndarray, points: np.ndarray, weights: np.ndarray, rounds: int
) -> tuple[np.ndarray, float]:
    """The values of the primitive nearest to points (n, 2), by Levenberg's and Marquardt's method from `start` on, and
    the loss: Huber's, of distances in standard errors, linear beyond 3.

    weights: (n,) 1/px^2. Raises EngineError where the library is missing.
    """
    values, points, weights = np.array(start, dtype=np.float64), _doubles(points), _doubles(weights)
    call = library().cs_fit_primitive
    call.restype = c_double
    call.argtypes = [*[c_int32] * 5, c_int64, *[c_void_p] * 3]
    given = (array.ctypes.data for array in (points, weights, values))
    return values, float(call(form.kind, form.rounded, form.turned, len(values), rounds, len(points), *given))


def _doubles(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=np.float64)
