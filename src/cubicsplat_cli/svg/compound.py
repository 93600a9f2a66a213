"""Grouping of shapes into compound paths: lettering and patterns, as artists write them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.geometry.stroke import Chain, Stroke
from cubicsplat_cli.artwork.shapes import Shape
from cubicsplat_cli.scene.paint import Gradient, Rgba

# Two shapes of one colour may be a pair of eyes; this many are lettering or a pattern.
LEAST_SHAPES = 3
# A drawing of so few colours is a sign, a logo or lettering: its artist writes all shapes of a colour as one path.
FEW_PAINTS = 4
_OPAQUE = 255
Pen = tuple[float, str, str, bool]
# Shapes nearer to each other than this keep their order.
_MARGIN = 1.0  # px


def compounds(shapes: Sequence[Shape]) -> list[list[Shape]]:
    """The shapes back to front, those to be written as one together: three or more paths in one opaque fill or
    gradient; in a drawing of at most FEW_PAINTS of these, where no shape is a stroke, any path and whatever else has
    its paint.

    The rings of all of them in one path cover what the shapes cover, since every outer ring runs clockwise as seen and
    every hole the other way. A shape joins an earlier one where nothing of another fill that is drawn between them
    touches it, so the picture stays the same. Shapes of different groups, and those with shading, stay apart.
    """
    boxes = np.array([_box(shape) for shape in shapes]).reshape(-1, 4)
    paints = [(s.gradient or s.fill, _pen(s.stroke), s.group, id(s.shading) if s.shading else 0) for s in shapes]
    number_of = {paint: number for number, paint in enumerate(dict.fromkeys(paints))}
    sign = len(number_of) <= FEW_PAINTS and all(shape.stroke is None for shape in shapes)
    numbers = np.array([number_of[paint] for paint in paints], dtype=int)
    leaders = np.arange(len(shapes))
    last: dict[tuple[Rgba | Gradient, Pen | None, str, int], int] = {}
    for index, shape in enumerate(shapes):
        if not _opaque(shape) or (_primitive(shape) and not sign):
            continue
        leader = last.get(paints[index])
        if leader is not None and not _meets_another(boxes, numbers, leader, index):
            leaders[index] = leader
        else:
            last[paints[index]] = index
    return _groups(shapes, leaders, sign)


def _pen(stroke: Stroke | None) -> Pen | None:
    """The properties that strokes of one path share: width, cap, join, and whether they are closed."""
    return None if stroke is None else (stroke.width, stroke.cap, stroke.join, stroke.closed)


def _groups(shapes: Sequence[Shape], leaders: np.ndarray, sign: bool) -> list[list[Shape]]:
    """Each group where its leader stands; groups of too few, and of primitives alone, are taken apart again."""
    paths = np.array([not _primitive(shape) for shape in shapes], dtype=bool)
    joined = np.bincount(leaders, paths, len(shapes)) >= (1 if sign else LEAST_SHAPES)
    groups: dict[int, list[Shape]] = {}
    for index, shape in enumerate(shapes):
        leader = int(leaders[index])
        groups.setdefault(leader if joined[leader] else index, []).append(shape)
    return list(groups.values())


def _primitive(shape: Shape) -> bool:
    """Whether a shape is a circle, ellipse or rectangle, which stays one; of strokes, what cannot join."""
    if shape.stroke is not None:
        return not isinstance(shape.stroke.path, (Chain, Ring))
    return len(shape.outlines) == 1 and not isinstance(shape.outlines[0], Ring)


def _opaque(shape: Shape) -> bool:
    """Two translucent shapes are not one where they overlap."""
    fills = [shape.fill] if shape.gradient is None else [stop.colour for stop in shape.gradient.stops]
    return all(fill[3] == _OPAQUE for fill in fills)


def _meets_another(boxes: np.ndarray, numbers: np.ndarray, leader: int, index: int) -> bool:
    """Whether a shape of another fill that is drawn after the leader and before this one is near this one."""
    between = slice(leader + 1, index)
    left, top, right, bottom = boxes[index]
    others = boxes[between][numbers[between] != numbers[index]]
    apart = (others[:, 0] > right) | (others[:, 2] < left) | (others[:, 1] > bottom) | (others[:, 3] < top)
    return not bool(apart.all())


def _box(shape: Shape) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of all its control points, with a margin."""
    points = np.concatenate([outline.ring().cubics.reshape(-1, 2) for outline in shape.outlines])
    (left, top), (right, bottom) = points.min(axis=0) - _MARGIN, points.max(axis=0)
    return left, top, right, bottom
