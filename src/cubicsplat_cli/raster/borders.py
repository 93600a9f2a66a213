"""The borders between regions, by the native library: which touch, which enclose others, and the loops of cracks."""

from __future__ import annotations

from collections.abc import Iterator
from ctypes import c_int64
from functools import cached_property, partial
from itertools import compress

import numpy as np

from cubicsplat_cli.raster.native import Out, doubles, floats, int32s, native
from cubicsplat_cli.raster.outlines import EdgePositions
from cubicsplat_cli.record import record

_native = partial(native, "borders")


@record
class Loops:
    """Closed loops of cracks around regions, in the order of these, those that enclose most first; pixels connect along
    edges. cracks: (n, 3) int64 x, y and direction (0 to 3: east, south, west, north), the region on the right; beside:
    (n,) int64 the region on the left, -1 beyond the canvas; ends: (L,) of the loops; owners: (L,) int64 their regions.
    """

    cracks: np.ndarray
    beside: np.ndarray
    ends: np.ndarray
    owners: np.ndarray

    def __iter__(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield the region of every loop, its cracks, and the regions beside them."""
        parts = (np.split(array, self.ends[:-1]) for array in (self.cracks, self.beside))
        return zip(self.owners.tolist(), *parts, strict=True)

    def outer(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield the same of the outer loop of every region."""
        return compress(self, np.diff(self.owners, prepend=-1))


@record
class BorderMap:
    """The borders of R regions. labels: (H, W) int32 the regions; count: R. first, second, cracks: (P,) int64 of every
    pair that touches, both ways round and ascending, the two regions and the number of cracks that they share."""

    labels: np.ndarray
    count: int
    first: np.ndarray
    second: np.ndarray
    cracks: np.ndarray

    @cached_property
    def beside(self) -> list[list[int]]:
        """The neighbours of each region, ascending."""
        ends = np.cumsum(np.bincount(self.first, minlength=self.count))
        return [part.tolist() for part in np.split(self.second, ends[:-1])]

    @cached_property
    def around(self) -> np.ndarray:
        """(R,) int32: the innermost region that encloses each, on all its ways to the canvas's border; -1 for none."""
        out = np.full(self.count, -1, np.int32)
        given = self.labels, *self.labels.shape, self.count, len(self.first), self.first, self.second
        _native("cs_enclosing", *given, out)
        return out

    @cached_property
    def loops(self) -> Loops:
        """The loops around all regions."""
        room = int(self.cracks.sum()) + 2 * sum(self.labels.shape)
        cracks, beside = np.empty((room, 3), np.int64), np.empty(room, np.int64)
        out = cracks, beside, Out(room, np.int64), Out(room, np.int64)
        return Loops(cracks, beside, *_native("cs_loops", self.labels, *self.labels.shape, *out, result=c_int64))


def border_map(labels: np.ndarray) -> BorderMap:
    """Return the borders of labels (H, W) >= 0."""
    labels = int32s(labels)
    count = int(labels.max()) + 1
    room = 6 * count  # enough for connected regions
    while True:
        pairs = np.empty((room, 3), np.int64)
        touching = _native("cs_touching", labels, *labels.shape, count, room, pairs, result=c_int64)
        if touching <= room:
            return BorderMap(labels, count, *np.ascontiguousarray(pairs[:touching].T))
        room = touching


def meeting(labels: np.ndarray) -> np.ndarray:
    """Return (H - 1, W - 1) bool: where three or more of the labels (H, W) meet at the corner of four pixels."""
    several = Out(tuple(side - 1 for side in labels.shape), bool)
    return _native("cs_meeting", int32s(labels), *labels.shape, several, result=None)


def passings(
    loops: Loops, edges: EdgePositions, reaches: tuple[float, ...], smooth: float, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """Find where loops pass from one region beside them to another, but for rough places. Return (m, 5) int64: their
    own region, the two, and x and y of the vertex; and (m, 2) the radians of the turn there, and the standard error.

    reaches: px along the loop over which a parabola gives its heading on either side; the first with a mean squared
    residual, in sigmas, of at most `smooth` is taken. least: radians, of the standard error beyond that of the points.
    """
    count = len(loops.cracks)
    given = loops.cracks, loops.beside, len(loops.ends), loops.ends, loops.owners, *edges.given
    tries = len(reaches), doubles(reaches), float(smooth), float(least)
    return _native("cs_passings", *given, *tries, Out((count, 5), np.int64), Out((count, 2)), result=c_int64)


def border_positions(
    levels: np.ndarray, labels: np.ndarray, fills: np.ndarray, error: float, rounding: float, share_error: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the positions of borders across all cracks, px, and their standard errors: two (H + 1, W) of horizontal
    cracks and two (H, W + 1) of vertical ones, the positions first.

    levels: (H, W, 4), known to an error, of which `rounding` is that of a clean picture; share_error: of the shares of
    pixels that shapes cover. labels: (H, W) the regions, fills: (R, 4) theirs, in levels.
    """
    height, width = labels.shape
    wide = levels.dtype == np.float64
    kinds = np.unique(doubles(fills), axis=0)
    given = doubles(levels) if wide else floats(levels), wide, int32s(labels), height, width, doubles(fills)
    errors = float(error), float(rounding), float(share_error)
    rows, columns = (height + 1, width), (height, width + 1)
    out = Out(rows), Out(rows), Out(columns), Out(columns)
    return _native("cs_edge_positions", *given, len(kinds), kinds, *errors, *out, result=None)
