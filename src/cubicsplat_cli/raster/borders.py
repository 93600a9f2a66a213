"""The map of the borders between regions, by the native library: which touch, which enclose others, and the loops of
cracks around them.

All raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from collections.abc import Iterator
from ctypes import c_int64
from functools import cached_property, partial
from itertools import compress

import numpy as np

from cubicsplat_cli.raster.cpu import doubles, int32s, native
from cubicsplat_cli.raster.outlines import EdgePositions, size_of
from cubicsplat_cli.record import record

_native = partial(native, "borders")


@record
class Loops:
    """Closed loops of cracks around regions, in the order of these, those that enclose most first; pixels connect along
    edges. cracks: (n, 3) int64 x, y and direction (0 to 3: east, south, west, north) of each, the region on its right;
    beside: (n,) int64 the region on its left, -1 beyond the canvas; ends: (L,) where each loop ends; owners: (L,) int64
    the region of each.
    """

    cracks: np.ndarray
    beside: np.ndarray
    ends: np.ndarray
    owners: np.ndarray

    def __iter__(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """The region of every loop, its cracks, and what is beside them."""
        parts = (np.split(each, self.ends[:-1]) for each in (self.cracks, self.beside))
        return zip(self.owners.tolist(), *parts, strict=True)

    def outer(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """The same of the outer loop of every region."""
        return compress(self, np.diff(self.owners, prepend=-1))


@record
class BorderMap:
    """labels: (H, W) int32 the regions, count: R of them. first, second, cracks: (P,) int64 of every two that touch,
    either way round and ascending, the two and how many cracks they share."""

    labels: np.ndarray
    count: int
    first: np.ndarray
    second: np.ndarray
    cracks: np.ndarray

    @cached_property
    def beside(self) -> list[list[int]]:
        """The neighbours of each region, ascending."""
        ends = np.cumsum(np.bincount(self.first, minlength=self.count))
        return [each.tolist() for each in np.split(self.second, ends[:-1])]

    @cached_property
    def around(self) -> np.ndarray:
        """(R,) int32 the innermost one that encloses each, through which all its ways to the canvas's border lead, -1
        where none does.
        """
        out = np.full(self.count, -1, np.int32)
        given = self.labels, *self.labels.shape, self.count, len(self.first), self.first, self.second
        _native("cs_enclosing", *given, out)
        return out

    @cached_property
    def loops(self) -> Loops:
        """The loops around all regions."""
        room = int(self.cracks.sum()) + 2 * sum(self.labels.shape)
        found = np.empty((room, 3), np.int64), *(np.empty(room, np.int64) for _ in range(3))
        count = _native("cs_loops", self.labels, *self.labels.shape, *found, result=c_int64)
        return Loops(*found[:2], *(each[:count].copy() for each in found[2:]))


def border_map(labels: np.ndarray) -> BorderMap:
    """The borders of labels (H, W) >= 0."""
    labels = int32s(labels)
    count = int(labels.max()) + 1
    room = 6 * count  # as many as connected regions have
    while True:
        pairs = np.empty((room, 3), np.int64)
        found = _native("cs_touching", labels, *labels.shape, count, room, pairs, result=c_int64)
        if found <= room:
            return BorderMap(labels, count, *np.ascontiguousarray(pairs[:found].T))
        room = found


def passings(
    loops: Loops, found: EdgePositions, reaches: tuple[float, ...], smooth: float, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """Where loops pass from one region beside them to another: (m, 5) int64 their own region, the two, and x and y of
    the vertex, and (m, 2) radians by which they turn there and the standard error. What is too rough is left out.

    reaches: px along the loop from which its headings on either side are taken, the first where the mean squared
    residual, in sigmas, of a parabola is at most `smooth`; least: radians, of the standard error beyond that of the
    points.
    """
    places, turns = np.empty((len(loops.cracks), 5), np.int64), np.empty((len(loops.cracks), 2))
    given = loops.cracks, loops.beside, len(loops.ends), loops.ends, loops.owners, *size_of(found), *found
    tries = len(reaches), doubles(reaches), float(smooth), float(least)
    count = _native("cs_passings", *given, *tries, places, turns, result=c_int64)
    return places[:count], turns[:count]


def border_positions(
    levels: np.ndarray, labels: np.ndarray, fills: np.ndarray, error: float, rounding: float, share_error: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where borders run across all cracks, px, and the standard errors: two (H + 1, W) of horizontal cracks and two (H,
    W + 1) of vertical ones.

    levels: (H, W, 4), known to an error, of which `rounding` is that of a clean picture; share_error: of the shares of
    pixels that shapes cover. labels: (H, W) the regions, fills: (R, 4) theirs, in levels.
    """
    height, width = labels.shape
    wide = levels.dtype == np.float64
    picture = np.ascontiguousarray(levels, np.float64 if wide else np.float32), wide
    kinds = np.unique(doubles(fills), axis=0)
    given = int32s(labels), height, width, doubles(fills), len(kinds), kinds
    rows, row_sigma = np.empty((2, height + 1, width))
    columns, column_sigma = np.empty((2, height, width + 1))
    found = rows, row_sigma, columns, column_sigma
    _native(
        "cs_edge_positions", *picture, *given, float(error), float(rounding), float(share_error), *found, result=None
    )
    return found
