"""Rows of dashes and dots of one colour found and drawn as dashed strokes; all other shapes stay as they are."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import summed
from cubicsplat_cli.artwork.finish.state import State, still_layer
from cubicsplat_cli.artwork.geometry.fitting import PRECISION
from cubicsplat_cli.artwork.geometry.outlines import arc_lengths, crossed, flattened, following
from cubicsplat_cli.artwork.geometry.rows import Link, rows_of
from cubicsplat_cli.artwork.geometry.stroke import BUTT, ROUND, Chain, Stroke, measured
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.strokes.centre_line import open_line
from cubicsplat_cli.artwork.strokes.find import length_of
from cubicsplat_cli.artwork.strokes.parameters import misfit_growth
from cubicsplat_cli.artwork.structure import boxes_of
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Rgba

ENDS = BUTT, ROUND
# How the line is fitted: px that its points are off beyond PRECISION, and times the detail.
WAYS = (PRECISION, 1.0), (0.0, 6.0)
FEWEST = 4  # dashes of a row
MANY = 64  # dashes, of which those that are no pattern are halved, and fewer cut where they are least even
PERIODS = 3  # of a row at least, since four wheels of a train, two and two, are no pattern
THIN = 12.0  # widths that a line is long at least
SPARE = 0.25  # of a gap that a line goes on beyond its first and its last dash
FINE = 0.25  # px between the points of an outline
FILLED = 0.6, 1.2  # the share of its length times its width that a dash covers, from a bent one's to a disc's
LONG = 1.5  # widths, from which a dash shows its direction
TURN = math.radians(30.0)  # between a dash and the way to the next
DOT_TURN = math.radians(24.0)  # between the ways at a dot: of a ring there are 15 or more
NEAREST = 16  # dashes, among which are those before and after one
CLEARLY = 1.1  # times as far off as those of its own row are the neighbours of a dash
SOME = 500  # dashes, each of which is compared with all others
KINDS = 3  # of dashes in a period, at most
OFF = 0.35  # px that a dash may begin or end off its place
USUAL = 0.75  # of the dashes of a row are where they ought to be, the others are hidden in part
APART = 4.0  # times the longest dash, that gaps are at most: bullets of a list are farther apart

Sizes = tuple[tuple[float, float], ...]


@record
class _Dash:
    """number: of its shape; middle, along: (2,) px, and its unit direction; length, width: px, of the rectangle that it
    is most like; spine: (n, 2) px, the points in the middle between its sides; sizes: of each of ENDS, px, its length
    without the caps, and its width; turned: of a dot, the same of a line that runs across."""

    number: int
    middle: np.ndarray
    along: np.ndarray
    length: float
    width: float
    spine: np.ndarray
    sizes: Sizes
    turned: Sizes | None

    @classmethod
    def of(cls, number: int, shape: Shape) -> _Dash | None:
        """Return the dash that a shape of one outline may be."""
        points = flattened(shape.outlines[0].ring(), FINE)
        middle, area, spread = _moments(points)
        if area < PRECISION:
            return None
        variances, ways = np.linalg.eigh(spread)
        width, length = np.sqrt(12.0 * np.maximum(variances, 1e-9)).tolist()
        if not FILLED[0] <= area / (length * width) <= FILLED[1]:
            return None
        along = ways[:, 1]
        across = np.array([-along[1], along[0]])
        s, t = (points - middle) @ along, (points - middle) @ across
        extent = float(np.ptp(s))
        if length < LONG * width:
            # Of a dot the width hardly differs from the length.
            turned = _dot_sizes(float(np.ptp(t)), width, area)
            return cls(number, middle, along, length, width, middle[None], _dot_sizes(extent, length, area), turned)
        at = np.linspace(s.min(), s.max(), 2 + math.ceil(extent))[1:-1]
        low, high = _sides(s, t, at)
        spine = middle + at[:, None] * along + 0.5 * (low + high)[:, None] * across
        pen = float(np.median(high - low))  # whether it bends or not
        sizes = (area / pen, pen), (area / pen - 0.25 * math.pi * pen, pen)
        return cls(number, middle, along, length, width, spine, sizes, None)

    def towards(self, way: np.ndarray) -> _Dash:
        """Return the dash as part of a line that runs in a direction (2,) where it is."""
        along = float(way @ self.along)
        if self.turned is None or abs(along) > math.sqrt(0.5):
            return self if along > 0.0 else replace(self, along=-self.along, spine=self.spine[::-1])
        return replace(self, along=way, length=self.width, width=self.length, sizes=self.turned)


def _dot_sizes(extent: float, length: float, area: float) -> Sizes:
    """Return the sizes of a dot by its extent, length and area."""
    pen = _round_width(extent, area)
    return (length, area / length), (extent - pen, pen)


def _moments(points: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Return of a polygon (n, 2) its centre of gravity (2,), area, and the covariance (2, 2) of what is within."""
    p = points - points[0]
    q = following(p)
    cross = crossed(p, q) / 2.0
    area = float(cross.sum())
    if not area:
        return points[0], 0.0, np.zeros((2, 2))
    middle = (p + q).T @ cross / (3.0 * area)
    both = p.T * cross @ q
    spread = (p.T * cross @ p + q.T * cross @ q + 0.5 * (both + both.T)) / (6.0 * area)
    return points[0] + middle, abs(area), spread - np.outer(middle, middle)


