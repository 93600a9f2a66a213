"""The free parameters of an outline: anchors, directions of smooth joints, handle lengths, handles at corners.

Which there are follows from what its joints are, and how its control points move with them from where they lie. The
former is found once for all places that an outline moves to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from cubicsplat_cli.raster.cubics import Joints

LARGEST_STEP = 3.0  # px
PAIR = np.array([0, 1])
LONGEST_HANDLE = 1.2  # of the distance between its piece's ends; longer ones do not grow


@dataclass(frozen=True)
class Pieces:
    """An outline being fitted: A anchors, S pieces (S = A when closed, else A - 1), piece i from anchor i on.

    anchors: (A, 2) px. incoming, outgoing: (A, 2) px, the handles of the piece before and after each anchor, relative
    to it. lines: (S,) bool. smooth: (A,) bool. level: (A,) bool, smooth anchors whose direction stays as it is.
    tied: (A, 2) int, the variable of each anchor coordinate, -1 for a fixed one. numbering: that of its variables,
    where it is known from pieces that they have moved from.
    """

    anchors: np.ndarray
    incoming: np.ndarray
    outgoing: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray
    level: np.ndarray
    tied: np.ndarray
    numbering: Numbering | None = None

    @property
    def closed(self) -> bool:
        """Whether the last piece returns to the first anchor."""
        return len(self.lines) == len(self.anchors)

    @property
    def ends(self) -> np.ndarray:
        """(S,) the anchor at which each piece ends."""
        return (np.arange(len(self.lines)) + 1) % len(self.anchors)

    @property
    def joints(self) -> Joints:
        """What stays of the pieces while they move."""
        return Joints(self.lines, self.smooth, self.level, self.tied)

    @cached_property
    def cubics(self) -> np.ndarray:
        """(S, 4, 2) control points, not to be written to; those of a line lie at its thirds."""
        count = len(self.lines)
        a, b = self.anchors[:count], self.anchors[self.ends]
        first = np.where(self.lines[:, None], a + (b - a) / 3.0, a + self.outgoing[:count])
        second = np.where(self.lines[:, None], b - (b - a) / 3.0, b + self.incoming[self.ends])
        found = np.stack([a, first, second, b], axis=1)
        found.flags.writeable = False
        return found


class Numbering:
    """The variables of some pieces, by number: `total` of them, -1 for none.

    angle, length_in, length_out: (A,) those of smooth joints. vector_in, vector_out: (A,) the first of two, of handles
    at corners. after_line, before_line: (A,) bool, smooth joints whose direction is that of a line.
    """

    def __init__(self, pieces: Pieces) -> None:
        self._of = (pieces.lines, pieces.smooth, pieces.level, pieces.tied)
        self.anchors, self.ends, self.tied = len(pieces.anchors), pieces.ends, pieces.tied
        count, s = self.anchors, len(pieces.lines)
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
        self.before, self.after = before, (np.arange(count) + 1) % count
        # (A, 2) the variables of handles at corners.
        self.pair_in, self.pair_out = (
            np.where(free[:, None], vector[:, None] + PAIR, -1)
            for free, vector in ((self.free_in, self.vector_in), (self.free_out, self.vector_out))
        )

    @classmethod
    def of(cls, pieces: Pieces) -> Numbering:
        """That of some pieces, the one that they know where their joints have not changed since."""
        known = pieces.numbering
        joints = (pieces.lines, pieces.smooth, pieces.level, pieces.tied)
        if known is not None and all(a is b for a, b in zip(known._of, joints, strict=True)):
            return known
        return cls(pieces)

    def _number(self, where: np.ndarray, width: int = 1) -> np.ndarray:
        numbers = np.full(len(where), -1)
        numbers[where] = self.total + width * np.arange(int(where.sum()))
        self.total += width * int(where.sum())
        return numbers

    @cached_property
    def handles(self) -> tuple[Handles, Handles]:
        """Those of the curves' starts and of their ends."""
        curve = np.flatnonzero(~self._of[0])
        ends = self.ends[curve]
        return (
            Handles(curve, 1, curve, (curve - 1) % self.anchors, self.after_line[curve], 1.0),
            Handles(curve, 2, ends, (ends + 1) % self.anchors, self.before_line[ends], -1.0),
        )

    @cached_property
    def pattern(self) -> Pattern:
        """Where the entries of the Jacobian matrix lie."""
        lines = self._of[0]
        start, end, line, curve = np.arange(len(lines)), self.ends, lines, ~lines
        rows, columns, shares = [], [], []

        def add(piece: np.ndarray, k: int, anchor: np.ndarray, share: float) -> None:
            rows.append((8 * piece[:, None] + 2 * k + PAIR).ravel())
            columns.append(self.tied[anchor].ravel())
            shares.append(np.full(2 * len(piece), share))

        add(start, 0, start, 1.0)
        add(start, 3, end, 1.0)
        for k, near, far in ((1, start, end), (2, end, start)):
            add(start[line], k, near[line], 2.0 / 3.0)
            add(start[line], k, far[line], 1.0 / 3.0)
            add(start[curve], k, near[curve], 1.0)
        numbers = ((self.length_out, self.vector_out), (self.length_in, self.vector_in))
        for handles, (lengths, vectors) in zip(self.handles, numbers, strict=True):
            own, anchor, tied = handles.rows, handles.anchor, handles.tied
            free = vectors[anchor, None]
            turned = np.repeat(own[tied, :, None], 2, axis=2)
            rows += [own.ravel(), own.ravel(), own.ravel(), turned.ravel(), turned.ravel()]
            columns += [
                np.where(free >= 0, free + PAIR, -1).ravel(),
                np.repeat(lengths[anchor], 2),
                np.repeat(self.angle[anchor], 2),
                np.repeat(self.tied[anchor[tied]], 2, axis=0).ravel(),
                np.repeat(self.tied[handles.other[tied]], 2, axis=0).ravel(),
            ]
        shape = (8 * len(lines), self.total)
        return Pattern.of(np.concatenate(rows), np.concatenate(columns), np.concatenate(shares), shape)


