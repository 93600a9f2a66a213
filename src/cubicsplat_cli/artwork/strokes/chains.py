"""Branches of a skeleton that make one stroke: those that run straight on through a junction, then those left over."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.strokes.centres import Centres
from cubicsplat_cli.artwork.strokes.skeleton import Graph

THROUGH = math.radians(35.0)  # of bend up to which a stroke goes on through a junction
ALIKE = 0.15  # of the width, that two branches of one stroke may differ by
REACH = 3.0  # widths along a branch from which its direction at a junction is taken

Link = tuple[int, int]  # a branch and one of its ends


def chains_of(graph: Graph, centres: list[Centres], widths: np.ndarray) -> list[tuple[list[Link], bool]]:
    """Rows of branches, each (branch, end at which it is entered), and whether the row closes.

    centres: of every branch; widths: (branches,) px, NaN where a branch has none.
    """
    partner: dict[Link, Link] = {}
    for node in range(len(graph.places)):
        links = [link for link in graph.at(node) if np.isfinite(widths[link[0]])]
        partner |= _partners(links, graph, centres, widths)
    rows: list[tuple[list[Link], bool]] = []
    left = {b for b in range(len(graph.branches)) if np.isfinite(widths[b])}
    starts = [(b, k) for b in sorted(left) for k in (0, 1) if (b, k) not in partner]
    for b, k in starts + [(b, 0) for b in sorted(left)]:
        if b not in left:
            continue
        row, here = [], (b, k)
        while here[0] in left:
            left.discard(here[0])
            row.append(here)
            out = (here[0], 1 - here[1])
            here = partner.get(out, out)
        loop = graph.branches[b].nodes == (-1, -1)
        rows.append((row, loop or (here == row[0] and partner.get((row[-1][0], 1 - row[-1][1])) == row[0])))
    return rows


def _partners(links: list[Link], graph: Graph, centres: list[Centres], widths: np.ndarray) -> dict[Link, Link]:
    """The ends at a node that go on into each other: the straightest pairs; of what is left two that bend."""
    ways = [_direction(link, graph, centres, widths) for link in links]
    pairs = []
    for i in range(len(links)):
        for j in range(i):
            alike = abs(widths[links[i][0]] - widths[links[j][0]]) <= ALIKE * widths[links[i][0]]
            one, other = ways[i], ways[j]
            if alike and one is not None and other is not None:
                bend = math.pi - math.acos(float(np.clip(one @ other, -1.0, 1.0)))
                pairs.append((bend, i, j))
    found: dict[Link, Link] = {}
    free = set(range(len(links)))
    for bend, i, j in sorted(pairs):
        if bend <= THROUGH and i in free and j in free:
            free -= {i, j}
            found |= {links[i]: links[j], links[j]: links[i]}
    rest = [pair for pair in pairs if pair[1] in free and pair[2] in free]
    if len(free) == 2 and rest and not found:
        _, i, j = rest[0]
        found |= {links[i]: links[j], links[j]: links[i]}
    if len(free) == 3 and len(rest) == 3:
        # Three that meet: the two that lie alike on either side of the third, as in the head of an arrow.
        def lopsided(pair: tuple[float, int, int]) -> float:
            (third,) = free - {pair[1], pair[2]}
            return abs(float(ways[pair[1]] @ ways[third] - ways[pair[2]] @ ways[third]))  # type: ignore[operator]

        _, i, j = min(rest, key=lopsided)
        found |= {links[i]: links[j], links[j]: links[i]}
    return found


def _direction(link: Link, graph: Graph, centres: list[Centres], widths: np.ndarray) -> np.ndarray | None:
    """(2,) the direction in which a branch leaves a node, from where its width is even; None where it is nowhere."""
    branch, end = link
    own, width = centres[branch], float(widths[branch])
    good = own.points[own.even(width)]
    if len(good) < 3:
        return None
    if end == 1:
        good = good[::-1]
    near = good[np.hypot(*(good - good[0]).T) <= REACH * width]
    if len(near) < 3:
        return None
    middle = near.mean(axis=0)
    along = np.linalg.svd(near - middle)[2][0]
    # A bent branch leaves as its nearer end does.
    half = near[: max(3, len(near) // 2)]
    along = np.linalg.svd(half - half.mean(axis=0))[2][0] if len(half) >= 5 else along
    return along if along @ (near[-1] - near[0]) > 0.0 else -along
