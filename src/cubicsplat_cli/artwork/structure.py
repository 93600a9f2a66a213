"""The structure of a finished drawing: its ground, the order of its shapes, and their groups in the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Rectangle, flattened, signed_area
from cubicsplat_cli.artwork.shapes import Drawing, Shape, colour_group, ground_shape
from cubicsplat_cli.scene.paint import Paint, Rgba

_ON_EDGE = 0.5  # px from the canvas' edge to the edge of a rectangle that covers the canvas, at most
_MARGIN = 1.0  # px; shapes farther apart share no pixel, so they may change their order


def ground_of(drawing: Drawing) -> Paint | None:
    """Return the paint of the shape that fills the canvas behind all others; None without one."""
    first = drawing.shapes[0].outlines if drawing.shapes else ()
    if len(first) != 1 or not isinstance(first[0], Rectangle) or first[0].angle != 0.0 or first[0].radius > _ON_EDGE:
        return None
    box = first[0]
    ends = box.x, box.y, drawing.width - box.x - box.width, drawing.height - box.y - box.height
    return drawing.shapes[0].paint if max(ends) <= _ON_EDGE else None


def on_ground(drawing: Drawing, fill: Rgba) -> Drawing:
    """Return a drawing with a ground of one fill behind it."""
    return replace(drawing, shapes=(ground_shape(fill, drawing.width, drawing.height), *drawing.shapes))


def with_ground(drawing: Drawing, ground: Paint, fill: Rgba | None) -> Drawing:
    """Return a drawing with another fill for its ground, or without its ground (None). In a cutout the ground is all
    shapes of its paint, so that holes are holes; otherwise it is the shape at the back.
    """
    shapes = []
    for index, shape in enumerate(drawing.shapes):
        if shape.paint != ground or (index and not drawing.abutting):
            shapes.append(shape)
        elif fill is not None:
            shapes.append(shape.filled(fill, drawing.width, drawing.height))
    return replace(drawing, shapes=tuple(shapes))


def by_lightness(drawing: Drawing) -> Drawing:
    """Return a cutout with its shapes in the order of a printer: by colour, the lightest first."""
    # Luma of Rec. 709.
    luma = {s.paint: 0.2126 * s.fill[0] + 0.7152 * s.fill[1] + 0.0722 * s.fill[2] for s in drawing.shapes}
    order = sorted(luma, key=lambda paint: -luma[paint])
    return replace(drawing, shapes=tuple(sorted(drawing.shapes, key=lambda shape: order.index(shape.paint))))


def grouped_by_colour(drawing: Drawing) -> Drawing:
    """Return the drawing in groups of one paint: one for each in a cutout, else as few as the order allows."""
    paints = [shape.paint for shape in drawing.shapes]
    return _in_groups(drawing, paints, [colour_group(shape.fill) for shape in drawing.shapes])


def grouped_by_object(drawing: Drawing, ground: Paint | None) -> Drawing:
    """Return a stacked drawing with each shape and all shapes on it in one group. Single shapes and the ground, given
    by its paint, are in none. A cutout of the drawing keeps the groups.
    """
    holder = _holders(drawing, ground)
    sizes = Counter(holder)
    return _in_groups(drawing, holder, ["object" if sizes[number] > 1 else "" for number in holder])


def _in_groups(drawing: Drawing, keys: Sequence[Hashable], names: Sequence[str]) -> Drawing:
    """Return the drawing with its shapes in groups of one key, in an order that does not change the picture.

    A shape joins an earlier group of its key unless a shape that touches it is in a later group. In a cutout it joins
    the first one, since shapes meet along edges only. names: of each shape's group; repeated names get numbers.
    """
    boxes = boxes_of(drawing.shapes).T.copy()
    groups, of_key = list[list[int]](), dict[Hashable, list[int]]()
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
    """Return (n, 4) left, top, right and bottom of the control points of each shape."""
    points = (np.concatenate([outline.ring().cubics.reshape(-1, 2) for outline in shape.outlines]) for shape in shapes)
    return np.array([[*each.min(axis=0), *each.max(axis=0)] for each in points]).reshape(-1, 4)


def near_box(boxes: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return (n,) bool, true for boxes (4, n) within _MARGIN of a box (4,)."""
    left, top, right, bottom = boxes
    low, high = box[:2] - _MARGIN, box[2:] + _MARGIN
    return np.asarray((left <= high[0]) & (right >= low[0]) & (top <= high[1]) & (bottom >= low[1]))


def _holders(drawing: Drawing, ground: Paint | None) -> list[int]:
    """Return for each shape the number of the outermost shape that it lies on, its own if there is none. A shape lies
    on a larger one if half of its outline lies within the other's outer outline. The ground holds none.
    """
    shapes = drawing.shapes
    boxes = boxes_of(shapes)
    outer = [flattened(shape.outlines[0].ring(), 2.0) for shape in shapes]  # px between points
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
        points = outer[index][:: max(1, len(outer[index]) // 32)]
        # The smallest one first.
        for other in order[np.flatnonzero(around)[::-1]].tolist():
            if _share_within(points, outer[other]) >= 0.5:
                holder[index] = holder[other]
                break
    return holder


def _share_within(points: np.ndarray, corners: np.ndarray) -> float:
    """Return the share of points (n, 2) within a polygon (m, 2), by the even-odd rule."""
    (x, y), after = points.T[..., None], np.roll(corners, -1, axis=0)
    spans = (corners[:, 1] <= y) != (after[:, 1] <= y)
    rise = np.where(after[:, 1] == corners[:, 1], 1.0, after[:, 1] - corners[:, 1])
    at = corners[:, 0] + (y - corners[:, 1]) * (after[:, 0] - corners[:, 0]) / rise
    return float((np.count_nonzero(spans & (at > x), axis=1) % 2).mean())
