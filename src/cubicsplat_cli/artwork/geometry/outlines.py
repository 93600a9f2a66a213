"""Outlines of artwork: rings of lines and cubics, the primitives that an artist would write as such, and
cubics at parameters, by Bernstein's polynomials and de Casteljau's differences.

Lengths are in px, y grows downwards, angles are in radians from the x axis towards the y axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cubicsplat_cli.artwork.channels import summed

FINE = 16  # cubics of a whole turn, true to 1e-7 of its radius
EXACT = 1e-6  # px by which what is level, or alike and held so, may be off
_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])  # of a box, clockwise as seen
# Green's theorem for a cubic in Bernstein form: what x of one control point and y of another add to the area.
_GREEN = np.array([[0, 6, 3, 1], [-6, 0, 3, 3], [-3, -3, 0, 6], [-1, -3, -6, 0]]) / 20.0


@dataclass(frozen=True)
class Ring:
    """A closed ring of lines and cubics; piece i runs from anchor i to anchor i + 1, the last one to anchor 0.

    anchors: (A, 2) float64 px, A >= 1. controls: (A, 2, 2) float64, the two inner control points of piece i; of a line
    they lie at its thirds. lines: (A,) bool, which pieces are straight. smooth: (A,) bool, at which anchors the
    tangent is continuous (G1). otherwise: a closer ring along the same points, of more pieces, where this one lies off
    them or crosses itself.
    """

    anchors: np.ndarray
    controls: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray
    otherwise: Ring | None = None

    @property
    def pieces(self) -> int:
        """A, the number of lines and cubics."""
        return len(self.anchors)

    @property
    def cubics(self) -> np.ndarray:
        """(A, 4, 2) the control points of every piece, ends included."""
        out = np.empty((len(self.anchors), 4, 2), np.result_type(self.anchors, self.controls))
        out[:, 0], out[:, 1:3] = self.anchors, self.controls
        out[:-1, 3], out[-1, 3] = self.anchors[1:], self.anchors[0]
        return out

    @property
    def coordinates(self) -> int:
        """Numbers in its path data: 2 to start, 6 a cubic, 2 a line (1 along an axis, 0 for the closing)."""
        numbers = path_numbers(following(self.anchors) - self.anchors, self.lines)
        return 2 + int(numbers[: -1 if self.lines[-1] else None].sum())

    @property
    def parameters(self) -> int:
        """Degrees of freedom: 2 an anchor, 4 a cubic, less 1 for every smooth joint."""
        return 2 * self.pieces + 4 * int((~self.lines).sum()) - int(self.smooth.sum())

    def ring(self, _arcs: int = 4) -> Ring:
        """Return the ring itself."""
        return self

    def chosen(self, which: np.ndarray) -> Ring:
        """Return the ring of some pieces, by their numbers or as (A,) bool, each from the anchor at its start on."""
        return Ring(self.anchors[which], self.controls[which], self.lines[which], self.smooth[which])


def path_numbers(steps: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Return the count (S,) of numbers in the path data of pieces whose ends are steps (S, 2) apart; lines: bool."""
    return np.where(lines, np.where((np.abs(steps) < 1e-9).any(axis=1), 1, 2), 6)


def pieces_of_rings(rings: Sequence[Ring]) -> tuple[np.ndarray, np.ndarray]:
    """The cubics (S, 4, 2) of one or more rings, one ring after the other, and which of them are lines (S,) bool."""
    return np.concatenate([ring.cubics for ring in rings]), np.concatenate([ring.lines for ring in rings])


def level_box(ring: Ring, off: float = 0.0) -> Rectangle | None:
    """The level rectangle that a ring of four lines is, `off` px about its corners; None where it is none."""
    if ring.pieces != 4 or not ring.lines.all():
        return None
    low, high = ring.anchors.min(axis=0), ring.anchors.max(axis=0)
    sides = np.abs(np.roll(ring.anchors, -1, axis=0) - ring.anchors)
    across = sides.argmin(axis=1)
    level = sides.min(axis=1).max() <= off and (sides.max(axis=1) > off).all() and (across[:2] == across[2:]).all()
    return Rectangle(*low.tolist(), *(high - low).tolist()) if level else None


