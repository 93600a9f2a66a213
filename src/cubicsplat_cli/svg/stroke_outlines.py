"""Outlines of strokes, near enough to begin a fit with.

Each cubic is halved and offset by its ends and the directions of its handles. `artwork.strokes.offset` is exact, and
needs 1.7 times the segments for 1 dB more.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from cubicsplat_cli.svg.paths import Subpath, halves, line_as_cubic

_SHORT = 1e-9


def stroke_rings(line: Subpath, half: float, cap: str, join: str, limit: float) -> list[np.ndarray]:
    """The closed cubics (M, 4, 2) around a stroke of half-width `half`: one ring, of a closed subpath two.

    cap, join, limit: as in SVG. Each cubic is offset in halves, by its ends and the direction of its handles.
    """
    cubics = halves(line.ring() if line.closed else line.cubics)
    back = cubics[::-1, ::-1]
    if line.closed:
        return [_side(cubics, half, join, limit, around=True), _side(back, half, join, limit, around=True)]
    there, again = _side(cubics, half, join, limit, around=False), _side(back, half, join, limit, around=False)
    ends = [_cap(there[-1, 3], again[0, 0], half, cap), _cap(again[-1, 3], there[0, 0], half, cap)]
    return [np.concatenate([there, ends[0], again, ends[1]])]


def _side(cubics: np.ndarray, half: float, join: str, limit: float, *, around: bool) -> np.ndarray:
    """The cubics moved to their left as seen, and what joins them."""
    moved = [_moved(cubic, half) for cubic in cubics]
    cubics_of_side = [moved[0][0]]
    pairs = list(zip(range(len(moved)), range(1, len(moved)), strict=False))
    for before, after in [*pairs, *([(len(moved) - 1, 0)] if around else [])]:
        cubics_of_side += _joint(moved[before], moved[after], cubics[after, 0], half, join, limit)
        if after:
            cubics_of_side.append(moved[after][0])
    return np.stack(cubics_of_side)


def _moved(cubic: np.ndarray, half: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A cubic moved to its left, and its normals at both ends."""
    first, last = _normal(cubic), -_normal(cubic[::-1])
    start, end = cubic[0] + half * first, cubic[3] + half * last
    chord = math.dist(cubic[0], cubic[3])
    scale = math.dist(start, end) / chord if chord > _SHORT else 1.0
    handles = [start + scale * (cubic[1] - cubic[0]), end + scale * (cubic[2] - cubic[3])]
    return np.stack([start, *handles, end]), first, last


def _normal(cubic: np.ndarray) -> np.ndarray:
    """The unit vector to the left of where a cubic sets out."""
    for point in cubic[1:]:
        x, y = point - cubic[0]
        if math.hypot(x, y) > _SHORT:
            return np.array([y, -x]) / math.hypot(x, y)
    return np.array([0.0, -1.0])


def _joint(
    before: tuple[np.ndarray, np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray, np.ndarray],
    corner: np.ndarray, half: float, join: str, limit: float,
) -> list[np.ndarray]:  # fmt: skip
    """The cubics that join two offset cubics at a corner: on its outer side a miter or an arc."""
    end, start = before[0][3], after[0][0]
    if math.dist(end, start) <= 1e-6 * half:
        return []
    u, v = before[2], after[1]
    outer = u[0] * v[1] - u[1] * v[0] > 0.0
    cosine = float(u @ v)
    # The ratio of the miter's length to the stroke's width is 1 / cos of half the angle between the normals.
    pointed = join.startswith("miter") and cosine > -1.0 + 1e-9 and math.sqrt(2.0 / (1.0 + cosine)) <= limit
    if outer and join == "round":
        return _around(corner, u, v, half)
    if not outer or not pointed:
        return [line_as_cubic(end, start)]
    tip = corner + half / (1.0 + cosine) * (u + v)
    return [line_as_cubic(end, tip), line_as_cubic(tip, start)]


def _around(
    middle: np.ndarray, u: np.ndarray, v: np.ndarray, radius: float, between: np.ndarray | None = None
) -> list[np.ndarray]:
    """The arc from the direction u to v, unit vectors, clockwise as seen, in two halves that meet in `between`."""
    if between is None:
        between = (u + v) / max(math.hypot(*(u + v)), _SHORT)
    arcs = []
    for first, last in ((u, between), (between, v)):
        handle = 4.0 / 3.0 * math.tan(math.acos(min(1.0, max(-1.0, float(first @ last)))) / 4.0)
        ahead, back = first + handle * _turned(first), last - handle * _turned(last)
        arcs.append(middle + radius * np.stack([first, ahead, back, last]))
    return arcs


def _turned(direction: np.ndarray) -> np.ndarray:
    """A quarter turn clockwise as seen."""
    return np.array([-direction[1], direction[0]])


def _cap(end: np.ndarray, start: np.ndarray, half: float, cap: str) -> np.ndarray:
    """From the left side's end to the right side's start."""
    across = (start - end) / (2.0 * half)
    ahead = half * np.array([across[1], -across[0]])
    if cap == "square":
        corners = [end, end + ahead, start + ahead, start]
        return np.stack([line_as_cubic(*pair) for pair in itertools.pairwise(corners)])
    if cap != "round":
        return line_as_cubic(end, start)[None]
    return np.stack(_around((end + start) / 2.0, -across, across, half, ahead / half))
