"""The fewest straight lines by which a hidden run gets from one end to the other without leaving what hides it.

Minimum-link paths: lines may run wherever upper layers hide them, and of the ways with fewest corners the shortest is
taken. Corners are sought along the run itself, deeper beneath the upper layers, and on the tangents at both ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.layers.ends import End
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.outlines import Hiding, fewest_links
from cubicsplat_cli.record import record

RAY = np.array([2.5, 4.0, 6.0, 9.0, 13.0, 18.0, 25.0, 35.0])  # px along a tangent at which a corner is tried
# px beneath the run at which a corner is tried, and at how many places along it; where nothing is found, as what hides
# the run is narrow, nearer to it and at more.
WIDE, NARROW = ((0.0, 3.0, 8.0, 16.0), 28), ((0.0, -1.5, 1.5), 64)
# px from an end of the run in which lines may be nearer, and in which pixels that show the layer do not count.
NEAR_END, AT_END = 6.0, 3.0
SLACK = 1.0  # px that the lines along an edge may be off it


@record
class Room:
    """Pixels in which a part of a layer may go on unseen. top, left: of its window, px. shown, allowed: (h, w) bool, as
    of an extent; spare: (h, w) bool, pixels that may be covered but need not be; canvas: height and width, px. Beyond
    the canvas all is as on its border.
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
        return np.asarray(ndimage.binary_erosion(self.hidden, ndimage.SQUARE, border_value=1))

    def at(self, mask: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(...) bool: a mask (h, w) at points (..., 2); beyond the window False."""
        column = np.clip(np.floor(points[..., 0]).astype(int), 0, self.canvas[1] - 1) - self.left
        row = np.clip(np.floor(points[..., 1]).astype(int), 0, self.canvas[0] - 1) - self.top
        height, width = mask.shape
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        return np.asarray(inside & mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])


def min_link_path(run: np.ndarray, first: End, last: End, room: Room) -> Iterator[np.ndarray]:
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
        box = room.top, room.left, *room.canvas
        hiding = Hiding(box, mask, room.hidden, room.allowed, np.stack([first.at, last.at]), NEAR_END, AT_END)
        path = fewest_links(nodes, order, RAY[: len(start)], RAY[: len(stop)], hiding)
        if len(path):
            yield nodes[path]


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
