"""A pen stroke, a line or closed outline drawn with a pen of one width; and its own outline by SVG's rules: offset
curves on both sides, caps and joins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import (
    Outline,
    Rectangle,
    Ring,
    arc,
    arc_lengths,
    are_lines,
    cubic_parts,
    path_numbers,
    points_at,
    polygon_lengths,
    ring_of_cubics,
    signed_area,
    thirds,
)
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.raster.cubics import Joints, Pieces, tied_coordinates
from cubicsplat_cli.raster.strokes import OffsetPlan
from cubicsplat_cli.record import record

BUTT, ROUND, SQUARE = "butt", "round", "square"
MITER, BEVEL = "miter", "bevel"
CAPS, JOINS = (BUTT, ROUND, SQUARE), (MITER, ROUND, BEVEL)
# A width is even where it is off the usual one by no more than a share of it and so many px.
EVEN_SHARE, EVEN_PX = 0.05, 0.2
MOST_DASHES = 65_535  # of a line, which take a few seconds
_DOT = 1e-3  # px, the length of a dash that has none
_FINE = 32  # points of a cubic by which lengths along it are found


@record
class Chain:
    """An open row of lines and cubics. anchors: (A, 2) px, A >= 2; controls: (A - 1, 2, 2) the inner control points of
    the piece from each anchor to the next, at its thirds for a line; lines: (A - 1,) bool; smooth: (A,) bool, at which
    anchors the tangent is continuous."""

    anchors: np.ndarray
    controls: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray

    @classmethod
    def of(cls, pieces: Pieces) -> Chain:
        """Return the chain that is fitted, as it stands."""
        return cls(pieces.anchors, pieces.cubics[:, 1:3].copy(), pieces.lines.copy(), pieces.joints.smooth.copy())

    @property
    def pieces(self) -> int:
        """A - 1, the number of lines and cubics."""
        return len(self.lines)

    @property
    def cubics(self) -> np.ndarray:
        """(A - 1, 4, 2) the control points of every piece."""
        return np.concatenate([self.anchors[:-1, None], self.controls, self.anchors[1:, None]], axis=1)

    @property
    def coordinates(self) -> int:
        """Numbers in its path data: 2 to start, 6 a cubic, 2 a line (1 along an axis)."""
        return 2 + int(path_numbers(np.diff(self.anchors, axis=0), self.lines).sum())


Path = Chain | Outline


@record
class Stroke:
    """path: the centre line, an outline where it is closed. width: px, > 0. cap: "butt", "round" or "square"; join:
    "miter", "round" or "bevel". dashes: px along the path, alternately drawn and left out, over and over; or empty.
    offset: px of these that come before its start."""

    path: Path
    width: float
    cap: str = BUTT
    join: str = MITER
    dashes: tuple[float, ...] = ()
    offset: float = 0.0

    @property
    def closed(self) -> bool:
        """Return whether it returns to its start."""
        return not isinstance(self.path, Chain)

    @property
    def coordinates(self) -> int:
        """Numbers of its path, its width, and its dashes and their offset."""
        return self.path.coordinates + 1 + len(self.dashes) + bool(self.dashes)

    def plan(self, cubics: np.ndarray, lines: np.ndarray) -> OffsetPlan:
        """Return the plan of its outline along cubics (S, 4, 2) that have a length, lines (S,) bool of them."""
        return OffsetPlan.of(cubics, lines, "closed" if self.closed else self.cap, self.join)


def line_chain(points: np.ndarray) -> Chain:
    """The chain of straight lines through points (A, 2)."""
    controls = thirds(points[:-1], points[1:])
    return Chain(points, controls, np.ones(len(controls), dtype=bool), np.zeros(len(points), dtype=bool))


def pieces_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Control points (S, 4, 2) of a path's pieces, and which are lines (S,)."""
    ring = path if isinstance(path, Chain) else path.ring()
    return ring.cubics, ring.lines


def pieces_of_chain(chain: Chain) -> Pieces:
    """The pieces of a chain that is fitted; lines that are exactly level or upright stay so."""
    outgoing, incoming = np.zeros_like(chain.anchors), np.zeros_like(chain.anchors)
    outgoing[:-1], incoming[1:] = chain.controls[:, 0] - chain.anchors[:-1], chain.controls[:, 1] - chain.anchors[1:]
    tied, level = tied_coordinates(chain.anchors, chain.lines), np.zeros(len(chain.anchors), dtype=bool)
    pieces = Pieces((chain.anchors, incoming, outgoing), Joints(chain.lines, chain.smooth, level, tied))
    return pieces.moved(np.zeros(pieces.joints.variables))


