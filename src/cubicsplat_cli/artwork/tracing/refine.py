"""All anchors, tangents and handles of an outline together, fitted to its points by damped Gauss-Newton.

Only distances along the normal count. Joints stay as they are: smooth ones share a direction (that of the line, where
one side is a line), corners do not. Points pass to the neighbouring piece when their foot does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cubicsplat_cli.artwork.tracing.cubics import basis, derivatives, nearer, point

HUBER = 3.0  # sigmas beyond which a residual counts linearly
ROUNDS = 8
ENOUGH = 0.01  # relative gain of a round below which the fit has converged
LARGEST_STEP = 3.0  # px
STIFFNESS = 0.3  # 1/px^2, against steps that the points do not call for
MOST_DENSE = 64  # variables
PAIR = np.array([0, 1])
LONGEST_HANDLE = 1.2  # of the distance between its piece's ends; longer ones do not grow


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

    @property
    def cubics(self) -> np.ndarray:
        """(S, 4, 2) control points; those of a line lie at its thirds."""
        count = len(self.lines)
        a, b = self.anchors[:count], self.anchors[self.ends]
        first = np.where(self.lines[:, None], a + (b - a) / 3.0, a + self.outgoing[:count])
        second = np.where(self.lines[:, None], b - (b - a) / 3.0, b + self.incoming[self.ends])
        return np.stack([a, first, second, b], axis=1)


@dataclass(frozen=True)
class Feet:
    """Where n points belong: piece (n,) int and parameter (n,) in [0, 1]."""

    piece: np.ndarray
    u: np.ndarray


def huber(residuals: np.ndarray, weights: np.ndarray) -> float:
    """Twice the negative log-likelihood: squares up to HUBER sigmas, linear beyond."""
    z = np.abs(residuals) * np.sqrt(weights)
    return float(np.where(z <= HUBER, z * z, HUBER * (2.0 * z - HUBER)).sum())


def settle(pieces: Pieces, points: np.ndarray, feet: Feet, rounds: int = 2) -> Feet:
    """The feet of the points, moved on to the neighbouring piece where they left their own."""
    count, ends = len(pieces.lines), pieces.ends
    cubics, piece, u = pieces.cubics, feet.piece, feet.u
    for _ in range(rounds):
        u = nearer(cubics[piece], points[:, None], u[:, None])[:, 0]
        on = (u > 1.0) & pieces.smooth[ends[piece]]
        back = (u < 0.0) & pieces.smooth[piece]
        piece = (piece + on.astype(int) - back) % count
        u = np.clip(np.where(on, 0.0, np.where(back, 1.0, u)), 0.0, 1.0)
    return Feet(piece, u)


def residuals(pieces: Pieces, points: np.ndarray, feet: Feet) -> tuple[np.ndarray, np.ndarray]:
    """((n,) signed distances along the normal, px, (n, 2) unit normals)."""
    own = pieces.cubics[feet.piece]
    first, _ = derivatives(own, feet.u[:, None])
    speed = np.maximum(np.hypot(first[:, 0, 0], first[:, 0, 1]), 1e-9)
    normals = np.stack([-first[:, 0, 1], first[:, 0, 0]], axis=1) / speed[:, None]
    rest = point(own, feet.u[:, None])[:, 0] - points
    return (rest * normals).sum(1), normals


def refine(pieces: Pieces, points: np.ndarray, weights: np.ndarray, feet: Feet) -> tuple[Pieces, Feet, float]:
    """The pieces nearest to the points, their feet, and chi^2 (with Huber's tails).

    points: (n, 2) px; weights: (n,) 1/px^2.
    """
    pieces = joined_smoothly(pieces)
    feet = settle(pieces, points, feet)
    rest, normals = residuals(pieces, points, feet)
    best = huber(rest, weights)
    damping = 1e-3
    for _ in range(ROUNDS):
        gram, slope = _normal_equations(pieces, feet, rest, normals, weights)
        variables, system, slope = _reduced(pieces, gram, slope)
        improved = False
        for _ in range(4):
            trial = variables.moved(_step(system, slope, damping))
            trial_feet = settle(trial, points, feet)
            trial_rest, trial_normals = residuals(trial, points, trial_feet)
            value = huber(trial_rest, weights)
            if value < best:
                improved = True
                break
            damping *= 8.0
        if not improved:
            break
        gain = best - value
        pieces, feet, rest, normals, best = trial, trial_feet, trial_rest, trial_normals, value
        damping = max(damping / 5.0, 1e-6)
        if gain < ENOUGH * best + 0.05:
            break
    return pieces, feet, best


def joined_smoothly(pieces: Pieces) -> Pieces:
    """The pieces with the handles at smooth joints turned into one direction, that of the line where there is one."""
    variables = Variables(pieces)
    return variables.moved(np.zeros(variables.total + 1))


def _normal_equations(
    pieces: Pieces, feet: Feet, rest: np.ndarray, normals: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gram matrices (S, 8, 8) and gradients (S, 8) over the 8 coordinates of each piece's control points."""
    z = np.abs(rest) * np.sqrt(weights)
    w = weights * np.minimum(1.0, HUBER / np.maximum(z, 1e-12))
    rows = (basis(feet.u)[:, :, None] * normals[:, None, :]).reshape(-1, 8)
    count = len(pieces.lines)
    gram = np.zeros((count, 8, 8))
    np.add.at(gram, feet.piece, w[:, None, None] * rows[:, :, None] * rows[:, None, :])
    slope = np.zeros((count, 8))
    np.add.at(slope, feet.piece, (w * rest)[:, None] * rows)
    return gram, slope


def _reduced(pieces: Pieces, gram: np.ndarray, slope: np.ndarray) -> tuple[Variables, sparse.csc_matrix, np.ndarray]:
    """The variables, and the Gram matrix and gradient over them."""
    variables = Variables(pieces)
    jacobian = variables.jacobian()
    count = len(gram)
    blocks = sparse.bsr_matrix((gram, np.arange(count), np.arange(count + 1)), shape=(8 * count, 8 * count))
    return variables, (jacobian.T @ (blocks.tocsr() @ jacobian)).tocsc(), jacobian.T @ slope.ravel()


def _step(system: sparse.csc_matrix, slope: np.ndarray, damping: float) -> np.ndarray:
    diagonal = system.diagonal()
    added = damping * (diagonal + 1e-4 * diagonal.max(initial=0.0)) + STIFFNESS
    if len(slope) <= MOST_DENSE:
        dense = system.toarray()
        dense[np.diag_indices_from(dense)] += added
        return np.append(np.linalg.solve(dense, -slope), 0.0)
    return np.append(splu(system + sparse.diags(added, format="csc")).solve(-slope), 0.0)


class Variables:
    """The free parameters of some pieces: anchors, directions of smooth joints, handle lengths, handles at corners."""

    def __init__(self, pieces: Pieces) -> None:
        self.pieces = pieces
        count = len(pieces.anchors)
        s = len(pieces.lines)
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
        self.direction = self._directions()

    def _number(self, where: np.ndarray, width: int = 1) -> np.ndarray:
        numbers = np.full(len(where), -1)
        numbers[where] = self.total + width * np.arange(int(where.sum()))
        self.total += width * int(where.sum())
        return numbers

    def _directions(self) -> np.ndarray:
        """(A, 2) unit tangents of the smooth joints."""
        p = self.pieces
        d = np.where(self.long_out[:, None], p.outgoing, -p.incoming)
        both = self.long_in & self.long_out
        d[both] = p.outgoing[both] / _norm(p.outgoing[both]) - p.incoming[both] / _norm(p.incoming[both])
        line = p.anchors - np.roll(p.anchors, 1, axis=0)
        d = np.where(self.after_line[:, None], line, d)
        d = np.where(self.before_line[:, None], np.roll(line, -1, axis=0), d)
        return d / _norm(d)

    def jacobian(self) -> sparse.csr_matrix:
        """(8 S, variables): how the control points move with the variables."""
        p = self.pieces
        start, end = np.arange(len(p.lines)), p.ends
        self.entries: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        every, curve, line = slice(None), ~p.lines, p.lines
        self._anchor(start[every], 0, start, 1.0)
        self._anchor(start[every], 3, end, 1.0)
        for k, near, far in ((1, start, end), (2, end, start)):
            self._anchor(start[line], k, near[line], 2.0 / 3.0)
            self._anchor(start[line], k, far[line], 1.0 / 3.0)
            self._anchor(start[curve], k, near[curve], 1.0)
        self._handle(start[curve], 1, start[curve], p.outgoing, self.length_out, self.vector_out, 1.0)
        self._handle(start[curve], 2, end[curve], p.incoming, self.length_in, self.vector_in, -1.0)
        rows, columns, values = (np.concatenate(part) for part in zip(*self.entries, strict=True))
        known = columns >= 0
        shape = (8 * len(p.lines), self.total)
        return sparse.csr_matrix((values[known], (rows[known], columns[known])), shape=shape)

    def _add(self, rows: np.ndarray, columns: np.ndarray, values: np.ndarray | float) -> None:
        columns, values = np.broadcast_to(columns, rows.shape), np.broadcast_to(values, rows.shape)
        self.entries.append((rows.ravel(), columns.ravel(), values.ravel()))

    def _anchor(self, piece: np.ndarray, k: int, anchor: np.ndarray, factor: float) -> None:
        self._add(8 * piece[:, None] + 2 * k + PAIR, self.pieces.tied[anchor], factor)

    def _handle(
        self,
        piece: np.ndarray,
        k: int,
        anchor: np.ndarray,
        handles: np.ndarray,
        lengths: np.ndarray,
        vectors: np.ndarray,
        sign: float,
    ) -> None:
        """Control point k of some pieces, by the handle at its anchor; sign: 1 if outgoing, -1 if incoming."""
        d = self.direction[anchor]
        across = np.stack([-d[:, 1], d[:, 0]], axis=1)
        size = np.hypot(*handles[anchor].T)
        rows = 8 * piece[:, None] + 2 * k + PAIR
        free = vectors[anchor, None]
        self._add(rows, np.where(free >= 0, free + PAIR, -1), 1.0)
        self._add(rows, lengths[anchor, None], sign * d)
        self._add(rows, self.angle[anchor, None], sign * size[:, None] * across)
        other = anchor - 1 if sign > 0 else (anchor + 1) % len(self.pieces.anchors)
        tied = self.after_line[anchor] if sign > 0 else self.before_line[anchor]
        anchor, other, across = anchor[tied], other[tied], across[tied]
        reach = np.hypot(*(self.pieces.anchors[anchor] - self.pieces.anchors[other]).T)
        lever = size[tied] / np.maximum(reach, 1e-6)
        values = lever[:, None, None] * across[:, :, None] * across[:, None, :]
        rows = np.repeat(rows[tied, :, None], 2, axis=2)
        self._add(rows, self.pieces.tied[anchor][:, None, :], values)
        self._add(rows, self.pieces.tied[other][:, None, :], -values)

    def moved(self, step: np.ndarray) -> Pieces:
        """The pieces after a step of the variables (one 0 appended, for the fixed ones at index -1)."""
        p = self.pieces
        step = np.clip(step, -LARGEST_STEP, LARGEST_STEP)
        anchors = p.anchors + step[p.tied]
        sizes_in = np.hypot(*p.incoming.T)
        sizes_out = np.hypot(*p.outgoing.T)
        sizes_in = np.maximum(sizes_in + step[self.length_in], 0.2 * sizes_in)
        sizes_out = np.maximum(sizes_out + step[self.length_out], 0.2 * sizes_out)
        turn = np.clip(step[self.angle], -0.5, 0.5)
        cos, sin = np.cos(turn), np.sin(turn)
        d = self.direction
        d = np.stack([cos * d[:, 0] - sin * d[:, 1], sin * d[:, 0] + cos * d[:, 1]], axis=1)
        line = anchors - np.roll(anchors, 1, axis=0)
        d = np.where(self.after_line[:, None], line / _norm(line), d)
        onward = np.roll(line, -1, axis=0)
        d = np.where(self.before_line[:, None], onward / _norm(onward), d)
        free_in = p.incoming + step[np.where(self.free_in[:, None], self.vector_in[:, None] + PAIR, -1)]
        free_out = p.outgoing + step[np.where(self.free_out[:, None], self.vector_out[:, None] + PAIR, -1)]
        incoming = np.where(self.long_in[:, None], -sizes_in[:, None] * d, free_in)
        outgoing = np.where(self.long_out[:, None], sizes_out[:, None] * d, free_out)
        spans = np.hypot(*line.T)
        incoming = _shortened(incoming, np.maximum(LONGEST_HANDLE * spans, np.hypot(*p.incoming.T)))
        outgoing = _shortened(outgoing, np.maximum(LONGEST_HANDLE * np.roll(spans, -1), np.hypot(*p.outgoing.T)))
        return replace(p, anchors=anchors, incoming=incoming, outgoing=outgoing)


def _shortened(handles: np.ndarray, longest: np.ndarray) -> np.ndarray:
    return handles * np.minimum(1.0, longest[:, None] / _norm(handles))


def _norm(vectors: np.ndarray) -> np.ndarray:
    return np.maximum(np.hypot(*vectors.T), 1e-12)[:, None]
