"""Details that the pixels ask for, drawn on top of a finished drawing.

What is less than two pixels wide has hardly a region of its own, and what the regions lose no polish brings back. Where
the drawing is far off its picture, its inks are arranged within the pixels as their shares say, and what differs from
what is drawn becomes polygons. Each is kept only where the description of the picture becomes shorter by it, before and
after it is settled against the pixels; everything else stays as it is.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.details.candidates import candidates, painted_inks
from cubicsplat_cli.artwork.details.subpixels import SIDE
from cubicsplat_cli.artwork.finish.finish import (
    HUBER,
    WHITE,
    Layer,
    State,
    begin,
    drawn,
    layer_of,
    premultiplied,
    settle,
)
from cubicsplat_cli.artwork.finish.freedom import Still
from cubicsplat_cli.artwork.finish.moves import PRICE, SHARE_SIGMA, UNSEEN
from cubicsplat_cli.artwork.geometry.coverage import coverage
from cubicsplat_cli.artwork.geometry.outlines import Outline
from cubicsplat_cli.artwork.names import shape_name
from cubicsplat_cli.artwork.robust import huber
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.scene.paint import Gradient, Ink

UNEXPLAINED = 48.0 / 255.0  # of full scale, by which a pixel is off that is not explained
FEWEST = 16  # such pixels in a drawing that has lost details; a few are errors of its own outlines
SHAPE_PARAMETERS = 3.0  # parameters that a shape is worth besides its outlines'
OPAQUE = 254  # levels of opacity of inks that spots are drawn in
ROUNDS = 5
MOST_TRIED = 2000  # candidates: each takes some thousandths of a second, and what holds more is shaded
LEAST_SIDE = 8  # px of a picture that has details

_log = logging.getLogger("cubicsplat")

Paint = tuple[Ink, Gradient | None]


def with_spots(
    drawing: Drawing, goal: Goal, detail: float = 1.0, min_area: float = 0.0, most: int | None = None
) -> Drawing:
    """The drawing with spots where it does not explain its goal, a clean picture; the same where that needs none.

    detail as in ArtworkSettings. min_area: px^2 that a spot has at least; most: spots, or None for any number. Spots
    are of the drawing's opaque inks.
    """
    small = min(drawing.width, drawing.height) < LEAST_SIDE
    if not drawing.shapes or small or (most is not None and most <= 0):
        return drawing
    still = [_still(shape, goal) for shape in drawing.shapes]
    before = State.of(still, goal)
    unexplained = np.abs(before.image - goal.target).max(axis=2) > UNEXPLAINED
    if unexplained.sum() < FEWEST:
        return drawing
    spots = _chosen(_found(drawing, goal, unexplained, min_area), before.image, goal.target, detail)[:most]
    if not spots:
        return drawing
    count = len(drawing.shapes)
    trial = replace(drawing, shapes=(*drawing.shapes, *spots))
    free = begin(replace(drawing, shapes=tuple(spots)), goal).layers
    settled = drawn(trial, settle(State.of(still + free, goal), goal, ROUNDS))
    spots = _chosen([[spot] for spot in settled.shapes[count:]], before.image, goal.target, detail)
    return replace(drawing, shapes=(*drawing.shapes, *spots))


def _still(shape: Shape, goal: Goal) -> Layer:
    """The layer of a shape that stays as it is."""
    return layer_of(shape, premultiplied(shape.ink) @ goal.space, [Still(outline) for outline in shape.outlines])


def _found(drawing: Drawing, goal: Goal, unexplained: np.ndarray, min_area: float) -> list[list[Shape]]:
    """The ways to draw each candidate of min_area px^2 or more, the largest first."""
    paints: list[Paint | None] = list(dict.fromkeys((shape.ink, shape.gradient) for shape in drawing.shapes))
    numbers = {paint: number for number, paint in enumerate(paints)}
    inks = [255.0 * premultiplied(paint[0]) for paint in paints if paint is not None]
    palette = np.array([*inks, np.zeros(4)])
    drawn = painted_inks(drawing, [numbers[shape.ink, shape.gradient] for shape in drawing.shapes], len(inks))
    found = list(candidates(255.0 * goal.target, palette, drawn, unexplained))
    ways = []
    if len(found) > MOST_TRIED:
        _log.warning("%d details are too many: only the %d largest are tried", len(found), MOST_TRIED)
    for each in sorted(found, key=lambda candidate: -candidate.area)[:MOST_TRIED]:
        paint = paints[each.ink] if each.ink < len(paints) else None
        if paint is not None and paint[0][3] >= OPAQUE and each.area >= min_area * SIDE**2:
            ink, gradient = paint
            size = drawing.width, drawing.height
            ways.append([Shape(ink, rings, shape_name(ink, rings, *size), gradient) for rings in each.ways()])
    return ways


def _chosen(spots: Iterable[list[Shape]], image: np.ndarray, target: np.ndarray, detail: float) -> list[Shape]:
    """Of each spot the way that shortens the description most, over `image` (H, W, 4) and the spots before it; none
    where none does.
    """
    image, kept = image.copy(), []
    for ways in spots:
        best, chosen = 0.0, None
        for spot in ways:
            painted = _painted_over(image, spot)
            if painted is None:
                continue
            window, over, floor = painted
            gain = 0.5 * float((_misfit(image[window] - target[window]) - _misfit(over - target[window])).sum()) / floor
            net = gain * detail - PRICE * (SHAPE_PARAMETERS + _parameters(spot.outlines))
            if net > best:
                best, chosen = net, (spot, window, over)
        if chosen is not None:
            spot, window, over = chosen
            kept.append(spot)
            image[window] = over
    return kept


def _painted_over(image: np.ndarray, spot: Shape) -> tuple[tuple[slice, slice], np.ndarray, float] | None:
    """A spot's window on the canvas, the picture with it there, and the misfit that a pixel of its edge has by chance;
    None where it is off the canvas.
    """
    rings = spot.oriented()
    cubics = np.concatenate([ring.cubics for ring in rings])
    points = cubics.reshape(-1, 2)
    x0, y0 = np.maximum(np.floor(points.min(axis=0)).astype(int), 0).tolist()
    x1, y1 = np.minimum(np.ceil(points.max(axis=0)).astype(int), image.shape[1::-1]).tolist()
    if x1 <= x0 or y1 <= y0:
        return None
    lines = np.concatenate([ring.lines for ring in rings])
    cover = coverage(cubics, lines, y0, x0, y1 - y0, x1 - x0)[..., None]
    window = (slice(y0, y1), slice(x0, x1))
    slope = premultiplied(spot.ink) - image[window]
    touched = cover[..., 0] > 0.0
    if not touched.any():
        return None
    floor = SHARE_SIGMA**2 * float(((slope[touched] * WHITE) ** 2).sum(axis=1).mean())
    return window, image[window] + cover * slope, max(floor, UNSEEN)


def _misfit(rest: np.ndarray) -> np.ndarray:
    """(h, w) what residuals (h, w, 4) count, as in the finish."""
    return huber(np.sqrt(((rest * WHITE) ** 2).sum(axis=2)), HUBER)


def _parameters(outlines: tuple[Outline, ...]) -> int:
    return sum(outline.parameters for outline in outlines)
