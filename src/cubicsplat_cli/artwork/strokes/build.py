"""Strokes of one shape: skeleton, centres, rows of branches, centre lines, caps and joins.

Branches that run straight on through a junction make one stroke, then those left over.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.fitting import GAP, PRECISION, fit_outlines
from cubicsplat_cli.artwork.geometry.outlines import Ring, arc_lengths, flattened, polyline_places, signed_area
from cubicsplat_cli.artwork.geometry.rows import Link, rows_of
from cubicsplat_cli.artwork.geometry.stroke import BEVEL, BUTT, MITER, ROUND, Path, Stroke, pieces_of
from cubicsplat_cli.artwork.strokes.centre_line import CORNER, FLANK, MITER_LIMIT, end_of, open_line, with_corners
from cubicsplat_cli.artwork.strokes.skeleton import Centres, Graph, Sides, centres_of, skeleton_of
from cubicsplat_cli.record import record

LEAST_EVEN = 0.5  # share of a shape's skeleton that must have an even width
SHORTEST = 1.2  # widths, of a shape's skeleton
THROUGH = math.radians(35.0)  # of bend up to which a stroke goes on through a junction
ALIKE = 0.15  # of the width, that two branches of one stroke may differ by
REACH = 3.0  # widths along a branch from which its direction at a junction is taken

BESIDE = 0.35  # widths to the side, where an end is looked at besides its middle
SLIT = 1.6  # steps of the outline: half of how wide a look ahead is
AHEAD = 0.75  # times as far ahead as to the side, at least, lies what is ahead


def strokes_of(rings: tuple[Ring, ...], detail: float, slack: float) -> list[Stroke]:
    """The strokes whose union rings (outer clockwise as seen, holes the other way) may be; none where hardly any is
    of an even width. slack: px by which the rings may be off.
    """
    area = sum(signed_area(ring) for ring in rings)
    around = sum(float(np.hypot(*np.diff(flattened(r, 1.0), axis=0, append=r.anchors[:1]).T).sum()) for r in rings)
    width = 2.0 * area / max(around, 1e-9)
    if not width > 0.5:
        return []
    graph, sides = skeleton_of(rings, width), Sides.of(rings)
    centres = [centres_of(_spaced(branch.points), sides, slack) for branch in graph.branches]
    even, total = sum(int(own.even.sum()) for own in centres), sum(len(own.points) for own in centres)
    if even < LEAST_EVEN * total or total < SHORTEST * width:
        return []
    rows = chains_of(graph, centres)
    found = [_stroke(row, closed, graph, centres, sides, detail, slack) for row, closed in rows]
    strokes = [stroke for stroke in found if stroke is not None]
    if len(strokes) < len(found):
        return []
    # Whoever draws several strokes gives them one cap, that of free ends; where it is hidden it may yet show beside
    # what hides it.
    shown = [not closed and any(len(graph.at(_node(row, graph, end))) == 1 for end in (0, 1)) for row, closed in rows]
    free = [stroke.cap for stroke, own in zip(strokes, shown, strict=True) if own]
    usual = max(free, key=free.count) if free else BUTT
    capped = [s if own or s.closed else replace(s, cap=usual) for s, own in zip(strokes, shown, strict=True)]
    # Lines without corners are told apart from others by the same pen if their joins differ.
    return [s if s.join else replace(s, join=ROUND if s.cap == ROUND else MITER) for s in capped]


def _spaced(points: np.ndarray) -> np.ndarray:
    """Points about one px apart along a skeleton."""
    length = float(arc_lengths(points)[-1])
    return polyline_places(points, np.linspace(0.0, length, max(3, round(length) + 1)))


def _stroke(
    row: list[Link], closed: bool, graph: Graph, centres: list[Centres], sides: Sides, detail: float, slack: float
) -> Stroke | None:
    """The stroke along a row of branches; None where its points or its ends are no stroke's."""
    own = [(centres[branch], -1 if entered else 1) for branch, entered in row]
    line = np.concatenate([each.points[each.even][::way] for each, way in own])
    if len(line) < 3:
        return None
    width = float(np.median(np.concatenate([each.widths[each.even] for each, _ in own])))
    hidden = [_beside(row, graph, centres, end) for end in (0, 1)]
    gaps = np.hypot(*(np.roll(line, -1, axis=0) - line).T) > GAP
    cap = BUTT
    if not closed:
        line, gaps, cap = with_ends(line, gaps, width, sides, hidden)
    line, corners = with_corners(line, gaps, closed, width)
    if closed and len(np.unique(line, axis=0)) < 8:
        return None
    sigma = np.full(len(line), math.hypot(PRECISION, slack))
    known = np.zeros(len(line), dtype=bool)
    path = fit_outlines([line], [sigma], detail, [known])[0] if closed else open_line(line, corners, detail, slack)
    return Stroke(path, width, cap, join_of(path, closed, width, sides))


