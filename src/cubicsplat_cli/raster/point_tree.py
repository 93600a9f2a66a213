"""The points near a place, natively: scipy.spatial takes a third of a second to import."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_int64
from functools import partial

import numpy as np

from cubicsplat_cli.raster.cpu import address_of, doubles, int64s, native

_native = partial(native, "points")


class PointTree:
    """Points (n, 2) sorted for look-ups. Raises EngineError where the library or the memory is missing, and ValueError
    for coordinates that are not finite."""

    def __init__(self, points: np.ndarray) -> None:
        self._given = given = _pairs(points)
        order, self._axes = np.empty(len(given), np.int64), np.zeros(len(given), np.uint8)
        _native("cs_tree", len(given), given, order, self._axes, result=None)
        self._points, self._order = given[order], order

    def query(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) how far the nearest point is from each place (m, 2), and (m,) its index: the first of several; without
        any points inf and -1."""
        places = _pairs(places)
        squares, indices = np.empty(len(places)), np.empty(len(places), np.int64)
        _native("cs_nearest", *self._sorted(), len(places), places, squares, indices, result=None)
        return np.sqrt(squares), indices

    def off_line(self, places: np.ndarray, on_it: float) -> tuple[np.ndarray, np.ndarray]:
        """(m,) how far places (m, 2) lie off the closed line through the points, in their order; and (m, 2) the unit
        directions in which they do, across the line where that is no farther than `on_it`. Raises ValueError where
        there are no points."""
        if not len(self._given):
            raise ValueError("a line without points is nowhere")
        places = _pairs(places)
        sizes, ways = np.empty(len(places)), np.empty((len(places), 2))
        given = (self._given, len(places), places, float(on_it), sizes, ways)
        _native("cs_off_line", *self._sorted(), *given, result=None)
        return sizes, ways

    def query_ball_point(self, places: np.ndarray, reach: float | np.ndarray) -> list[np.ndarray]:
        """For each place (m, 2) the indices, ascending, of the points no farther than `reach` or reach (m,)."""
        found, ends = self._within(_pairs(places), reach)
        return np.split(found, ends[:-1]) if len(ends) else []

    def query_pairs(self, reach: float) -> np.ndarray:
        """(k, 2) the indices i < j of all pairs of points no farther than `reach` from each other, in order."""
        found, ends = self._within(self._given, reach)
        first = np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0))
        return np.stack([first, found], axis=1)[found > first]

    def _within(self, places: np.ndarray, reach: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        reaches = doubles(np.broadcast_to(reach, len(places)))
        ends, room = np.empty(len(places), np.int64), 16 * len(places)
        while True:
            found = np.empty(room, np.int64)
            given = (len(places), places, reaches, room, ends, found)
            count = _native("cs_within", *self._sorted(), *given, result=c_int64)
            if count <= room:
                return found[:count], ends
            room = count

    def line(self, seen: np.ndarray) -> list[int]:
        """The closed line through the points, and points (n, 2) of it that show, as the library takes them."""
        arrays = (*self._sorted()[1:], self._given)
        return [len(self._given), *map(address_of, arrays), len(seen), address_of(seen)]

    def _sorted(self) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        return len(self._points), self._points, self._order, self._axes


class ClosedLines:
    """Closed lines, of which one may lie on another one when it is moved or mirrored. trees: of the points of each
    line; seen: (n, 2) the points of each that show; boxes: (lines, 2, 2) their least and greatest x and y, px."""

    def __init__(self, trees: Sequence[PointTree], seen: Sequence[np.ndarray], boxes: np.ndarray) -> None:
        self._kept = trees, seen
        self._lines = np.array([tree.line(points) for tree, points in zip(trees, seen, strict=True)], np.int64)
        self._boxes = doubles(boxes)

    def first_on(
        self,
        own: int,
        models: np.ndarray,
        firsts: np.ndarray,
        flips: np.ndarray,
        limits: tuple[float, float, float],
        tries: tuple[int, int],
        on_it: float,
    ) -> tuple[int, int, np.ndarray, np.ndarray] | None:
        """Which of the lines `models` (m,), the first, and of the flips (f, 2), by which x and y are multiplied, lies
        on the line `own`; the shift (2,), px, by which it does, and (2,) what the points that show tell of it, 1/px^2
        if each is known to a px. None where none lies near enough.

        firsts, limits: px that a point of each model may be off at first, with the middles of both boxes on each other,
        after a step and at last, and that all may be off at last in the root mean square. tries: points that are tried
        before all of them, and steps of least squares, of points off the other line. on_it: as of `off_line`.
        """
        shift, told = np.empty(2), np.empty(2)
        lines = (self._lines, self._boxes, own, len(models), int64s(models), doubles(firsts), len(flips), flips)
        given = (*lines, np.array(limits), *tries, on_it, shift, told)
        model, flip = divmod(_native("cs_lay_on", *given, result=c_int64), len(flips))
        return None if model == len(models) else (int(models[model]), flip, shift, told)


def _pairs(points: np.ndarray) -> np.ndarray:
    if not np.isfinite(points).all():
        raise ValueError("a point has a coordinate that is no finite number")
    return doubles(points).reshape(-1, 2)
