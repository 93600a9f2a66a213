"""Straight lines of one pen that cross and meet: grids, mazes, frames, charts.

Each side of a line is a straight piece of the outline. Moved inwards by half a width, the sides of a line lie on its
middle. What lies on one line is one stroke, as far as the shape goes on between; ends that meet are corners.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import itemgetter

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring, crossed, pieces_of_rings, polygon, signed_area
from cubicsplat_cli.artwork.geometry.rows import Link, rows_of
from cubicsplat_cli.artwork.geometry.stroke import Stroke, line_chain
from cubicsplat_cli.raster.outlines import coverage
from cubicsplat_cli.record import record

FLAT = 0.1  # px by which a straight piece may bend
SHORTEST = 1.2  # widths of a piece that is a side rather than an end
STRAIGHT = 0.8  # share of the outline, without its ends, that straight sides are
ACROSS, ALONG = 0.25, 0.1  # widths, and px, by which a side may lie off the middle
BESIDE = 0.35  # widths to the side of the middle that lie within the shape as well
STEPS = 4  # a px, of the picture in which the shape is looked up
EVEN, BENT = math.radians(2.0), 0.1  # angle of pieces of one line, and share of the sides that others may bend at
LEAST_SINE = 0.25  # of an angle at which lines meet
MEETING = 0.8  # widths over that sine, from an end to the middle of a line in which it ends
FEWEST = 4  # straight sides
THIN = 6.0  # widths that lines have on average; letters are shorter
TIP = 0.6  # of the way to the tip of a corner, that is inside where two lines are joined


@record
class _Sides:
    """Straight sides of an outline: starts and ends (n, 2) px, moved to the middle of their lines."""

    starts: np.ndarray
    ends: np.ndarray

    @property
    def lengths(self) -> np.ndarray:
        """(n,) px."""
        return np.hypot(*(self.ends - self.starts).T)


@record
class Inside:
    """Where a shape is: low (2,) px, the corner of a mask (H, W) bool of `steps` pixels a px."""

    low: np.ndarray
    steps: int
    mask: np.ndarray

    @classmethod
    def of(cls, rings: Sequence[Ring], steps: int = STEPS) -> Inside:
        """Return where rings, outer ones clockwise as seen and holes the other way, enclose a shape."""
        cubics, lines = pieces_of_rings(rings)
        low = np.floor(cubics.min(axis=(0, 1))) - 2.0
        columns, rows = ((np.ceil(cubics.max(axis=(0, 1))) + 2.0 - low) * steps).astype(int).tolist()
        return cls(low, steps, coverage((cubics - low) * steps, lines, 0, 0, rows, columns) > 0.5)

    def __call__(self, places: np.ndarray) -> np.ndarray:
        """Return (...) bool for places (..., 2) in px."""
        x, y = np.moveaxis(np.floor((places - self.low) * self.steps).astype(int), -1, 0)
        height, width = self.mask.shape
        return self.mask[y.clip(0, height - 1), x.clip(0, width - 1)]


def network_of(rings: tuple[Ring, ...]) -> list[Stroke]:
    """Return the straight strokes, of one width, that a shape may be; none if its sides are not straight.

    rings: outer ones clockwise as seen, holes the other way.
    """
    cubics, lines = pieces_of_rings(rings)
    chords = cubics[:, 3] - cubics[:, 0]
    lengths = np.hypot(*chords.T)
    width = 2.0 * sum(map(signed_area, rings)) / max(float(lengths.sum()), 1e-9)
    if len(lengths) < FEWEST or not width > 0.0:
        return []
    ways = chords / np.maximum(lengths, 1e-9)[:, None]
    inward = np.stack([-ways[:, 1], ways[:, 0]], axis=1)
    bends = np.abs(np.einsum("nkc,nc->nk", cubics[:, 1:3] - cubics[:, :1], inward)).max(axis=1)
    sides = (lengths > SHORTEST * width) & (lines | (bends <= FLAT))
    rest = lengths[~sides & (lengths > SHORTEST * width)].sum()
    if sides.sum() < FEWEST or rest > (1.0 - STRAIGHT) * lengths.sum() or _bent(ways, sides):
        return []
    inside = Inside.of(rings)
    starts, ends, inward = cubics[sides, 0], cubics[sides, 3], inward[sides]
    for _ in range(2):  # the second time with the width that the first has told
        found = _Sides(starts + 0.5 * width * inward, ends + 0.5 * width * inward)
        groups = _groups(found, width)
        width = _width(groups, starts, inward, found.lengths, width)
    middle = [_line(found, own) for own in groups]
    parts = [_segments(found, own, *line, inside, width) for own, line in zip(groups, middle, strict=True)]
    segments = np.concatenate(parts)
    lengths = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    return _strokes(segments, inside, width) if lengths.mean() >= THIN * width else []


def _bent(ways: np.ndarray, sides: np.ndarray) -> bool:
    """Return True if a share of the straight sides, (n,) bool of pieces with directions (n, 2), go on into another one
    at a small angle, as the pieces of a curve do.
    """
    after = np.roll(ways, -1, axis=0)
    turns = np.abs(np.arctan2(crossed(ways, after), (ways * after).sum(axis=1)))
    small = sides & np.roll(sides, -1) & (turns > EVEN) & (turns < math.asin(LEAST_SINE))
    return bool(small.sum() > BENT * sides.sum())


def _groups(sides: _Sides, width: float) -> list[np.ndarray]:
    """Return the numbers of sides that lie on one line, for each line; the longest sides first."""
    out, left, lengths = list[np.ndarray](), np.ones(len(sides.starts), dtype=bool), sides.lengths
    most = ACROSS * width + ALONG
    for first in np.argsort(-lengths, kind="stable").tolist():
        if not left[first]:
            continue
        own = np.array([first])
        for _ in range(3):  # rounds, in which a line becomes surer
            place, way = _line(sides, own)
            across = np.array([-way[1], way[0]])
            off = np.maximum(np.abs((sides.starts - place) @ across), np.abs((sides.ends - place) @ across))
            along = np.abs((sides.ends - sides.starts) @ way) > 0.9 * lengths
            own = np.flatnonzero(left & along & (off <= most))
            if first not in own:
                own = np.append(own, first)
        left[own] = False
        out.append(own)
    return out


def _line(sides: _Sides, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a place (2,) on the line of some sides, and its unit direction (2,): by least squares."""
    points, weights = np.concatenate([sides.starts[own], sides.ends[own]]), np.tile(sides.lengths[own], 2)
    place = np.average(points, axis=0, weights=weights)
    off = (points - place) * weights[:, None] ** 0.5
    way = np.linalg.eigh(off.T @ off)[1][:, 1]
    return place, way


