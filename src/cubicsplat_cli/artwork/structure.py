"""The structure of a finished drawing: its ground, the order of its shapes, and their groups in the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Rectangle, flattened, signed_area
from cubicsplat_cli.artwork.shapes import Drawing, Shape, colour_group, ground_shape
from cubicsplat_cli.scene.paint import Gradient, Rgba

# A rectangle that ends so near to the canvas' edge covers it.
_ON_EDGE = 0.5  # px
# Shapes as near to each other keep their order: no pixel is of both.
_MARGIN = 1.0  # px
_SAMPLES = 32  # points of an outline that are looked at, to tell where it lies
_FLAT = 2.0  # px between the points of an outline in which others may lie
Paint = Rgba | Gradient


def paint_of(shape: Shape) -> Paint:
    """The fill or gradient of a shape."""
    return shape.gradient or shape.fill


def ground_of(drawing: Drawing) -> Paint | None:
    """The paint of the shape that fills the canvas behind everything; None where none does."""
    first = drawing.shapes[0].outlines if drawing.shapes else ()
    if len(first) != 1 or not isinstance(first[0], Rectangle) or first[0].angle != 0.0 or first[0].radius > _ON_EDGE:
        return None
    box = first[0]
    ends = box.x, box.y, drawing.width - box.x - box.width, drawing.height - box.y - box.height
    return paint_of(drawing.shapes[0]) if max(ends) <= _ON_EDGE else None


def on_ground(drawing: Drawing, fill: Rgba) -> Drawing:
    """A drawing without a ground, on one of a fill."""
    return replace(drawing, shapes=(ground_shape(fill, drawing.width, drawing.height), *drawing.shapes))


def with_ground(drawing: Drawing, ground: Paint, fill: Rgba | None) -> Drawing:
    """A drawing whose ground, of a paint, is of another fill, or gone (None): in a cutout all that shows its paint, so
    that holes are holes; else the shape at the back alone.
    """
    shapes = []
    for index, shape in enumerate(drawing.shapes):
        if paint_of(shape) != ground or (index and not drawing.abutting):
            shapes.append(shape)
        elif fill is not None:
            shapes.append(shape.filled(fill, drawing.width, drawing.height))
    return replace(drawing, shapes=tuple(shapes))


def by_lightness(drawing: Drawing) -> Drawing:
    """A cutout whose shapes come by colour, the lightest first, as a printer prints them."""
    # Luma of Rec. 709.
    luma = {paint_of(s): 0.2126 * s.fill[0] + 0.7152 * s.fill[1] + 0.0722 * s.fill[2] for s in drawing.shapes}
    order = {paint: place for place, paint in enumerate(sorted(luma, key=lambda paint: -luma[paint]))}
    return replace(drawing, shapes=tuple(sorted(drawing.shapes, key=lambda shape: order[paint_of(shape)])))


def ranks_of(drawing: Drawing) -> np.ndarray:
    """(shapes,) the number of each shape's paint, in the order of their first use."""
    number_of = {paint: number for number, paint in enumerate(dict.fromkeys(map(paint_of, drawing.shapes)))}
    return np.array([number_of[paint_of(shape)] for shape in drawing.shapes], dtype=np.int64)


def grouped_by_colour(drawing: Drawing) -> Drawing:
    """The drawing with its shapes in groups of one paint: of a cutout one each, else as few as the order of painting
    leaves.
    """
    shapes = drawing.shapes
    paints = [paint_of(shape) for shape in shapes]
    return _in_groups(drawing, paints, [colour_group(shape.fill) for shape in shapes])


def grouped_by_object(drawing: Drawing, ground: Paint | None) -> Drawing:
    """A stacked drawing with each shape in one group with all that lies on or in it; shapes alone, and the ground, are
    in none. ground: its paint. A cutout made of it keeps the groups.
    """
    holder = _holders(drawing, ground)
    sizes = Counter(holder)
    return _in_groups(drawing, holder, ["object" if sizes[number] > 1 else "" for number in holder])


