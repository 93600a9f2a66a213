"""What is left of an outline beside what covers a part of it: its runs that show, each joined to the nearest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import (
    Ring,
    extent_of,
    places_within,
    points_at,
    polygon_lengths,
    ring_of_cubics,
    signed_area,
    thirds,
)
from cubicsplat_cli.artwork.geometry.stroke import between
from cubicsplat_cli.artwork.shapes import Shape
from cubicsplat_cli.artwork.strokes.network import Inside

FINE = 0.25  # px between the points of an outline
SEEN = 1.0  # px^2, of the least part that matters
STRAIGHT = 1e-6  # off 1, of the cosine of the angle at which a line goes on as another one


def left_of(shape: Shape, covers: Sequence[Ring], reach: float) -> list[Shape] | None:
    """Return the shapes that are left of a shape where nothing covers it, in any order; none if it is covered all over,
    None if what is left makes no shapes.

    covers: the outlines, clockwise as seen, of what covers it. reach: px by which what is left goes on beneath
    what covers the rest; runs of the outline that are shorter do not count.
    """
    rings, runs = list[Ring](), list[np.ndarray]()
    hidden = [(extent_of([cover]), Inside.of([cover])) for cover in covers]
    for ring in shape.oriented():
        low, high = extent_of([ring])
        near = [inside for (first, last), inside in hidden if (first <= high).all() and (last >= low).all()]
        if not near:
            rings.append(ring)
            continue
        piece, number = places_within(np.maximum(1, np.ceil(polygon_lengths(ring.cubics) / FINE)).astype(int))
        places = piece + number / np.bincount(piece)[piece]
        points = points_at(ring.cubics[piece], (places - piece)[:, None])[:, 0]
        covered = np.logical_or.reduce([inside(points) for inside in near])
        if not covered.any():
            rings.append(ring)
        elif not covered.all():
            runs += [_longer(run, reach) for run in _runs(ring.cubics, places, ~covered, reach)]
    rings += _joined(runs)
    outer = [ring for ring in rings if signed_area(ring) >= SEEN]
    made = [replace(shape, outlines=(ring,)) for ring in outer]
    for hole in rings:
        if signed_area(hole) <= -SEEN:
            around = [k for k, ring in enumerate(outer) if _holds(ring, hole)]
            if not around:
                return None
            k = min(around, key=lambda k: signed_area(outer[k]))
            made[k] = replace(made[k], outlines=(*made[k].outlines, hole))
    window = shape.window
    off = sum(each.coverage(*window) for each in made) - shape.coverage(*window)
    return None if np.maximum(off, 0.0).sum() > SEEN * len(made) else made


def _holds(outer: Ring, inner: Ring) -> bool:
    """Return whether the box of a ring lies within that of another one."""
    (low, high), (first, last) = extent_of([outer]), extent_of([inner])
    return bool((low <= first).all() and (high >= last).all())


def _runs(cubics: np.ndarray, places: np.ndarray, shown: np.ndarray, shortest: float) -> list[np.ndarray]:
    """Return the parts (n, 4, 2) of a ring of cubics that show, of those at least so many px long. places, shown: (m,)
    of points FINE px apart along it, the number of a cubic and the parameter on it, and whether they do."""
    first = int(np.argmin(shown))
    along, count = np.roll(shown, -first), len(places)
    starts = np.flatnonzero(along & ~np.roll(along, 1)) + first
    ends = np.flatnonzero(along & ~np.roll(along, -1)) + first
    twice = np.concatenate([places, places + len(cubics)])
    around = np.concatenate([cubics, cubics, cubics])
    long = FINE * (ends - starts) >= shortest
    return [
        between(around, *twice[[a % count, a % count + b - a]].tolist())
        for a, b in zip(starts[long], ends[long], strict=True)
    ]


def _longer(run: np.ndarray, reach: float) -> np.ndarray:
    """Return a part (n, 4, 2) of an outline that goes on straight for so many px at both ends."""
    ends = []
    for place, way in ((run[0, 0], run[0, 0] - run[0, 1]), (run[-1, 3], run[-1, 3] - run[-1, 2])):
        ends.append(place + reach * way / max(float(np.hypot(*way)), 1e-9))
    return np.concatenate([_line(ends[0], run[0, 0]), run, _line(run[-1, 3], ends[1])])


def _line(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the line (1, 4, 2) between two places (2,)."""
    return np.concatenate([start[None, None], thirds(start[None], end[None]), end[None, None]], axis=1)


def _joined(runs: list[np.ndarray]) -> list[Ring]:
    """Return the rings of parts (n, 4, 2) of outlines, each of which goes on straight to that which begins nearest."""
    if not runs:
        return []
    starts, ends = np.array([run[0, 0] for run in runs]), np.array([run[-1, 3] for run in runs])
    distances = np.hypot(*(ends[:, None] - starts).transpose(2, 0, 1))
    following = dict[int, int]()
    for pair in np.argsort(distances, axis=None, kind="stable").tolist():
        end, start = divmod(pair, len(runs))
        if end not in following and start not in following.values():
            following[end] = start
    rings, left = list[Ring](), set(following)
    while left:
        row = [min(left)]
        while following[row[-1]] != row[0]:
            row.append(following[row[-1]])
        left -= set(row)
        rings.append(
            _ring([part for a, b in pairwise([*row, row[0]]) for part in (runs[a], _line(ends[a], starts[b]))])
        )
    return rings


def _ring(parts: list[np.ndarray]) -> Ring:
    """Return the ring of parts (n, 4, 2) of outlines; lines that go on straight as others are one."""
    cubics = np.concatenate(parts)
    cubics = cubics[polygon_lengths(cubics) > 1e-9]
    chords = cubics[:, 3] - cubics[:, 0]
    ways = chords / np.maximum(np.hypot(*chords.T), 1e-9)[:, None]
    lines = np.isclose(cubics[:, 1:3], thirds(cubics[:, 0], cubics[:, 3])).all(axis=(1, 2))
    before = np.roll(np.arange(len(cubics)), 1)
    kept = np.flatnonzero(~(lines & lines[before] & ((ways * ways[before]).sum(axis=1) > 1.0 - STRAIGHT)))
    merged = cubics[kept]
    merged[:, 3] = np.roll(merged[:, 0], -1, axis=0)
    straight = lines[kept]
    merged[straight, 1:3] = thirds(merged[straight, 0], merged[straight, 3])
    return ring_of_cubics(merged, straight, smooth=False)