def _node(row: list[Link], graph: Graph, end: int) -> int:
    """The node at which a row of branches begins (0) or ends (1)."""
    branch, entered = row[-1] if end else row[0]
    return graph.branches[branch].nodes[1 - entered if end else entered]


def _beside(row: list[Link], graph: Graph, centres: list[Centres], end: int) -> float:
    """The greatest width of what else meets where a row ends, 0 at a free end."""
    branch = (row[-1] if end else row[0])[0]
    others = [centres[b].width for b, _ in graph.at(_node(row, graph, end)) if b != branch]
    return max(filter(math.isfinite, others), default=0.0)


def join_of(path: Path, closed: bool, width: float, sides: Sides) -> str:
    """The join that reaches as far out of a path's corners as the outline does; empty without any."""
    cubics, _ = pieces_of(path)
    votes = {MITER: 0.0, ROUND: 0.0, BEVEL: 0.0}
    for last, own in zip(np.roll(cubics, 1, axis=0)[not closed :], cubics[not closed :], strict=True):
        before, after = (v / max(float(np.hypot(*v)), 1e-9) for v in (last[3] - last[2], own[1] - own[0]))
        out = before - after
        size = float(np.hypot(*out))
        if size < 2.0 * math.sin(0.5 * CORNER):
            continue
        out = out / size
        off = sides.near(own[0], MITER_LIMIT * width) - own[0]
        ahead = (np.abs(off @ np.array([-out[1], out[0]])) < SLIT * PRECISION) & (off @ out > 0.0)
        if not ahead.any():
            continue
        reach = float((off @ out)[ahead].min()) / (0.5 * width)
        stretch = math.cos(math.asin(min(0.5 * size, 1.0)))  # of half the turn
        wanted = {MITER: 1.0 / max(stretch, 1e-6), ROUND: 1.0, BEVEL: stretch}
        votes[min(wanted, key=lambda join: abs(wanted[join] - reach))] += size
    return max(votes, key=lambda join: votes[join]) if any(votes.values()) else ""


def chains_of(graph: Graph, centres: list[Centres]) -> list[tuple[list[Link], bool]]:
    """Rows of branches, each (branch, end at which it is entered), and whether the row closes. centres: of each."""
    partner: dict[Link, Link] = {}
    even = [b for b, own in enumerate(centres) if math.isfinite(own.width)]
    for node in range(len(graph.places)):
        partner |= _partners([link for link in graph.at(node) if math.isfinite(centres[link[0]].width)], centres)
    return [(row, closed or graph.branches[row[0][0]].nodes == (-1, -1)) for row, closed in rows_of(even, partner)]


def _partners(links: list[Link], centres: list[Centres]) -> dict[Link, Link]:
    """The ends at a node that go on into each other: the straightest pairs; of what is left two that bend."""
    ways, widths = [_direction(link, centres) for link in links], [centres[branch].width for branch, _ in links]
    pairs = []
    for i in range(len(links)):
        for j in range(i):
            one, other = ways[i], ways[j]
            if abs(widths[i] - widths[j]) <= ALIKE * widths[i] and one is not None and other is not None:
                bend = math.pi - math.acos(float(np.clip(one @ other, -1.0, 1.0)))
                pairs.append((bend, i, j))
    found: list[tuple[int, int]] = []
    free = set(range(len(links)))
    for bend, i, j in sorted(pairs):
        if bend <= THROUGH and i in free and j in free:
            free -= {i, j}
            found.append((i, j))
    rest = [pair for pair in pairs if pair[1] in free and pair[2] in free]
    if len(free) == 2 and rest and not found:
        found.append(rest[0][1:])
    if len(free) == 3 and len(rest) == 3:
        # Three that meet: the two that lie alike on either side of the third, as in the head of an arrow.
        def lopsided(pair: tuple[float, int, int]) -> float:
            (third,) = free - {pair[1], pair[2]}
            return abs(float(ways[pair[1]] @ ways[third] - ways[pair[2]] @ ways[third]))  # type: ignore[operator]

        found.append(min(rest, key=lopsided)[1:])
    return {links[a]: links[b] for i, j in found for a, b in ((i, j), (j, i))}