def _width(
    groups: list[np.ndarray], starts: np.ndarray, inward: np.ndarray, lengths: np.ndarray, width: float
) -> float:
    """Return the usual distance of both sides of lines; the width if none has both."""
    found, weights = list[float](), list[float]()
    for own in groups:
        across = inward[own[0]]
        off, same = starts[own] @ across, inward[own] @ across > 0.0
        if same.all():
            continue
        one, other = (np.average(off[part], weights=lengths[own][part]) for part in (same, ~same))
        found.append(float(other - one))
        weights.append(float(min(lengths[own][same].sum(), lengths[own][~same].sum())))
    if not found:
        return width
    order = np.argsort(found)
    total = np.cumsum(np.array(weights)[order])
    return float(np.array(found)[order][np.searchsorted(total, 0.5 * total[-1])])


def _segments(
    sides: _Sides, own: np.ndarray, place: np.ndarray, way: np.ndarray, inside: Inside, width: float
) -> np.ndarray:
    """Return the parts (n, 2, 2) of a line that a shape holds, from end to end, as far as the shape goes on beyond the
    sides.
    """
    spans = np.sort(np.stack([(sides.starts[own] - place) @ way, (sides.ends[own] - place) @ way], axis=1), axis=1)
    spans = spans[np.argsort(spans[:, 0])]
    across = BESIDE * width * np.array([-way[1], way[0]])

    def held(first: float, last: float) -> np.ndarray:
        along = np.arange(first, last, 1.0 / STEPS)
        places = place + along[:, None] * way
        return np.asarray(inside(np.stack([places - across, places, places + across])).all(axis=0))

    parts = [spans[0].copy()]
    for first, last in spans[1:]:
        if first <= parts[-1][1] or held(parts[-1][1], first).all():
            parts[-1][1] = max(parts[-1][1], last)
        else:
            parts.append(np.array([first, last]))
    out = []
    for first, last in parts:
        before, behind = held(first - 2.0 * width, first)[::-1], held(last, last + 2.0 * width)
        ends = [
            first - (before.argmin() if not before.all() else len(before)) / STEPS,
            last + (behind.argmin() if not behind.all() else len(behind)) / STEPS,
        ]
        out.append(place + np.array(ends)[:, None] * way)
    return np.array(out)


