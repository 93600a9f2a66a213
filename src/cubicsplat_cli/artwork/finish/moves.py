"""Moves of the finish: where the pixels ask for more than an outline's pieces can do, it gets a piece more, and a
primitive becomes a ring.

Every move is tried with a short finish, and kept only where the description of the picture becomes shorter: half of
chi^2 over the pixels that the outline crosses, plus a price for every parameter.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import summed
from cubicsplat_cli.artwork.finish.parameters import Constraints, Parameters, parametrised
from cubicsplat_cli.artwork.finish.state import WHITE, State
from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Rectangle, Ring, polygon_lengths
from cubicsplat_cli.record import record

PRICE = 4.0  # nats a parameter
FILL_PARAMETERS = 3.0  # of a new fill
SHAPE_PARAMETERS = 3.0  # of a shape besides its outlines'
# Half of chi^2 beyond what chance gives from which a piece is worth looking at; a pixel counts at most MOST_CHI.
WORTH, MOST_CHI = 12.0, 60.0
UNSEEN = 1e-7  # misfit by chance below which a shape hardly shows
NEAR = 2.5  # px: misfit within this of a joint is the joint's
CONCENTRATED = 0.5
LEAST_LENGTH = 3.0  # px of a piece that may be cut
# Half of the excess of chi^2 that a primitive's pixels must have on average: twice as much as by chance. Over the many
# pixels of a large circle even what one of its neighbours spoils is worth a ring's parameters.
CLEARLY = 0.5


@record
class Complaint:
    """Misfit of a piece's pixels. chi: half of the excess of chi^2; t: the parameter in its middle; start,
    end: the shares of it near the piece's ends."""

    chi: float
    t: float
    start: float
    end: float


def with_moves(state: State, constraints: Constraints, detail: float) -> dict[int, Parameters]:
    """The outlines that have a piece more, by number, wherever the pixels ask for one."""
    found, better = complaints(state), {}
    starts, marks = state.pieces.tolist(), state.marks.tolist()
    for k, outline in enumerate(state.outlines):
        own = {i - starts[k]: found[i] for i in range(starts[k], starts[k + 1]) if i in found}
        edited = _edited(outline, own, constraints, detail, marks[k + 1] - marks[k])
        if edited is not None:
            better[k] = edited
    return better


def complaints(state: State) -> dict[int, Complaint]:
    """The complaints against the pieces of a drawing, numbered through all its outlines."""
    c, count = state.crossings, int(state.pieces[-1])
    floor = _floor(state, slice(None))
    chi = np.where(floor > UNSEEN, np.minimum(state.misfit[c.pixel] / np.maximum(floor, UNSEEN), MOST_CHI) - 1.0, 0.0)
    lengths = polygon_lengths(np.concatenate([o.cubics for o in state.outlines]))
    along = c.t * lengths[c.piece]
    weight = np.maximum(chi, 0.0)

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(c.piece, values, count)

    excess, sums = 0.5 * total(chi), np.maximum(total(weight), 1e-12)
    middle, start = total(weight * c.t) / sums, total(weight * (along < NEAR)) / sums
    end = total(weight * (along > lengths[c.piece] - NEAR)) / sums
    return {
        int(i): Complaint(float(excess[i]), float(middle[i]), float(start[i]), float(end[i]))
        for i in np.flatnonzero(excess > 0.0)
    }


def _floor(state: State, own: slice) -> np.ndarray:
    """(m,) the misfit that the pixels of some crossings have by chance."""
    slopes = summed((state.crossings.slope[own] * WHITE) ** 2)
    return state.goal.share_error**2 * state.sharing * slopes + state.goal.error**2


def _edited(
    outline: Parameters, own: dict[int, Complaint], constraints: Constraints, detail: float, crossed: int
) -> Parameters | None:
    """The outline, which crosses so many pixels, with the moves that its complaints suggest, from the last piece on;
    None without any."""
    ring = outline.outline()
    if not isinstance(ring, Ring):
        other = as_path(ring, detail * sum(complaint.chi for complaint in own.values()), crossed)
        return None if other is None else parametrised(other, constraints)
    found = {i: complaint for i, complaint in own.items() if complaint.chi * detail > WORTH}
    done = ring
    joints: set[int] = set()
    for i in sorted(found, reverse=True):
        done = _move(done, i, found[i], joints)
    return None if done is ring else parametrised(done, constraints)


def as_path(shape: Circle | Ellipse | Rectangle, chi: float, crossed: int) -> Ring | None:
    """The ring to try in a primitive's place; None where all that its pixels hold against it, half of the excess of
    chi^2, is worth less than the ring's further parameters, or is little for the pixels crossed.

    Rectangles that stand level stay: drawing programs with few samples a pixel know their sides to a quarter of one,
    and sides that slant would fit that better than they fit the drawing.
    """
    if isinstance(shape, Rectangle) and shape.angle == 0.0:
        return None
    ring = shape.ring()
    return ring if chi > max(PRICE * (ring.parameters - shape.parameters), CLEARLY * crossed) else None


