"""The outline of a stroke: offset curves on both sides, caps and joins, as SVG's rules for stroking have them.

Offsets of a cubic are cubics through exact offset points with exact tangents and speeds (Hermite), of parts that turn
by so little that they are true to a few thousandths of the width.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.artwork.geometry.fine import arc
from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring, derivatives, points_at, polygon_lengths, signed_area
from cubicsplat_cli.artwork.geometry.stroke import MITER, ROUND, SQUARE, Chain, Stroke, pieces_of
from cubicsplat_cli.record import record

MOST_TURN = math.radians(25.0)  # of a part of a cubic
MITER_LIMIT = 4.0  # SVG's own: of the length of a miter over the width
STRAIGHT = math.radians(0.3)  # a joint that turns by less needs no join
MOST_PARTS = 64

_THIRDS = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])[:, None]


class Piece(NamedTuple):
    """A piece of an outline. points: (4, 2); line: whether it is straight; first, last: the pieces of the centre line
    that it depends on, the same one twice but at a joint."""

    points: np.ndarray
    line: bool
    first: int = 0
    last: int = 0


@record
class OffsetPlan:
    """The structure of the outline of a centre line of S pieces, without its exact numbers.

    parts: (S,) int, into how many parts the offset of each is cut; turns: (S,) radians, by how much the line turns from
    each to the next, 0 where that needs no join.
    """

    parts: np.ndarray
    turns: np.ndarray


def plan_of(cubics: np.ndarray, lines: np.ndarray) -> OffsetPlan:
    """The plan for a centre line, closed or not: the last turn is back to the first piece."""
    tangents = [_tangents(cubic) for cubic in cubics]
    parts = [1 if line else _parts(cubic) for cubic, line in zip(cubics, lines, strict=True)]
    turns = np.array([_turn(tangents[i - 1][1], tangents[i][0]) for i in range(len(cubics))])
    turns = np.where(np.abs(turns) < STRAIGHT, 0.0, turns)
    return OffsetPlan(np.array(parts), np.roll(turns, -1))


def outlines_of_stroke(stroke: Stroke) -> tuple[Outline, ...]:
    """The outline of a stroke, and of a closed one the hole too.

    Where the stroke crosses itself its outline does too, and the nonzero rule fills it.
    """
    cubics, lines = pieces_of(stroke.path)
    cubics, lines = _lasting(cubics, lines)
    if not len(cubics):
        assert isinstance(stroke.path, Chain)
        return (_dot(stroke.path.anchors[0], 0.5 * stroke.width, stroke.cap),)
    rings = rings_around(cubics, lines, stroke, plan_of(cubics, lines))
    if not stroke.closed:
        return (_ring(rings[0]),)
    if abs(abs(_winding(cubics)) - 1.0) < 0.25:
        return tuple(sorted((_ring(ring) for ring in rings), key=lambda ring: -abs(signed_area(ring))))
    # It crosses itself: once around it on one side and back on the other, cut open where it begins.
    left, back = rings
    across = _straight(left[-1].points[3], back[0].points[0])
    home = _straight(back[-1].points[3], left[0].points[0])
    return (_ring([*left, Piece(across, True), *back, Piece(home, True)]),)


def offset_ring(ring: Ring, reach: float) -> Ring:
    """The outline at `reach` px to the left of a ring, as seen, with mitred corners; it crosses itself where the ring
    bends back. A nonzero fill of it covers what the ring encloses on its right, and what is within the reach.
    """
    cubics, lines = _lasting(ring.cubics, ring.lines)
    return _ring(_side(cubics, lines, -reach, Stroke(ring, 2.0 * reach), plan_of(cubics, lines)))


def rings_around(cubics: np.ndarray, lines: np.ndarray, stroke: Stroke, plan: OffsetPlan) -> list[list[Piece]]:
    """The pieces of the outline of a stroke along cubics (S, 4, 2) that have a length, lines (S,) bool of them: one
    ring, or of a closed stroke that on the side of the normal (-y, x) and the other one, run the other way.

    Their number and kind are the plan's.
    """
    half, last = 0.5 * stroke.width, len(cubics) - 1
    left, right = (_side(cubics, lines, sign * half, stroke, plan) for sign in (1.0, -1.0))
    back = [piece._replace(points=piece.points[::-1]) for piece in right[::-1]]
    if stroke.closed:
        return [left, back]
    end, start = _tangents(cubics[-1])[1], -_tangents(cubics[0])[0]
    caps = [_cap(cubics[-1, 3], end, half, stroke.cap), _cap(cubics[0, 0], start, half, stroke.cap)]
    line = stroke.cap != ROUND
    ending, starting = ([Piece(points, line, k, k) for points in cap] for cap, k in zip(caps, (last, 0), strict=True))
    return [[*left, *ending, *back, *starting]]


def _winding(cubics: np.ndarray) -> float:
    """The winding number of a closed line."""
    ways = np.diff(cubics, axis=1).reshape(-1, 2)
    ways = ways[np.hypot(*ways.T) > 1e-9]
    angles = np.arctan2(ways[:, 1], ways[:, 0])
    turns = np.diff(angles, append=angles[:1])
    return float(((turns + np.pi) % (2.0 * np.pi) - np.pi).sum() / (2.0 * np.pi))


def _lasting(cubics: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pieces that have a length."""
    long = polygon_lengths(cubics) > 1e-9
    return cubics[long], lines[long]


def _ring(pieces: list[Piece]) -> Ring:
    cubics = np.stack([piece.points for piece in pieces])
    cubics[:, 3] = np.roll(cubics[:, 0], -1, axis=0)
    lines = np.array([piece.line for piece in pieces])
    return Ring(cubics[:, 0].copy(), cubics[:, 1:3].copy(), lines, np.zeros(len(lines), dtype=bool))


