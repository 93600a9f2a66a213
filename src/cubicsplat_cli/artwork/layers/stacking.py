"""The regions that make one shape, and the order of shapes.

Evidence that a region lies above another: it is enclosed by it; its outline runs straight on where three regions
meet; it hides a shadow that falls on the other; little of it lies in the other's convex hull. Regions of one fill with
only higher regions between them are pieces of one shape that continues beneath.

Outlines are known to hundredths of a px, so their headings on either side of a meeting point have standard errors of
about a degree. An outline that turns by less is far likelier to pass than two outlines are to meet by chance, provided
that the other two turn more.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from heapq import heapify, heappop, heappush
from itertools import chain, groupby, pairwise

import numpy as np

from cubicsplat_cli.artwork.limits import MOST_COMPLETED
from cubicsplat_cli.artwork.regions.fills import CLEAR, CONTACT
from cubicsplat_cli.artwork.regions.regions import Regions, ShadowSides
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.borders import passings
from cubicsplat_cli.raster.outlines import EdgePositions, Runs
from cubicsplat_cli.raster.sparse import linked_groups
from cubicsplat_cli.record import record

EXPOSED = 0.004  # share of the hull of two pieces that may show anything but its own pieces and what lies above
# Votes: being enclosed outweighs everything, a junction counts at most 1, lying between pieces that are joined less,
# hiding a shadow more than the two places where the outlines of two regions usually meet a third.
ENCLOSED, JOINED, VOTE = 1000.0, 0.5, 3.0
# px of the boxes around hulls that are tried, those of the largest pieces first: 4,000 times 512 x 512, in seconds.
MOST_HULL_PIXELS = 1_050_000_000
REACH = 14.0  # px along an outline from which its heading is taken
REACHES = (REACH, 0.5 * REACH)  # the first that is smooth
SMOOTH = 3.0  # mean squared residual, in sigmas, of a smooth one
LEAST_TURN = math.radians(2.5)  # standard error beyond that of the points
MEETING = 3  # px within which the outlines of three regions meet at one place
LIKELY = 0.3  # probability that an outline passes at a meeting, below which it counts as turning there


@record
class Stack:
    """layers: back to front, each the regions of one fill that show of it, ascending. rank: (R,) the layer of each
    region, -1 where nothing is drawn. ends: of each layer, the upper ones whose outlines turn wherever they are seen to
    meet its own: so it likely ends at these."""

    layers: tuple[tuple[int, ...], ...]
    rank: np.ndarray
    ends: tuple[tuple[int, ...], ...]


def stack(regions: Regions, found: EdgePositions, joined: bool = True, shaded: Sequence[ShadowSides] = ()) -> Stack:
    """The layers of a picture's regions, back to front. found: where their outlines run. joined: pieces of one fill may
    be one beneath what hides it. shaded: the sides of shadows that were removed from the picture. Of more than
    MOST_COMPLETED regions only those that enclose others are known to lie beneath these, and all others lie in the
    order of their sizes."""
    facts = _Facts(regions, found, shaded)
    layers = _ordered(facts, _merged(facts, MOST_HULL_PIXELS if joined else 0))
    rank = np.full(regions.count, -1)
    for place, members in enumerate(layers):
        rank[members] = place
    surest: dict[tuple[int, int], float] = defaultdict(float)
    for lower, seen in facts.passes.items():
        for upper, sure in seen.items():
            pair = int(rank[lower]), int(rank[upper])
            surest[pair] = max(surest[pair], sure)
    ends: list[list[int]] = [[] for _ in layers]
    for (low, high), sure in surest.items():
        if 0 <= low < high and sure < LIKELY:
            ends[low].append(high)
    return Stack(tuple(tuple(members.tolist()) for members in layers), rank, tuple(map(tuple, ends)))


class _Facts:
    """Measurements of the regions: neighbours, enclosures, votes[i, j] for i lying above j, and passes[j][i], the
    largest probability that the outline of i passes where it is seen to meet j's."""

    def __init__(self, regions: Regions, found: EdgePositions, shaded: Sequence[ShadowSides]) -> None:
        self.regions, self.clear = regions, regions.fills[:, 3] <= CLEAR
        self.boxes = ndimage.find_objects(regions.labels + 1)
        self.runs = Runs(regions.labels)
        self.around = regions.borders.around.tolist()
        self.ground = regions.ground()
        self.votes: dict[tuple[int, int], float] = defaultdict(float)
        self.passes: dict[int, dict[int, float]] = defaultdict(dict)
        if regions.count <= MOST_COMPLETED:
            meetings = meetings_of(regions, found)
            self.votes = junction_votes(meetings)
            for region, others, _, _, likelihood in meetings:
                for other in others:
                    seen = self.passes[other]
                    seen[region] = max(seen.get(region, 0.0), likelihood / (1.0 + likelihood))
            for pair in _shading(regions, shaded):
                self.votes[pair] += VOTE
        self.held = [(inner, outer) for inner in range(regions.count) for outer in self.enclosing(inner)]
        for pair in self.held:
            self.votes[pair] += ENCLOSED
        # The regions that each one lies above, and those that it is taken to lie above.
        self.beneath: dict[int, set[int]] = defaultdict(set)
        self.assumed: dict[int, set[int]] = defaultdict(set)
        for (above, below), votes in self.votes.items():
            if votes > self.votes.get((below, above), 0.0):
                self.beneath[above].add(below)

    def enclosing(self, region: int) -> Iterator[int]:
        """The regions that enclose one, the innermost first, and of the ground each piece."""
        if region not in self.ground:
            while (region := self.around[region]) >= 0 and region not in self.ground:
                yield region
            yield from self.ground

    def turning(self, above: set[int], members: list[int]) -> bool:
        """Return whether each of some members is beside regions above it, and the outlines of all these turn there."""
        beside = self.regions.borders.beside
        near = ([self.passes[m].get(i, 1.0) for i in beside[m] if i in above] for m in members)
        return all(some and max(some) < LIKELY for some in near)

    def assume(self, above: np.ndarray, below: np.ndarray) -> None:
        """Takes regions to lie above others, where nothing is known of the two."""
        lower = set(below.tolist())
        for i in above.tolist():
            for j in lower - self.beneath[i] - self.assumed[i]:
                if i not in self.beneath[j] and i not in self.assumed[j]:
                    self.votes[i, j] += JOINED
                    self.assumed[i].add(j)


