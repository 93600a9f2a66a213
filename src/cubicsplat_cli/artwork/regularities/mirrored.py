"""Rings that are their own mirror image about an upright or a level axis: made of one half, and moved as such."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.finish.moves import divided
from cubicsplat_cli.artwork.finish.parameters import Constraints, ring_pieces
from cubicsplat_cli.artwork.geometry.outlines import Ring, points_at, thirds, with_thirds
from cubicsplat_cli.artwork.geometry.variables import Pieces
from cubicsplat_cli.artwork.regularities.ties import Tie, TiedRing, tie_matrix
from cubicsplat_cli.record import record

ON_AXIS = 1.0  # px: a lone anchor nearer than this to the axis is on it
SQUARE = 0.15  # tangent of the angle off square to the axis below which a smooth joint there is square
ONE_PIECE = 0.05  # px that one piece across the axis may be off the two that it stands for
_WITHIN = np.linspace(0.0, 1.0, 11)[1:-1]


@record
class Axis:
    """A line about which things are mirrored. across: the coordinate that changes, 0 for an upright axis, 1 for a level
    one; at: its place there, px."""

    across: int
    at: float

    def mirrored(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 2) on the other side."""
        out = np.array(points, dtype=float)
        out[..., self.across] = 2.0 * self.at - out[..., self.across]
        return out


@record
class MirroredRing:
    """A ring that is its own mirror image. partner: (A,) int, the anchor across the axis, or the same one on it."""

    ring: Ring
    axis: Axis
    partner: np.ndarray


def mirrored_rings(ring: Ring, axis: Axis) -> list[MirroredRing]:
    """The rings that either side of a ring and its mirror image make; none unless the axis is crossed just twice."""
    return [_whole(half, axis) for half in _opened(ring, axis)]


def _opened(ring: Ring, axis: Axis) -> list[Ring]:
    """The two sides of a ring, each with its first and last anchor on the axis; the piece that closes them is void."""
    side = ring.anchors[:, axis.across] - axis.at
    near = np.abs(side) < ON_AXIS
    near &= ~(np.roll(near, 1) | np.roll(near, -1))
    if _touches(ring, axis, side, near):
        return []
    on = set(np.flatnonzero(near).tolist())
    for i in reversed(range(len(side))):
        j = (i + 1) % len(side)
        if near[i] or near[j] or (side[i] > 0.0) == (side[j] > 0.0):
            continue
        ring = divided(ring, i, _crossing(ring.cubics[i][:, axis.across] - axis.at))
        on = {k + (k > i) for k in on} | {i + 1}
    if len(on) != 2:
        return []
    a, b = sorted(on)
    count = ring.pieces
    sides = [_turned(ring, np.arange(a, b + 1)), _turned(ring, np.arange(b, a + count + 1) % count)]
    beyond = [float(half.controls[:-1, :, axis.across].mean()) > axis.at for half in sides]
    return [_ended(half, axis) for half in sides] if beyond[0] != beyond[1] else []


def _touches(ring: Ring, axis: Axis, side: np.ndarray, near: np.ndarray) -> bool:
    """Whether a piece crosses the axis more often than its ends tell, or a line runs along it."""
    for i in range(ring.pieces):
        j = (i + 1) % ring.pieces
        if near[i] and near[j]:
            return True
        ends = [k for k in (i, j) if not near[k]]
        within = points_at(ring.cubics[i], _WITHIN)[:, axis.across] - axis.at
        if len(ends) == 2 and (side[i] > 0.0) != (side[j] > 0.0):
            beyond = np.concatenate([[side[i]], within, [side[j]]]) > 0.0
            if int((beyond[1:] != beyond[:-1]).sum()) != 1:
                return True
        elif (within * np.sign(side[ends[0]]) < -ON_AXIS).any():
            return True
    return False


def _crossing(values: np.ndarray) -> float:
    """The parameter at which a cubic with control values (4,) of which the ends differ in sign is zero."""
    low, high = 0.0, 1.0
    points = values[:, None]
    rising = values[3] > 0.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        if (points_at(points, np.array([middle]))[0, 0] > 0.0) == rising:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


def _turned(ring: Ring, order: np.ndarray) -> Ring:
    return Ring(ring.anchors[order], ring.controls[order], ring.lines[order], ring.smooth[order])


def _ended(half: Ring, axis: Axis) -> Ring:
    """A side with its ends brought onto the axis, and square to it where it is smooth there."""
    anchors, controls, smooth = half.anchors.copy(), half.controls.copy(), half.smooth.copy()
    along = 1 - axis.across
    for anchor, piece, k in ((0, 0, 0), (-1, -2, 1)):
        shift = axis.at - anchors[anchor, axis.across]
        anchors[anchor, axis.across] += shift
        controls[piece, k, axis.across] += shift
        way = np.abs(controls[piece, k] - anchors[anchor])
        smooth[anchor] = bool(smooth[anchor] and not half.lines[piece] and way[along] < SQUARE * way[axis.across])
        if smooth[anchor]:
            controls[piece, k, along] = anchors[anchor, along]
    return Ring(anchors, controls, half.lines.copy(), smooth)