def _tangents(cubic: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit tangents at both ends; where a handle has no length, those of what follows it."""
    found = []
    for points in (cubic, cubic[::-1]):
        ways = points[1:] - points[0]
        lengths = np.hypot(*ways.T)
        k = int(np.argmax(lengths > 1e-9))
        found.append(ways[k] / lengths[k])
    return found[0], -found[1]


def _turn(before: np.ndarray, after: np.ndarray) -> float:
    """Radians from one direction to another, positive from x to y."""
    return math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after))


def _normal(way: np.ndarray) -> np.ndarray:
    return np.array([-way[1], way[0]])


def _straight(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a + (b - a) * _THIRDS


def _side(cubics: np.ndarray, lines: np.ndarray, reach: float, stroke: Stroke, plan: OffsetPlan) -> list[Piece]:
    """The offset of all pieces, reach px to the side of the normal (-y, x), with joins."""
    count = len(cubics)
    tangents = [_tangents(cubic) for cubic in cubics]
    out: list[Piece] = []
    for i in range(count):
        line, following = bool(lines[i]), (i + 1) % count
        offset = _offset(cubics[i], line, reach, tangents[i], int(plan.parts[i]))
        out += [Piece(points, line, i, i) for points in offset]
        if plan.turns[i] and (i < count - 1 or stroke.closed):
            join = _join(cubics[i, 3], tangents[i][1], tangents[following][0], reach, stroke.join, float(plan.turns[i]))
            curved = stroke.join == ROUND and plan.turns[i] * reach <= 0.0
            out += [Piece(points, not curved, i, following) for points in join]
    return out


def _parts(cubic: np.ndarray) -> int:
    """Into how many parts the offset of a cubic is cut, so that each turns by little."""
    ways = np.diff(cubic, axis=0)
    ways = ways[np.hypot(*ways.T) > 1e-9]
    angles = np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))
    return min(MOST_PARTS, max(1, math.ceil(float(np.abs(np.diff(angles)).sum()) / MOST_TURN)))


def _offset(
    cubic: np.ndarray, line: bool, reach: float, tangents: tuple[np.ndarray, np.ndarray], count: int
) -> list[np.ndarray]:
    if line:
        return [_straight(cubic[0] + reach * _normal(tangents[0]), cubic[3] + reach * _normal(tangents[0]))]
    t = np.linspace(0.0, 1.0, count + 1)
    places = points_at(cubic[None], t[None])[0]
    first, second = (d[0] for d in derivatives(cubic[None], t[None]))
    speed = np.hypot(*first.T)
    unit = first / np.maximum(speed, 1e-9)[:, None]
    unit[0], unit[-1] = tangents
    # Where a handle has no length the curve stops for a moment, and its bend there is not known.
    moving = speed > 1e-3 * speed.max()
    turning = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    bend = np.where(moving, turning, 0.0) / np.where(moving, speed, 1.0) ** 3
    offset = places + reach * np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    slope = unit * (speed * (1.0 - bend * reach))[:, None] / (3.0 * count)
    return [
        np.stack([offset[k], offset[k] + slope[k], offset[k + 1] - slope[k + 1], offset[k + 1]]) for k in range(count)
    ]


def _join(
    at: np.ndarray, before: np.ndarray, after: np.ndarray, reach: float, join: str, planned: float
) -> list[np.ndarray]:
    """The join that fills the gap between the offsets of two pieces; on the inner side the way over the joint itself.

    planned: about the angle by which the line turns, which says what it is made of.
    """
    a, b = at + reach * _normal(before), at + reach * _normal(after)
    if planned * reach > 0.0:
        return [_straight(a, at), _straight(at, b)]
    if join == ROUND:
        return _arc(at, a, _turn(before, after), _eighths(planned))
    if join == MITER and 1.0 / max(math.cos(0.5 * planned), 1e-9) <= MITER_LIMIT:
        stretch = 1.0 / max(math.cos(0.5 * _turn(before, after)), 1e-9)
        middle = _normal(before) + _normal(after)
        tip = at + reach * stretch * middle / max(float(np.hypot(*middle)), 1e-9)
        return [_straight(a, tip), _straight(tip, b)]
    return [_straight(a, b)]


def _cap(at: np.ndarray, way: np.ndarray, half: float, cap: str) -> list[np.ndarray]:
    """From the left side of an end (that of the normal) around to its right."""
    a, b = at + half * _normal(way), at - half * _normal(way)
    if cap == ROUND:
        return _arc(at, a, -math.pi, _eighths(math.pi))
    if cap == SQUARE:
        return [_straight(a, a + half * way), _straight(a + half * way, b + half * way), _straight(b + half * way, b)]
    return [_straight(a, b)]


def _eighths(turn: float) -> int:
    """The number of cubics of an arc, of an eighth of a turn at most."""
    return max(1, math.ceil(abs(turn) / (0.25 * math.pi + 1e-9)))


def _arc(middle: np.ndarray, start: np.ndarray, turn: float, count: int) -> list[np.ndarray]:
    """Cubics of an arc by `turn` radians, positive from x to y."""
    x, y = start - middle
    first = math.atan2(y, x)
    return list(middle + math.hypot(x, y) * arc(first, first + turn, count))


def _dot(at: np.ndarray, half: float, cap: str) -> Ring:
    """A stroke of no length: a disc or, with square caps, a square."""
    if cap == ROUND:
        circle = _arc(at, at + np.array([half, 0.0]), 2.0 * math.pi, _eighths(2.0 * math.pi))
        return _ring([Piece(points, False) for points in circle])
    corners = at + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return _ring([Piece(_straight(a, b), True) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
