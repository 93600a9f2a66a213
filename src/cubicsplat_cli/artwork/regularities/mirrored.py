"""Rings that are their own mirror image about an upright or a level axis: made of one half, and moved as such."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.merges import SEEN_SIGMA
from cubicsplat_cli.artwork.finish.parameters import MEAN_ERROR, Constraints, RingParameters, ring_pieces
from cubicsplat_cli.artwork.geometry.fitting import SYSTEMATIC
from cubicsplat_cli.artwork.geometry.outlines import EXACT, Ring, divided, points_at, thirds, with_thirds
from cubicsplat_cli.artwork.geometry.steps import suggested_precision
from cubicsplat_cli.artwork.layers.translucent import SIGMAS
from cubicsplat_cli.artwork.regularities.alike import FEWEST, Track, lines_of
from cubicsplat_cli.raster.cubics import Pieces
from cubicsplat_cli.raster.sparse import SparseRows, linked_groups
from cubicsplat_cli.record import record

ON_AXIS = 1.0  # px: a lone anchor nearer than this to the axis is on it
SQUARE = 0.15  # tangent of the angle off square to the axis below which a smooth joint there is square
SAMPLES = 64  # of a cubic, between which nothing happens


@record
class Axis:
    """A line about which things are mirrored. across: the coordinate that changes, 0 for an upright axis, 1 for a level
    one; at: its place there, px, and its standard error."""

    across: int
    at: float
    error: float = 0.0

    def near(self, at: float) -> bool:
        """Return whether a place is within the errors of the axis."""
        return abs(self.at - at) <= SIGMAS * float(np.hypot(self.error, SYSTEMATIC))

    def mirrored(self, points: np.ndarray) -> np.ndarray:
        """Return points (..., 2) on the other side."""
        out = np.array(points, dtype=float)
        out[..., self.across] = 2.0 * self.at - out[..., self.across]
        return out


def axis_of(track: Track, across: int) -> Axis | None:
    """Return the axis across a coordinate about which an outline is mirrored; None without one, or if little tells."""
    if len(track.seen) < FEWEST:
        return None
    flips = np.where(np.arange(2) == across, -1.0, 1.0)[None]
    found = lines_of([track]).first_on(0, np.zeros(1, int), flips)
    if found is None:
        return None
    # Of a mirror image's shift, which is twice the axis's place, points tell on both sides of the axis.
    _, _, shift, told = found
    error = SEEN_SIGMA / float(np.sqrt(told[across]))
    return Axis(across, 0.5 * float(shift[across]), error) if told[across] >= 2.0 else None


def axes_of(tracks: Mapping[int, Track], size: tuple[int, int]) -> dict[int, Axis]:
    """Return the axes of outlines that are their own mirror images, by number, on half grid steps; size: canvas px."""
    found: dict[int, Axis] = {}
    for k, track in tracks.items():
        both = [axis for across in (0, 1) if (axis := axis_of(track, across)) is not None]
        if both:
            found[k] = min(both, key=lambda axis: axis.error)
    half_step = 0.5 * 10.0 ** -suggested_precision(*size)
    axes: dict[int, Axis] = {}
    for across in (0, 1):
        places = _shared({k: axis for k, axis in found.items() if axis.across == across}, 0.5 * size[across])
        axes |= {k: Axis(across, half_step * round(at / half_step)) for k, at in places.items()}
    return axes


def _shared(axes: dict[int, Axis], middle: float) -> dict[int, float]:
    """Return the places of axes: the middle of the canvas, or the mean of those that are one, the surest first."""
    rest = sorted(axes, key=lambda k: (axes[k].error, k))
    places = {k: middle for k in rest if axes[k].near(middle)}
    while rest := [k for k in rest if k not in places]:
        group = [k for k in rest if axes[k].near(axes[rest[0]].at)]
        weights = [axes[k].error ** -2 for k in group]
        places |= dict.fromkeys(group, float(np.average([axes[k].at for k in group], weights=weights)))
    return places


@record
class MirroredRing:
    """A ring that is its own mirror image. partner: (A,) int, the anchor across the axis, or the same one on it."""

    ring: Ring
    axis: Axis
    partner: np.ndarray


def mirrored_rings(ring: Ring, axis: Axis) -> list[MirroredRing]:
    """Return the rings that sides of a ring and their mirror images make; none unless the axis is crossed twice."""
    side = ring.anchors[:, axis.across] - axis.at
    near = np.abs(side) < ON_AXIS
    near &= ~(np.roll(near, 1) | np.roll(near, -1))
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
    # Each with its first and last anchor on the axis; the piece that closes it is void.
    sides = [ring.chosen(np.arange(a, b + 1)), ring.chosen(np.arange(b, a + count + 1) % count)]
    beyond = [float(half.controls[:-1, :, axis.across].mean()) > axis.at for half in sides]
    return [_whole(_ended(half, axis), axis) for half in sides] if beyond[0] != beyond[1] else []


def _crossing(values: np.ndarray) -> float:
    """Return the parameter at which a cubic with control values (4,), of which the ends differ in sign, is zero."""
    a, b, c, d = values
    roots = np.roots([d - 3.0 * c + 3.0 * b - a, 3.0 * (a - 2.0 * b + c), 3.0 * (b - a), a])
    inside = np.clip(roots.real, 0.0, 1.0)
    return float(inside[np.abs(roots - inside).argmin()])


def _ended(half: Ring, axis: Axis) -> Ring:
    """Return a side with its ends brought onto the axis, and square to it where it is smooth there."""
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
    """Return the ring of a side, of which the first and the last anchor lie on the axis, and its mirror image."""
    m = half.pieces - 1
    anchors = np.concatenate([half.anchors, axis.mirrored(half.anchors[-2:0:-1])])
    controls = np.concatenate([half.controls[:m], axis.mirrored(half.controls[:m][::-1, ::-1])])
    lines = np.concatenate([half.lines[:m], half.lines[:m][::-1]])
    smooth = np.concatenate([half.smooth, half.smooth[-2:0:-1]])
    partner = (2 * m - np.arange(2 * m)) % (2 * m)
    return _joined(MirroredRing(with_thirds(Ring(anchors, controls, lines, smooth)), axis, partner))


def _joined(found: MirroredRing) -> MirroredRing:
    """Return the ring without the anchors on its axis that one level line or one cubic across it does without."""
    for i in np.flatnonzero(found.partner == np.arange(found.ring.pieces))[::-1].tolist():
        ring, along = found.ring, 1 - found.axis.across
        before = (i - 1) % ring.pieces
        start, end = ring.anchors[before], ring.anchors[(i + 1) % ring.pieces]
        if ring.pieces <= 3 or ring.lines[before] != ring.lines[i]:
            continue
        if ring.lines[i]:
            if abs(ring.anchors[i, along] - start[along]) > MEAN_ERROR:
                continue
            (handles,) = thirds(start[None], end[None])
        else:
            first = _across(ring.cubics[before], found.axis) if ring.smooth[i] else None
            if first is None:
                continue
            handles = np.stack([first, found.axis.mirrored(first)])
        controls, rest = ring.controls.copy(), np.arange(ring.pieces) != i
        controls[before] = handles
        number = np.cumsum(rest) - 1
        found = MirroredRing(replace(ring, controls=controls).chosen(rest), found.axis, number[found.partner[rest]])
    return found


def _across(cubic: np.ndarray, axis: Axis) -> np.ndarray | None:
    """Return (2,) the first handle of the cubic that runs on across the axis to the mirror image of its start; None
    where none is as near. cubic: (4, 2) up to the axis.
    """
    along = 1 - axis.across
    start, way = cubic[0], cubic[1] - cubic[0]
    rise = 4.0 / 3.0 * (cubic[3, along] - start[along])
    if abs(way[along]) < 1e-3 or rise / way[along] <= 0.0:
        return None
    handle = start + way * (rise / way[along])
    whole = np.stack([start, handle, axis.mirrored(handle), axis.mirrored(start)])
    fine = points_at(cubic, np.linspace(0.0, 1.0, SAMPLES + 1))
    off = points_at(whole, np.linspace(0.0, 0.5, SAMPLES // 8 + 1))[:, None] - fine
    return handle if np.hypot(*off.transpose(2, 0, 1)).min(axis=1).max() < MEAN_ERROR else None


def as_mirrored(ring: Ring, axis: Axis, constraints: Constraints) -> RingParameters | None:
    """Return the parameters of a ring as its own mirror image, of the side with fewer variables; None where it cannot
    be one, or only with more than two further coordinates.
    """
    sides = [mirrored_parameters(one, constraints) for one in mirrored_rings(ring, axis)]
    short = [one for one in sides if one is not None and one.outline().coordinates <= ring.coordinates + 2]
    return min(short, key=lambda one: one.jacobian.count, default=None)


def mirrored_parameters(found: MirroredRing, constraints: Constraints) -> RingParameters | None:
    """Return the parameters of a ring that stays its own mirror image: those of one half. Its axis is fixed. None where
    it is none with what is held where it must be, such as the canvas's border.
    """
    pieces = ring_pieces(found.ring, constraints)
    if not np.abs(found.axis.mirrored(pieces.anchors)[found.partner] - pieces.anchors).max() < EXACT:
        return None
    return RingParameters(pieces, ties=null_basis(pieces.joints.variables, _equations(pieces, found)))


def _equations(pieces: Pieces, found: MirroredRing) -> Iterator[tuple[int, int, float]]:
    """Yield pairs of numbers across a ring's axis, -1 for a fixed one, and the factor, 1 or -1, between both."""
    tied, v = pieces.joints.tied, pieces.joints.numbers
    signs = np.where(np.arange(2) == found.axis.across, -1.0, 1.0)
    for i, j in enumerate(found.partner.tolist()):
        yield from ((tied[i, c], tied[j, c], signs[c]) for c in (0, 1))
        yield from ((v.angle[i], v.angle[j], -1.0), (v.length_out[i], v.length_in[j], 1.0))
        if v.vector_out[i] >= 0 and v.vector_in[j] >= 0:
            yield from ((v.vector_out[i] + c, v.vector_in[j] + c, signs[c]) for c in (0, 1))


def null_basis(count: int, equations: Iterable[tuple[int, int, float]]) -> SparseRows:
    """Return (count, free) how `count` variables follow from the free ones, the first of those that are equal or
    opposite; equations: two variables, -1 for one that is zero, and the factor, 1 or -1, by which each is the other.
    """
    # Node 2 k stands for variable k, node 2 k + 1 for its opposite; the last two for zero, which is its own opposite.
    zero = 2 * count
    links = [(zero, zero + 1)]
    for one, other, sign in equations:
        i, j = (zero if variable < 0 else 2 * variable for variable in (one, other))
        links += [(i, j + (sign < 0.0)), (i + 1, j + (sign > 0.0))]
    _, groups = linked_groups(zero + 2, *np.array(links).T)
    # What is its own opposite is zero.
    rows = np.flatnonzero(groups[:zero:2] != groups[1:zero:2])
    first = np.unique(groups, return_index=True)[1][groups[2 * rows]]
    free, columns = np.unique(first // 2, return_inverse=True)
    return SparseRows.of(rows, columns, 1.0 - 2.0 * (first % 2), (count, len(free)))
