"""Grouping of shapes into compound paths: lettering and patterns, as artists write them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring, signed_area
from cubicsplat_cli.artwork.geometry.stroke import Chain, Stroke
from cubicsplat_cli.artwork.shapes import Shape
from cubicsplat_cli.artwork.structure import boxes_of, near_box
from cubicsplat_cli.raster.outlines import coverage

# Two shapes of one colour may be a pair of eyes; this many are lettering or a pattern.
LEAST_SHAPES = 3
# A drawing of so few colours is a sign, a logo or lettering: its artist writes all shapes of a colour as one path.
FEW_PAINTS = 4
_OPAQUE = 255
Pen = tuple[float, str, str, bool]
_LOOP = 1.0  # px^2 of a loop that is seen
_COPY = 512  # px a side, on which loops are looked for


def compounds(shapes: Sequence[Shape]) -> list[list[Shape]]:
    """The shapes back to front, those to be written as one together: three or more paths in one opaque fill or
    gradient, and strokes by one pen; in a drawing of at most FEW_PAINTS of these any path, and whatever else that can
    has its paint.

    The rings of all of them in one path cover what the shapes cover, since every outer ring runs clockwise as seen and
    every hole the other way. A shape joins an earlier one where nothing of another fill that is drawn between them
    by then touches it, so the picture stays the same. Shapes of different groups, and those with shading, stay apart.
    """
    boxes = boxes_of(shapes).T.copy()
    paints = [(s.gradient or s.fill, _pen(s.stroke), s.group, id(s.shading) if s.shading else 0) for s in shapes]
    number_of = {paint: number for number, paint in enumerate(dict.fromkeys(paints))}
    sign = len({paint[:1] + paint[2:] for paint in paints}) <= FEW_PAINTS  # with any pens
    numbers = np.array([number_of[paint] for paint in paints], dtype=int)
    paths = np.array([not _primitive(shape) for shape in shapes], dtype=bool)
    joins = paths | np.array([sign and shape.stroke is None for shape in shapes], dtype=bool)
    free = joins & np.array([_opaque(shape) and not _crosses(shape) for shape in shapes], dtype=bool)
    while True:
        leaders = _leaders(boxes, numbers, free)
        # Groups of too few, and of primitives alone, are none.
        few = np.bincount(leaders, paths, len(shapes)) < (1 if sign else LEAST_SHAPES)
        loose = few[leaders] & (leaders != np.arange(len(shapes)))
        if not loose.any():
            return [[shapes[k] for k in np.flatnonzero(leaders == leader).tolist()] for leader in np.unique(leaders)]
        free &= ~loose


def _leaders(boxes: np.ndarray, numbers: np.ndarray, free: np.ndarray) -> np.ndarray:
    """(n,) the first of the shapes with which each is drawn, by their boxes (4, n), the numbers of their paints (n,),
    and whether they may be drawn with others (n,): the first that nothing is drawn after which it has to lie above.
    """
    leaders = np.arange(len(numbers))
    known: dict[int, list[int]] = {}
    for index in np.flatnonzero(free).tolist():
        same = known.setdefault(int(numbers[index]), [])
        if same:
            beneath = near_box(boxes[:, :index], boxes[:, index]) & (numbers[:index] != numbers[index])
            lowest = leaders[:index][beneath].max(initial=-1)
            leaders[index] = next((other for other in same if other > lowest), index)
        if leaders[index] == index:
            same.append(index)
    return leaders


def _pen(stroke: Stroke | None) -> Pen | None:
    """The properties that strokes of one path share: width, cap, join, and whether they are closed."""
    return None if stroke is None else (stroke.width, stroke.cap, stroke.join, stroke.closed)


def _primitive(shape: Shape) -> bool:
    """Whether a shape is a circle, ellipse or rectangle, which stays one; of strokes, what cannot join."""
    if shape.stroke is not None:
        return not isinstance(shape.stroke.path, (Chain, Ring))
    return len(shape.outlines) == 1 and not isinstance(shape.outlines[0], Ring)


def _opaque(shape: Shape) -> bool:
    """Two translucent shapes are not one where they overlap."""
    fills = [shape.fill] if shape.gradient is None else [stop.colour for stop in shape.gradient.stops]
    return all(fill[3] == _OPAQUE for fill in fills)


def _crosses(shape: Shape) -> bool:
    """Whether a ring crosses itself: where a loop runs the other way round, it would cut holes into others."""
    rings = [outline for outline in shape.outlines if isinstance(outline, Ring)]
    return shape.stroke is None and any(_reversed_area(ring) >= _LOOP for ring in rings)


def _reversed_area(ring: Ring) -> float:
    """Area in px^2 of the loops in which a ring that crosses itself runs the other way round, found on a copy of at
    most _COPY px a side."""
    points = ring.cubics.reshape(-1, 2)
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    factor = max(1.0, float(extent.max()) / _COPY)
    width, height = np.ceil(extent / factor).astype(int).tolist()
    covered = coverage((ring.cubics - low) / factor, ring.lines, 0, 0, height, width).sum()
    return 0.5 * (factor**2 * float(covered) - abs(signed_area(ring)))