def _in_groups(drawing: Drawing, keys: Sequence[Hashable], names: Sequence[str]) -> Drawing:
    """The drawing with its shapes in groups of one key, in the order that leaves the picture as it is.

    A shape goes back to a group of its key unless a shape that touches it is in a later one; a cutout's go to the
    first, since none of them touch but along edges. names: of the groups, by shape; further ones of a name get numbers.
    """
    boxes = boxes_of(drawing.shapes).T.copy()
    groups: list[list[int]] = []
    of_key: dict[Hashable, list[int]] = {}
    group_of = np.zeros(len(keys), dtype=np.int64)
    for index, key in enumerate(keys):
        near = group_of[:index][near_box(boxes[:, :index], boxes[:, index])]
        lowest = 0 if drawing.abutting else int(near.max(initial=0))
        group = next((number for number in of_key.setdefault(key, []) if number >= lowest), len(groups))
        if group == len(groups):
            groups.append([])
            of_key[key].append(group)
        groups[group].append(index)
        group_of[index] = group
    shapes: list[Shape] = []
    used: Counter[str] = Counter()
    for members in groups:
        name = names[members[0]]
        used[name] += bool(name)
        label = f"{name}-{used[name]}" if used[name] > 1 else name
        shapes += [replace(drawing.shapes[index], group=label) for index in members]
    return replace(drawing, shapes=tuple(shapes))


def boxes_of(shapes: Sequence[Shape]) -> np.ndarray:
    """(n, 4) left, top, right and bottom of all control points of each shape."""
    boxes = np.empty((len(shapes), 4))
    for row, shape in zip(boxes, shapes, strict=True):
        points = np.concatenate([outline.ring().cubics.reshape(-1, 2) for outline in shape.outlines])
        row[:2], row[2:] = points.min(axis=0), points.max(axis=0)
    return boxes


def near_box(boxes: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(n,) bool: which boxes (4, n) are as near to a box (4,) as the margin."""
    left, top, right, bottom = boxes
    low, high = box[:2] - _MARGIN, box[2:] + _MARGIN
    return np.asarray((left <= high[0]) & (right >= low[0]) & (top <= high[1]) & (bottom >= low[1]))


def _holders(drawing: Drawing, ground: Paint | None) -> list[int]:
    """The number of the outermost shape that each shape lies on or in, its own where there is none; none lies on the
    ground.

    A shape lies in a larger one if half of its outline does, holes of that one not counted.
    """
    shapes = drawing.shapes
    boxes = boxes_of(shapes)
    outer = [flattened(shape.outlines[0].ring(), _FLAT) for shape in shapes]
    areas = np.array([abs(signed_area(shape.outlines[0].ring())) for shape in shapes])
    if ground is not None:
        areas[0] = 0.0
    holder = list(range(len(shapes)))
    order = np.argsort(-areas, kind="stable")
    left, top, right, bottom = boxes[order].T.copy()
    for place, index in enumerate(order.tolist()):
        if areas[index] == 0.0:
            break
        x, y = (left[place] + right[place]) / 2.0, (top[place] + bottom[place]) / 2.0
        larger = slice(place)
        around = (left[larger] <= x) & (right[larger] >= x) & (top[larger] <= y) & (bottom[larger] >= y)
        points = outer[index][:: max(1, len(outer[index]) // _SAMPLES)]
        # The smallest that holds it first.
        for other in order[np.flatnonzero(around)[::-1]].tolist():
            if _share_within(points, outer[other]) >= 0.5:
                holder[index] = holder[other]
                break
    return holder


def _share_within(points: np.ndarray, corners: np.ndarray) -> float:
    """The share of points (n, 2) within a polygon (m, 2), by the even-odd rule."""
    (x, y), after = points.T[..., None], np.roll(corners, -1, axis=0)
    spans = (corners[:, 1] <= y) != (after[:, 1] <= y)
    rise = np.where(after[:, 1] == corners[:, 1], 1.0, after[:, 1] - corners[:, 1])
    at = corners[:, 0] + (y - corners[:, 1]) * (after[:, 0] - corners[:, 0]) / rise
    return float((np.count_nonzero(spans & (at > x), axis=1) % 2).mean())