# Of an outline that goes on from one region to another: its own region, these two, the vertex, and how much likelier it
# is to pass straight there than to turn by chance.
_Meeting = tuple[int, tuple[int, int], int, int, float]


def meetings_of(regions: Regions, found: EdgePositions) -> list[_Meeting]:
    """The places where outlines go on from one region to another, but for rough ones. found: where they run."""
    turns = passings(regions.borders.loops, found, REACHES, SMOOTH, LEAST_TURN)
    out = []
    for (region, before, after, x, y), (turn, error) in zip(*(each.tolist() for each in turns), strict=True):
        # Of a turn, radians, where the outline goes straight on, over that of any turn up to a right angle.
        likelihood = math.exp(-0.5 * (turn / error) ** 2) * math.sqrt(0.5 * math.pi) / error
        out.append((region, (before, after), x, y, likelihood))
    return out


def junction_votes(meetings: Sequence[_Meeting]) -> dict[tuple[int, int], float]:
    """Votes for (above, below): the sum over the meetings of two regions with a third, each from LIKELY to 1."""
    places: dict[tuple[int, ...], list[_Meeting]] = defaultdict(list)
    for each in meetings:
        places[tuple(sorted((each[0], *each[1])))].append(each)
    votes: dict[tuple[int, int], float] = defaultdict(float)
    for same in places.values():
        for region, others, x, y, own in same:
            rivals = [p for r, _, u, v, p in same if r != region and max(abs(u - x), abs(v - y)) <= MEETING]
            sure = own / (1.0 + own + sum(rivals))
            if len(rivals) == 2 and sure >= LIKELY:
                for other in others:
                    votes[region, other] += sure
    return votes


