"""The outline of a stroke: offset curves on both sides, caps and joins, as SVG's rules for stroking have them.

Offsets of a cubic are cubics through exact offset points with exact tangents and speeds (Hermite), of parts that turn
by so little that they are true to a few thousandths of the width.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring, signed_area
from cubicsplat_cli.artwork.geometry.stroke import MITER, ROUND, SQUARE, Chain, Stroke, pieces_of
from cubicsplat_cli.artwork.tracing.cubics import derivatives, point

MOST_TURN = math.radians(25.0)  # of a part of a cubic
MITER_LIMIT = 4.0  # SVG's own: of the length of a miter over the width
STRAIGHT = math.radians(0.3)  # a joint that turns by less needs no join
MOST_PARTS = 64

_THIRDS = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])[:, None]
Piece = tuple[np.ndarray, bool]


def outlines_of_stroke(stroke: Stroke) -> tuple[Outline, ...]:
    """What a stroke covers: its outline, and of a closed one the hole too.

    Where the stroke crosses itself its outline does too, and the nonzero rule fills it.
    """
    cubics, lines = pieces_of(stroke.path)
    cubics, lines = _lasting(cubics, lines)
    half = 0.5 * stroke.width
    if not len(cubics):
        assert isinstance(stroke.path, Chain)
        return (_dot(stroke.path.anchors[0], half, stroke.cap),)
    left, right = (_side(cubics, lines, sign * half, stroke) for sign in (1.0, -1.0))
    back = [(piece[::-1], line) for piece, line in right[::-1]]
    if stroke.closed and abs(abs(_winding(cubics)) - 1.0) < 0.25:
        return tuple(sorted((_ring(left), _ring(right)), key=lambda ring: -abs(signed_area(ring))))
    if stroke.closed:
        # It crosses itself: once around it on one side and back on the other, cut open where it begins.
        return (
            _ring([*left, _straight(left[-1][0][3], back[0][0][0]), *back, _straight(back[-1][0][3], left[0][0][0])]),
        )
    end, start = _tangents(cubics[-1])[1], -_tangents(cubics[0])[0]
    pieces = [*left, *_cap(cubics[-1, 3], end, half, stroke.cap), *back, *_cap(cubics[0, 0], start, half, stroke.cap)]
    return (_ring(pieces),)


def _winding(cubics: np.ndarray) -> float:
    """How many times a closed line turns round."""
    ways = np.diff(cubics, axis=1).reshape(-1, 2)
    ways = ways[np.hypot(*ways.T) > 1e-9]
    angles = np.arctan2(ways[:, 1], ways[:, 0])
    turns = np.diff(angles, append=angles[:1])
    return float(((turns + np.pi) % (2.0 * np.pi) - np.pi).sum() / (2.0 * np.pi))


def _lasting(cubics: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pieces that have a length."""
    long = np.hypot(*np.diff(cubics, axis=1).transpose(2, 0, 1)).sum(axis=1) > 1e-9
    return cubics[long], lines[long]


def _ring(pieces: list[Piece]) -> Ring:
    cubics = np.stack([piece for piece, _ in pieces])
    cubics[:, 3] = np.roll(cubics[:, 0], -1, axis=0)
    lines = np.array([line for _, line in pieces])
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


def _normal(way: np.ndarray) -> np.ndarray:
    return np.array([-way[1], way[0]])


def _straight(a: np.ndarray, b: np.ndarray) -> Piece:
    return a + (b - a) * _THIRDS, True


def _side(cubics: np.ndarray, lines: np.ndarray, reach: float, stroke: Stroke) -> list[Piece]:
    """The offset of all pieces, reach px to the side of the normal (-y, x), with joins."""
    count = len(cubics)
    tangents = [_tangents(cubic) for cubic in cubics]
    out: list[Piece] = []
    for i in range(count):
        out += _offset(cubics[i], bool(lines[i]), reach, tangents[i])
        if i < count - 1 or stroke.closed:
            out += _join(cubics[i, 3], tangents[i][1], tangents[(i + 1) % count][0], reach, stroke.join)
    return out


def _offset(cubic: np.ndarray, line: bool, reach: float, tangents: tuple[np.ndarray, np.ndarray]) -> list[Piece]:
    if line:
        return [_straight(cubic[0] + reach * _normal(tangents[0]), cubic[3] + reach * _normal(tangents[0]))]
    ways = np.diff(cubic, axis=0)
    ways = ways[np.hypot(*ways.T) > 1e-9]
    angles = np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))
    count = min(MOST_PARTS, max(1, math.ceil(float(np.abs(np.diff(angles)).sum()) / MOST_TURN)))
    t = np.linspace(0.0, 1.0, count + 1)
    places = point(cubic[None], t[None])[0]
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
        (np.stack([offset[k], offset[k] + slope[k], offset[k + 1] - slope[k + 1], offset[k + 1]]), False)
        for k in range(count)
    ]


def _join(at: np.ndarray, before: np.ndarray, after: np.ndarray, reach: float, join: str) -> list[Piece]:
    """What fills the gap between the offsets of two pieces; on the inner side the way over the joint itself."""
    turn = math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after))
    a, b = at + reach * _normal(before), at + reach * _normal(after)
    if abs(turn) < STRAIGHT:
        return []
    if turn * reach > 0.0:
        return [_straight(a, at), _straight(at, b)]
    if join == ROUND:
        return _arc(at, a, turn)
    stretch = 1.0 / max(math.cos(0.5 * turn), 1e-9)
    if join == MITER and stretch <= MITER_LIMIT:
        middle = _normal(before) + _normal(after)
        tip = at + reach * stretch * middle / max(float(np.hypot(*middle)), 1e-9)
        return [_straight(a, tip), _straight(tip, b)]
    return [_straight(a, b)]


def _cap(at: np.ndarray, way: np.ndarray, half: float, cap: str) -> list[Piece]:
    """From the left side of an end (that of the normal) around to its right."""
    a, b = at + half * _normal(way), at - half * _normal(way)
    if cap == ROUND:
        return _arc(at, a, -math.pi)
    if cap == SQUARE:
        return [_straight(a, a + half * way), _straight(a + half * way, b + half * way), _straight(b + half * way, b)]
    return [_straight(a, b)]


def _arc(middle: np.ndarray, start: np.ndarray, turn: float) -> list[Piece]:
    """Cubics of an arc by `turn` radians, positive from x to y, in eighths of a turn at most."""
    count = max(1, math.ceil(abs(turn) / (0.25 * math.pi + 1e-9)))
    step = turn / count
    handle = 4.0 / 3.0 * math.tan(0.25 * step)
    cos, sin = math.cos(step), math.sin(step)
    spin = np.array([[cos, sin], [-sin, cos]])
    radius = start - middle
    out = []
    for _ in range(count):
        following = radius @ spin
        controls = [radius, radius + handle * _normal(radius), following - handle * _normal(following), following]
        out.append((np.stack(controls) + middle, False))
        radius = following
    return out


def _dot(at: np.ndarray, half: float, cap: str) -> Ring:
    """A stroke of no length: a disc or, with square caps, a square."""
    if cap == ROUND:
        return _ring(_arc(at, at + np.array([half, 0.0]), 2.0 * math.pi))
    corners = at + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return _ring([_straight(a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
