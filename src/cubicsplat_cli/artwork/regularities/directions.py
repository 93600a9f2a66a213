"""Lines at 45 degrees, or at 30 and 60: which lines of a drawing an artist drew so, and rings that keep them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from cubicsplat_cli.artwork.finish.merges import SEEN_SIGMA, Visibility
from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.regularities.ties import TiedRing, null_basis
from cubicsplat_cli.record import record

# Degrees of the lines that are sought together; level and upright ones are told where outlines are traced.
FAMILIES = ((45.0, 135.0), (30.0, 60.0, 120.0, 150.0))
SHORTEST = 4.0  # px of a line that tells its direction
SHOWN = 0.8  # share of a line that must show
# Px that one end of a line is off in its direction besides what its points tell, and the standard errors allowed.
SYSTEMATIC, SIGMAS = 0.01, 3.0
POINT = 0.5 * SEEN_SIGMA  # px, the standard error of a point of a straight line
OFTEN = 0.1  # share of a drawing's sloping lines that have the directions of a family, where the artist used it
CLEAR = 3.0  # nats by which a family must explain more than chance
LEVEL = 1e-6  # px
EXACT = 1e-9  # px by which a tied line may still be off


@record
class Slope:
    """A line of a ring in one of the directions. piece: its number; angle: radians."""

    piece: int
    angle: float


def found_slopes(rings: Mapping[int, tuple[Ring, Visibility]]) -> dict[int, list[Slope]]:
    """The lines of rings by number that are in the directions of a family, where the drawing has clearly more of these
    than chance would put there."""
    lines = [(k, *line) for k, (ring, visibility) in rings.items() for line in _sloping(ring, visibility)]
    found: dict[int, list[Slope]] = {}
    for family in FAMILIES:
        score, hits = 0.0, []
        for k, piece, length, angle in lines:
            allowed = SIGMAS * math.hypot(SYSTEMATIC, POINT * math.sqrt(12.0 / length))
            nearest = min(family, key=lambda degrees: _between(angle, math.radians(degrees)))
            hit = length * math.sin(_between(angle, math.radians(nearest))) <= allowed
            chance = min(len(family) * 2.0 * allowed / (math.pi * length), 1.0)
            score += math.log((OFTEN / chance if hit else 0.0) + 1.0 - OFTEN)
            hits += [(k, Slope(piece, math.radians(nearest)))] if hit else []
        if score > CLEAR:
            for k, slope in hits:
                found.setdefault(k, []).append(slope)
    return found


def _sloping(ring: Ring, visibility: Visibility) -> Iterable[tuple[int, float, float]]:
    """Number, length, px, and direction, radians, of the lines of a ring that show and slope."""
    ways = np.roll(ring.anchors, -1, axis=0) - ring.anchors
    for i in np.flatnonzero(ring.lines & (np.abs(ways) > LEVEL).all(axis=1)).tolist():
        length = float(np.hypot(*ways[i]))
        if length >= SHORTEST:
            weights = visibility.weights(i, (np.arange(math.ceil(length)) + 0.5) / math.ceil(length))
            if (weights > 0.5 * visibility.sigma**-2).mean() >= SHOWN:
                yield i, length, math.atan2(ways[i, 1], ways[i, 0])


def _between(one: float, other: float) -> float:
    """The angle between two lines, whichever way these run, 0 to pi / 2."""
    off = (one - other) % math.pi
    return min(off, math.pi - off)


def directed(ring: TiedRing, slopes: Iterable[Slope]) -> TiedRing | None:
    """A ring with some lines brought into their directions and kept there; None where other ties do not let them."""
    p = ring.pieces
    rows = []
    for slope in slopes:
        i, j = slope.piece, (slope.piece + 1) % len(p.anchors)
        across = _across(slope.angle)
        row = np.zeros(p.joints.variables + 1)
        # The last entry stands for all that is fixed.
        for c in (0, 1):
            row[p.tied[j, c]] += across[c]
            row[p.tied[i, c]] -= across[c]
        rows.append(row[:-1])
    matrix = np.array(rows) @ ring.ties.toarray()
    off = _off(p.anchors, slopes)
    step = np.linalg.lstsq(matrix, -off, rcond=None)[0]
    brought = ring.moved(step)
    if np.abs(_off(brought.pieces.anchors, slopes)).max() > EXACT:
        return None
    equations = [{int(k): float(row[k]) for k in np.flatnonzero(row)} for row in matrix]
    return TiedRing(brought.pieces, ring.ties.after(null_basis(ring.ties.shape[1], equations)))


def _across(angle: float) -> tuple[float, float]:
    """(2,) square to a direction, in whole numbers for 45 degrees."""
    x, y = -math.sin(angle), math.cos(angle)
    return (x, y) if abs(abs(x) - abs(y)) > EXACT else (math.copysign(1.0, x), math.copysign(1.0, y))


def _off(anchors: np.ndarray, slopes: Iterable[Slope]) -> np.ndarray:
    """(lines,) by how much, about px, lines between anchors (A, 2) miss their directions."""
    ways = np.roll(anchors, -1, axis=0) - anchors
    return np.array([ways[slope.piece] @ _across(slope.angle) for slope in slopes])


def has_diagonal(ring: Ring) -> bool:
    """Whether a line of a ring runs at 45 degrees exactly."""
    ways = np.abs(np.roll(ring.anchors, -1, axis=0) - ring.anchors)
    return bool((ring.lines & (np.abs(ways[:, 0] - ways[:, 1]) < EXACT) & (ways[:, 0] > LEVEL)).any())