def _direction(link: Link, centres: list[Centres]) -> np.ndarray | None:
    """(2,) the direction in which a branch leaves a node, from where its width is even; None where it is nowhere."""
    branch, end = link
    own = centres[branch]
    good = own.points[own.even][:: -1 if end else 1]
    if len(good) < 3:
        return None
    near = good[np.hypot(*(good - good[0]).T) <= REACH * own.width]
    if len(near) < 3:
        return None
    # A bent branch leaves as its nearer end does.
    half = near[: len(near) // 2] if len(near) >= 10 else near
    along = np.linalg.svd(half - half.mean(axis=0))[2][0]
    return along if along @ (near[-1] - near[0]) > 0.0 else -along


def with_ends(
    line: np.ndarray, gaps: np.ndarray, width: float, sides: Sides, hidden: list[float]
) -> tuple[np.ndarray, np.ndarray, str]:
    """The points with both ends of the stroke, the gaps between them, and the cap. hidden: the widths of the strokes in
    which an end lies, where no cap shows; 0 for free ends.
    """
    tips = [_Tip.of(line[::-1]), _Tip.of(line)]
    reaches = [None if inside else _reaches(tip, width, sides) for tip, inside in zip(tips, hidden, strict=True)]
    drops = [r[0] - 0.5 * (r[1] + r[2]) for r in reaches if r is not None]
    round_reach = math.sqrt(0.25 - BESIDE**2)  # widths, of a half disc beside its middle, where it is 0.5
    cap = ROUND if drops and float(np.mean(drops)) > 0.5 * (0.5 - round_reach) * width else BUTT
    places = []
    for tip, inside in zip(tips, hidden, strict=True):
        if inside:
            places.append(tip.on(_to_middle(tip, width, inside, sides)).place)
            continue
        for _ in range(2):
            beyond = (0.5 + 2.0 * round_reach) / 3.0 * width if cap == ROUND else 0.0
            tip = tip.on(float(_reaches(tip, width, sides).mean()) - beyond)
        places.append(tip.place)
    line = np.concatenate([places[0][None], line, places[1][None]])
    return line, np.concatenate([[False], gaps[:-1], [False, False]]), cap


@record
class _Tip:
    """An end of a line: its place, unit tangent and bend, (2,) each."""

    place: np.ndarray
    direction: np.ndarray
    bend: np.ndarray

    @classmethod
    def of(cls, line: np.ndarray) -> _Tip:
        """The last of some points."""
        return cls(line[-1], *end_of(line[-FLANK:]))

    def seen(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points (n, 2) lie ahead, and to the left."""
        off = points - self.place
        return off @ self.direction, off @ np.array([-self.direction[1], self.direction[0]])

    def on(self, reach: float) -> _Tip:
        """The end if the line went on by so many px, bending as it does."""
        direction = self.direction + reach * self.bend
        direction = direction / max(float(np.hypot(*direction)), 1e-9)
        return _Tip(self.place + reach * self.direction + 0.5 * reach**2 * self.bend, direction, self.bend)


def _reaches(tip: _Tip, width: float, sides: Sides) -> np.ndarray:
    """(3,) how far ahead the outline lies in the middle, and beside it to the left and to the right."""
    along, across = tip.seen(sides.near(tip.place, 2.0 * width + BESIDE * width + SLIT * PRECISION))
    found = []
    for side in (0.0, -BESIDE * width, BESIDE * width):
        near = (np.abs(across - side) < SLIT * PRECISION) & (along > -0.2 * width) & (along < 2.0 * width)
        found.append(float(along[near].min()) if near.any() else 0.0)
    return np.array(found)


def _to_middle(tip: _Tip, width: float, beside: float, sides: Sides) -> float:
    """The distance ahead to the middle of the stroke, `beside` px wide, that this one ends in: half of that from its
    far side, or less than a step beyond, since an end that is hardly moved would have no direction.
    """
    along, across = tip.seen(sides.near(tip.place, 2.0 * (width + beside)))
    step = max(0.02 * width, 0.1)
    # From `first` on half of that from a point of the outline, which is ahead up to `last`.
    first = np.maximum(along - np.sqrt(np.maximum(0.25 * beside**2 - across**2, 0.0)), 0.0)
    last = along - AHEAD * np.abs(across)
    reaches = step * np.ceil(first / step)
    reaches = reaches[reaches < np.minimum(last, width + beside)]
    return float(reaches.min()) if len(reaches) else 0.0