def _sides(s: np.ndarray, t: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest t (n,) of a polygon's points s, t at some s (n,)."""
    s0, t0 = s[:, None], t[:, None]
    s1, t1 = np.roll(s0, -1), np.roll(t0, -1)
    crosses = (s0 <= at) != (s1 <= at)
    there = t0 + (t1 - t0) * (at - s0) / np.where(s0 == s1, 1.0, s1 - s0)
    return np.where(crosses, there, np.inf).min(axis=0), np.where(crosses, there, -np.inf).max(axis=0)


def _round_width(extent: float, area: float) -> float:
    """Return the width of a bar with round ends, by its length with these and its area."""
    rest = 1.0 - 0.25 * math.pi
    inner = extent**2 - 4.0 * rest * area
    return min((extent - math.sqrt(max(inner, 0.0))) / (2.0 * rest), extent)


@record
class _Row:
    """dashes: in order; slots, whole: (n,) of each its number in the pattern and whether it is seen whole; many: in a
    period; members: the numbers of the shapes that the row takes the place of."""

    dashes: list[_Dash]
    slots: np.ndarray
    whole: np.ndarray
    many: int
    members: list[int]

    def halves(self) -> list[_Row]:
        """Return the rows on both sides of the widest gap, or of the middle."""
        steps = np.diff(self.slots)
        middle = int(steps.argmax()) + 1 if steps.max() > 1 else len(self.dashes) // 2
        return _in_patterns(self.dashes[:middle]) + _in_patterns(self.dashes[middle:])


def with_dashes(drawing: Drawing, goal: Goal, detail: float) -> Drawing:
    """Return the drawing with dashed strokes in place of shapes in rows, where its description gets shorter. detail: as
    in ArtworkSettings."""
    shapes, dashes = drawing.shapes, defaultdict[Rgba, list[_Dash]](list)
    extents = np.ptp(boxes_of(shapes).reshape(-1, 2, 2), axis=1).max(axis=1)
    # Of very long ones there is no room for a row.
    for n in np.flatnonzero(extents < math.hypot(drawing.width, drawing.height) / FEWEST).tolist():
        shape = shapes[n]
        plain = shape.gradient is None and shape.shading is None and not shape.over
        if plain and len(shape.outlines) == 1 and (dash := _Dash.of(n, shape)):
            dashes[shape.fill].append(dash)
    rows = [row for own in dashes.values() if len(own) >= FEWEST for row in _rows(own)]
    if not rows:
        return drawing
    before, after = State([still_layer(shape, goal) for shape in shapes], goal), dict(enumerate(shapes))
    while rows:
        left = list[_Row]()
        for row, (gain, shape, place) in zip(rows, _tried(rows, before, goal, detail), strict=True):
            if gain > 0.0:
                for n in row.members:
                    del after[n]
                after[place] = shape
            else:
                left += row.halves()
        rows = left
    return replace(drawing, shapes=tuple(shape for _, shape in sorted(after.items(), key=lambda each: each[0])))


def _tried(rows: list[_Row], before: State, goal: Goal, detail: float) -> list[tuple[float, Shape, int]]:
    """Return for each of some rows by how much the description of a drawing, as layers, gets shorter where a dashed
    stroke takes its place, at best; that stroke, and the number of the shape of the row whose place it takes."""
    shapes, strokes = [layer.shape for layer in before.layers], [_strokes(row, detail) for row in rows]
    of_before = np.full(len(shapes), -1)
    for row in rows:
        of_before[row.members] = row.members[0]
    saved = [length_of(*(shapes[n] for n in row.members)) for row in rows]
    best = [(-math.inf, shapes[row.members[0]], -1) for row in rows]
    for way in range(len(strokes[0])):
        work().at()
        tried = [
            still_layer(shapes[row.members[0]].stroked(own[way]), goal) for row, own in zip(rows, strokes, strict=True)
        ]
        for end in (min, max):  # in front of all of its row or behind it
            places = {end(row.members): layer for row, layer in zip(rows, tried, strict=True)}
            kept = [n for n in range(len(shapes)) if of_before[n] < 0 or n in places]
            after = before.with_layers([places.get(n, before.layers[n]) for n in kept])
            lost = misfit_growth(before, after, of_before, of_before[kept])
            for k, (row, layer) in enumerate(zip(rows, tried, strict=True)):
                gain = saved[k] - length_of(layer.shape) - detail * float(lost[row.members[0]])
                best[k] = max(best[k], (gain, layer.shape, end(row.members)), key=lambda each: each[0])
    return best


def _rows(dashes: list[_Dash]) -> list[_Row]:
    """Return the rows of dashes that lie one behind the other, in order, in a pattern."""
    middles = np.array([dash.middle for dash in dashes])
    links = _links(dashes, *_nearest(middles, min(NEAREST + 1, len(dashes))))
    partner, ways = dict[Link, Link](), dict[Link, np.ndarray]()
    for distance, i, j in sorted(links):
        way = (middles[j] - middles[i]) / distance
        a, b = _free_end(dashes[i], i, way, ways), _free_end(dashes[j], j, -way, ways)
        if a is not None and b is not None:
            partner[a], partner[b], ways[a], ways[b] = b, a, way, -way
    found = []
    for row, closed in rows_of(range(len(dashes)), partner):
        index = np.array([n for n, _ in row])
        if closed:
            # The pattern begins and ends where the steps are least alike.
            steps = np.hypot(*(middles[index] - middles[np.roll(index, 1)]).T)
            index = np.roll(index, -int(np.abs(steps - np.median(steps)).argmax()))
        found += _in_patterns([dashes[n] for n in index.tolist()])
    return found


def _nearest(points: np.ndarray, many: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances (n, many) from points (n, 2) to those nearest to each, itself first, and their numbers."""
    if len(points) > SOME:
        from scipy.spatial import cKDTree  # takes 0.2 s to import

        return cKDTree(points).query(points, many)
    far = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    near = far.argsort(axis=1)[:, :many]
    return np.take_along_axis(far, near, 1), near


def _links(dashes: list[_Dash], far: np.ndarray, near: np.ndarray) -> set[tuple[float, int, int]]:
    """Return the pairs of dashes of which one may lie behind the other, and px between them. far, near: (n, k) as
    `_nearest` returns them."""
    middles, along = np.array([(dash.middle, dash.along) for dash in dashes]).transpose(1, 0, 2)
    length, pen = np.array([(dash.length, dash.sizes[0][1]) for dash in dashes]).T
    dots, this = np.array([dash.turned is not None for dash in dashes]), np.arange(len(dashes))[:, None]
    way, straight = middles[near] - middles[this], math.cos(TURN) * far
    aligned = [dots[each] | (np.abs(summed(way * along[each])) > straight) for each in (this, near)]
    alike = np.maximum(pen[this], pen[near]) < LONG * np.minimum(pen[this], pen[near])
    ahead = alike & aligned[0] & aligned[1] & (far > 0.5 * (length[this] + length[near]))
    # Those with others beside them that are as near lie in arrays, as bricks and windows do. A dot has two beside it.
    parallel = ~dots[near] & (np.abs(summed(along[this] * along[near])) > math.cos(TURN)) & (near != this)
    beside = parallel & ~ahead & (far < CLEARLY * np.where(ahead, far, np.inf).min(axis=1, keepdims=True))
    alone = np.where(dots, far[:, 3] > CLEARLY * far[:, 2], ~beside.any(axis=1))
    first, place = np.nonzero(ahead & alone[:, None] & alone[near])
    pairs = np.sort(np.column_stack([first, near[first, place]]), axis=1)
    return {(d, i, j) for d, (i, j) in zip(far[first, place].tolist(), pairs.tolist(), strict=True)}


def _free_end(dash: _Dash, n: int, way: np.ndarray, ways: dict[Link, np.ndarray]) -> Link | None:
    """Return the end of a dash in a direction if that is free. ways: of the ends that are not. A dot has its ends where
    its neighbours are, one across from the other."""
    if not dash.turned:
        link = n, int(way @ dash.along > 0.0)
        return None if link in ways else link
    taken = [end for end in (0, 1) if (n, end) in ways]
    if len(taken) == 2 or (taken and float(way @ ways[n, taken[0]]) > -math.cos(DOT_TURN)):
        return None
    return n, 1 - taken[0] if taken else 0


def _in_patterns(row: list[_Dash]) -> list[_Row]:
    """Return a row, or the parts of it that have a pattern."""
    if len(row) < FEWEST:
        return []
    row = [dash.towards(way) for dash, way in zip(row, _ways(row), strict=True)]
    every = np.array([dash.sizes[0][0] for dash in row])
    # Longer ones are several that meet beneath something.
    single = np.flatnonzero(every < 2.0 * np.quantile(every, USUAL))
    at, lengths = arc_lengths(np.array([dash.middle for dash in row]))[single], every[single]
    for many in range(1, min(KINDS, len(single) // PERIODS) + 1):
        if found := _pattern(at, lengths, many):
            kept, slots, whole = found
            own = single[kept]
            if np.ptp(at[kept]) < THIN * row[own[0]].sizes[0][1]:
                return []
            members = [dash.number for dash in row[own[0] : own[-1] + 1]]
            return [_Row([row[n] for n in own.tolist()], slots, whole, many, members)]
    steps = np.diff(at)
    cut = len(steps) // 2 if len(steps) > MANY else int(np.abs(steps - np.median(steps)).argmax())
    cut = int(single[cut + 1])
    return _in_patterns(row[:cut]) + _in_patterns(row[cut:])


def _ways(row: list[_Dash]) -> np.ndarray:
    """Return the unit directions (n, 2) of a row at its dashes."""
    ways = np.gradient(np.array([dash.middle for dash in row]), axis=0)
    return ways / np.hypot(*ways.T).clip(1e-9)[:, None]


def _pattern(at: np.ndarray, lengths: np.ndarray, many: int) -> tuple[slice, np.ndarray, np.ndarray] | None:
    """Return which of some dashes, at (n,) px, lie in a pattern of so many a period, their numbers in it, as some may
    be hidden, and whether each is seen whole; None if there is no such pattern."""
    steps, kinds = np.diff(at), np.arange(len(at)) % many
    usual = np.array([np.median(steps[kinds[:-1] == kind]) for kind in range(many)])
    missed = np.rint((steps - usual[kinds[:-1]]) / usual.sum()).astype(int)
    slots = np.cumsum([0, *(1 + many * missed)])
    kinds = slots % many
    if (missed < 0).any():
        return None
    lacks = np.array([np.median(lengths[kinds == kind]) for kind in range(many)])[kinds] - lengths
    whole = np.abs(lacks) < 2.0 * OFF
    # Two of each kind tell the period.
    if np.bincount(kinds[whole], minlength=many).min() < 2:
        return None
    drawn, ought, places = _placed(at, lengths, slots, whole, many)
    # The middle of a part is off by half of what is missing.
    fits = (lacks > -2.0 * OFF) & (np.abs(ought - at) < OFF + np.where(whole, 0.0, 0.5 * lacks))
    gaps = _gaps(drawn, places)
    if (
        np.count_nonzero(whole & fits) < max(FEWEST, USUAL * len(at))
        or not 0.0 < gaps.min() <= gaps.max() < APART * drawn.max()
    ):
        return None
    # The first and the last may be cut off, but not be anything else.
    own = np.flatnonzero(fits)
    kept = slice(int(own[0]), int(own[-1]) + 1)
    return kept, slots[kept], (whole & fits)[kept]


def _placed(
    at: np.ndarray, lengths: np.ndarray, slots: np.ndarray, whole: np.ndarray, many: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return of dashes (n,) of a row, by their numbers in a pattern and whether each is whole, its lengths (many,), the
    place (n,) where each ought to be, and where those (many + 1,) of the first period and the next one are."""
    kinds = slots % many
    drawn = np.array([np.median(lengths[whole & (kinds == kind)]) for kind in range(many)])
    terms = np.column_stack([slots // many, kinds[:, None] == np.arange(many)]).astype(float)
    (period, *places), *_ = np.linalg.lstsq(terms[whole], at[whole], rcond=None)
    return drawn, terms @ [period, *places], np.array([*places, places[0] + period])


def _gaps(drawn: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return (many,) px between dashes of such lengths in such places, as `_placed` returns them."""
    return np.diff(places) - 0.5 * (drawn + np.roll(drawn, -1))


def _strokes(row: _Row, detail: float) -> list[Stroke]:
    """Return the dashed strokes, with each of ENDS, that a row is."""
    from scipy.interpolate import Akima1DInterpolator  # takes a while to import, and few pictures have dashes

    middles = np.array([dash.middle for dash in row.dashes])
    spines = [dash.spine for dash in row.dashes]
    knots = np.concatenate(spines)
    at = arc_lengths(knots)
    first, last = at[len(spines[0]) // 2], at[-1 - len(spines[-1]) // 2]
    line = Akima1DInterpolator(at, knots, method="makima", extrapolate=True)
    slots, pattern = row.slots, (row.slots, row.whole, row.many)
    strokes = []
    for n, cap in enumerate(ENDS):
        lengths, widths = np.array([dash.sizes[n] for dash in row.dashes]).clip(0.0).T
        drawn, _, places = _placed(arc_lengths(middles), lengths, *pattern)
        # Where an end is not cut off the line goes on into the gap: a dot at its very end might not be drawn.
        spare = SPARE * _gaps(drawn, places)[(slots[[0, -1]] - [1, 0]) % row.many]
        reach = 0.5 * lengths[[0, -1]] + spare * row.whole[[0, -1]]
        points = line(np.linspace(first - reach[0], last + reach[1], max(2, math.ceil(last - first))))
        for slack, finer in WAYS:
            path = open_line(points, np.zeros(0, dtype=int), finer * detail, slack)
            drawn, ought, places = _placed(_along(path, middles), lengths, *pattern)
            dashes = np.stack([drawn, _gaps(drawn, places)], axis=1).ravel().tolist()
            start = ought[0] - places[slots[0] % row.many] + places[0] - 0.5 * drawn[0]
            strokes.append(Stroke(path, float(np.median(widths)), cap, dashes=tuple(dashes), offset=-float(start)))
    return strokes


def _along(path: Chain, points: np.ndarray) -> np.ndarray:
    """Return (n,) px along a path to the places on it nearest to points (n, 2)."""
    fine, along = measured(path.cubics)
    step = np.diff(fine, axis=0)
    share = summed((points[:, None] - fine[:-1]) * step) / summed(step * step)
    share = share.clip(0.0, 1.0)
    off = np.hypot(*(fine[:-1] + share[..., None] * step - points[:, None]).transpose(2, 0, 1))
    nearest = off.argmin(axis=1)
    return along[nearest] + np.take_along_axis(share, nearest[:, None], 1)[:, 0] * np.diff(along)[nearest]