def _strokes(segments: np.ndarray, inside: Inside, width: float) -> list[Stroke]:
    """Return the strokes of segments (n, 2, 2): those that make a corner in one, others up to the middle of the line in
    which they end.
    """
    ways = segments[:, 1] - segments[:, 0]
    lengths = np.hypot(*ways.T)
    ways = ways / np.maximum(lengths, 1e-9)[:, None]
    places, corners = segments.copy(), list[tuple[float, Link, Link, np.ndarray]]()
    for a, end in np.ndindex(len(segments), 2):
        sine = crossed(ways[a], ways)
        safe = np.where(np.abs(sine) > LEAST_SINE, sine, math.nan)
        off = segments[:, 0] - segments[a, end]
        ahead, along = crossed(off, ways) / safe, crossed(off, ways[a]) / safe  # px to where they meet, on either
        reach = MEETING * width / np.abs(safe)
        before_end = np.minimum(along, lengths - along)
        met = np.flatnonzero((np.abs(ahead) <= reach) & (before_end >= -reach))
        for b in met[np.argsort(-np.abs(ahead[met]), kind="stable")].tolist():
            meeting = segments[a, end] + ahead[b] * ways[a]
            if before_end[b] > reach[b]:
                places[a, end] = meeting
            elif a < b:
                other = b, int(along[b] > 0.5 * lengths[b])
                corners.append((abs(ahead[b]) + abs(before_end[b]), (a, end), other, meeting))
    partner = dict[Link, Link]()
    for _, one, other, meeting in sorted(corners, key=itemgetter(0)):
        if (
            one not in partner
            and other not in partner
            and inside(_tip(meeting, _way_in(ways, one), _way_in(ways, other), width))
        ):
            partner |= {one: other, other: one}
            places[one] = places[other] = meeting
    for _, one, other, _ in corners:
        if (one in partner) != (other in partner):
            one, other = (one, other) if other in partner else (other, one)
            places[one] = places[other]
    out = []
    for row, closed in rows_of(range(len(segments)), partner):
        points = np.array([places[n, 1 - end] for n, end in row])
        path = polygon(points) if closed else line_chain(np.vstack([places[row[0]], points]))
        out.append(Stroke(path, width))
    return out


def _way_in(ways: np.ndarray, link: Link) -> np.ndarray:
    """Return the direction (2,) from one end of a segment to the other, by those (n, 2) from the first to the last."""
    return ways[link[0]] * (1 - 2 * link[1])


def _tip(corner: np.ndarray, one: np.ndarray, other: np.ndarray, width: float) -> np.ndarray:
    """Return a place (2,) on the way to the tip of a corner, from which two lines go in directions (2,)."""
    inward = 0.5 * (one + other)  # as long as the cosine of half the angle
    cosine = float(np.hypot(*inward))
    return corner - TIP * 0.5 * width * inward / (cosine * math.sqrt(1.0 - cosine**2))
