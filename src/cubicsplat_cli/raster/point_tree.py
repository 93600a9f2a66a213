"""The points near a place, natively: scipy.spatial takes a third of a second to import."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_int64
from functools import partial

import numpy as np

from cubicsplat_cli.raster.native import Out, address_of, doubles, int64s, native

_native = partial(native, "points")


class PointTree:
    """Points (n, 2) sorted for look-ups. Raises ValueError for coordinates that are not finite."""

    def __init__(self, points: np.ndarray) -> None:
        self._given = given = _pairs(points)
        out = Out(len(given), np.int64), Out(len(given), np.uint8)
        order, axes = _native("cs_tree", len(given), given, *out, result=None)
        self._sorted = len(given), given[order], order, axes

    def query(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance (m,) of the nearest point from each place (m, 2), and its index (m,), the first of
        several; without any points inf and -1."""
        places, out = _pairs(places), (Out(len(places)), Out(len(places), np.int64))
        squares, indices = _native("cs_nearest", *self._sorted, len(places), places, *out, result=None)
        return np.sqrt(squares), indices

    def query_ball_point(self, places: np.ndarray, reach: float | np.ndarray) -> list[np.ndarray]:
        """Return for each place (m, 2) the indices, ascending, of the points no farther than `reach` or reach (m,)."""
        indices, ends = self._within(_pairs(places), reach)
        return np.split(indices, ends[:-1]) if len(ends) else []

    def query_pairs(self, reach: float) -> np.ndarray:
        """Return (k, 2): the indices i < j of all pairs of points no farther than `reach` from each other, in order."""
        second, ends = self._within(self._given, reach)
        first = np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0))
        return np.stack([first, second], axis=1)[second > first]

    def _within(self, places: np.ndarray, reach: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        reaches = doubles(np.broadcast_to(reach, len(places)))
        ends, room = np.empty(len(places), np.int64), 16 * len(places)
        while True:
            indices = np.empty(room, np.int64)
            given = *self._sorted, len(places), places, reaches, room, ends, indices
            count = _native("cs_within", *given, result=c_int64)
            if count <= room:
                return indices[:count], ends
            room = count

    def line(self, shown: np.ndarray) -> list[int]:
        """Return the closed line through the points, and points (n, 2) of it that show, as the library takes them."""
        return [len(self._given), *map(address_of, (*self._sorted[1:], self._given)), len(shown), address_of(shown)]


class ClosedLines:
    """Closed lines, to be laid on one another by a shift or a reflection. trees: of the points of each line; shown:
    (n, 2) the points of each that show; boxes: (lines, 2, 2) their least and greatest x and y, px.

    limits: px that a point may be off with the middles of both boxes on each other, and at last, and that all may be
    off at last in the root mean square. tries: points that are tried before all of them, and steps of least squares, of
    points off the other line. on_it: px within which a place counts as on a line.
    """

    def __init__(
        self, trees: Sequence[PointTree], shown: Sequence[np.ndarray], boxes: np.ndarray,
        limits: tuple[float, float, float], tries: tuple[int, int], on_it: float,
    ) -> None:  # fmt: skip
        self._kept = trees, shown
        self._lines = np.array([tree.line(points) for tree, points in zip(trees, shown, strict=True)], np.int64)
        self._boxes, self._way = doubles(boxes), (doubles(limits), *tries, on_it)

    def first_on(
        self, own: int, models: np.ndarray, flips: np.ndarray
    ) -> tuple[int, int, np.ndarray, np.ndarray] | None:
        """Find the first of the lines `models` (m,), and of the flips (f, 2), by which x and y are multiplied, that
        lies on the line `own`. Return both, the shift (2,), px, that brings it there, and the information (2,) that the
        points that show give of the shift, 1/px^2 if each is known to a px. None if no line lies near enough.
        """
        shift, information = np.empty(2), np.empty(2)
        lines = self._lines, self._boxes, own, len(models), int64s(models), len(flips), flips
        model, flip = divmod(_native("cs_lay_on", *lines, *self._way, shift, information, result=c_int64), len(flips))
        return None if model == len(models) else (int(models[model]), flip, shift, information)


def _pairs(points: np.ndarray) -> np.ndarray:
    if not np.isfinite(points).all():
        raise ValueError("a point has a coordinate that is no finite number")
    return doubles(points).reshape(-1, 2)
