"""The centre line through points of a stroke: corners where its flanks meet, lines and cubics between them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import LEAST
from cubicsplat_cli.artwork.geometry.fitting import PRECISION, parameter_price
from cubicsplat_cli.artwork.geometry.outlines import arc_lengths, crossed, feet_of
from cubicsplat_cli.artwork.geometry.stroke import Chain, line_chain
from cubicsplat_cli.raster.cubics import Division, Joints, Pieces, divided_run
from cubicsplat_cli.raster.outlines import parabolas

CORNER = math.radians(20.0)  # a bend in a gap of the points from which it may be a corner
LONG_GAP = 0.4  # widths, from which a gap is of a corner however little its flanks bend
FLANK = 8  # points that tell the direction of an end, as on either side of a gap
MITER_LIMIT = 4.0  # SVG's own: of the length of a miter over the width
FEWEST = 6  # points
HALF_WINDOWS = 2 ** np.arange(1, 5)  # points, of local fits


def open_line(points: np.ndarray, corners: np.ndarray, detail: float, slack: float) -> Chain:
    """The centre line through points (n, 2), its ends included; corners: indices of those where it bends sharply;
    slack: px by which points may be off beyond PRECISION.
    """
    stops = np.unique(np.concatenate([[0], corners, [len(points) - 1]]))
    price = parameter_price(points, detail)
    parts = []
    for first, last in pairwise(stops.tolist()):
        run = points[first : last + 1]
        parts.append(line_chain(run[[0, -1]]) if len(run) < FEWEST else _between_corners(run, price, slack))
    anchors = np.concatenate([parts[0].anchors, *(part.anchors[1:] for part in parts[1:])])
    controls, lines = [part.controls for part in parts], [part.lines for part in parts]
    smooth = np.concatenate([part.smooth[:-1] for part in parts] + [[False]])
    return Chain(anchors, np.concatenate(controls), np.concatenate(lines), smooth)


def _between_corners(points: np.ndarray, price: float, slack: float) -> Chain:
    weights = np.full(len(points), 1.0 / (PRECISION**2 + slack**2))
    local = _local_fits(points, weights)
    ends, tangents = points[[0, -1]], local[1][[0, -1]]
    # The ends are off by as many px as a point is, and by as many radians.
    division, _ = divided_run(local, weights, (ends, tangents, np.full((2, 2), PRECISION)), price)
    pieces, _, _ = _pieces(division, ends).refined(points, weights, feet_of(division.sizes))
    return Chain.of(pieces)


def _local_fits(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return for points (n, 2) px, n >= 3, with weights (n,) 1/px^2 places of the line (n, 2), px, its unit tangents
    (n, 2) and curvature (n,), 1/px, and standard errors (n, 2), px across it and radians.

    Each point gets a parabola in arc length over a window of its neighbours, which grows while the parabola still
    explains them: straight stretches average many points and tight bends few (Lepski's choice of a bandwidth).
    """
    # Mean squared residuals, in sigmas, up to which fits of so many degrees of freedom are believed.
    kinds = [(half, 1.0 + 2.0 * math.sqrt(2.0 / (2 * half - 2))) for half in HALF_WINDOWS.tolist()]
    terms, errors, _ = parabolas(points, weights, arc_lengths(points), kinds)
    positions, first, second = terms[:, 0], terms[:, 1], 2.0 * terms[:, 2]
    speed = np.maximum(np.hypot(*first.T), 1e-9)
    return positions, first / speed[:, None], crossed(first, second) / speed**3, errors


def _pieces(division: Division, ends: np.ndarray) -> Pieces:
    anchors = np.concatenate([ends[:1], division.anchors[1:], ends[1:]])
    count, nothing = len(anchors), np.zeros((1, 2))
    outgoing = np.concatenate([division.handles[:, 0], nothing])
    incoming = np.concatenate([nothing, division.handles[:, 1]])
    smooth = np.zeros(count, dtype=bool)
    smooth[1:-1] = ~(division.lines[1:] & division.lines[:-1])
    # Both ends are where they are: their points tell nothing of the way along.
    tied = np.full((count, 2), -1)
    tied[1:-1] = np.arange(2 * (count - 2)).reshape(-1, 2)
    level = smooth & np.append(division.level, False)
    return Pieces((anchors, incoming, outgoing), Joints(division.lines, smooth, level, tied))


def with_corners(points: np.ndarray, gaps: np.ndarray, closed: bool, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Points about one px apart with corners put into gaps, and the corners' indices. points: (n, 2) px; gaps: (n,)
    bool, whether there is one between a point and the next; width: of the stroke, px.
    """
    count = len(points)
    out, corners = list[np.ndarray](), list[int]()
    for i in range(count):
        out.append(points[i])
        if not gaps[i] or (i == count - 1 and not closed):
            continue
        after = (i + 1) % count
        ways = _flank(points, gaps, i, -1, closed), _flank(points, gaps, after, 1, closed)
        corner = _meeting(points[i], points[after], *ways, width)
        if corner is not None:
            out.extend(_between(points[i], corner))
            corners.append(len(out))
            out += [corner, *_between(corner, points[after])]
    return np.array(out), np.array(corners, dtype=int)


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Points on the way, about one px apart, ends left out."""
    count = round(float(np.hypot(*(b - a))))
    t = np.arange(1, max(count, 1)) / max(count, 1)
    return a + (b - a) * t[:, None]


def _flank(points: np.ndarray, gaps: np.ndarray, start: int, step: int, closed: bool) -> np.ndarray:
    """(2,) the direction of the line, towards growing indices, at a point beside a gap."""
    index, i = [start], start
    while len(index) < FLANK:
        following = i + step
        if closed:
            following %= len(points)
        if not 0 <= following < len(points) or gaps[i if step > 0 else following]:
            break
        i = following
        index.append(i)
    return -step * end_of(points[index[::-1]])[0] if len(index) > 1 else np.zeros(2)


def end_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(2,) the unit tangent at the last of a run of points, and (2,) how it bends there, 1/px; 0 where all are one."""
    s = arc_lengths(points)
    if s[-1] < LEAST:
        return np.zeros(2), np.zeros(2)
    chord = points[-1] - points[0]
    off = (points - points[0]) @ np.array([-chord[1], chord[0]]) / max(float(np.hypot(*chord)), 1e-9)
    # It bends where points are off their chord by more than chance.
    degree = 2 if len(points) >= 6 and np.abs(off).max() > 2.0 * PRECISION else 1
    x, y = (np.polyfit(s - s[-1], points[:, c], degree)[::-1] for c in (0, 1))
    way = np.array([x[1], y[1]])
    way = way / max(float(np.hypot(*way)), 1e-9)
    bend = 2.0 * np.array([x[2], y[2]]) if degree == 2 else np.zeros(2)
    return way, bend - (bend @ way) * way


def _meeting(a: np.ndarray, b: np.ndarray, way: np.ndarray, onward: np.ndarray, width: float) -> np.ndarray | None:
    """The point where the line on from a meets the line back from b; None where both are about one line, where a bend
    of a radius of half a width explains the gap, and where it lies so far out that no miter would reach it.
    """
    gap, turn = b - a, float(crossed(way, onward))
    bend = 2.0 * min(float(np.hypot(*gap)) / width, LONG_GAP)
    if abs(math.atan2(turn, float(way @ onward))) < max(CORNER, bend):
        return None
    s, u = crossed(gap, onward) / turn, crossed(gap, way) / turn
    # Of a corner like a miter's, both ways to it over the gap are the miter's length over the width.
    return a + s * way if s > 0.0 > u and s - u < MITER_LIMIT * float(np.hypot(*gap)) else None
