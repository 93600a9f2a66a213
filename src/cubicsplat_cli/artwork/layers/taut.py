"""The fewest straight lines by which a hidden run gets from one end to the other without leaving what hides it.

Minimum-link paths: lines may run wherever upper layers hide them, and of the ways with fewest corners the shortest is
taken. Corners are sought along the run itself, deeper beneath the upper layers, and on the tangents at both ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.geometry.fewer import fewer_points
from cubicsplat_cli.artwork.layers.ends import End
from cubicsplat_cli.raster import ndimage

RAY = np.array([2.5, 4.0, 6.0, 9.0, 13.0, 18.0, 25.0, 35.0])  # px along a tangent at which a corner is tried
# px beneath the run at which a corner is tried, and at how many places along it; where nothing is found, as what hides
# the run is narrow, nearer to it and at more.
WIDE, NARROW = ((0.0, 3.0, 8.0, 16.0), 28), ((0.0, -1.5, 1.5), 64)
CLEARANCE = 1.5  # px from the middles of pixels that show the layer, or that it must not cover, where there is room
# px from an end of the run in which lines may be nearer, and in which pixels that show the layer do not count.
NEAR_END, AT_END = 6.0, 3.0
SAMPLES = (np.arange(32) + 0.5) / 32
MOST_REPAIRS = 60  # times that lines which show between the samples are given up
CORNER = 1e3  # px of length that a corner less is worth
SLACK = 1.0  # px that the lines along an edge may be off it


@dataclass(frozen=True)
class Room:
    """Where a part of a layer may go on unseen. top, left: of its window, px. shown, allowed: (h, w) bool, as of an
    extent; spare: (h, w) bool, pixels that may be covered but need not be; canvas: height and width, px. Beyond the
    canvas all is as on its border.
    """

    top: int
    left: int
    shown: np.ndarray
    allowed: np.ndarray
    spare: np.ndarray
    canvas: tuple[int, int]

    @cached_property
    def hidden(self) -> np.ndarray:
        """(h, w) bool: pixels that upper layers hide."""
        return self.allowed & ~self.shown

    @cached_property
    def wide(self) -> np.ndarray:
        """(h, w) bool: hidden pixels far enough from all others."""
        inside = np.pad(self.hidden, 1, constant_values=True)
        return np.asarray(ndimage.distance_transform_edt(inside)[1:-1, 1:-1] >= CLEARANCE)

    def at(self, mask: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(...) bool: a mask (h, w) at points (..., 2); beyond the window False."""
        column = np.clip(np.floor(points[..., 0]).astype(int), 0, self.canvas[1] - 1) - self.left
        row = np.clip(np.floor(points[..., 1]).astype(int), 0, self.canvas[0] - 1) - self.top
        height, width = mask.shape
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        return np.asarray(inside & mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])


def taut(run: np.ndarray, first: End, last: End, room: Room) -> Iterator[np.ndarray]:
    """(k, 2) corners of the fewest lines from one end of a hidden run to the other, where such are found: well beneath
    what hides it, then with no room to spare.

    run: (m, 2) px along the edge of what hides it, in order. first, last: where it begins and ends.
    """
    start, stop = _on_ray(first, run[0], room), _on_ray(last, run[-1], room)
    for mask, (depths, count) in ((room.wide, WIDE), (room.spare, NARROW)):
        inner, place = _beneath(run, depths, count)
        good = room.at(mask, inner)
        nodes = np.concatenate([start, inner[good], stop])
        order = np.concatenate([np.full(len(start), -1.0), place[good], np.full(len(stop), float(len(run)))])
        hiding = _Hiding(room, mask, (first.at, last.at))
        reach = _links(nodes, order, hiding)
        for _ in range(MOST_REPAIRS):
            path = _fewest(reach, len(start), len(stop))
            broken = [(a, b) for a, b in pairwise(path) if not hiding.all_along(nodes[a], nodes[b])]
            if path and not broken:
                yield nodes[path]
            if not broken:
                break
            reach[tuple(zip(*broken, strict=True))] = np.inf


