"""What is left of an outline beside what covers a part of it: its runs that show, each joined to the nearest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import (
    Ring,
    are_lines,
    extent_of,
    places_within,
    points_at,
    polygon_lengths,
    ring_of_cubics,
    signed_area,
    thirds,
)
from cubicsplat_cli.artwork.geometry.rows import Link, rows_of
from cubicsplat_cli.artwork.geometry.stroke import between, line_chain
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
    before, behind = (line_chain(np.stack(points)).cubics for points in ((ends[0], run[0, 0]), (run[-1, 3], ends[1])))
    return np.concatenate([before, run, behind])


def _joined(runs: list[np.ndarray]) -> list[Ring]:
    """Return the rings of parts (n, 4, 2) of outlines, each of which goes on straight to that which begins nearest."""
    if not runs:
        return []
    starts, ends = np.array([run[0, 0] for run in runs]), np.array([run[-1, 3] for run in runs])
    distances = np.hypot(*(ends[:, None] - starts).transpose(2, 0, 1))
    partner = dict[Link, Link]()  # the end of each, 1, goes on into the start of another one, 0
    for pair in np.argsort(distances, axis=None, kind="stable").tolist():
        end, start = divmod(pair, len(runs))
        if (end, 1) not in partner and (start, 0) not in partner:
            partner |= {(end, 1): (start, 0), (start, 0): (end, 1)}
    rings = list[Ring]()
    for row, _ in rows_of(range(len(runs)), partner):
        parts = list[np.ndarray]()
        for (a, _), (b, _) in pairwise([*row, row[0]]):
            parts += [runs[a], line_chain(np.stack([ends[a], starts[b]])).cubics]
        rings.append(_ring(parts))
    return rings


def _ring(parts: list[np.ndarray]) -> Ring:
    """Return the ring of parts (n, 4, 2) of outlines; lines that go on straight as others are one."""
    cubics = np.concatenate(parts)
    cubics = cubics[polygon_lengths(cubics) > 1e-9]
    chords = cubics[:, 3] - cubics[:, 0]
    ways = chords / np.maximum(np.hypot(*chords.T), 1e-9)[:, None]
    lines = are_lines(cubics)
    before = np.roll(np.arange(len(cubics)), 1)
    kept = np.flatnonzero(~(lines & lines[before] & ((ways * ways[before]).sum(axis=1) > 1.0 - STRAIGHT)))
    merged = cubics[kept]
    merged[:, 3] = np.roll(merged[:, 0], -1, axis=0)
    lines = lines[kept]
    merged[lines, 1:3] = thirds(merged[lines, 0], merged[lines, 3])
    return ring_of_cubics(merged, lines, smooth=False)