@dataclass(frozen=True)
class Handles:
    """One handle of every curve: control point k of `piece` (n,), at `anchor` (n,). other: (n,) the anchor on the
    other side; tied: (n,) bool, whether it is in line with that; sign: 1 where the handle goes out, -1 where in."""

    piece: np.ndarray
    k: int
    anchor: np.ndarray
    other: np.ndarray
    tied: np.ndarray
    sign: float

    @property
    def rows(self) -> np.ndarray:
        """(n, 2) of the Jacobian matrix."""
        return np.asarray(8 * self.piece[:, None] + 2 * self.k + PAIR)


@dataclass(frozen=True)
class Pattern:
    """Where the values of a sparse matrix belong of which some share a place, and the first are always the same.

    order: of the values that are known, by their place; starts: where those of each place begin; place: row times
    columns plus column; indices, indptr, shape: the matrix in compressed rows.
    """

    constant: np.ndarray
    order: np.ndarray
    starts: np.ndarray
    place: np.ndarray
    indices: np.ndarray
    indptr: np.ndarray
    shape: tuple[int, int]

    @classmethod
    def of(cls, rows: np.ndarray, columns: np.ndarray, constant: np.ndarray, shape: tuple[int, int]) -> Pattern:
        """That of values in these places; those in column -1 are none."""
        known = np.flatnonzero(columns >= 0)
        place = rows[known].astype(np.int64) * shape[1] + columns[known]
        order = np.argsort(place, kind="stable")
        place, starts = np.unique(place[order], return_index=True)
        indptr = np.searchsorted(place, np.arange(shape[0] + 1) * shape[1]).astype(np.int32)
        indices = (place % max(shape[1], 1)).astype(np.int32)
        return cls(constant, known[order], starts, place, indices, indptr, shape)

    def filled(self, values: list[np.ndarray]) -> sparse.csr_matrix:
        """The matrix with the values that are not always the same."""
        return sparse.csr_matrix((self._data(values), self.indices, self.indptr), shape=self.shape)

    def _data(self, values: list[np.ndarray]) -> np.ndarray:
        every = np.concatenate([self.constant, *values])[self.order]
        return np.add.reduceat(every, self.starts) if len(every) else every


