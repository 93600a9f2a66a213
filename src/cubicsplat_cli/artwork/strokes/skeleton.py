"""The skeleton of a shape as a graph, its branches between ends and junctions; points halfway between both sides."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

import numpy as np

from cubicsplat_cli.artwork.geometry.fitting import PRECISION
from cubicsplat_cli.artwork.geometry.outlines import Ring, arc_lengths, pieces_of_rings, points_at
from cubicsplat_cli.artwork.geometry.rows import Link, pairs_of, rows_of
from cubicsplat_cli.artwork.geometry.stroke import EVEN_PX, EVEN_SHARE
from cubicsplat_cli.artwork.strokes.network import Inside
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.record import record

FINEST = 8  # pixels of the skeleton per px at most, and across a stroke at least
SHORT = 0.8  # of the width: shorter branches to an end, and between junctions, are none
REST = 0.46  # of a width, that the outline is from a point halfway across at the least


@dataclass(eq=False)
class Branch:
    """points: (n, 2) px along it, ends included; nodes: the numbers of the junctions or ends at both, -1 of a loop."""

    points: np.ndarray
    nodes: tuple[int, int]


@record
class Graph:
    """branches: of the skeleton. places: (N, 2) px, of the nodes, junctions and ends."""

    branches: list[Branch]
    places: np.ndarray

    def at(self, node: int) -> list[Link]:
        """Return (branch, which end) of all that meet at a node."""
        return [(b, k) for b, branch in enumerate(self.branches) for k in (0, 1) if branch.nodes[k] == node]


def skeleton_of(rings: tuple[Ring, ...], width: float) -> Graph:
    """The skeleton of what the rings (outer clockwise as seen, holes the other way) cover, a stroke about so wide.
    Spurs into corners are taken off, and junctions that a crossing falls apart into are joined again.
    """
    scale = int(np.clip(np.ceil(FINEST / max(width, 1e-6)), 1, FINEST))
    inside = Inside.of(rings, scale)
    graph = _graph(ndimage.skeletonize(inside.mask))
    for branch in graph.branches:
        branch.points = (branch.points + 0.5) / scale + inside.low
    return _tidied(Graph(graph.branches, (graph.places + 0.5) / scale + inside.low), width)


def _graph(skeleton: np.ndarray) -> Graph:
    """Return the graph of a skeleton one pixel wide, in x, y of its pixels."""
    places = np.argwhere(skeleton)
    steps = _steps(skeleton)
    special = np.zeros(skeleton.shape, dtype=bool)
    special[skeleton] = np.bincount(steps.ravel(), minlength=len(places)) != 2
    labels, count = ndimage.label(special, ndimage.SQUARE)
    node = labels[skeleton] - 1  # of each pixel, -1 for those within a branch
    steps = steps[(node[steps] < 0).any(axis=1) | (node[steps[:, 0]] != node[steps[:, 1]])]
    meetings: dict[int, list[Link]] = defaultdict(list)
    for number, ends in enumerate(steps.tolist()):
        for end, pixel in enumerate(ends):
            meetings[pixel].append((number, end))
    partner = pairs_of(meetings[pixel] for pixel in np.flatnonzero(node < 0).tolist())
    branches = []
    for row, closed in rows_of(range(len(steps)), partner):
        pixels = np.array([steps[k, end] for k, end in row])
        if not closed:
            pixels = np.append(pixels, steps[row[-1][0], 1 - row[-1][1]])
        branches.append(Branch(places[pixels, ::-1].astype(float), (int(node[pixels[0]]), int(node[pixels[-1]]))))
    middles = ndimage.center_of_mass(special, labels, np.arange(1, count + 1))
    return Graph(branches, np.array(middles).reshape(-1, 2)[:, ::-1])


def _steps(skeleton: np.ndarray) -> np.ndarray:
    """Return (n, 2) the numbers of pixels beside each other, ascending, in the order of `np.argwhere`."""
    number = np.cumsum(skeleton).reshape(skeleton.shape) - 1
    first, after = skeleton[:-1], skeleton[1:]
    # A diagonal step that two straight ones make as well is none.
    down = first[:, :-1] & after[:, 1:] & ~first[:, 1:] & ~after[:, :-1]
    up = first[:, 1:] & after[:, :-1] & ~first[:, :-1] & ~after[:, 1:]
    across = skeleton[:, :-1] & skeleton[:, 1:]
    pairs = [
        (number[:, :-1][across], number[:, 1:][across]),
        (number[:-1][first & after], number[1:][first & after]),
        (number[:-1, :-1][down], number[1:, 1:][down]),
        (number[:-1, 1:][up], number[1:, :-1][up]),
    ]
    steps = np.concatenate([np.stack(pair, axis=1) for pair in pairs])
    return steps[np.lexsort(steps.T[::-1])]


def _tidied(graph: Graph, width: float) -> Graph:
    """The graph without spurs, with bridges between junctions contracted, and branches joined at nodes of two."""
    places, branches = graph.places.copy(), list(graph.branches)

    def degree(node: int) -> int:
        return sum(branch.nodes.count(node) for branch in branches)

    lengths = [float(arc_lengths(branch.points)[-1]) for branch in branches]
    for length, branch in sorted(zip(lengths, branches, strict=True), key=itemgetter(0)):
        a, b = branch.nodes
        free = [degree(a) == 1, degree(b) == 1]
        if a >= 0 and sum(free) == 1 and degree(b if free[0] else a) >= 3 and length < SHORT * width:
            branches.remove(branch)
        elif a >= 0 and a != b and not any(free) and length < SHORT * width and degree(a) > 2 < degree(b):
            branches.remove(branch)
            places[a] = 0.5 * (places[a] + places[b])
            for other in branches:
                start, end = (a if node == b else node for node in other.nodes)
                other.nodes = start, end
    return _joined(Graph(branches, places))


def _joined(graph: Graph) -> Graph:
    """Return the graph with branches in one where only two meet."""
    branches, joined = graph.branches, list[Branch]()
    for row, closed in rows_of(range(len(branches)), pairs_of(map(graph.at, range(len(graph.places))))):
        points = np.concatenate([branches[b].points[:: -1 if end else 1] for b, end in row])
        (first, start), (last, entered) = row[0], row[-1]
        ends = branches[first].nodes[start], branches[last].nodes[1 - entered]
        joined.append(Branch(points, (-1, -1) if closed else ends))
    return replace(graph, branches=joined)


@record
class Sides:
    """The outline of a shape as points (n, 2) no more than PRECISION px apart, with a tree to find the nearest."""

    points: np.ndarray
    tree: PointTree

    @classmethod
    def of(cls, rings: tuple[Ring, ...]) -> Sides:
        """Return the sides of the rings of a stroke."""
        found = []
        for cubic in pieces_of_rings(rings)[0]:
            count = max(1, int(np.ceil(float(np.hypot(*np.diff(cubic, axis=0).T).sum()) / PRECISION)))
            found.append(points_at(cubic[None], np.arange(count)[None] / count)[0])
        points = np.concatenate(found)
        return cls(points, PointTree(points))

    def nearest(self, places: np.ndarray) -> np.ndarray:
        """(n, 2) the points of the outline nearest to places (n, 2)."""
        return self.points[self.tree.query(places)[1]]

    def near(self, place: np.ndarray, reach: float) -> np.ndarray:
        """(n, 2) the points of the outline no farther than `reach` px from a place (2,)."""
        return self.points[self.tree.query_ball_point(place[None], reach)[0]]


@record
class Centres:
    """Along a branch: points (n, 2) px, widths (n,) px, and true (n,), whether both sides lie opposite each other.
    slack: px by which the outline may be off.
    """

    points: np.ndarray
    widths: np.ndarray
    true: np.ndarray
    slack: float

    @cached_property
    def width(self) -> float:
        """The usual one, NaN where its sides are nowhere opposite."""
        good = self.widths[self.true]
        return float(np.median(good)) if len(good) >= 3 else math.nan

    @cached_property
    def even(self) -> np.ndarray:
        """(n,) bool: points where the stroke has its usual width."""
        off = np.abs(self.widths - self.width)
        return self.true & (off <= EVEN_SHARE * self.width + EVEN_PX + 2.0 * self.slack)


def centres_of(places: np.ndarray, sides: Sides, slack: float) -> Centres:
    """The centres near places (n, 2) of a skeleton: from the nearest point of the outline across to the other side."""
    middle = places
    for _ in range(3):  # rounds
        near = sides.nearest(middle)
        far = sides.nearest(2.0 * middle - near)
        middle = 0.5 * (near + far)
    # The other side is opposite where a disc between the two reaches the outline nowhere else.
    radius = np.hypot(*(sides.nearest(middle) - middle).T)
    widths = np.hypot(*(near - far).T)
    return Centres(middle, widths, radius > REST * widths, slack)