def extent_of(rings: Sequence[Ring]) -> tuple[np.ndarray, np.ndarray]:
    """The corners (2,) of the box around rings, left and top, right and bottom, px: that of the curves themselves."""
    points = points_at(pieces_of_rings(rings)[0], np.linspace(0.0, 1.0, 65)).reshape(-1, 2)
    return points.min(axis=0), points.max(axis=0)


def ring_of_cubics(cubics: np.ndarray, lines: np.ndarray | bool = False, smooth: np.ndarray | bool = True) -> Ring:
    """A ring of cubics (A, 4, 2), each from the end of the last. lines, smooth: (A,) bool, or of all, as of `Ring`."""
    straight, joints = (np.broadcast_to(each, len(cubics)).copy() for each in (lines, smooth))
    return Ring(cubics[:, 0].copy(), cubics[:, 1:3].copy(), straight, joints)


@dataclass(frozen=True)
class Circle:
    """A circle around (cx, cy) of radius r > 0."""

    cx: float
    cy: float
    r: float

    pieces = 4
    coordinates = 3
    parameters = 3

    def ring(self, arcs: int = 4) -> Ring:
        """Return a ring of so many cubics, from the rightmost point on, in the direction of growing angles."""
        return Ellipse(self.cx, self.cy, self.r, self.r).ring(arcs)


@dataclass(frozen=True)
class Ellipse:
    """An ellipse around (cx, cy) with half-axes rx, ry > 0, the first one at `angle`."""

    cx: float
    cy: float
    rx: float
    ry: float
    angle: float = 0.0

    pieces = 4

    @property
    def coordinates(self) -> int:
        """4, and the angle where there is one."""
        return 4 + (self.angle != 0.0)

    parameters = coordinates

    def ring(self, arcs: int = 4) -> Ring:
        """Return a ring of so many cubics, from the end of the first half-axis on, towards growing angles."""
        return ring_of_cubics(_turn(0.0, arcs) * [self.rx, self.ry] @ turn_matrix(self.angle) + [self.cx, self.cy])