def _whole(half: Ring, axis: Axis) -> MirroredRing:
    """A side, of which the first and the last anchor lie on the axis, and its mirror image."""
    m = half.pieces - 1
    other = _turned(half, np.arange(m, -1, -1))
    anchors = np.concatenate([half.anchors, axis.mirrored(other.anchors[1:m])])
    controls = np.concatenate([half.controls[:m], axis.mirrored(half.controls[:m][::-1, ::-1])])
    lines = np.concatenate([half.lines[:m], half.lines[:m][::-1]])
    smooth = np.concatenate([half.smooth, other.smooth[1:m]])
    partner = (2 * m - np.arange(2 * m)) % (2 * m)
    return _joined(MirroredRing(with_thirds(Ring(anchors, controls, lines, smooth)), axis, partner))


def _joined(found: MirroredRing) -> MirroredRing:
    """The ring without the anchors on its axis that one level line or one cubic across it does without."""
    for i in sorted(np.flatnonzero(found.partner == np.arange(found.ring.pieces)).tolist(), reverse=True):
        ring, along = found.ring, 1 - found.axis.across
        before = (i - 1) % ring.pieces
        start, end = ring.anchors[before], ring.anchors[(i + 1) % ring.pieces]
        if ring.pieces <= 3 or ring.lines[before] != ring.lines[i]:
            continue
        if ring.lines[i]:
            if abs(ring.anchors[i, along] - start[along]) > ONE_PIECE:
                continue
            (handles,) = thirds(start[None], end[None])
        else:
            first = _across(ring.cubics[before], found.axis) if ring.smooth[i] else None
            if first is None:
                continue
            handles = np.stack([first, found.axis.mirrored(first)])
        found = _without(found, i, handles)
    return found


def _across(cubic: np.ndarray, axis: Axis) -> np.ndarray | None:
    """(2,) the first handle of the cubic that runs on across the axis to the mirror image of its start; None where none
    is as near. cubic: (4, 2) up to the axis."""
    along = 1 - axis.across
    start, way = cubic[0], cubic[1] - cubic[0]
    rise = 4.0 / 3.0 * (cubic[3, along] - start[along])
    if abs(way[along]) < 1e-3 or rise / way[along] <= 0.0:
        return None
    handle = start + way * (rise / way[along])
    whole = np.stack([start, handle, axis.mirrored(handle), axis.mirrored(start)])
    fine = points_at(cubic, np.linspace(0.0, 1.0, 65))
    off = points_at(whole, np.linspace(0.0, 0.5, 9))[:, None] - fine
    return handle if np.hypot(*off.transpose(2, 0, 1)).min(axis=1).max() < ONE_PIECE else None


def _without(found: MirroredRing, i: int, handles: np.ndarray) -> MirroredRing:
    """The ring without an anchor on the axis; handles: (2, 2) of the piece that stands for both beside it."""
    ring, before = found.ring, (i - 1) % found.ring.pieces
    controls = ring.controls.copy()
    controls[before] = handles
    rest = np.arange(ring.pieces) != i
    number = np.cumsum(rest) - 1
    shorter = Ring(ring.anchors[rest], controls[rest], ring.lines[rest], ring.smooth[rest])
    return MirroredRing(shorter, found.axis, number[found.partner[rest]])


def mirrored_parameters(found: MirroredRing, constraints: Constraints) -> TiedRing:
    """A ring that is its own mirror image and stays so: the parametrisation of one half; the axis stays where it is."""
    pieces = ring_pieces(found.ring, constraints)
    return TiedRing(pieces, tie_matrix(pieces.joints.variables, _ties(pieces, found)))


def _ties(pieces: Pieces, found: MirroredRing) -> list[Tie]:
    """Pairs of a ring's numbers that are equal or opposite on both sides of its axis; a number fixed on one side is on
    both."""
    across, ties, tied, v = found.axis.across, [], pieces.tied, pieces.joints.numbers
    signs = np.where(np.arange(2) == across, -1.0, 1.0)
    for i, j in enumerate(found.partner.tolist()):
        ties += [(int(tied[i, c]), int(tied[j, c]), float(signs[c])) for c in (0, 1)]
        ties.append((int(v.angle[i]), int(v.angle[j]), -1.0))
        ties.append((int(v.length_out[i]), int(v.length_in[j]), 1.0))
        if v.vector_out[i] >= 0 and v.vector_in[j] >= 0:
            ties += [(int(v.vector_out[i]) + c, int(v.vector_in[j]) + c, float(signs[c])) for c in (0, 1)]
    return ties
