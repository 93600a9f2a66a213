"""The points near a place, natively: scipy.spatial takes a third of a second to import."""

from __future__ import annotations

import ctypes
from ctypes import c_int64
from functools import partial

import numpy as np

from cubicsplat_cli.raster.cpu import address_of, doubles, native

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

    def laid_on(
        self,
        seen: np.ndarray,
        other: PointTree,
        other_seen: np.ndarray,
        placed: tuple[np.ndarray, np.ndarray],
        limits: tuple[float, float, float, float],
        tries: int,
        on_it: float,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """The shift (2,) with which the closed line through the points lies nearest to another one, and (2,) what the
        points that show tell of it, 1/px^2 if each is known to a px; None where it lies not near enough.

        seen, other_seen: (n, 2) and (m, 2) the points of either line that show. placed: signs (2,) by which x and y are
        multiplied first, and the shift (2,) to begin with. limits: px that a point may be off at first, after a try,
        and at last, and that all may be off at last in the root mean square. tries: steps of least squares, of points
        off the other line. on_it: as of `off_line`.
        """
        signs, shift, told = doubles(placed[0]), doubles(placed[1]).copy(), np.empty(2)
        kept = [tree._line(points) for tree, points in ((self, seen), (other, other_seen))]
        given = (*kept, signs, np.array(limits), tries, on_it, shift, told)
        return (shift, told) if _native("cs_lay_on", *given, result=c_int64) else None

    def _line(self, seen: np.ndarray) -> ctypes.Array[c_int64]:
        """The line and the points of it that show, as the library takes them."""
        arrays = (*self._sorted()[1:], self._given)
        return (c_int64 * 7)(len(self._given), *map(address_of, arrays), len(seen), address_of(seen))

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

    def _sorted(self) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        return len(self._points), self._points, self._order, self._axes


def _pairs(points: np.ndarray) -> np.ndarray:
    if not np.isfinite(points).all():
        raise ValueError("a point has a coordinate that is no finite number")
    return doubles(points).reshape(-1, 2)
