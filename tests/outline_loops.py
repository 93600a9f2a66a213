"""Parts of the native fit of outlines by themselves: the corners of a loop, its division into pieces, and the primitive
through it.
"""

from __future__ import annotations

from ctypes import byref, c_int64
from functools import partial

import numpy as np

from cubicsplat_cli.raster.cubics import Division
from cubicsplat_cli.raster.native import doubles, native

_native = partial(native, "outlines")


def farthest(points: np.ndarray, line: np.ndarray) -> float:
    """The largest distance of points from a polyline, both (n, 2)."""
    start, step = line[:-1], np.diff(line, axis=0)
    share = ((points[:, None] - start) * step).sum(-1) / np.maximum((step**2).sum(-1), 1e-30)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * step
    return float(np.hypot(*np.moveaxis(points[:, None] - nearest, -1, 0)).min(axis=1).max())


def corners_of(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The corners of a closed loop of points (n, 2), px: the index of the first point after each (C,), ascending, their
    positions (C, 2), px, and turns (C,), radians, in (-pi, pi). weights: (n,) 1/px^2, 0 where unknown. Raises
    EngineError where the library or the memory is missing.
    """
    count = len(points)
    out = np.empty(count, np.int64), np.empty((count, 2)), np.empty(count)
    found = _native("cs_corners", count, doubles(points), doubles(weights), *out, result=c_int64)
    return out[0][:found], out[1][:found], out[2][:found]


def laid_out(
    points: np.ndarray,
    weights: np.ndarray,
    corners: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    price: float,
) -> tuple[Division, np.ndarray, int, np.ndarray]:
    """The cheapest division of a closed loop into lines and cubics: which of its corners pay (C,), from which point on
    the pieces follow each other, and the weights (n,) 1/px^2 without the points next to corners, which see both flanks.

    Every corner but a sure one that turns little, or has another near, is kept only if that is cheaper than doing
    without, and so are those in a row along a rounding. The runs between the corners, or the whole loop where none is
    left, are divided by dynamic programming: nodes are laid along a run, denser where it bends, each pair of them gets
    the best line and the best cubic with the tangents measured there, and the cheapest path through the nodes is the
    division. The price of a piece is half of chi^2 plus the price of a parameter times their number.

    points: (n, 2) px; weights: (n,) 1/px^2, 0 where points tell nothing. corners: indices (C,) of the points after
    them, ascending, positions (C, 2) px, turns (C,) radians, and (C,) bool, which are sure. price: of a parameter,
    nats. Raises EngineError where the library or the memory is missing.
    """
    count, start = len(points), c_int64()
    index, position, turn, sure = corners
    at = [np.ascontiguousarray(index, np.int64), doubles(position), doubles(turn), np.ascontiguousarray(sure, bool)]
    given = count, doubles(points), doubles(weights), len(index), *at, float(price)
    kept, chosen, room = np.empty(len(index), bool), np.empty(count), Division.room(2 * count + 2)
    division = Division(*_native("cs_lay_out", *given, kept, byref(start), chosen, *room, result=c_int64))
    return division, kept, start.value, chosen


def nearest_primitive(
    points: np.ndarray, weights: np.ndarray, price: float
) -> tuple[int, np.ndarray, float, float] | None:
    """The cheapest primitive through a closed loop of points (n, 2): CIRCLE, ELLIPSE or BOX, its values (6,), as in a
    `FittedContour`, its cost, nats, and the mean squared residual, in sigmas; None if none comes near.

    Fitted by Levenberg's and Marquardt's method; the cost is half of Huber's loss of distances in standard errors,
    linear beyond 3, and the price of each parameter. weights: (n,) 1/px^2, 0 for unknown points.
    """
    form, values, fit = np.empty(3, np.int32), np.empty(6), np.empty(2)
    given = len(points), doubles(points), doubles(weights), float(price)
    near = _native("cs_nearest_primitive", *given, form, values, fit, result=c_int64)
    return (int(form[0]), values, float(fit[0]), float(fit[1])) if near else None
