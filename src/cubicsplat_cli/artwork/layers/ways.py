"""The ways in which a hidden run of an outline may go on, from the shortest description to the longest.

Straight sides go on until they meet; the rest of a primitive or of a smooth piece; one cubic that goes on smoothly at
both ends; a limb's end; the fewest straight lines that stay hidden; the upper layers' edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import arc_lengths, polyline_places
from cubicsplat_cli.artwork.layers.ends import REACH, End, continued, ends_of
from cubicsplat_cli.artwork.layers.min_link import SLACK, Room, min_link_path
from cubicsplat_cli.raster.outlines import fewer_points
from cubicsplat_cli.record import record

CURVE_SIGMA = 0.3  # px, of the points of a cubic that goes on
# The most that such a cubic turns, radians: an edge less likely turns by more than a right angle.
SLIGHT, ROUND = 0.5 * math.pi, 1.25 * math.pi
BLUNTEST, SHARPEST = math.radians(15.0), math.radians(125.0)  # by which an outline turns where its sides meet
LEAST_REACH = 1.0  # px that a side goes on until it meets another
# Straight sides within such an angle are those of a limb or a band. How far it goes on, of its width: artists' limbs
# went 0.25 to 0.87, the middle one of ten 0.6. Beyond FARTHEST px the sides' headings say too little.
PARALLEL, DEPTH, FARTHEST = math.radians(25.0), 0.5, 3.0 * REACH


@record
class Completion:
    """points: (m, 2) px in place of a hidden run's; sigma: their standard error, px, inf where they do not matter;
    corners: (k,) which of them are corners."""

    points: np.ndarray
    sigma: float
    corners: np.ndarray


Wrong = Callable[[np.ndarray], int]


@record
class HiddenLoop:
    """A closed outline, some of it hidden. points: (n, 2) px; sigma: (n,) px, inf where hidden; wrong: how many px an
    outline of points (n, 2) covers or leaves wrongly."""

    points: np.ndarray
    sigma: np.ndarray
    wrong: Wrong
    room: Room


def ways_on(loop: HiddenLoop, run: np.ndarray) -> Iterator[Completion]:
    """The ways to go on along a hidden run (m,), indices in order, the simplest first; the last always stays hidden."""
    points, sigma = loop.points, loop.sigma
    first, last = ends_of(points, sigma, run)
    meet = _meeting(first, last)
    straight = first.straight and last.straight
    yield Completion(points[run], np.inf, np.zeros(0, dtype=int))
    if meet is not None and straight:
        yield from _by_lines(loop, run, (first, last), meet)
    yield from _by_cubic(loop, run, SLIGHT)
    if meet is not None and not straight:
        yield from _by_lines(loop, run, (first, last), meet)
    # Straight sides, as of a stripe, turn back in a bow only where they are longer than they are apart.
    if not straight or _long(loop, first, last):
        yield from _by_cubic(loop, run, ROUND)
    level = _across(first, last) if straight else None
    if level is not None:
        yield from _by_lines(loop, run, (first, last), level)
    yield from simply(loop, run, (first, last))


def _long(loop: HiddenLoop, first: End, last: End) -> bool:
    """Whether what shows is longer, the way that the first end is heading, than the ends are apart."""
    if first.tangent is None:
        return False
    along = loop.points[np.isfinite(loop.sigma)] @ first.tangent
    return bool(np.ptp(along) >= np.hypot(*(last.at - first.at)))


def sides_meeting(loop: HiddenLoop, run: np.ndarray) -> Completion | None:
    """The way by straight sides that go on until they meet; None where there are none, or they would not be hidden."""
    ends = ends_of(loop.points, loop.sigma, run)
    meet = _meeting(*ends) if ends[0].straight and ends[1].straight else None
    return None if meet is None else next(_by_lines(loop, run, ends, meet), None)


def simply(loop: HiddenLoop, run: np.ndarray, ends: tuple[End, End] | None = None) -> Iterator[Completion]:
    """The ways by the fewest and shortest straight lines."""
    points = loop.points[run]
    first, last = ends or ends_of(loop.points, loop.sigma, run)
    for corners in min_link_path(points, first, last, loop.room):
        yield from _by_lines(loop, run, (first, last), corners)
    yield from _by_lines(loop, run, (first, last), fewer_points(points, SLACK))


def _by_cubic(loop: HiddenLoop, run: np.ndarray, most: float) -> Iterator[Completion]:
    curve = continued(loop.points, loop.sigma, run, most, loop.wrong)
    if curve is not None:
        yield Completion(curve, CURVE_SIGMA, np.zeros(0, dtype=int))


def _by_lines(loop: HiddenLoop, run: np.ndarray, ends: tuple[End, End], corners: np.ndarray) -> Iterator[Completion]:
    """Straight lines from one end through the corners (k, 2) to the other; none where the run has too few points."""
    count = len(run)
    if count < len(corners):
        return
    knots = np.concatenate([ends[0].at[None], corners, ends[1].at[None]])
    length = arc_lengths(knots)
    points = polyline_places(knots, np.arange(1, count + 1) / (count + 1.0) * length[-1])
    index = np.rint(length[1:-1] / max(length[-1], 1e-9) * (count + 1.0)).astype(int) - 1
    # Each corner gets a point of its own.
    index = np.maximum.accumulate(index - np.arange(len(index))) + np.arange(len(index))
    index = np.clip(index, np.arange(len(index)), count - len(index) + np.arange(len(index)))
    points[index] = corners
    yield Completion(points, np.inf, index)


def _meeting(first: End, last: End) -> np.ndarray | None:
    """(1, 2) where both ends, going straight on, meet; None where they do not, or at an unlikely angle."""
    if first.tangent is None or last.tangent is None:
        return None
    u, v = first.tangent, last.tangent
    cross = float(u[0] * v[1] - u[1] * v[0])
    turn = math.pi - math.acos(float(np.clip(u @ v, -1.0, 1.0)))
    if not BLUNTEST <= turn <= SHARPEST:
        return None
    gap = last.at - first.at
    onward, back = (gap[0] * v[1] - gap[1] * v[0]) / cross, (gap[0] * u[1] - gap[1] * u[0]) / cross
    return (first.at + onward * u)[None] if min(onward, back) >= LEAST_REACH else None


def _across(first: End, last: End) -> np.ndarray | None:
    """(2, 2) corners of the straight end of a limb whose two sides are about parallel; None of other sides."""
    u, v = first.tangent, last.tangent
    if u is None or v is None or u @ v < math.cos(PARALLEL):
        return None
    along = (u + v) / np.hypot(*(u + v))
    gap = last.at - first.at
    width = abs(float(gap[0] * along[1] - gap[1] * along[0]))
    if DEPTH * width > FARTHEST:
        return None
    level = 0.5 * float((first.at + last.at) @ along) + DEPTH * width
    far = [(level - float(at @ along)) / float(way @ along) for at, way in ((first.at, u), (last.at, v))]
    return np.array([first.at + far[0] * u, last.at + far[1] * v]) if min(far) >= LEAST_REACH else None
