"""The free parameters of an outline: anchors, directions of smooth joints, handle lengths, handles at corners.

Which there are follows from what its joints are, and how its control points move with them from where they lie.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.raster.cubics import Division, Joints, moved_outline, outline_cubics, outline_jacobian, refined
from cubicsplat_cli.raster.sparse import SparseRows

ROUNDS = 8
PAIR = np.array([0, 1])


@dataclass(frozen=True)
class Pieces:
    """An outline being fitted: A anchors, S pieces (S = A when closed, else A - 1), piece i from anchor i on.

    anchors: (A, 2) px. incoming, outgoing: (A, 2) px, the handles of the piece before and after each anchor, relative
    to it. lines: (S,) bool. smooth: (A,) bool. level: (A,) bool, smooth anchors whose direction stays as it is.
    tied: (A, 2) int, the variable of each anchor coordinate, -1 for a fixed one.
    """

    anchors: np.ndarray
    incoming: np.ndarray
    outgoing: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray
    level: np.ndarray
    tied: np.ndarray

    @property
    def closed(self) -> bool:
        """Whether the last piece returns to the first anchor."""
        return len(self.lines) == len(self.anchors)

    @property
    def ends(self) -> np.ndarray:
        """(S,) the anchor at which each piece ends."""
        return (np.arange(len(self.lines)) + 1) % len(self.anchors)

    @cached_property
    def joints(self) -> Joints:
        """Joints of pieces that move."""
        return Joints(self.lines, self.smooth, self.level, self.tied)

    @cached_property
    def cubics(self) -> np.ndarray:
        """(S, 4, 2) control points, not to be written to; those of a line lie at its thirds."""
        found = outline_cubics(self.lines, (self.anchors, self.incoming, self.outgoing))
        found.flags.writeable = False
        return found

    def moved(self, step: np.ndarray) -> Pieces:
        """The pieces after a step of their variables, with joints that are known."""
        (anchors, incoming, outgoing), cubics = moved_outline(
            self.joints, (self.anchors, self.incoming, self.outgoing), step
        )
        cubics.flags.writeable = False
        found = Pieces(anchors, incoming, outgoing, self.lines, self.smooth, self.level, self.tied)
        vars(found).update(joints=self.joints, cubics=cubics)
        return found


class Numbering:
    """The variables of some pieces, by number: `total` of them, -1 for none.

    angle, length_in, length_out: (A,) those of smooth joints. vector_in, vector_out: (A,) the first of two, of handles
    at corners. after_line, before_line: (A,) bool, smooth joints whose direction is that of a line.
    """

    def __init__(self, pieces: Pieces) -> None:
        self.tied = pieces.tied
        count, s = len(pieces.anchors), len(pieces.lines)
        before = (np.arange(count) - 1) % count
        has_in = pieces.closed | (np.arange(count) > 0)
        has_out = pieces.closed | (np.arange(count) < count - 1)
        line_in = has_in & pieces.lines[np.minimum(before, s - 1)]
        line_out = has_out & pieces.lines[np.minimum(np.arange(count), s - 1)]
        curve_in, curve_out = has_in & ~line_in, has_out & ~line_out
        smooth = pieces.smooth & ~(line_in & line_out)
        self.after_line = smooth & line_in & curve_out
        self.before_line = smooth & line_out & curve_in
        self.turning = smooth & ~line_in & ~line_out & ~pieces.level
        self.free_in, self.free_out = ~smooth & curve_in, ~smooth & curve_out
        self.long_in, self.long_out = smooth & curve_in, smooth & curve_out
        self.total = int(pieces.tied.max(initial=-1)) + 1
        self.angle = self._number(self.turning)
        self.length_in, self.length_out = self._number(self.long_in), self._number(self.long_out)
        self.vector_in, self.vector_out = self._number(self.free_in, 2), self._number(self.free_out, 2)

    def _number(self, where: np.ndarray, width: int = 1) -> np.ndarray:
        numbers = np.full(len(where), -1)
        numbers[where] = self.total + width * np.arange(int(where.sum()))
        self.total += width * int(where.sum())
        return numbers


class Variables:
    """The variables of some pieces where these lie."""

    def __init__(self, pieces: Pieces) -> None:
        self.pieces = pieces

    @cached_property
    def numbering(self) -> Numbering:
        """The numbers of the variables."""
        return Numbering(self.pieces)

    @property
    def total(self) -> int:
        """The number of variables."""
        return self.pieces.joints.variables

    @cached_property
    def direction(self) -> np.ndarray:
        """(A, 2) unit tangents of the smooth joints."""
        p, n = self.pieces, self.numbering
        d = np.where(n.long_out[:, None], p.outgoing, -p.incoming)
        both = n.long_in & n.long_out
        d[both] = p.outgoing[both] / _norm(p.outgoing[both]) - p.incoming[both] / _norm(p.incoming[both])
        line = p.anchors - np.roll(p.anchors, 1, axis=0)
        d = np.where(n.after_line[:, None], line, d)
        d = np.where(n.before_line[:, None], np.roll(line, -1, axis=0), d)
        return np.asarray(d / _norm(d))

    def jacobian(self) -> SparseRows:
        """(8 S, variables): how the control points move with the variables."""
        p = self.pieces
        values, columns, starts = outline_jacobian(p.joints, (p.anchors, p.incoming, p.outgoing))
        return SparseRows(starts, columns, values, self.total)

    def moved(self, step: np.ndarray) -> Pieces:
        """The pieces after a step of the variables (one 0 appended, for the fixed ones at index -1)."""
        return self.pieces.moved(step)


def _norm(vectors: np.ndarray) -> np.ndarray:
    return np.maximum(np.hypot(*vectors.T), 1e-12)[:, None]


@dataclass(frozen=True)
class Feet:
    """The places of n points: piece (n,) int and parameter (n,) in [0, 1]."""

    piece: np.ndarray
    u: np.ndarray


def feet_of(division: Division) -> Feet:
    """First parameters of the points of a division: evenly along its pieces."""
    sizes = division.sizes
    piece = np.repeat(np.arange(len(sizes)), sizes)
    place = np.arange(len(piece)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return Feet(piece, (place + 0.5) / sizes[piece])


def refine(
    pieces: Pieces, points: np.ndarray, weights: np.ndarray, feet: Feet, rounds: int = ROUNDS
) -> tuple[Pieces, Feet, float]:
    """The pieces nearest to the points, their feet, and chi^2 (with Huber's tails).

    points: (n, 2) px; weights: (n,) 1/px^2.
    """
    outline = (pieces.anchors, pieces.incoming, pieces.outgoing)
    (anchors, incoming, outgoing), (piece, u), chi = refined(
        pieces.joints, outline, points, weights, (feet.piece, feet.u), rounds
    )
    return replace(pieces, anchors=anchors, incoming=incoming, outgoing=outgoing), Feet(piece, u), chi
