"""The skeleton of a shape as a graph, its branches between ends and junctions; points halfway between both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring, pieces_of_rings, points_at
from cubicsplat_cli.artwork.geometry.stroke import EVEN_PX, EVEN_SHARE
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.outlines import coverage
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.record import record

FINEST = 8  # pixels of the skeleton per px
PIXELS_ACROSS = 8.0  # a stroke is drawn with so many at least
SPUR, BRIDGE = 0.75, 0.9  # of the width: shorter branches to an end, and between junctions, are none
_AROUND = [(-1, 0), (0, 1), (1, 0), (0, -1), (-1, 1), (1, 1), (1, -1), (-1, -1)]
STEP, STEPS_ACROSS = 0.05, 256.0  # px between the points of an outline at the least, and of these over its width
REST = 0.46  # of a width, that the outline is from a point halfway across at the least
MOST_MOVED = 0.3  # widths, that such a point lies off the skeleton at the most
_ROUNDS = 3
_Pixel = tuple[int, int]  # y, x


@dataclass(eq=False)
class Branch:
    """points: (n, 2) px along it, its ends included; nodes: the numbers of the junctions or ends at both, -1 of a
    loop."""

    points: np.ndarray
    nodes: tuple[int, int]


@record
class Graph:
    """branches: of the skeleton. places: (N, 2) px, of the nodes, junctions and ends."""

    branches: list[Branch]
    places: np.ndarray

    def at(self, node: int) -> list[tuple[int, int]]:
        """(branch, which end) of all that meet at a node."""
        return [(b, k) for b, branch in enumerate(self.branches) for k in (0, 1) if branch.nodes[k] == node]


def skeleton_of(rings: tuple[Ring, ...], width: float) -> Graph:
    """The skeleton of what the rings (outer clockwise as seen, holes the other way) cover, a stroke about so wide.

    Spurs into corners are taken off, and junctions that a crossing falls apart into are joined again.
    """
    scale = int(np.clip(np.ceil(PIXELS_ACROSS / max(width, 1e-6)), 1, FINEST))
    cubics, lines = pieces_of_rings(rings)
    low = np.floor(cubics.min(axis=(0, 1))) - 2.0
    size = np.ceil(cubics.max(axis=(0, 1))) + 3.0 - low
    columns, rows = (size * scale).astype(int)
    mask = coverage((cubics - low) * scale, lines, 0, 0, int(rows), int(columns)) > 0.5
    graph = _graph(ndimage.skeletonize(mask))
    for branch in graph.branches:
        branch.points = (branch.points + 0.5) / scale + low
    return _tidied(Graph(graph.branches, (graph.places + 0.5) / scale + low), width)


def _graph(skeleton: np.ndarray) -> Graph:
    """The graph of a skeleton one pixel wide, in x, y of its pixels."""
    pixels = {(int(y), int(x)) for y, x in np.argwhere(skeleton)}

    def neighbours(pixel: _Pixel) -> list[_Pixel]:
        y, x = pixel
        near = [(y + dy, x + dx) for dy, dx in _AROUND if (y + dy, x + dx) in pixels]
        # A diagonal step that two straight ones make as well is none.
        return [(v, u) for v, u in near if v == y or u == x or ((v, x) not in pixels and (y, u) not in pixels)]

    around = {pixel: neighbours(pixel) for pixel in pixels}
    special = np.zeros(skeleton.shape, dtype=bool)
    for pixel, beside in around.items():
        special[pixel] = len(beside) != 2
    labels, count = ndimage.label(special, ndimage.SQUARE)
    places = np.array(ndimage.center_of_mass(special, labels, np.arange(1, count + 1))).reshape(-1, 2)[:, ::-1]
    branches: list[Branch] = []
    seen: set[_Pixel] = set()
    for pixel in sorted(p for p in pixels if special[p]):
        node = int(labels[pixel]) - 1
        for step in around[pixel]:
            if (special[step] and labels[step] == labels[pixel]) or step in seen:
                continue
            row = _walked(around, pixel, step, special)
            seen.update(row[1:-1])
            here = row[-1]
            if len(row) == 2 and (int(labels[here]) - 1 < node):
                continue  # two nodes side by side, met from the other one
            branches.append(Branch(np.array(row)[:, ::-1].astype(float), (node, int(labels[here]) - 1)))
    for pixel in sorted(pixels):
        if special[pixel] or pixel in seen:
            continue
        row = _walked(around, pixel, around[pixel][0], special)[:-1]
        seen.update(row)
        branches.append(Branch(np.array(row)[:, ::-1].astype(float), (-1, -1)))
    return Graph(branches, places)


def _walked(around: dict[_Pixel, list[_Pixel]], start: _Pixel, step: _Pixel, special: np.ndarray) -> list[_Pixel]:
    """The pixels from one on, by a neighbour of it, to the next special one, or round to itself."""
    row = [start, step]
    while not special[row[-1]] and row[-1] != start:
        row.append(next(p for p in around[row[-1]] if p != row[-2]))
    return row


def _length(branch: Branch) -> float:
    return float(np.hypot(*np.diff(branch.points, axis=0).T).sum())


def _tidied(graph: Graph, width: float) -> Graph:
    """The graph without spurs, with bridges between junctions contracted, and branches joined at nodes of two."""
    places, branches = graph.places.copy(), list(graph.branches)

    def degree(node: int) -> int:
        return sum(branch.nodes.count(node) for branch in branches)

    for branch in sorted(branches, key=_length):
        a, b = branch.nodes
        free = [degree(a) == 1, degree(b) == 1]
        if a >= 0 and sum(free) == 1 and degree(b if free[0] else a) >= 3 and _length(branch) < SPUR * width:
            branches.remove(branch)
        elif a >= 0 and a != b and not any(free) and _length(branch) < BRIDGE * width and degree(a) > 2 < degree(b):
            branches.remove(branch)
            places[a] = 0.5 * (places[a] + places[b])
            for other in branches:
                start, end = (a if node == b else node for node in other.nodes)
                other.nodes = start, end
    return Graph(_joined(branches, places), places)


def _joined(branches: list[Branch], places: np.ndarray) -> list[Branch]:
    """The branches, those in one where only two meet."""
    joined = True
    while joined:
        joined = False
        for node in range(len(places)):
            met = [(branch, k) for branch in branches for k in (0, 1) if branch.nodes[k] == node]
            if len(met) != 2:
                continue
            (first, i), (second, j) = met
            if first is second:
                first.nodes = (-1, -1)
                continue
            start = first.points if i == 1 else first.points[::-1]
            rest = second.points if j == 0 else second.points[::-1]
            new = Branch(np.concatenate([start, rest]), (first.nodes[1 - i], second.nodes[1 - j]))
            branches = [branch for branch in branches if branch is not first and branch is not second] + [new]
            joined = True
    return branches


@record
class Sides:
    """The outline of a shape as points (n, 2) no more than `step` px apart, with a tree to find the nearest."""

    points: np.ndarray
    tree: PointTree
    step: float

    @classmethod
    def of(cls, rings: tuple[Ring, ...], width: float) -> Sides:
        """Those of the rings of a stroke about so wide."""
        step = max(STEP, width / STEPS_ACROSS)
        found = []
        for cubic in pieces_of_rings(rings)[0]:
            count = max(1, int(np.ceil(float(np.hypot(*np.diff(cubic, axis=0).T).sum()) / step)))
            found.append(points_at(cubic[None], np.arange(count)[None] / count)[0])
        points = np.concatenate(found)
        return cls(points, PointTree(points), step)

    def nearest(self, places: np.ndarray) -> np.ndarray:
        """(n, 2) the points of the outline nearest to places (n, 2)."""
        return self.points[self.tree.query(places)[1]]


@record
class Centres:
    """Along a branch: points (n, 2) px, widths (n,) px, and true (n,), whether both sides lie opposite each other.
    slack: px by which the outline may be off.
    """

    points: np.ndarray
    widths: np.ndarray
    true: np.ndarray
    slack: float = 0.0

    def even(self, width: float) -> np.ndarray:
        """(n,) bool: points where the stroke has a width."""
        return self.true & (np.abs(self.widths - width) <= EVEN_SHARE * width + EVEN_PX + 2.0 * self.slack)


def centres_of(places: np.ndarray, sides: Sides, slack: float = 0.0) -> Centres:
    """The centres near places (n, 2) of a skeleton: from the nearest point of the outline across to the other side.

    slack: px by which the outline may be off.
    """
    middle = places
    for _ in range(_ROUNDS):
        near = sides.nearest(middle)
        far = sides.nearest(2.0 * middle - near)
        middle = 0.5 * (near + far)
    # The other side is opposite where a disc between the two reaches the outline nowhere else.
    radius = np.hypot(*(sides.nearest(middle) - middle).T)
    widths = np.hypot(*(near - far).T)
    moved = np.hypot(*(middle - places).T)
    true = (widths > 0.0) & (radius > REST * widths) & (moved < MOST_MOVED * np.maximum(widths, 1.0))
    return Centres(middle, widths, true, slack)
