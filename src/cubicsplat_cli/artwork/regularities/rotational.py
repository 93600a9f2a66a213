"""Rings that are their own images by n-th parts of a turn, such as stars, crosses and gears: one part stands for all.

Seen from its middle a ring walked round at even steps is a row of complex numbers. By an n-th of a turn it becomes the
same row, an n-th of its length later, if and only if its Fourier coefficients vanish but for those of the frequencies
1 + k n: what the others hold says how far a ring is from that, for all n at once.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import RingParameters
from cubicsplat_cli.artwork.geometry.transforms import RigidTransform
from cubicsplat_cli.artwork.geometry.variables import Pieces
from cubicsplat_cli.artwork.regularities.alike import FEWEST, Track, nearest
from cubicsplat_cli.artwork.regularities.ties import constrained, tied_ring
from cubicsplat_cli.artwork.regularities.turned import MOST_PARTS, NEAR, STEPS, Walk
from cubicsplat_cli.record import record

# Px that a ring may be off itself in the root mean square: level edges are often known to a quarter of a pixel only,
# and come to lie on sloping ones.
ROUGHLY = 0.1


@record
class Rotation:
    """The turns by n-th parts about a middle (2,), px, by which a ring is its own image. parts: n."""

    parts: int
    middle: np.ndarray

    def transform(self, count: int) -> RigidTransform:
        """Return the transform by which a ring lies on itself in `count` parts."""
        turn = RigidTransform((1.0, 1.0), (0.0, 0.0), 2.0 * math.pi * count / self.parts)
        x, y = (self.middle - turn.points(self.middle)).tolist()
        return replace(turn, shift=(x, y))


def rotated(parameters: RingParameters, track: Track) -> RingParameters | None:
    """Return a ring that is its own image by parts of a turn, the smallest that it is, as one that stays so; None where
    it is none, or where what that saves might be chance. track: of the ring."""
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
        fit = nearest(np.array([walk.middle.real, walk.middle.imag]), partial(_distances, track, parts), ROUGHLY)
        ring = None if fit is None else rotational(parameters, Rotation(parts, fit.numbers))
        if ring is not None:
            saved = parameters.jacobian.shape[1] - ring.jacobian.shape[1]
            return ring if walk.is_certain(saved + 3, MOST_PARTS) else None
    return None


def _distances(track: Track, parts: int, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far an outline lies off itself by an n-th of a turn about a middle (2,), and the derivatives."""
    transform = Rotation(parts, middle).transform(1)
    off, ways = track.off(transform.points(track.seen))
    return off, ways @ (np.eye(2) - transform.matrix).T


def rotational(parameters: RingParameters, rotation: Rotation) -> RingParameters | None:
    """Return a ring that is brought to be its own image by parts of a turn and stays so, wherever its middle goes, with
    the ties that it has; None where these, or what is held, do not let it."""
    if parameters.ties is None:
        parameters = RingParameters(_freed(parameters.pieces, rotation.parts))
    ring = tied_ring(parameters)
    if ring is None:
        return None

    def missed(pieces: Pieces, middle: np.ndarray) -> np.ndarray:
        return _constraints(pieces, replace(rotation, middle=middle))[1]

    return constrained(ring, _constraints(ring.pieces, rotation)[0], missed, rotation.middle)


def _freed(pieces: Pieces, parts: int) -> Pieces:
    """Return the pieces with only those joints and lines held level that are so in all parts."""
    level = np.tile(pieces.level.reshape(parts, -1).all(axis=0), parts)
    tied = pieces.tied
    if 4 % parts:
        # A short line that seems level would turn all others with it.
        tied = np.where(tied < 0, -1, np.cumsum(tied.ravel() >= 0).reshape(tied.shape) - 1)
    return replace(pieces, level=level, tied=tied)


def _constraints(p: Pieces, rotation: Rotation) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of what is alike in all parts by the variables and by the x and y of the middle (rows,
    variables + 2), and (rows,) by how much, px and radians, each is off now."""
    n, numbers, total = rotation.parts, p.joints.numbers, p.joints.variables
    own = np.arange(len(p.anchors) // n)
    rows, off = [], []

    def add(ones: np.ndarray, others: np.ndarray, factors: np.ndarray, gap: np.ndarray) -> None:
        """Add that variables (m, c) are others (m, c) times a matrix (c, c), but for gaps (m, c); those below 0 are
        fixed.
        """
        for one, other, apart in zip(ones, others, gap, strict=True):
            for c in range(len(factors)):
                row = np.zeros(total + 3)  # the last entry stands for all that is fixed
                row[one[c]] += 1.0
                np.subtract.at(row, other, factors[:, c])
                rows.append(row[:-1])
                off.append(apart[c])

    for count in range(1, n):
        transform, there = rotation.transform(count), own + count * len(own)
        turn = transform.matrix
        first = len(rows)
        add(p.tied[there], p.tied[own], turn, p.anchors[there] - transform.points(p.anchors[own]))
        for row, c in zip(rows[first:], np.tile([0, 1], len(own)), strict=True):
            row[total:] -= (np.eye(2) - turn)[:, c]
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
