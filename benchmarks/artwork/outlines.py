"""Which outlines of a drawing are circles, ellipses, rectangles or rounded rectangles, however they are written."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from benchmarks.artwork.document import PRIMITIVES, Document
from cubicsplat_cli.artwork.geometry.outlines import points_at
from cubicsplat_cli.svg.elements import StyledShape
from cubicsplat_cli.svg.paths import PathSegment, cubics_of, subpaths
from cubicsplat_cli.svg.values import parse_length

# px, and shares of its size, that an outline may be off the primitive that it is, and off one that it might be.
OFF, OFF_SHARE, NEAR_SHARE = 0.1, 0.002, 0.004
LEAST_RADIUS = 0.5  # px of round corners
_STEPS = np.linspace(0.0, 1.0, 17)[1:]


@dataclass(frozen=True, eq=False)
class Form:
    """A closed outline. element: number of its element; kind: "round", "box", "rounded", or "" for any other; near: the
    same, of what might be one; written: whether as a primitive, in path data by its arcs or, among other outlines, by
    its level and upright lines; points: (n, 2) px of the canvas; width: px of its stroke, 0 without one.
    """

    element: int
    kind: str
    near: str
    written: bool
    points: np.ndarray
    width: float


def forms_of(document: Document) -> list[Form]:
    """Every closed outline of a drawing."""
    forms = []
    for number, shape in enumerate(document.shapes()):
        matrix, width = shape.matrix, 0.0
        if shape.style["stroke"] != "none":
            width = parse_length(shape.style["stroke-width"], shape.view[0]) * math.sqrt(
                abs(np.linalg.det(matrix[:2, :2]))
            )
        for points, written in _outlines(shape):
            placed = points @ matrix[:2, :2].T + matrix[:2, 2]
            if len(placed) >= 3 and np.ptp(placed, axis=0).min() > 0.0:
                near = kind_of(placed, NEAR_SHARE)
                forms.append(Form(number, near and kind_of(placed), near, written, placed, width))
    return forms


def _outlines(shape: StyledShape) -> Iterator[tuple[np.ndarray, bool]]:
    """(n, 2) points of each closed outline, in the element's own units, and whether it is written as a primitive."""
    if shape.name in ("line", "polyline"):
        return
    paths = subpaths(shape.path_data())
    for pieces in paths:
        points = [point for piece in pieces for point in along(piece)]
        letters = "".join(piece.command for piece in pieces)
        written = bool(_ARCS.fullmatch(letters) or (len(paths) > 1 and _LEVEL.fullmatch(letters)))
        if points:
            yield without_repeats(np.array(points)), written or shape.name in PRIMITIVES


# Path data of ellipses and rounded rectangles, and of rectangles.
_ARCS, _LEVEL = re.compile(r"A{2,4}Z|([HV]A){2,4}Z"), re.compile(r"HVHV?Z|VHVH?Z")


def without_repeats(points: np.ndarray) -> np.ndarray:
    """The points (n, 2) of a closed outline but for those where the one before lies."""
    moved = np.abs(points - np.roll(points, 1, axis=0)).max(axis=1) > 1e-9
    return points[moved] if moved.any() else points[:1]


def along(piece: PathSegment) -> list[tuple[float, float]]:
    """Points of a piece of a path, its start left out, its end included."""
    if not piece.handles and not piece.is_arc:
        return [piece.end]
    points = points_at(np.stack(cubics_of(piece)), _STEPS).reshape(-1, 2)
    return [(float(x), float(y)) for x, y in points]


def kind_of(points: np.ndarray, share: float = OFF_SHARE, slack: float = 0.0) -> str:
    """Whether a closed outline of points (n, 2), px, is "round" (circle, ellipse), a "box", or a "rounded" box.

    share: of its size that it may be off. slack: px that the points themselves may be off.
    """
    allowed = slack + OFF + share * float(np.ptp(points, axis=0).max())
    dense = _dense(points)
    if len(points) >= 8 and _off_ellipse(dense) <= allowed:
        return "round"
    radius, off = min(_boxes(points, dense, slack), key=lambda found: found[1])
    if off > allowed:
        return ""
    return "rounded" if radius else "box"


def _boxes(points: np.ndarray, dense: np.ndarray, slack: float) -> Iterator[tuple[float, float]]:
    """The radius of the corners of the box around points, with sharp corners and with round ones by its area, and how
    far the farthest point is off it.
    """
    # A box lies along its longest side; where sides are steps, along that of the smallest box.
    sides = np.roll(points, -1, axis=0) - points
    side = sides[int(np.hypot(*sides.T).argmax())] if not slack else _smallest_box_direction(points)
    along_side = side / math.hypot(*side)
    turned = dense @ np.array([[along_side[0], -along_side[1]], [along_side[1], along_side[0]]])
    half = np.ptp(turned, axis=0) / 2.0
    middle = turned.min(axis=0) + half
    x, y = points.T
    area = 0.5 * abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()))
    round_corner = math.sqrt(max(4.0 * half[0] * half[1] - area, 0.0) / (4.0 - math.pi))
    for radius in {0.0, min(round_corner, float(half.min()))}:
        if radius == 0.0 or LEAST_RADIUS < round_corner <= half.min() + OFF + slack:
            q = np.abs(turned - middle) - half + radius
            off = np.hypot(*np.maximum(q, 0.0).T) + np.minimum(q.max(axis=1), 0.0) - radius
            yield radius, float(np.abs(off).max())


def _smallest_box_direction(points: np.ndarray) -> np.ndarray:
    """(2,) the direction of a side of the smallest box around points, one of the sides of their hull."""
    corners = points[ConvexHull(points).vertices]
    directions = np.roll(corners, -1, axis=0) - corners
    directions /= np.hypot(*directions.T)[:, None]
    across = np.ptp(corners @ directions.T, axis=0)
    down = np.ptp(corners @ np.stack([-directions[:, 1], directions[:, 0]]), axis=0)
    return directions[int((across * down).argmin())]


def _dense(points: np.ndarray) -> np.ndarray:
    """The points and those at the eighths of the way to the next ones."""
    after = np.roll(points, -1, axis=0)
    t = np.arange(8)[None, :, None] / 8.0
    return (points[:, None] * (1.0 - t) + after[:, None] * t).reshape(-1, 2)


def _off_ellipse(points: np.ndarray) -> float:
    """How far the farthest point is off the ellipse of the least squares, to first order; infinite without one."""
    origin, size = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    x, y = ((points - origin) / size).T
    terms = np.stack([x * x, x * y, y * y, x, y], axis=1)
    values, *_ = np.linalg.lstsq(terms, np.ones(len(x)), rcond=None)
    a, b, c, d, e = values
    if 4.0 * a * c - b * b <= 0.0:
        return math.inf
    slope = np.hypot(2.0 * a * x + b * y + d, b * x + 2.0 * c * y + e)
    return float(np.abs((terms @ values - 1.0) / np.maximum(slope, 1e-9)).max() * size)
