"""The outlines of strokes, by the native library; kernels/cpu/strokes.cpp says how they are made."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_int64
from functools import partial
from typing import Any

import numpy as np

from cubicsplat_cli.raster.native import Out, bools, doubles, native
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.record import record

_native = partial(native, "strokes")
CAPS, JOINS = ("butt", "round", "square", "closed", "one side"), ("miter", "round", "bevel")
STEP = 1e-5  # px, of the differences that tell how an outline moves with its centre line


def evenly_wide(shapes: Sequence[Sequence[np.ndarray]], share: float, px: float, beside: float) -> np.ndarray:
    """Return (shapes,) px: the usual width of each shape that has one width nearly all along its outline, else 0.

    shapes: of each the cubics (S, 4, 2) of its rings, the outer one first. share, px: of the usual width, and further
    px, that an even width may differ from it. That share of the outline may be uneven, or as many widths as it has
    corners and `beside` more.
    """
    rings = [ring for shape in shapes for ring in shape]
    if not rings:
        return np.zeros(len(shapes))
    shape_ends, ring_ends = (np.cumsum([len(part) for part in parts]) for parts in (shapes, rings))
    given = len(shapes), shape_ends, ring_ends, np.concatenate(rings), share, px, beside
    return _native("cs_even_widths", *given, Out(len(shapes)))


def ring_widths(rings: Sequence[np.ndarray], share: float, px: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (rings,) px: the usual width of a shape along each of its rings; and the share, 0..1, of the ring's length
    where the width differs from that by no more than `share` of it and `px` px.

    rings: the cubics (S, 4, 2) of each, the outer one first.
    """
    ends = np.cumsum([len(ring) for ring in rings])
    return _native(
        "cs_ring_widths", len(rings), ends, np.concatenate(rings), share, px, Out(len(rings)), Out(len(rings))
    )


@record
class StrokeOutline:
    """cubics: (n, 4, 2) px; lines: (n,) bool, straight ones. ends: of its rings, one or two; the first ring of a closed
    stroke is on the side of the normal (-y, x), and the second runs the other way."""

    cubics: np.ndarray
    lines: np.ndarray
    ends: tuple[int, ...]


@record
class OffsetPlan:
    """The structure of the outline of a centre line, without its exact numbers. lines: (S,) bool, its straight pieces;
    parts: (S,) int64, the number of parts that the offset of each is cut into; turns: (S,) radians, the turn of the
    line from each piece to the next, 0 if it needs no join; the last one back to the first. cap, join: of CAPS and
    JOINS; "closed" for a closed line, "one side" for the outline on the side of its normal alone."""

    lines: np.ndarray
    parts: np.ndarray
    turns: np.ndarray
    cap: str
    join: str

    @classmethod
    def of(cls, cubics: np.ndarray, lines: np.ndarray, cap: str, join: str) -> OffsetPlan:
        """Return the plan for a centre line of cubics (S, 4, 2) with a length above 0."""
        given = len(cubics), doubles(cubics), bools(lines), Out(len(cubics), np.int64), Out(len(cubics))
        parts, turns = _native("cs_plan_offset", *given, result=None)
        return cls(bools(lines), parts, turns, cap, join)

    def outline(self, cubics: np.ndarray, half: float) -> StrokeOutline:
        """Return the outline `half` px from a centre line of cubics (S, 4, 2), as many and of the kinds of the plan."""
        room = 2 * int(self.parts.sum()) + 8 * (len(self.parts) + 1)  # a join or a cap has at most 4 pieces
        given, ends = (*self._given(cubics, half), Out((room, 4, 2)), Out(room, bool)), np.zeros(2, np.int64)
        points, straight = _native("cs_offset", *given, ends, result=c_int64)
        return StrokeOutline(points, straight, tuple(ends[ends > 0].tolist()))

    def slopes(self, cubics: np.ndarray, half: float, pieces: int) -> SparseRows:
        """Return (8 n, 8 S): the derivatives of the points of the outline, of n pieces, by the points of the one or two
        pieces of the centre line that they depend on."""
        room = 128 * pieces
        given = *self._given(cubics, half), STEP, Out(room, np.int64), Out(room, np.int64), Out(room)
        rows, columns, values = _native("cs_offset_slopes", *given, result=c_int64)
        return SparseRows.of(rows, columns, values, (8 * pieces, 8 * len(cubics)))

    def _given(self, cubics: np.ndarray, half: float) -> tuple[Any, ...]:
        style = CAPS.index(self.cap), JOINS.index(self.join)
        return len(cubics), doubles(cubics), self.lines, self.parts, self.turns, float(half), *style