def outlines_of_stroke(stroke: Stroke) -> tuple[Outline, ...]:
    """The outline of a stroke, and of a closed one the hole too.

    Where the stroke crosses itself its outline does too, and the nonzero rule fills it.
    """
    if stroke.dashes:
        parts = dashed(pieces_of(stroke.path)[0], stroke.dashes, stroke.offset)
        bare = [replace(stroke, path=_chain_of(part), dashes=()) for part in parts]
        return tuple(outline for own in bare for outline in outlines_of_stroke(own))
    cubics, lines = _lasting(*pieces_of(stroke.path))
    if not len(cubics):
        assert isinstance(stroke.path, Chain)
        return (_dot(stroke.path.anchors[0], 0.5 * stroke.width, stroke.cap),)
    found = stroke.plan(cubics, lines).outline(cubics, 0.5 * stroke.width)
    rings, straight = (np.split(each, found.ends[:-1]) for each in (found.cubics, found.lines))
    made = [ring_of_cubics(*own, smooth=False) for own in zip(rings, straight, strict=True)]
    areas = [signed_area(ring) for ring in made]
    # Within a sharp corner a side makes a loop, which may be larger than the hole.
    if not stroke.closed or (abs(_winding(cubics)) == 1 and math.prod(areas) < 0.0):
        return tuple(made[k] for k in np.argsort(-np.abs(areas), kind="stable").tolist())
    # It crosses itself: once around it on one side and back on the other, cut open where it begins.
    there = line_chain(np.stack([rings[0][0, 0], rings[1][0, 0]])).cubics
    whole = np.concatenate([rings[0], there, rings[1], there[:, ::-1]])
    return (ring_of_cubics(whole, np.concatenate([straight[0], [True], straight[1], [True]]), smooth=False),)


def dashed(cubics: np.ndarray, dashes: Sequence[float], offset: float = 0.0) -> list[np.ndarray]:
    """The parts (n, 4, 2) of a line of cubics (S, 4, 2) that its dashes draw, by SVG's rules.

    dashes: px, alternately drawn and left out, over and over; an even number. offset: px of the pattern before the
    start of the line. A dash of no length, which shows its caps, gets a very small one. Raises InputError for more than
    MOST_DASHES.
    """
    _, along = measured(cubics)
    ends, period = np.cumsum([0.0, *dashes]), float(sum(dashes))
    if len(dashes) * along[-1] > 2 * MOST_DASHES * period:
        raise InputError(f"has a line of more than {MOST_DASHES} dashes; make them longer")
    start = -(offset % period) + period * np.arange(math.ceil(along[-1] / period) + 2)[:, None]
    first, last = ((start + ends[side:-1:2]).ravel() for side in (0, 1))
    sides = np.stack([first, np.maximum(last, first + _DOT)], axis=1).clip(0.0, along[-1])
    places = np.interp(sides[sides[:, 1] > sides[:, 0]], along, np.arange(len(along)) / _FINE)
    return [between(cubics, a, b) for a, b in places.tolist()]


def measured(cubics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (32 S + 1, 2) along a line of cubics (S, 4, 2), and how far along it each of them is (32 S + 1,), px."""
    points = np.concatenate([points_at(cubics, np.arange(_FINE) / _FINE).reshape(-1, 2), cubics[-1:, 3]])
    return points, arc_lengths(points)


def between(cubics: np.ndarray, first: float, last: float) -> np.ndarray:
    """The part (n, 4, 2) of a line of cubics between two places: the number of a cubic and the parameter on it."""
    a, b = int(first), math.ceil(last) - 1
    part = cubics[a : b + 1].copy()
    part[-1] = cubic_parts(part[-1], last - b)[0]
    part[0] = cubic_parts(part[0], (first - a) / (last - b if a == b else 1.0))[1]
    return part


def _chain_of(cubics: np.ndarray) -> Chain:
    """The chain of cubics (n, 4, 2), those that are straight as lines."""
    lines = are_lines(cubics)
    anchors = np.concatenate([cubics[:, 0], cubics[-1:, 3]])
    return Chain(anchors, cubics[:, 1:3].copy(), lines, np.zeros(len(anchors), dtype=bool))


def offset_ring(ring: Ring, reach: float) -> Ring:
    """The outline at `reach` px to the left of a ring, as seen, with mitred corners; it crosses itself where the ring
    bends back. A nonzero fill of it covers what the ring encloses on its right, and what is within the reach.
    """
    cubics, lines = _lasting(ring.cubics, ring.lines)
    found = OffsetPlan.of(cubics, lines, "one side", MITER).outline(cubics, -reach)
    return ring_of_cubics(found.cubics, found.lines, smooth=False)


def _winding(cubics: np.ndarray) -> int:
    """The winding number of a closed line."""
    ways = np.diff(cubics, axis=1).reshape(-1, 2)
    ways = ways[np.hypot(*ways.T) > 1e-9]
    angles = np.arctan2(ways[:, 1], ways[:, 0])
    turns = np.diff(angles, append=angles[:1])
    return round(float(((turns + np.pi) % (2.0 * np.pi) - np.pi).sum() / (2.0 * np.pi)))


def _lasting(cubics: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pieces that have a length."""
    long = polygon_lengths(cubics) > 1e-9
    return cubics[long], lines[long]


def _dot(at: np.ndarray, half: float, cap: str) -> Ring:
    """A stroke of no length: a disc or, with square caps, a square."""
    if cap == ROUND:
        return ring_of_cubics(at + half * arc(0.0, 2.0 * np.pi, 8), smooth=False)
    x, y = (at - half).tolist()
    return Rectangle(x, y, 2.0 * half, 2.0 * half).ring()
