"""Rings that are their own images by n-th parts of a turn, such as stars, crosses and gears: one part stands for all.

Seen from its middle a ring walked round at even steps is a row of complex numbers. By an n-th of a turn it becomes the
same row, an n-th of its length later, if and only if its Fourier coefficients vanish but for those of the frequencies
1 + k n: what the others hold says how far a ring is from that, for all n at once.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import RingParameters
from cubicsplat_cli.artwork.geometry.transforms import RigidTransform
from cubicsplat_cli.artwork.geometry.variables import Pieces
from cubicsplat_cli.artwork.regularities.alike import FARTHEST, FEWEST, LARGEST, TRIES, Track
from cubicsplat_cli.artwork.regularities.ties import EXACT, LEAST, TiedRing, null_basis
from cubicsplat_cli.artwork.regularities.turned import MOST_PARTS, NEAR, STEPS, Walk
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.record import record

# Px that a ring may be off itself in the root mean square: level edges are often known to a quarter of a pixel only,
# and come to lie on sloping ones.
ROUGHLY = 0.1


@record
class Rotation:
    """That a ring is its own image by each n-th part of a turn about a middle (2,), px. parts: n."""

    parts: int
    middle: np.ndarray

    def transform(self, count: int) -> RigidTransform:
        """The correspondence by which a ring lies on itself in `count` parts."""
        turn = RigidTransform((1.0, 1.0), (0.0, 0.0), 2.0 * math.pi * count / self.parts)
        x, y = (self.middle - turn.points(self.middle)).tolist()
        return replace(turn, shift=(x, y))


def rotated(parameters: RingParameters | TiedRing, track: Track) -> TiedRing | None:
    """A ring that is its own image by parts of a turn, the smallest that it is, as one that stays so; None where it is
    none, or where what that saves might be chance. track: of the ring."""
    count = len(parameters.pieces.anchors)
    if len(track.seen) < FEWEST:
        return None
    walk = Walk.of(track)
    power = np.abs(walk.waves / STEPS) ** 2
    beyond = np.fft.fftfreq(STEPS, 1.0 / STEPS).astype(int) - 1
    for parts in range(min(MOST_PARTS, count), 1, -1):
        if count % parts or power[beyond % parts != 0].sum() > NEAR**2:
            continue
        # Pieces and joints are of the same kinds in all parts.
        kinds = np.stack([parameters.pieces.lines, parameters.pieces.smooth]).reshape(2, parts, -1)
        if (kinds != kinds[:, :1]).any():
            continue
        middle = _middle(track, parts, np.array([walk.middle.real, walk.middle.imag]))
        found = None if middle is None else rotational(parameters, Rotation(parts, middle))
        if found is not None:
            saved = parameters.jacobian.shape[1] - found.jacobian.shape[1]
            return found if walk.is_certain(saved + 3, MOST_PARTS) else None
    return None


def _middle(track: Track, parts: int, middle: np.ndarray) -> np.ndarray | None:
    """(2,) the middle about which an outline lies nearest to itself by an n-th of a turn; None where it lies not near
    enough. middle: where to begin."""
    for left in reversed(range(TRIES + 1)):
        transform = Rotation(parts, middle).transform(1)
        size, ways = track.off(transform.points(track.seen))
        if size.max() > LARGEST:
            return None
        if left:
            rows = ways @ (np.eye(2) - transform.matrix).T
            middle = middle - np.linalg.solve(rows.T @ rows + 1e-6 * np.eye(2), rows.T @ size)
    return middle if size.max() <= FARTHEST and np.sqrt((size**2).mean()) <= ROUGHLY else None


def rotational(parameters: RingParameters | TiedRing, rotation: Rotation) -> TiedRing | None:
    """A ring that is brought to be its own image by parts of a turn and stays so, wherever its middle goes, with the
    ties that it has; None where these, or what is held, do not let it."""
    if isinstance(parameters, RingParameters):
        pieces = _freed(parameters.pieces, rotation.parts)
        ring = TiedRing(pieces, SparseRows.identity(pieces.joints.variables))
    else:
        ring = parameters
    count = ring.ties.shape[1]
    rows, off = _constraints(ring.pieces, rotation)
    # Behind the free variables of the ring come the x and y of the middle.
    matrix = np.hstack([rows[:, :-3] @ ring.ties.toarray(), rows[:, -2:]])
    step = np.linalg.lstsq(matrix, -off, rcond=None)[0]
    brought = ring.moved(step[:count])
    at = replace(rotation, middle=rotation.middle + step[count:])
    if np.abs(_constraints(brought.pieces, at)[1]).max() > EXACT:
        return None
    equations = [{int(k): float(row[k]) for k in np.flatnonzero(np.abs(row) > LEAST)} for row in matrix]
    basis = null_basis(count + 2, equations)
    return TiedRing(brought.pieces, ring.ties.after(basis))


def _freed(pieces: Pieces, parts: int) -> Pieces:
    """The pieces with only those joints and lines held level that are so in all parts."""
    level = np.tile(pieces.level.reshape(parts, -1).all(axis=0), parts)
    tied = pieces.tied
    if 4 % parts:
        # A short line that seems level would turn all others with it.
        tied = np.where(tied < 0, -1, np.cumsum(tied.ravel() >= 0).reshape(tied.shape) - 1)
    return replace(pieces, level=level, tied=tied)


def _constraints(p: Pieces, rotation: Rotation) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of what is alike in all parts by the variables (rows, variables + 3), behind which come one for all
    that is fixed and the x and y of the middle, and (rows,) by how much, px and radians, each is off now."""
    n, numbers, total = rotation.parts, p.joints.numbers, p.joints.variables
    own = np.arange(len(p.anchors) // n)
    rows, off = [], []

    def add(ones: np.ndarray, others: np.ndarray, factors: np.ndarray, gap: np.ndarray) -> None:
        """Variables (m, c) are others (m, c) times a matrix (c, c), but for gaps (m, c); those below 0 are fixed."""
        for one, other, apart in zip(ones, others, gap, strict=True):
            for c in range(len(factors)):
                row = np.zeros(total + 3)
                row[one[c] if one[c] >= 0 else total] += 1.0
                for k, number in enumerate(other):
                    row[number if number >= 0 else total] -= factors[k, c]
                rows.append(row)
                off.append(apart[c])

    for count in range(1, n):
        transform, there = rotation.transform(count), own + count * len(own)
        turn = transform.matrix
        first = len(rows)
        add(p.tied[there], p.tied[own], turn, p.anchors[there] - transform.points(p.anchors[own]))
        for row, c in zip(rows[first:], np.tile([0, 1], len(own)), strict=True):
            row[-2:] -= (np.eye(2) - turn)[:, c]
        one = np.eye(1)
        curved = numbers.angle[own] >= 0
        headings = [np.arctan2(*p.directions[k[curved]].T[::-1]) for k in (there, own)]
        gap = np.mod(headings[0] - headings[1] - 2.0 * math.pi * count / n + math.pi, 2.0 * math.pi) - math.pi
        add(numbers.angle[there[curved], None], numbers.angle[own[curved], None], one, gap[:, None])
        for handles, lengths, vectors in (
            (p.incoming, numbers.length_in, numbers.vector_in),
            (p.outgoing, numbers.length_out, numbers.vector_out),
        ):
            k, sizes = lengths[own] >= 0, np.hypot(*handles.T)
            add(lengths[there[k], None], lengths[own[k], None], one, (sizes[there[k]] - sizes[own[k]])[:, None])
            k = vectors[own] >= 0
            gap = handles[there[k]] - handles[own[k]] @ turn
            add(vectors[there[k], None] + np.arange(2), vectors[own[k], None] + np.arange(2), turn, gap)
    return np.array(rows), np.array(off)