def along_edge(run: np.ndarray) -> np.ndarray:
    """(k, 2) corners of lines along a run (m, 2), px."""
    return fewer_points(run, SLACK)


def _on_ray(end: End, near: np.ndarray, room: Room) -> np.ndarray:
    """(k, 2) places straight on from an end for as long as that stays hidden; the run's own where there are none."""
    if end.tangent is None:
        return near[None]
    steps = np.arange(0.5, RAY[-1] + 0.5, 0.5)
    way = end.at + steps[:, None] * end.tangent
    good = room.at(room.hidden, way) | ((steps <= AT_END) & room.at(room.allowed, way))
    far = steps[-1] if good.all() else steps[int(np.argmin(good))] - 0.5
    points = end.at + RAY[far >= RAY, None] * end.tangent
    return points if len(points) else near[None]


def _beneath(run: np.ndarray, depths: tuple[float, ...], count: int) -> tuple[np.ndarray, np.ndarray]:
    """(k, 2) places along a run and deeper, and (k,) how far along each is."""
    index = np.unique(np.linspace(0, len(run) - 1, min(count, len(run))).astype(int))
    way = run[np.minimum(index + 2, len(run) - 1)] - run[np.maximum(index - 2, 0)]
    normal = np.stack([way[:, 1], -way[:, 0]], axis=1) / np.maximum(np.hypot(*way.T), 1e-9)[:, None]
    return np.concatenate([run[index] + depth * normal for depth in depths]), np.tile(index.astype(float), len(depths))


@dataclass(frozen=True)
class _Hiding:
    """What hides lines: the pixels of a mask (h, w), and others next to the ends of the run."""

    room: Room
    mask: np.ndarray
    ends: tuple[np.ndarray, np.ndarray]

    def at(self, points: np.ndarray) -> np.ndarray:
        """(n, k) bool: whether lines may pass the points (n, k, 2)."""
        room, good = self.room, self.room.at(self.mask, points)
        doubtful = np.flatnonzero(~good.all(axis=1))
        away = np.minimum(*(np.hypot(*(points[doubtful] - end).transpose(2, 0, 1)) for end in self.ends))
        good[doubtful] |= (away < NEAR_END) & room.at(room.hidden, points[doubtful])
        good[doubtful] |= (away < AT_END) & room.at(room.allowed, points[doubtful])
        return good

    def all_along(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Whether a line from a to b may pass all the way."""
        t = np.linspace(0.0, 1.0, 2 * int(np.hypot(*(b - a))) + 2)[:, None]
        return bool(self.at((a * (1.0 - t) + b * t)[None]).all())


def _links(nodes: np.ndarray, order: np.ndarray, hiding: _Hiding) -> np.ndarray:
    """(n, n) px of the line from a node to one farther along, as far as samples tell; infinite where it shows."""
    a, b = np.nonzero(order[:, None] < order[None, :])
    good = hiding.at(nodes[a, None] * (1.0 - SAMPLES[:, None]) + nodes[b, None] * SAMPLES[:, None]).all(axis=1)
    out = np.full((len(nodes), len(nodes)), np.inf)
    out[a[good], b[good]] = np.hypot(*(nodes[a] - nodes[b]).T)[good]
    return out


def _fewest(reach: np.ndarray, starts: int, stops: int) -> list[int]:
    """The nodes of the path with the fewest, then the shortest, from one of the first to one of the last; empty where
    there is none.
    """
    count = len(reach)
    cost = np.full(count, np.inf)
    cost[:starts] = RAY[:starts]
    before = np.full(count, -1)
    # Each round adds a corner.
    for _ in range(count):
        trial = cost[:, None] + reach + CORNER
        via = trial.argmin(axis=0)
        better = trial[via, np.arange(count)] < cost - 1e-9
        if not better.any():
            break
        cost[better], before[better] = trial[via, np.arange(count)][better], via[better]
    ends = cost[count - stops :] + RAY[:stops]
    k = count - stops + int(ends.argmin())
    if not np.isfinite(cost[k]):
        return []
    path = [k]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return path[::-1]