class Variables:
    """The variables of some pieces where these lie."""

    def __init__(self, pieces: Pieces) -> None:
        self.pieces, self.numbering = pieces, Numbering.of(pieces)
        self.total = self.numbering.total

    @cached_property
    def direction(self) -> np.ndarray:
        """(A, 2) unit tangents of the smooth joints."""
        p, n = self.pieces, self.numbering
        d = np.where(n.long_out[:, None], p.outgoing, -p.incoming)
        both = n.long_in & n.long_out
        d[both] = p.outgoing[both] / _norm(p.outgoing[both]) - p.incoming[both] / _norm(p.incoming[both])
        line = p.anchors - p.anchors[n.before]
        d = np.where(n.after_line[:, None], line, d)
        d = np.where(n.before_line[:, None], line[n.after], d)
        return np.asarray(d / _norm(d))

    def jacobian(self) -> sparse.csr_matrix:
        """(8 S, variables): how the control points move with the variables."""
        return self.numbering.pattern.filled(self._by_handles())

    def _by_handles(self) -> list[np.ndarray]:
        outgoing, incoming = self.numbering.handles
        return [*self._by_handle(outgoing, self.pieces.outgoing), *self._by_handle(incoming, self.pieces.incoming)]

    def _by_handle(self, handles: Handles, own: np.ndarray) -> list[np.ndarray]:
        """How some handles (A, 2) move with their coordinates, length, angle, and with the line that they continue."""
        anchor, other, tied = handles.anchor, handles.other, handles.tied
        d = self.direction[anchor]
        across = np.stack([-d[:, 1], d[:, 0]], axis=1)
        size = np.hypot(*own[anchor].T)
        reach = np.hypot(*(self.pieces.anchors[anchor[tied]] - self.pieces.anchors[other[tied]]).T)
        lever = size[tied] / np.maximum(reach, 1e-6)
        turned = (lever[:, None, None] * across[tied][:, :, None] * across[tied][:, None, :]).ravel()
        along, round_about = handles.sign * d, handles.sign * size[:, None] * across
        return [np.ones(2 * len(anchor)), along.ravel(), round_about.ravel(), turned, -turned]

    def moved(self, step: np.ndarray) -> Pieces:
        """The pieces after a step of the variables (one 0 appended, for the fixed ones at index -1)."""
        p, n = self.pieces, self.numbering
        step = np.clip(step, -LARGEST_STEP, LARGEST_STEP)
        anchors = p.anchors + step[p.tied]
        came_in, came_out = np.hypot(*p.incoming.T), np.hypot(*p.outgoing.T)
        sizes_in = np.maximum(came_in + step[n.length_in], 0.2 * came_in)
        sizes_out = np.maximum(came_out + step[n.length_out], 0.2 * came_out)
        turn = np.clip(step[n.angle], -0.5, 0.5)
        cos, sin = np.cos(turn), np.sin(turn)
        d = self.direction
        d = np.stack([cos * d[:, 0] - sin * d[:, 1], sin * d[:, 0] + cos * d[:, 1]], axis=1)
        line = anchors - anchors[n.before]
        spans = np.hypot(*line.T)
        way = line / np.maximum(spans, 1e-12)[:, None]
        d = np.where(n.after_line[:, None], way, d)
        d = np.where(n.before_line[:, None], way[n.after], d)
        free_in = p.incoming + step[n.pair_in]
        free_out = p.outgoing + step[n.pair_out]
        incoming = np.where(n.long_in[:, None], -sizes_in[:, None] * d, free_in)
        outgoing = np.where(n.long_out[:, None], sizes_out[:, None] * d, free_out)
        incoming = _shortened(incoming, np.maximum(LONGEST_HANDLE * spans, came_in))
        outgoing = _shortened(outgoing, np.maximum(LONGEST_HANDLE * spans[n.after], came_out))
        return replace(p, anchors=anchors, incoming=incoming, outgoing=outgoing, numbering=n)


def _shortened(handles: np.ndarray, longest: np.ndarray) -> np.ndarray:
    return handles * np.minimum(1.0, longest[:, None] / _norm(handles))


def _norm(vectors: np.ndarray) -> np.ndarray:
    return np.maximum(np.hypot(*vectors.T), 1e-12)[:, None]