def _shading(regions: Regions, shaded: Sequence[ShadowSides]) -> Iterator[tuple[int, int]]:
    """Yield each region that hides a shadow, with each that is shaded by it."""
    for sides in shaded:
        below, above = (np.bincount(regions.labels[side], minlength=regions.count) for side in sides)
        hiding = np.flatnonzero((above >= CONTACT) & (above > below)).tolist()
        for lower in np.flatnonzero((below >= CONTACT) & (below > above)).tolist():
            yield from ((upper, lower) for upper in hiding)


def _merged(facts: _Facts, budget: int) -> np.ndarray:
    """(R,) the group of each region, by their smallest members; -1 if clear. budget: px of the boxes of hulls tried."""
    group = np.where(facts.clear, -1, np.arange(facts.regions.count))
    group[facts.ground] = min(facts.ground, default=-1)
    of = _members(group)
    for a, b in _candidates(facts):
        p, q = group[a], group[b]
        if p == q:
            continue
        members = np.sort(np.concatenate([of[p], of[q]]))
        joined = _shows_through(facts, a, b)
        if not joined and budget > 0:
            window = _box_around(facts, members)
            budget -= _area(window)
            between = _between(facts, members, window)
            if between is not None:
                # What a shape runs beneath is a shape too: no piece of it may lie around one of the members.
                above, own = np.flatnonzero(np.isin(group, group[between])), members.tolist()
                upper, around = set(above.tolist()), chain.from_iterable(map(facts.enclosing, own))
                joined = upper.isdisjoint(around) and not facts.turning(upper, own)
                if joined:
                    # What the joined shape runs beneath cannot be joined beneath it any more.
                    facts.assume(above, members)
        if joined:
            group[members] = members[0]
            of[members[0]] = members
    return np.unique(np.append(group, -1), return_inverse=True)[1][:-1] - 1


def _members(group: np.ndarray) -> dict[int, np.ndarray]:
    """The regions of each group of (R,), ascending."""
    order = np.argsort(group, kind="stable")
    names, first = np.unique(group[order], return_index=True)
    return dict(zip(names.tolist(), np.split(order, first[1:]), strict=True))


def _candidates(facts: _Facts) -> list[tuple[int, int]]:
    """Pairs of regions of one fill with a common neighbour that is drawn, the largest first."""
    fills, areas, pairs = facts.regions.fill_of.tolist(), facts.regions.areas.tolist(), set[tuple[int, int]]()
    for between, beside in enumerate(facts.regions.borders.beside):
        drawn = [] if facts.clear[between] else [i for i in beside if not facts.clear[i]]
        drawn.sort(key=lambda i: (fills[i], -areas[i], i))
        for _, (hub, *others) in groupby(drawn, key=fills.__getitem__):
            pairs |= {(hub, i) for i in others} | set(pairwise(others))
    return sorted(pairs, key=lambda p: (-min(areas[p[0]], areas[p[1]]), p))


def _shows_through(facts: _Facts, a: int, b: int) -> bool:
    """Return whether one lies in a hole of a region that the other encloses: then that region has a hole."""
    for outer, inner in ((a, b), (b, a)):
        around = list(facts.enclosing(inner))
        if outer in around and any(r not in facts.ground for r in around[: around.index(outer)]):
            return True
    return False


def _box_around(facts: _Facts, members: np.ndarray) -> tuple[slice, slice]:
    """The rows and columns that regions reach."""
    boxes = [facts.boxes[m] for m in members]
    rows, columns = (slice(min(b[k].start for b in boxes), max(b[k].stop for b in boxes)) for k in (0, 1))
    return rows, columns


def _area(window: tuple[slice, slice]) -> int:
    return math.prod(side.stop - side.start for side in window)