def _move(ring: Ring, i: int, complaint: Complaint, joints: set[int]) -> Ring:
    length = float(polygon_lengths(ring.cubics[[i]])[0])
    if max(complaint.start, complaint.end) > CONCENTRATED and length > 2.0 * NEAR:
        anchor = i if complaint.start >= complaint.end else (i + 1) % ring.pieces
        if anchor in joints or anchor == 0:
            return ring
        joints.add(anchor)
        if ring.smooth[anchor]:
            return cornered(ring, anchor)
        return rounded(ring, anchor, 2.0)
    if length < LEAST_LENGTH:
        return ring
    if ring.lines[i]:
        return curved(ring, i)
    return divided(ring, i, float(np.clip(complaint.t, 0.25, 0.75)))


def shorter(before: State, after: State, changed: np.ndarray, detail: float) -> np.ndarray:
    """(outlines,) bool: which changed outlines make the whole description longer rather than shorter."""
    worse, gained = np.zeros(len(changed), dtype=bool), gains(before, after, changed)
    for k in np.flatnonzero(changed):
        cost = PRICE * (after.outlines[k].outline().parameters - before.outlines[k].outline().parameters)
        worse[k] = gained[k] * detail < cost
    return worse


def gains(before: State, after: State, wanted: np.ndarray) -> np.ndarray:
    """(outlines,) by how much half of chi^2 falls on the pixels that some outlines (outlines,) bool cross before or
    after; 0 for the others."""
    found = -0.5 * before.growth(after, wanted)
    for k in np.flatnonzero(wanted).tolist():
        found[k] /= floor_of(before, k)
    return found


def floor_of(state: State, number: int) -> float:
    """The misfit of a pixel that an outline crosses by chance."""
    own = _floor(state, slice(state.marks[number], state.marks[number + 1]))
    return max(float(np.median(own)) if len(own) else 0.0, state.goal.share_error**2 * state.sharing * 1e-4)


def divided(ring: Ring, piece: int, t: float) -> Ring:
    """The same curve with a piece cut in two at a parameter, joined smoothly; of a line, both parts are lines."""
    a, b = _cut(ring.cubics[piece], t)
    anchors = np.insert(ring.anchors, piece + 1, a[3], axis=0)
    controls = np.insert(ring.controls, piece + 1, b[1:3], axis=0)
    controls[piece] = a[1:3]
    lines = np.insert(ring.lines, piece + 1, ring.lines[piece])
    return Ring(anchors, controls, lines, np.insert(ring.smooth, piece + 1, not ring.lines[piece]))


def curved(ring: Ring, piece: int) -> Ring:
    """The ring with a line made a cubic, straight to begin with, that turns at its ends as it likes."""
    return Ring(ring.anchors, ring.controls, ring.lines & (np.arange(ring.pieces) != piece), ring.smooth)


def cornered(ring: Ring, anchor: int) -> Ring:
    """The ring with a smooth joint made a corner."""
    return Ring(ring.anchors, ring.controls, ring.lines, ring.smooth & (np.arange(ring.pieces) != anchor))


def rounded(ring: Ring, anchor: int, reach: float) -> Ring:
    """The ring with a corner replaced by a cubic between points `reach` px before and after it, joined smoothly."""
    before, after = (anchor - 1) % ring.pieces, anchor
    cubics = ring.cubics
    first, _ = _cut(cubics[before], 1.0 - _parameter(cubics[before][::-1], reach))
    _, second = _cut(cubics[after], _parameter(cubics[after], reach))
    corner = ring.anchors[anchor]
    anchors, controls = ring.anchors.copy(), ring.controls.copy()
    controls[before] = first[1:3]
    controls[after] = second[1:3]
    anchors[anchor] = second[0]
    bend = np.stack([first[3] + (corner - first[3]) * 0.55, second[0] + (corner - second[0]) * 0.55])
    anchors = np.insert(anchors, anchor, first[3], axis=0)
    controls = np.insert(controls, anchor, bend, axis=0)
    smooth = ring.smooth.copy()
    smooth[anchor] = True
    return Ring(anchors, controls, np.insert(ring.lines, anchor, False), np.insert(smooth, anchor, True))


def _cut(cubic: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """The parts of a cubic (4, 2) before and after t, by de Casteljau's construction."""
    rows = [cubic]
    while len(rows[-1]) > 1:
        rows.append(rows[-1][:-1] * (1.0 - t) + rows[-1][1:] * t)
    return np.stack([row[0] for row in rows]), np.stack([row[-1] for row in rows[::-1]])


def _parameter(cubic: np.ndarray, reach: float) -> float:
    """The parameter at which a cubic is about `reach` px from its start, at most two fifths."""
    length = float(np.hypot(*np.diff(cubic, axis=0).T).sum())
    return min(reach / max(length, 1e-9), 0.4)
