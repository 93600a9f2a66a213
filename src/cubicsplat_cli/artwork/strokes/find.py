"""Shapes of even width found and drawn as strokes; all others stay as they are."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import MEAN_ERROR
from cubicsplat_cli.artwork.geometry.fitting import PRECISION
from cubicsplat_cli.artwork.geometry.outlines import Circle, Outline, Rectangle, Ring, flattened, pieces_of_rings
from cubicsplat_cli.artwork.geometry.stroke import EVEN_PX, EVEN_SHARE, ROUND, Stroke, line_chain
from cubicsplat_cli.artwork.shapes import SHAPE_PARAMETERS, Drawing, Shape
from cubicsplat_cli.artwork.strokes.network import network_of
from cubicsplat_cli.artwork.traced import MOST_OFF
from cubicsplat_cli.raster.outlines import coverage
from cubicsplat_cli.raster.strokes import evenly_wide

MOST_SLACK = 0.15  # px by which an outline may be off: the error of its pixels, of full scale, up to this
BESIDE = 2.0  # widths, of an outline, that are uneven at the ends of a stroke and where it meets others
# Where the px by which widths may differ are a larger part of the width, any thin shape would be even.
LEAST_TOLD = 8.0
PEN = SHAPE_PARAMETERS + 1.0  # numbers: of the style and the width of strokes
LEAST_LENGTH = PEN + SHAPE_PARAMETERS + 4.0  # numbers: of a shape with one straight stroke
LEAST_ASPECT = 3.0  # of a bar that is a stroke where all are asked for
ALIKE = 0.08  # px; widths that differ by less are one


def as_strokes(drawing: Drawing, detail: float, error: float, *, shorter: bool = False) -> list[tuple[Shape, ...]]:
    """For each shape of a drawing its strokes if it is of even width, one for each line of a pen, else itself.

    A shape is given up where its strokes would cover anything else than it does. Widths that are alike become one.
    error: of the pixels that it was fitted to, of full scale. shorter: only where their description is shorter, and
    widths are told well enough.
    """
    slack, shapes = min(error, MOST_SLACK), drawing.shapes
    hopeful = set(_hopeful(shapes, slack) if shorter else range(len(shapes)))
    by_shape = dict[int, list[Stroke]]()
    for n, shape in enumerate(shapes):
        if shape.gradient is None:
            own = _strokes(shape, detail, slack, shorter) if n in hopeful else []
            by_shape[n] = _straight(shape, own, slack) or own
    width_of = _common([stroke for strokes in by_shape.values() for stroke in strokes])
    alike = {n: [replace(own, width=width_of[own.width]) for own in strokes] for n, strokes in by_shape.items()}
    return [tuple(map(shape.stroked, alike.get(n, ()))) or (shape,) for n, shape in enumerate(shapes)]


def _hopeful(shapes: tuple[Shape, ...], slack: float) -> list[int]:
    """The numbers of the shapes that have more numbers than a stroke, and one width nearly all along their outlines."""
    long = [n for n, shape in enumerate(shapes) if length_of(shape) > LEAST_LENGTH]
    rings = [[outline.ring().cubics for outline in shapes[n].outlines] for n in long]
    widths = evenly_wide(rings, EVEN_SHARE, EVEN_PX + 2.0 * slack, BESIDE)
    return [n for n, width in zip(long, widths.tolist(), strict=True) if width > LEAST_TOLD * EVEN_PX]


def length_of(*shapes: Shape) -> float:
    """Return the length of the description of shapes, in numbers. A stroke's style counts as a fill does, and once for
    all strokes of a shape, which are one element.
    """
    bare = [shape for shape in shapes if shape.stroke is None]
    strokes = [(shape.fill, shape.stroke) for shape in shapes if shape.stroke]
    paths = sum(stroke.path.coordinates for _, stroke in strokes)
    pens = {(fill, own.width, own.cap, own.join, own.dashes, own.offset): own for fill, own in strokes}
    pen = sum(2.0 * SHAPE_PARAMETERS + own.coordinates - own.path.coordinates for own in pens.values())
    return paths + pen + sum(SHAPE_PARAMETERS + sum(each.coordinates for each in shape.outlines) for shape in bare)


def _straight(shape: Shape, others: list[Stroke], slack: float) -> list[Stroke]:
    """The straight strokes of one pen that cover what a shape does, if their description is shorter than its own and
    that of other strokes, and they are no more than these; none without such.
    """
    least = min(length_of(shape), _numbers(shape, others) if others else math.inf)
    strokes = network_of(shape.oriented()) if least > LEAST_LENGTH else []
    if not strokes or _numbers(shape, strokes) >= least or 0 < len(others) < len(strokes):
        return []
    # Of wider lines the ends and corners are told, which may be round.
    told = strokes[0].width > LEAST_TOLD * EVEN_PX
    return strokes if _same(shape, strokes, slack if told else MOST_SLACK) else []


def _numbers(shape: Shape, strokes: list[Stroke]) -> float:
    """The length of the description of strokes in place of a shape."""
    return length_of(*(replace(shape, stroke=stroke) for stroke in strokes))


def _strokes(shape: Shape, detail: float, slack: float, shorter: bool) -> list[Stroke]:
    """The strokes that cover what a shape does; none without such, or if they must be shorter and are not."""
    simple = _simple(shape.outlines, LEAST_ASPECT)
    if simple is not None:
        return [simple]
    if len(shape.outlines) == 1 and not isinstance(shape.outlines[0], Ring):
        return []
    from cubicsplat_cli.artwork.strokes.build import strokes_of  # few drawings have any

    strokes = strokes_of(shape.oriented(), detail, slack)
    if shorter and _numbers(shape, strokes) >= length_of(shape):
        return []
    # Where only shorter ones are asked for the pixels decide about them, once they are fitted to these.
    return strokes if strokes and _same(shape, strokes, MOST_SLACK if shorter else slack) else []


def by_pens(shapes: tuple[Shape, ...]) -> dict[int, tuple[Stroke, bool]]:
    """The strokes that bars and rings of circles are, by number, and whether their pen costs nothing: rings show no cap
    or join, and bars take the width of another stroke that has about theirs and the same colour.
    """
    flat = [(n, shape) for n, shape in enumerate(shapes) if shape.gradient is None]
    bare = {n: own for n, shape in flat if shape.stroke is None and (own := _simple(shape.outlines, 1.0))}
    # A bar with straight ends is as short as a rectangle.
    found = {n: s for n, s in bare.items() if (s.closed or s.cap == ROUND) and s.width > LEAST_TOLD * EVEN_PX}
    width_of, strokes = _common([*found.values()]), {}
    for n, own in found.items():
        widths = [shape.stroke.width for _, shape in flat if shape.stroke and shape.fill == shapes[n].fill]
        nearest = min(widths, key=lambda width: abs(width - own.width), default=math.inf)
        shared = abs(nearest - own.width) <= ALIKE
        strokes[n] = replace(own, width=nearest if shared else width_of[own.width]), shared or own.closed
    return strokes


def _simple(outlines: tuple[Outline, ...], least_aspect: float) -> Stroke | None:
    """The stroke that a ring of two circles or a bar of such an aspect is."""
    first = outlines[0]
    if len(outlines) == 2 and isinstance(first, Circle) and isinstance(hole := outlines[1], Circle):
        width = first.r - hole.r
        if math.hypot(first.cx - hole.cx, first.cy - hole.cy) < PRECISION and width < hole.r:
            return Stroke(Circle(first.cx, first.cy, 0.5 * (first.r + hole.r)), width)
    if len(outlines) == 1 and isinstance(first, Rectangle):
        long, short = max(first.width, first.height), min(first.width, first.height)
        rounded = first.radius > 0.45 * short
        if long > least_aspect * short and (rounded or first.radius == 0.0):
            angle = first.angle + (0.0 if first.width >= first.height else 0.5 * math.pi)
            half = 0.5 * (long - short if rounded else long) * np.array([math.cos(angle), math.sin(angle)])
            middle = np.array([first.x + 0.5 * first.width, first.y + 0.5 * first.height])
            path = line_chain(np.stack([middle - half, middle + half]))
            return Stroke(path, short, ROUND, ROUND) if rounded else Stroke(path, short)
    return None


def _same(shape: Shape, strokes: list[Stroke], slack: float) -> bool:
    """Return whether strokes cover what a shape does, to a few hundredths of a px along its outline, or as far as that
    is known: its ends and corners are where it is off by more.
    """
    rings = shape.oriented()
    margin = math.ceil(2.0 * max(stroke.width for stroke in strokes))
    cubics, _ = pieces_of_rings(rings)
    low = np.floor(cubics.min(axis=(0, 1))).astype(int) - margin
    high = np.ceil(cubics.max(axis=(0, 1))).astype(int) + margin
    drawn = [shape.stroked(stroke).oriented() for stroke in strokes]
    off = np.abs(_covered([rings], low, high) - _covered(drawn, low, high))
    length = sum(float(np.hypot(*np.diff(flattened(ring), axis=0).T).sum()) for ring in rings)
    most = (MEAN_ERROR + slack) * length
    if not slack:
        return bool(off.sum() <= most and off.max() <= MOST_OFF)
    ends = sum(stroke.width**2 for stroke in strokes)  # that these may be off, in place of MOST_OFF
    far = float(off[off > MOST_OFF].sum())
    return bool(off.sum() - far <= most and far <= ends)


def _covered(groups: list[tuple[Ring, ...]], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The share of each pixel, of those from low to high (2,), under groups of rings."""
    (left, top), (width, height) = low.tolist(), (high - low).tolist()
    return np.minimum(sum(coverage(*pieces_of_rings(rings), top, left, height, width) for rings in groups), 1.0)


def _common(strokes: list[Stroke]) -> dict[float, float]:
    """For each width the one that it and those like it become, their mean by length."""
    groups: list[list[Stroke]] = []
    for stroke in sorted(strokes, key=lambda stroke: stroke.width):
        if groups and stroke.width - groups[-1][0].width <= ALIKE:
            groups[-1].append(stroke)
        else:
            groups.append([stroke])
    means = [float(np.mean([stroke.width for stroke in group])) for group in groups]
    return {stroke.width: mean for group, mean in zip(groups, means, strict=True) for stroke in group}
