"""The ways in which a hidden run of an outline may go on, from the shortest description to the longest.

They are the rest of a primitive or of a smooth piece; straight sides that go on until they meet; one cubic that goes on
smoothly at both ends; the fewest straight lines that stay hidden; the edge of the upper layers.

The cubic is the one that bends least, by the integral of the squared curvature, of those that stay hidden. The lines
are the shortest of the fewest (minimum-link paths). Their corners are sought along the run itself, deeper beneath the
upper layers, and on the tangents at both ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import chain

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import arc_lengths, crossed, derivatives, points_at, polyline_places
from cubicsplat_cli.artwork.layers.extents import HIDDEN_SIGMA, Window
from cubicsplat_cli.artwork.layers.stacking import REACH
from cubicsplat_cli.raster.outlines import fewer_points, fewest_links, heading
from cubicsplat_cli.record import record

STRAIGHT = 0.12  # radians that an outline turns in REACH px, below which it counts as straight
HANDLES = (0.25, 0.4, 0.6, 0.9, 1.4)  # lengths of handles that are tried, over the distance between the ends
MOST_TRIED = 8  # cubics, those that bend least
SAMPLES = 33  # places along a cubic where its curvature is measured
ALLOWED = 1  # px that an outline may cover or leave wrongly
ROUND = 1.25 * math.pi  # radians by which a cubic turns at most
BLUNTEST, SHARPEST = math.radians(15.0), math.radians(125.0)  # turns of an outline where its sides meet
RAY = np.array([2.5, 4.0, 6.0, 9.0, 13.0, 18.0, 25.0, 35.0])  # px along a tangent at which a corner is tried
DEPTHS = (16.0, 8.0, 4.0, 2.0)  # px beneath the edge of a shape that hides an outline, at which this is tried
# Px beneath the run at which corners are tried, and places along it. The second try, at more places near the run,
# serves runs that something narrow hides.
WIDE, NARROW = ((0.0, *DEPTHS), 28), ((0.0, -1.5, 1.5), 64)
AT_END = 3.0  # px from an end of the run within which lines may cross visible pixels, and twice that come nearer
SLACK = 1.0  # px by which lines along an edge may differ from it, and that a side goes on until it meets another


@record
class End:
    """End of the visible part of an outline. at: (2,) px; tangent: (2,) unit, onwards into the hidden part, None if it
    is not known; straight: True if the outline is straight up to there."""

    at: np.ndarray
    tangent: np.ndarray | None
    straight: bool


def ends_of(points: np.ndarray, sigma: np.ndarray, run: np.ndarray) -> tuple[End, End]:
    """Return the ends of the visible parts of a closed outline, points (n, 2) px and sigma (n,), inf where hidden,
    before and after a hidden run (m,), indices in order.
    """
    n, ends = len(points), list[End]()
    for start, step in ((run[0], -1), (run[-1], 1)):
        index = (start + step * np.arange(1, n)) % n
        index = index[: np.append(np.isfinite(sigma[index]), False).argmin()]
        found = heading(points[index], sigma[index], REACH)
        if found is None:
            ends.append(End(points[index[0] if len(index) else start], None, False))
        else:
            ends.append(End(found.at, found.tangent, found.bend * REACH <= STRAIGHT))
    return ends[0], ends[1]


@record
class Completion:
    """points: (m, 2) px that replace a hidden run; sigma: their standard error, px, inf if they do not matter; corners:
    (k,) indices of the corners among them."""

    points: np.ndarray
    sigma: float
    corners: np.ndarray


@record
class HiddenLoop:
    """A closed outline with hidden parts. points: (n, 2) px; sigma: (n,) px, inf where hidden; wrong: counts the px
    that an outline of points (n, 2) covers or leaves wrongly. room: the window of the outer outline."""

    points: np.ndarray
    sigma: np.ndarray
    wrong: Callable[[np.ndarray], int]
    room: Window


def ways_on(loop: HiddenLoop, run: np.ndarray, whole: bool) -> Iterator[Completion]:
    """Yield the ways to go on along a hidden run (m,), indices in order, the simplest first. The last is hidden. whole:
    not only by the fewest and shortest straight lines.
    """
    points, ends = loop.points[run], ends_of(loop.points, loop.sigma, run)
    if whole:
        meet = _meeting(*ends)
        yield Completion(points, np.inf, np.zeros(0, dtype=int))
        sides = () if meet is None else _by_lines(run, ends, meet)
        cubic = by_cubic(loop, run, ends)
        yield from chain(sides, cubic) if ends[0].straight and ends[1].straight else chain(cubic, sides)
    for corners in chain(min_link_path(points, *ends, loop.room), [fewer_points(points, SLACK)]):
        yield from _by_lines(run, ends, corners)


def sides_meeting(loop: HiddenLoop, run: np.ndarray) -> Completion | None:
    """Return the way by straight sides that go on until they meet; None if they do not."""
    ends = ends_of(loop.points, loop.sigma, run)
    meet = _meeting(*ends) if ends[0].straight and ends[1].straight else None
    return None if meet is None else next(_by_lines(run, ends, meet), None)


def by_cubic(loop: HiddenLoop, run: np.ndarray, ends: tuple[End, End]) -> Iterator[Completion]:
    """Yield the cubic that continues the outline smoothly from one end to the other; none without one."""
    first, leaving, last, arriving = ends[0].at, ends[0].tangent, ends[1].at, ends[1].tangent
    span = float(np.hypot(*(last - first)))
    if leaving is None or arriving is None or span < 1.0:
        return
    # Angles between the tangents and the line from one end to the other.
    turns = np.arccos(np.clip(np.array([leaving, -arriving]) @ (last - first) / span, -1.0, 1.0))
    if turns.sum() > ROUND:
        return
    cubics = np.array(
        [[first, first + a * span * leaving, last + b * span * arriving, last] for a in HANDLES for b in HANDLES]
    )
    for k in np.argsort(_bending(cubics), kind="stable")[:MOST_TRIED]:
        trial, fine = loop.points.copy(), points_at(cubics[k], np.linspace(0.0, 1.0, 4 * len(run) + 8))
        trial[run] = polyline_places(fine, (np.arange(len(run)) + 1.0) / (len(run) + 1.0) * arc_lengths(fine)[-1])
        if loop.wrong(trial) <= ALLOWED:
            yield Completion(trial[run], HIDDEN_SIGMA, np.zeros(0, dtype=int))
            return


def _bending(cubics: np.ndarray) -> np.ndarray:
    """Return (k,) the integral of the squared curvature along cubics (k, 4, 2), times their chord."""
    first, second = derivatives(cubics, np.broadcast_to(np.linspace(0.0, 1.0, SAMPLES), (len(cubics), SAMPLES)))
    speed = np.maximum(np.hypot(first[..., 0], first[..., 1]), 1e-9)
    return (crossed(first, second) ** 2 / speed**5).mean(axis=1) * np.hypot(*(cubics[:, 3] - cubics[:, 0]).T)


def _by_lines(run: np.ndarray, ends: tuple[End, End], corners: np.ndarray) -> Iterator[Completion]:
    """Yield straight lines from one end through corners (k, 2) to the other; none if the run has too few points."""
    count, corner = len(run), np.arange(len(corners))
    if count < len(corners):
        return
    knots = np.concatenate([ends[0].at[None], corners, ends[1].at[None]])
    length = arc_lengths(knots)
    points = polyline_places(knots, np.arange(1, count + 1) / (count + 1.0) * length[-1])
    index = np.rint(length[1:-1] / max(length[-1], 1e-9) * (count + 1.0)).astype(int) - 1
    # Each corner gets a point of its own.
    index = np.clip(np.maximum.accumulate(index - corner), 0, count - len(corners)) + corner
    points[index] = corners
    yield Completion(points, np.inf, index)


def _meeting(first: End, last: End) -> np.ndarray | None:
    """Return (1, 2) the place where both ends, going straight on, meet; None if there is no likely one."""
    u, v = first.tangent, last.tangent
    if u is None or v is None:
        return None
    turn = math.pi - math.acos(float(np.clip(u @ v, -1.0, 1.0)))
    if not BLUNTEST <= turn <= SHARPEST:
        return None
    gap = last.at - first.at
    onward, back = crossed(gap, v) / crossed(u, v), crossed(gap, u) / crossed(u, v)
    return (first.at + onward * u)[None] if min(onward, back) >= SLACK else None


def min_link_path(run: np.ndarray, first: End, last: End, room: Window) -> Iterator[np.ndarray]:
    """Yield (k, 2) the corners of the fewest lines from one end of a hidden run to the other: well beneath the shapes
    that hide it, then with no room to spare; nothing if there are none.

    run: (m, 2) px along the edge of these shapes, in order. first, last: its ends.
    """
    start, stop = _on_ray(first, run[0], room), _on_ray(last, run[-1], room)
    for mask, (depths, count) in ((room.wide, WIDE), (room.spare, NARROW)):
        inner, place = _beneath(run, depths, count)
        good = room.at(mask, inner)
        nodes = np.concatenate([start, inner[good], stop])
        order = np.concatenate([np.full(len(start), -1.0), place[good], np.full(len(stop), float(len(run)))])
        box = room.extent.top, room.extent.left, *room.canvas
        ends = np.stack([first.at, last.at])
        masks = mask, room.hidden, room.extent.allowed
        path = fewest_links(nodes, order, RAY[: len(start)], RAY[: len(stop)], box, masks, ends, 2.0 * AT_END, AT_END)
        if len(path):
            yield nodes[path]


def _on_ray(end: End, near: np.ndarray, room: Window) -> np.ndarray:
    """Return (k, 2) places straight on from an end as long as they stay hidden; `near` (2,) if there are none."""
    if end.tangent is None:
        return near[None]
    steps = np.arange(0.5, RAY[-1] + 0.5, 0.5)
    way = end.at + steps[:, None] * end.tangent
    good = room.at(room.hidden, way) | ((steps <= AT_END) & room.at(room.extent.allowed, way))
    far = steps[-1] if good.all() else steps[int(np.argmin(good))] - 0.5
    points = end.at + RAY[far >= RAY, None] * end.tangent
    return points if len(points) else near[None]


def _beneath(run: np.ndarray, depths: tuple[float, ...], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (k, 2) places along a run and deeper, and (k,) the index of each along the run."""
    index = np.unique(np.linspace(0, len(run) - 1, min(count, len(run))).astype(int))
    way = run[np.minimum(index + 2, len(run) - 1)] - run[np.maximum(index - 2, 0)]
    normal = np.stack([way[:, 1], -way[:, 0]], axis=1) / np.maximum(np.hypot(*way.T), 1e-9)[:, None]
    return np.concatenate([run[index] + depth * normal for depth in depths]), np.tile(index.astype(float), len(depths))
