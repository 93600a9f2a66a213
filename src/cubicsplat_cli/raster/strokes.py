"""The outlines of strokes, by the native library; it says how they are made.

All raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_int64

import numpy as np

from cubicsplat_cli.raster.cpu import bools, doubles, native
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.record import record

CAPS, JOINS = ("butt", "round", "square", "closed", "one side"), ("miter", "round", "bevel")
STEP = 1e-5  # px, of the differences that tell how an outline moves with its centre line
_MOST = 4  # pieces of a join or a cap


def evenly_wide(shapes: Sequence[Sequence[np.ndarray]], share: float, px: float, beside: float) -> np.ndarray:
    """(shapes,) px: the usual widths of those that are of one width nearly all along their outlines, 0 of the others.

    shapes: of each the cubics (S, 4, 2) of its rings, the outer one first. share, px: of the usual width, and further
    px, that an even one is off it at the most. Of the outline that share may be uneven, or as many widths as it has
    corners and `beside` more.
    """
    rings = [ring for shape in shapes for ring in shape]
    found = np.zeros(len(shapes))
    if rings:
        shape_ends, ring_ends = (np.cumsum([len(each) for each in parts]) for parts in (shapes, rings))
        given = len(shapes), shape_ends, ring_ends, np.concatenate(rings), share, px, beside
        native("strokes", "cs_even_widths", *given, found)
    return found


@record
class StrokeOutline:
    """cubics: (n, 4, 2) px; lines: (n,) bool, which are straight. ends: of its rings, one or two; of a closed stroke
    the first is on the side of the normal (-y, x), and the other one runs the other way."""

    cubics: np.ndarray
    lines: np.ndarray
    ends: tuple[int, ...]


@record
class OffsetPlan:
    """The structure of the outline of a centre line, without its exact numbers. lines: (S,) bool, its straight pieces;
    parts: (S,) int64, into how many parts the offset of each is cut; turns: (S,) radians, by how much the line turns
    from each to the next, 0 where that needs no join; the last one back to the first. cap, join: of CAPS and JOINS;
    "closed" for a closed line, "one side" for that of its normal alone."""

    lines: np.ndarray
    parts: np.ndarray
    turns: np.ndarray
    cap: str
    join: str

    @classmethod
    def of(cls, cubics: np.ndarray, lines: np.ndarray, cap: str, join: str) -> OffsetPlan:
        """The plan for a centre line of cubics (S, 4, 2) that have a length."""
        parts, turns = np.empty(len(cubics), np.int64), np.empty(len(cubics))
        native("strokes", "cs_plan_offset", len(cubics), doubles(cubics), bools(lines), parts, turns, result=None)
        return cls(bools(lines), parts, turns, cap, join)

    def outline(self, cubics: np.ndarray, half: float) -> StrokeOutline:
        """The outline `half` px from a centre line of this plan, of cubics (S, 4, 2); their number and kind are the
        plan's."""
        room = self._room
        points, straight, ends = np.empty((room, 4, 2)), np.empty(room, bool), np.zeros(2, np.int64)
        given = self._given(cubics, half)
        count = native("strokes", "cs_offset", *given, points, straight, ends, result=c_int64)
        return StrokeOutline(points[:count], straight[:count], tuple(ends[ends > 0].tolist()))

    def slopes(self, cubics: np.ndarray, half: float, pieces: int) -> SparseRows:
        """(8 n, 8 S): how the points of the outline, of n pieces, move with those of the one or two pieces of the
        centre line that they depend on."""
        room = 128 * pieces
        rows, columns, values = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
        given = self._given(cubics, half)
        count = native("strokes", "cs_offset_slopes", *given, STEP, rows, columns, values, result=c_int64)
        return SparseRows.of(rows[:count], columns[:count], values[:count], (8 * pieces, 8 * len(cubics)))

    @property
    def _room(self) -> int:
        return 2 * int(self.parts.sum()) + 2 * _MOST * (len(self.parts) + 1)

    def _given(self, cubics: np.ndarray, half: float) -> tuple[object, ...]:
        style = CAPS.index(self.cap), JOINS.index(self.join)
        return len(cubics), doubles(cubics), self.lines, self.parts, self.turns, float(half), *style