def _between(facts: _Facts, members: np.ndarray, window: tuple[slice, slice]) -> np.ndarray | None:
    """The regions that the hull of the members runs beneath; None where it holds others than may lie above them."""
    own = np.zeros(facts.regions.count, dtype=bool)
    own[members] = True
    held, inner = facts.runs.held_by_hull(window, own)
    names = np.flatnonzero(held)
    sizes = held[names]
    sure, likely = (
        np.isin(names, [*set().union(*(of[m] for m in members.tolist() if m in of))])
        for of in (facts.beneath, facts.assumed)
    )
    shut = facts.clear[names] | sure
    doubtful = likely & ~shut
    # Outlines are only known to a pixel here, so what lies along the hull's rim may be exposed, and a little within.
    rim = EXPOSED * _area(window) + 0.02 * sizes.sum()
    exposed = inner[names[shut | doubtful]].sum()
    return names[~(shut | doubtful) & (sizes > rim)] if exposed <= rim else None


def _ordered(facts: _Facts, group: np.ndarray) -> list[np.ndarray]:
    """The members of each group, back to front: of those that lie above none that is left, the largest first."""
    groups = [members for name, members in _members(group).items() if name >= 0]
    size = np.bincount(group + 1, facts.regions.areas)[1:]
    # The px^2 of the box around each: what it would cover.
    span = np.array([float(_area(_box_around(facts, members))) for members in groups])
    above, below = _without_cycles(len(groups), *_net(facts, group))
    # What a large one waits for comes as early as the large one would, lest all small ones come between.
    waiting = np.zeros_like(span)
    while (waiting != span).any():
        waiting = span.copy()
        np.maximum.at(span, below, waiting[above])
    load = np.bincount(above, minlength=len(groups))
    ends = np.cumsum(np.bincount(below, minlength=len(groups)))
    lying = np.split(above[np.argsort(below, kind="stable")], ends[:-1])
    ready = [(-span[i], -size[i], i) for i in np.flatnonzero(load == 0).tolist()]
    heapify(ready)
    order = []
    while ready:
        best = heappop(ready)[2]
        order.append(groups[best])
        for i in lying[best].tolist():
            load[i] -= 1
            if load[i] == 0:
                heappush(ready, (-span[i], -size[i], i))
    return order


def _net(facts: _Facts, group: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of groups (e,) of which one lies above the other, and the evidence (e,), less that for the contrary."""
    weight: dict[tuple[int, int], float] = defaultdict(float)
    for (above, below), votes in facts.votes.items():
        p, q = int(group[above]), int(group[below])
        if p >= 0 and q >= 0 and p != q:
            weight[p, q] += votes
    # Groups with pieces around and within another one lie beneath it: what is within shows through its holes.
    broken = {outer for inner, outer in facts.held if group[inner] == group[outer] >= 0}
    for inner, outer in facts.held:
        p, q = int(group[inner]), int(group[outer])
        if outer in broken and p >= 0 and p != q and facts.regions.areas[outer] > facts.regions.areas[inner]:
            weight[q, p] = 0.0
    net = [(p, q, votes - weight.get((q, p), 0.0)) for (p, q), votes in weight.items()]
    net = sorted(each for each in net if each[2] > 0.0)
    upper, lower, evidence = np.array(net).reshape(-1, 3).T
    return upper.astype(int), lower.astype(int), evidence


def _without_cycles(
    count: int, above: np.ndarray, below: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of `count` groups that one lies above another, cycles broken where the evidence is weakest."""
    while True:
        _, knot = linked_groups(count, above, below, directed=True)
        inside = np.flatnonzero(knot[above] == knot[below])
        if not len(inside):
            return above, below
        # The weakest of each knot, which may be of several cycles.
        inside = inside[np.argsort(weight[inside], kind="stable")]
        weakest = inside[np.unique(knot[above[inside]], return_index=True)[1]]
        above, below, weight = (np.delete(each, weakest) for each in (above, below, weight))
