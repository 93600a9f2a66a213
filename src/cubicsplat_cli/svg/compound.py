"""Groups the shapes of lettering and patterns into compound paths."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Rectangle, Ring, pieces_of_rings, signed_area
from cubicsplat_cli.artwork.geometry.stroke import Chain, Stroke
from cubicsplat_cli.artwork.shapes import Shape, is_framed
from cubicsplat_cli.artwork.structure import boxes_of, near_box
from cubicsplat_cli.raster.outlines import coverage
from cubicsplat_cli.scene.paint import is_opaque
from cubicsplat_cli.svg.drawing_paths import MOST_ON_RECT

# Three shapes of one colour may be a head and two hands; this many are lettering or a pattern.
LEAST_SHAPES = 4
# A drawing of so few colours is a sign, a logo or lettering, in which all shapes of a colour are one path.
FEW_PAINTS = 4
_DOT = 4.0  # px^2 of the box of a shape, of the few pixels that show no form
_LOOP = 1.0  # px^2, the least area of a visible loop
_COPY = 512  # px, the longer side of the copy of a window in which loops and shared pixels are searched


def compounds(shapes: Sequence[Shape]) -> list[list[Shape]]:
    """Return the shapes back to front, grouped into compound paths.

    Where LEAST_SHAPES paths or more have one opaque fill or gradient, or are strokes by one pen, all that can join
    become groups, however small: their sizes depend on the order of layers, which little may change. In a drawing of at
    most FEW_PAINTS fills and gradients, one path and anything else that can join it is enough. Well rounded boxes join
    paths too, as they are written as paths, and dots, since pixels do not tell their form. A fill and the stroke around
    it are a group of their own.

    The rings of a group cover what its shapes cover, since every outer ring runs clockwise as seen and every hole the
    other way. A shape joins another one only if no shape of another fill that shares a pixel with it is drawn between
    them, so the picture stays the same. Shapes of different groups in the file, and those with shading, stay apart.
    """
    boxes = boxes_of(shapes).T.copy()
    paints = [(s.paint, _pen(s.stroke), s.group, id(s.shading) if s.shading else 0) for s in shapes]
    number_of = {paint: number for number, paint in enumerate(dict.fromkeys(paints))}
    sign = len({paint[:1] + paint[2:] for paint in paints}) <= FEW_PAINTS  # with any pens
    numbers = np.array([number_of[paint] for paint in paints], dtype=int)
    paths = np.array([primitive_of(shape) is None for shape in shapes], dtype=bool)
    filled = np.array([shape.stroke is None for shape in shapes], dtype=bool)
    dots = filled & ((boxes[2:] - boxes[:2]).prod(axis=0) <= _DOT)
    # Boxes that are written as paths, for their round corners.
    rounded = [isinstance(box := shape.outlines[0], Rectangle) and box.radius > MOST_ON_RECT for shape in shapes]
    framed = np.array([*(is_framed(*pair) for pair in pairwise(shapes)), False])
    joins = (paths | dots | (filled & (sign | np.array(rounded, dtype=bool)))) & ~framed & ~np.roll(framed, 1)
    # Translucent shapes would look different where they overlap.
    free = joins & np.array([is_opaque(shape.paint) for shape in shapes], dtype=bool)
    for k in np.flatnonzero(free).tolist():
        if _crosses(shapes[k]):
            beside = free & near_box(boxes, boxes[:, k]) & (numbers == numbers[k])
            free[k] = not _cuts(shapes[k], [shapes[n] for n in np.flatnonzero(beside).tolist() if n != k])
    free &= sign | (np.bincount(numbers, free)[numbers] >= LEAST_SHAPES)
    last = len(shapes) - 1

    @cache
    def pieces(k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cubics, lines = pieces_of_rings(shapes[k].oriented())
        rows = np.sort(cubics[..., 1], axis=1)[:, [0, -1]]
        return cubics, lines, rows.T.copy()

    @cache
    def meet(first: int, second: int) -> bool:
        low = np.floor(np.maximum(boxes[:2, first], boxes[:2, second]))
        extent = np.ceil(np.minimum(boxes[2:, first], boxes[2:, second])) - low
        if (extent <= 0.0).any():
            return False
        covered = []
        for cubics, lines, (top, bottom) in (pieces(first), pieces(second)):
            # Pieces above or below a window cover nothing in it, and most windows are a small part of a large shape.
            level = (bottom >= low[1]) & (top <= low[1] + extent[1])
            covered.append(_copy(cubics[level], lines[level], low, extent) > 0.0)
        return bool((covered[0] & covered[1]).any())

    while True:
        # From the back to the front, or the other way round, where each joins a later one.
        forth = _leaders(boxes, numbers, free, meet)
        back = last - _leaders(boxes[:, ::-1], numbers[::-1], free[::-1], lambda a, b: meet(last - b, last - a))[::-1]
        leaders = min(forth, back, key=lambda each: len(np.unique(each)))
        # Groups of primitives alone that show their form are dissolved.
        loose = (np.bincount(leaders, paths | dots, len(shapes)) == 0)[leaders] & (leaders != np.arange(len(shapes)))
        if not loose.any():
            leaders[1:][framed[:-1]] = np.flatnonzero(framed)
            return [[shapes[k] for k in np.flatnonzero(leaders == leader).tolist()] for leader in np.unique(leaders)]
        free &= ~loose


def _leaders(boxes: np.ndarray, numbers: np.ndarray, free: np.ndarray, meet: Callable[[int, int], bool]) -> np.ndarray:
    """Return the first shape (n,) of the group of each shape.

    That is the first of its paint after which no shape is drawn that must stay beneath it. boxes: (4, n). numbers: (n,)
    of the paints. free: (n,) whether a shape may join others. meet: whether two shapes share a pixel, the lower first.
    """
    leaders = np.arange(len(numbers))
    leaders_of: dict[int, list[int]] = {}
    for index in np.flatnonzero(free).tolist():
        same = leaders_of.setdefault(int(numbers[index]), [])
        if same:
            near = near_box(boxes[:, :index], boxes[:, index]) & (numbers[:index] != numbers[index])
            # Only what is drawn after the first of the group keeps it from that, what is drawn last first of all.
            after = np.flatnonzero(near & (leaders[:index] > same[0]))
            after = after[np.argsort(-leaders[after], kind="stable")]
            lowest = next((int(leaders[k]) for k in after.tolist() if meet(k, index)), -1)
            leaders[index] = next((other for other in same if other > lowest), index)
        if leaders[index] == index:
            same.append(index)
    return leaders


def _pen(stroke: Stroke | None) -> tuple[Hashable, ...] | None:
    """Return what strokes of one path share: width, cap, join, dashes, and whether they are closed."""
    if stroke is None:
        return None
    return stroke.width, stroke.cap, stroke.join, stroke.dashes, stroke.offset, stroke.closed


def primitive_of(shape: Shape) -> Circle | Ellipse | Rectangle | None:
    """Return the circle, ellipse or rectangle that a shape, or the path of its stroke, is; None for others, and for one
    that a transform would turn together with its gradient.
    """
    path, *more = shape.paths
    if more or isinstance(path, (Chain, Ring)):
        return None
    turned = not isinstance(path, Circle) and path.angle != 0.0
    return None if turned and shape.gradient is not None else path


def _crosses(shape: Shape) -> bool:
    """Return whether a loop of a ring runs the other way round; it would cut a hole into shapes that it lies on."""
    rings = [ring for ring in shape.outlines if shape.stroke is None and isinstance(ring, Ring)]
    return any(_reversed_area(ring) >= _LOOP for ring in rings)


def _cuts(shape: Shape, others: Sequence[Shape]) -> bool:
    """Return whether less is covered where a shape and others are one path."""
    own, rest = shape.oriented(), tuple(ring for other in others for ring in other.oriented())
    x0, y0, x1, y1 = np.rint(boxes_of([shape])[0]).astype(int).tolist()
    window = y0 - 1, x0 - 1, y1 - y0 + 2, x1 - x0 + 2
    one, many, both = (coverage(*pieces_of_rings(rings), *window) for rings in (own, rest or own, own + rest))
    return bool((np.maximum(one, many) - both).sum() >= _LOOP)


def _reversed_area(ring: Ring) -> float:
    """Return the area in px^2 of the loops in which a ring that crosses itself runs the other way round."""
    points = ring.cubics.reshape(-1, 2)
    extent = np.ptp(points, axis=0)
    covered = _copy(ring.cubics, ring.lines, points.min(axis=0), extent).sum()
    return 0.5 * (_times(extent) ** 2 * float(covered) - abs(signed_area(ring)))


def _copy(cubics: np.ndarray, lines: np.ndarray, low: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """Return the coverage (h, w) of a window of an extent (2,) px by outlines, each side `_times` smaller."""
    width, height = np.ceil(extent / _times(extent)).astype(int).tolist()
    return coverage((cubics - low) / _times(extent), lines, 0, 0, height, width)


def _times(extent: np.ndarray) -> float:
    return max(1.0, float(extent.max()) / _COPY)