@dataclass(frozen=True)
class Rectangle:
    """A rectangle of a width and height > 0 with its top left corner at (x, y), turned by `angle` about its middle.

    radius: of its corners, 0 for sharp ones, at most half of the shorter side.
    """

    x: float
    y: float
    width: float
    height: float
    radius: float = 0.0
    angle: float = 0.0

    @property
    def pieces(self) -> int:
        """The lines and cubics of its ring: 4, or 8 with a radius."""
        return 8 if self.radius > 0.0 else 4

    @property
    def coordinates(self) -> int:
        """4, and the radius and the angle where there are such."""
        return 4 + (self.radius > 0.0) + (self.angle != 0.0)

    parameters = coordinates

    def ring(self, arcs: int = 4) -> Ring:
        """Return a ring from the left end of the top side on, clockwise as seen: four lines, and where the corners are
        round a whole turn in so many cubics, a quarter of them at each corner.
        """
        half = np.array([self.width / 2.0, self.height / 2.0])
        middle, turn = half + np.array([self.x, self.y]), turn_matrix(self.angle)
        if self.radius <= 0.0:
            return polygon(_CORNERS * half @ turn + middle)
        # The bend at the end of each side.
        bends = self.radius * _turn(-0.5 * math.pi, arcs).reshape(4, -1, 4, 2)
        bends = bends + following(_CORNERS * (half - self.radius))[:, None, None]
        starts, ends = np.roll(bends[:, -1, 3:], 1, axis=0), bends[:, 0, :1]
        sides = np.concatenate([starts, thirds(starts[:, 0], ends[:, 0]), ends], axis=1)
        cubics = np.concatenate([sides[:, None], bends], axis=1).reshape(-1, 4, 2) @ turn + middle
        return ring_of_cubics(cubics, np.arange(len(cubics)) % (len(cubics) // 4) == 0)


def polygon(anchors: np.ndarray) -> Ring:
    """A ring of straight lines through the anchors (A, 2)."""
    straight = np.ones(len(anchors), dtype=bool)
    return Ring(np.asarray(anchors, dtype=float), thirds(anchors, following(anchors)), straight, ~straight)


def thirds(starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(n, 2, 2) the inner control points of lines between points (n, 2) as cubics."""
    return starts[:, None] + (ends - starts)[:, None] * np.array([1.0, 2.0])[:, None] / 3.0


def are_lines(cubics: np.ndarray) -> np.ndarray:
    """(n,) bool: which cubics (n, 4, 2) are lines, with their inner control points at the thirds."""
    return np.asarray(np.isclose(cubics[:, 1:3], thirds(cubics[:, 0], cubics[:, 3])).all(axis=(1, 2)))


def crossed(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(...) the cross products of vectors (..., 2)."""
    return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]


def turn_matrix(angle: float) -> np.ndarray:
    """Return the matrix (2, 2) that turns rows of x and y by an angle when they are multiplied by it."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, sin], [-sin, cos]])


def arc(start: float, stop: float, count: int) -> np.ndarray:
    """Return cubics (count, 4, 2) of the unit circle from one angle to another, radians."""
    at = np.linspace(start, stop, count + 1)
    unit = np.stack([np.cos(at), np.sin(at)], axis=1)
    reach = 4.0 / 3.0 * np.tan((stop - start) / count / 4.0) * np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    return np.stack([unit[:-1], (unit + reach)[:-1], (unit - reach)[1:], unit[1:]], axis=1)


@lru_cache(maxsize=16)
def _turn(start: float, count: int) -> np.ndarray:
    """Return the cubics of the whole unit circle from an angle on, not to be written to."""
    cubics = arc(start, start + 2.0 * math.pi, count)
    cubics.flags.writeable = False
    return cubics


def following(points: np.ndarray) -> np.ndarray:
    """(n, ...) of each of the points of a loop the next one; `np.roll` takes ten times as long for short ones."""
    return np.concatenate([points[1:], points[:1]])


Outline = Ring | Circle | Ellipse | Rectangle


def with_thirds(ring: Ring) -> Ring:
    """The ring with the control points of its lines where they belong."""
    straight = thirds(ring.anchors, following(ring.anchors))
    return Ring(ring.anchors, np.where(ring.lines[:, None, None], straight, ring.controls), ring.lines, ring.smooth)


def flattened(ring: Ring, step: float = 0.5) -> np.ndarray:
    """(n, 2) points along a ring, those of a cubic about `step` px apart; each piece gives its start, not its end."""
    cubics = ring.cubics
    counts = np.where(ring.lines, 1, np.maximum(2, np.ceil(polygon_lengths(cubics) / step))).astype(int)
    owner, place = places_within(counts)
    return summed(bernstein(place / counts[owner])[:, None] * cubics.transpose(0, 2, 1)[owner])


def polygon_lengths(cubics: np.ndarray) -> np.ndarray:
    """(n,) px of the control polygons of cubics (n, 4, 2), hardly more than of these themselves."""
    return np.asarray(np.hypot(*np.diff(cubics, axis=1).transpose(2, 0, 1)).sum(axis=1))


def dense(corners: np.ndarray, step: float) -> np.ndarray:
    """The corners (n, 2) of a closed polyline, and points between those that are farther apart than `step` px."""
    after = following(corners)
    counts = np.maximum(np.ceil(np.hypot(*(after - corners).T) / step).astype(int), 1)
    owner, place = places_within(counts)
    return corners[owner] + (after - corners)[owner] * (place / counts[owner])[:, None]


def places_within(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for the elements (m,) of rows of so many each, counts (n,), the row and the number there, from 0 on."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


def next_in_loops(owner: np.ndarray) -> np.ndarray:
    """Return the number (n,) of the element after each one in its loop. owner: (n,) ascending, the loop of each."""
    last, after = np.flatnonzero(np.diff(owner, append=-1)), np.arange(1, len(owner) + 1)
    after[last] = np.append(0, last + 1)[:-1]
    return after


def feet_of(sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places evenly along pieces, so many on each (S,): the piece (n,) int and the parameter (n,) in [0, 1]."""
    piece, place = places_within(sizes)
    return piece, (place + 0.5) / sizes[piece]


def signed_area(ring: Ring) -> float:
    """Area in px^2, exact for the cubics; positive when it runs clockwise as seen (y grows downwards)."""
    # From the first anchor, so that what is far from the origin is as exact.
    return float(areas_beside(ring.cubics - ring.anchors[0]).sum())


def areas_beside(cubics: np.ndarray) -> np.ndarray:
    """(n,) px^2 that each of some cubics (n, 4, 2) adds to the area of the ring that it is of."""
    return np.asarray(((cubics[..., 0] @ _GREEN) * cubics[..., 1]).sum(axis=1))


def reversed_ring(ring: Ring) -> Ring:
    """The same ring run the other way round, from the same first anchor."""
    order = (-np.arange(ring.pieces)) % ring.pieces
    pieces = (order - 1) % ring.pieces
    return Ring(ring.anchors[order], ring.controls[pieces][:, ::-1], ring.lines[pieces], ring.smooth[order])


def turned_to(ring: Ring, clockwise: bool) -> Ring:
    """Return a ring that runs clockwise as seen or not."""
    return ring if (signed_area(ring) > 0.0) == clockwise else reversed_ring(ring)


def divided(ring: Ring, piece: int, t: float) -> Ring:
    """Return the same curve with a piece cut in two at a parameter, joined smoothly. Parts of a line are lines."""
    a, b = cubic_parts(ring.cubics[piece], t)
    anchors = np.insert(ring.anchors, piece + 1, a[3], axis=0)
    controls = np.insert(ring.controls, piece + 1, b[1:3], axis=0)
    controls[piece] = a[1:3]
    lines = np.insert(ring.lines, piece + 1, ring.lines[piece])
    return Ring(anchors, controls, lines, np.insert(ring.smooth, piece + 1, not ring.lines[piece]))


def cubic_parts(cubic: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts of a cubic (4, 2) before and after t, by de Casteljau's construction."""
    rows = [cubic]
    while len(rows[-1]) > 1:
        rows.append(rows[-1][:-1] * (1.0 - t) + rows[-1][1:] * t)
    return np.stack([row[0] for row in rows]), np.stack([row[-1] for row in rows[::-1]])


def bernstein(u: np.ndarray) -> np.ndarray:
    """The Bernstein polynomials of degree 3 at u (...): (..., 4), the weights of a cubic's control points."""
    v = 1.0 - u
    return np.stack([v * v * v, 3.0 * v * v * u, 3.0 * v * u * u, u * u * u], axis=-1)


def points_at(cubics: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Points (..., K, 2) of cubics (..., 4, 2) at u (..., K)."""
    return bernstein(u) @ cubics


def polyline_places(points: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """(n, 2) the places at lengths (n,), px, along the polyline through points (k, 2)."""
    s = arc_lengths(points)
    return np.stack([np.interp(lengths, s, points[:, c]) for c in (0, 1)], axis=1)


def arc_lengths(points: np.ndarray) -> np.ndarray:
    """(k,) px of the polyline through points (k, 2) up to each of them."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def derivatives(cubics: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivatives, each (P, K, 2), of the cubics (P, 4, 2) at u (P, K)."""
    first, v = 3.0 * np.diff(cubics, axis=1), 1.0 - u
    second = 2.0 * np.diff(first, axis=1)
    return (np.stack([v * v, 2.0 * v * u, u * u], axis=-1) @ first, np.stack([v, u], axis=-1) @ second)
