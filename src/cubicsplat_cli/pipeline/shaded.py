"""Shaded drawings: clean objects, each with a group of curves of the photo engine inside, clipped at its outline.

Only an object's own shading, over its opaque paint, shows within its outline. So each object is a separate fit, to the
pixels in which it shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from PIL import Image

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.finish.state import premultiplied
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.regions.fills import APART, SAME
from cubicsplat_cli.artwork.shading import (
    CLEAR,
    FULL,
    base_paint,
    objects_of,
    shown,
    silhouettes,
    surfaces_of,
    without_surfaces,
)
from cubicsplat_cli.artwork.shapes import Drawing, Shape, scaled_drawing
from cubicsplat_cli.artwork.vectorize import draw, draw_flat
from cubicsplat_cli.evaluate.perceptual import metric as ciede2000_metric
from cubicsplat_cli.files.decode import straight_colours
from cubicsplat_cli.files.load import resampled
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.pipeline.artwork import prepared_of, result_of_drawing
from cubicsplat_cli.pipeline.likeness import seen_db_of
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.progress import Work, under_way, work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import nearest_paints
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.paint import Gradient, Rgba, painted
from cubicsplat_cli.settings import FitSettings, cpu_count

SHAPES = "triangle"  # at equal bytes nearer to soft shading than curves of 2 cubics, by a tenth in root mean square
# The opacity of all curves, which the file states once. It is fixed, since the fit would lower it, and the rounding of
# more and fainter layers would show in even areas. One half serves both best.
SHARED_OPACITY = 0.5
SHADED = 2.0  # levels of root mean square error of its paint, above which an object gets shading
PX_PER_CURVE = 42.0  # at first: few curves at the start are better than many removed at the end
MOST_PIXELS = 2**20  # of a picture with shading
MOST_FITTED = 2**16  # of the copy that curves are fitted to, since shading is as soft in a larger picture
# The squared CIEDE2000, summed over the copy's pixels, that a curve must save to stay. The mean 3D emoji then takes the
# bytes of a photo of 135 curves.
PRICE = 25.0
# A picture with more objects, or with a larger share of rough pixels in them, has textures rather than shading.
MOST_OBJECTS, MOST_ROUGH = 80, 0.08
ROUGH = 6.0  # levels between a rough pixel and the mean of 3 x 3 px; shading never differs so much
LEAST_SHADED = 0.1  # share of the objects' pixels that need more than paint
# Share of the pixels on no surface whose colours are lost in objects: .04 to .25 of text on shading, .014 of 3D emoji.
LEAST_LOST = 0.025
EVEN = 5  # px each way of an object's inside
REACH = 3  # px from a pixel at an edge to the pixel whose colour it takes
PLAIN = 0.1  # share of an error's cost that is alike in all directions: CIEDE2000 is quadratic for small errors only
FULL_STEPS = 100  # curves of a fit that takes all its steps; smaller ones converge sooner
LEAST_STEPS = 0.25  # the least share of the steps
# dB by which shading may be above the means of EVEN x EVEN px of the copy; 14 drawings are 12 below to 5.5 above.
ABOVE_MEANS_DB = 6.0
# Of a picture: levels (H, W, 4) premultiplied, 0..255, and labels (H, W) int32, the object of a pixel.
Objects = tuple[np.ndarray, np.ndarray]


def shaded_objects(target: np.ndarray) -> Objects | None:
    """Return the objects of a picture, (H, W, 3) or premultiplied (H, W, 4), float32 in [0, 1]; None unless it consists
    of few opaque objects with soft shading, on any ground.
    """
    if target.shape[0] * target.shape[1] > MOST_PIXELS:
        return None
    levels = as_levels(target)
    labels = objects_of(levels)
    count = int(labels.max()) + 1
    visible = ndimage.alike(labels, EVEN) & (levels[..., 3] >= CLEAR)
    if count > MOST_OBJECTS or not visible.any() or (levels[..., 3][visible] < 250.0).mean() > MOST_ROUGH:
        return None
    rough = largest(np.abs(levels - ndimage.uniform_filter(levels, (3, 3, 1)))) > ROUGH
    if rough[visible].mean() > MOST_ROUGH:
        return None
    off = np.zeros(labels.shape)
    straight = ndimage.uniform_filter(straight_colours(levels), (EVEN, EVEN, 1))  # without grain, which is no shading
    for number in range(count):
        own = visible & (labels == number)
        if own.any():
            off[own] = _off(straight, *_paint_of(straight, own))[own].mean()
    return (levels, labels) if (off[visible] > SHADED**2).mean() >= LEAST_SHADED else None


def _objects_in(task: Task) -> Objects | None:
    return shaded_objects(task.pixels) if task.request.may_shade else None


def most_shaded_db(task: Task) -> float:
    """Return the level, see `seen_db`, that a shaded drawing hardly exceeds; minus infinity if there is none."""
    objects = task.once(_objects_in)
    return -math.inf if objects is None else seen_db_of(task, _softly(*objects)) + ABOVE_MEANS_DB


def shaded_drawing(task: Task) -> Made | None:
    """Return the shaded drawing of a picture; None if it has no shaded objects, or the request rules shading out."""
    objects, request = task.once(_objects_in), task.request
    if objects is None:
        return None
    settings = task.settings().with_(curves=int(request.shading) if request.shading.isdecimal() else None)
    with under_way(Work(task.on_progress, math.inf, request.settings.threads or cpu_count())) as doing:
        prepared, drawing = task.once(prepared_of), None
        if prepared.levels.shape == objects[0].shape:
            drawing = shade_surfaces(objects, prepared.condition, settings)
        drawing = drawing or shade_objects(objects, settings)
    made = result_of_drawing(scaled_drawing(drawing, *task.picture.size), request)
    return replace(made, interrupted=doing.interrupted)


def _softly(levels: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 4) in [0, 1] of the means of small squares within an object; its edges as they were."""
    side = 2 * round(0.5 * (EVEN / _fitted_scale(labels.size) - 1.0)) + 1
    inside, soft = ndimage.alike(labels, EVEN), levels / np.float32(255.0)
    for number, box in enumerate(ndimage.find_objects(labels + 1)):
        own = (labels[box] == number).astype(np.float32)[..., None]
        sums, sizes = (ndimage.uniform_filter(each, (side, side, 1)) for each in (soft[box] * own, own))
        shown = inside[box] & (own[..., 0] > 0.0)
        soft[box][shown] = sums[shown] / sizes[shown]
    return soft


def _fitted_scale(pixels: int) -> float:
    """Return the scale of the copy of a picture of so many pixels that curves are fitted to."""
    return min(1.0, math.sqrt(MOST_FITTED / pixels))


def shade_surfaces(objects: Objects, condition: Condition, settings: FitSettings) -> Drawing | None:
    """Draw a picture in a condition, with at most the settings' curves, if any, in each of its surfaces; all else is
    drawn as without shading. None unless surfaces are most of it, and what lies on them would be lost in its objects.
    """
    levels, labels = objects
    surfaces = surfaces_of(levels, condition)
    beside = ~np.logical_or.reduce([np.zeros(labels.shape, dtype=bool), *(surface.mask for surface in surfaces)])
    lost = largest(np.abs(255.0 * _softly(levels, labels) - levels)) > APART
    if beside.mean() > 0.5 or not beside.any() or lost[beside].mean() < LEAST_LOST:
        return None
    flat, fills = without_surfaces(levels, surfaces, condition)
    outlined = draw((flat / 255.0).astype(np.float32))
    shares, goals = shown(outlined), list[np.ndarray | None]()
    for shape, share in zip(outlined.shapes, shares, strict=True):
        y, x = np.nonzero(share)
        weights, seen, fill = share[y, x], levels[y, x], 255.0 * premultiplied(shape.fill)
        off = [largest(np.abs(each.colours[y, x] - seen)) @ weights for each in surfaces]
        own = largest(np.abs(fill - seen)) @ weights
        gaps = largest(np.abs(fills - fill))
        # Specks may have got only a share of what stands for a surface, and letters may have a colour like a surface's.
        nearest = int(np.argmin(gaps if gaps.min() <= SAME else off))
        shaded = gaps[nearest] <= SAME or off[nearest] < 0.5 * own
        plain = not shaded or shape.gradient is not None or shape.stroke is not None
        goals.append(None if plain else surfaces[nearest].colours[..., :3])
    return _with_shading(outlined, shares, goals, np.zeros(3), settings)


def shade_objects(objects: Objects, settings: FitSettings) -> Drawing:
    """Draw objects with shading, of at most the settings' curves each; some have none if the work is stopped."""
    levels, labels = objects
    outlined = draw_flat(silhouettes(levels, labels))
    straight, shares = straight_colours(levels), shown(outlined)
    spread = np.zeros(3)
    with work().stoppable():
        spread = _spread(levels, straight, shares)
    return _with_shading(outlined, shares, [straight] * len(shares), spread, settings)


def _with_shading(
    outlined: Drawing, shares: Sequence[np.ndarray], goals: Sequence[np.ndarray | None], spread: np.ndarray,
    settings: FitSettings,
) -> Drawing:  # fmt: skip
    """Return a drawing with the best paint, and shading, for its goals: the levels (H, W, 3) that a shape shows, None
    where it stays as it is. shares: as of `shown`; spread: as of `_spread`, or zeros (3,). settings: as
    of `shade_surfaces`.
    """
    shapes = list(outlined.shapes)
    chosen = [(k, goal) for k, goal in enumerate(goals) if goal is not None and shares[k].any()]
    for k, goal in chosen:
        fill, gradient = _paint_of(goal, shares[k] >= min(FULL, float(shares[k].max())))
        shapes[k] = replace(shapes[k].filled(fill, outlined.width, outlined.height), gradient=gradient)
    with work().stoppable():
        for done, (k, goal) in enumerate(chosen):
            work().at("shading objects", 0.85 + 0.15 * done / len(chosen))
            shapes[k] = _shaded(goal, shapes[k], shares[k], spread, settings)
    return replace(outlined, shapes=tuple(shapes))


def _shaded(straight: np.ndarray, plain: Shape, share: np.ndarray, spread: np.ndarray, settings: FitSettings) -> Shape:
    """Return a shape with shading; without if its paint is near enough to the picture. share: (H, W) of each pixel that
    shows it. spread: see `_spread`. Raises KeyboardInterrupt if the fit is interrupted.
    """
    whole = share > FULL
    if not whole.any() or math.sqrt(float(_off(straight, plain.fill, plain.gradient)[whole].mean())) < SHADED:
        return plain
    scale = _fitted_scale(whole.size)
    curves = round(min(scale**2 * float(whole.sum()) / PX_PER_CURVE, settings.curves or math.inf))
    if curves < 1:
        return plain
    goal, weights = _continued(straight, share)
    goal += np.where(whole, 0.0, share)[..., None] * spread
    ground = _painted(plain.fill, plain.gradient, share.shape)
    shading = _fitted(np.clip(goal, 0.0, 255.0), weights, ground, settings.with_(curves=curves), scale)
    return replace(plain, shading=shading)


def _continued(straight: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the colours (H, W, 3) of a shape, and the weights (H, W) of its pixels, the squares of their shares. A
    pixel that the shape shares with others takes the colour of the nearest whole one.
    """
    goal, whole = straight.copy(), share > FULL
    weights = np.where(whole, 1.0, 0.0)
    at = np.flatnonzero((share > 0.0) & ~whole)
    paints, places = nearest_paints(np.where(whole, 0, -1), at, REACH, 1)
    at, places = at[paints[:, 0] == 0], places[paints[:, 0] == 0, 0]
    goal.reshape(-1, 3)[at] = straight.reshape(-1, 3)[places]
    weights.reshape(-1)[at] = share.reshape(-1)[at] ** 2
    return goal, weights


def _spread(levels: np.ndarray, straight: np.ndarray, shares: Sequence[np.ndarray]) -> np.ndarray:
    """Return the smallest correction (H, W, 3) that makes the shapes' colours, continued to their edges, add up to the
    picture: each shape changes by this times its share of a pixel.
    """
    rest, squares = levels[..., :3].astype(float), np.full(levels.shape[:2], 1e-3)
    for share in shares:
        rest -= share[..., None] * _continued(straight, share)[0]
        squares += share**2
    return rest / squares[..., None]


def _paint_of(straight: np.ndarray, where: np.ndarray) -> tuple[Rgba, Gradient | None]:
    """Return the paint of the pixels `where`, (H, W) bool, of a picture (H, W, 3); see `base_paint`."""
    y, x = np.nonzero(where)
    return base_paint(straight[y, x], x, y)


def _painted(fill: Rgba, gradient: Gradient | None, shape: tuple[int, ...]) -> np.ndarray:
    """Return the levels (H, W, 3) of a paint over a whole canvas of shape (H, W)."""
    if gradient is None:
        return np.broadcast_to(np.array(fill[:3], float), (*shape, 3))
    y, x = np.indices(shape)
    return 255.0 * painted(gradient, x + 0.5, y + 0.5)[..., :3]


def _off(straight: np.ndarray, fill: Rgba, gradient: Gradient | None) -> np.ndarray:
    """Return the mean square error of a paint over the three channels, (H, W) in levels^2."""
    return np.asarray(((straight - _painted(fill, gradient, straight.shape[:2])) ** 2).mean(axis=2))


def _fitted(goal: np.ndarray, weights: np.ndarray, ground: np.ndarray, settings: FitSettings, scale: float) -> Scene:
    """Fit curves over a ground to a picture, (H, W, 3) in levels, in the box of weights (H, W), at a scale <= 1."""
    from cubicsplat_cli.photo.loop import FitLoop

    rows, columns = (np.flatnonzero(weights.any(axis=axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    height, width = (each.stop - each.start for each in window)
    weight = weights[window][..., None]
    channels = np.concatenate([weight, weight * goal[window] / 255.0, ground[window] / 255.0], axis=2, dtype=np.float32)
    size = max(1, round(scale * width)), max(1, round(scale * height))
    small = resampled(channels, size, Image.Resampling.BOX)
    target, behind = small[..., 1:4] / np.maximum(small[..., :1], 1e-6), small[..., 4:]
    steps = round(settings.steps * min(1.0, max(LEAST_STEPS, settings.curves / FULL_STEPS)))
    recipe = settings.recipe  # its first edges suit this number of curves
    own = FitSettings.from_preset(settings.preset, shapes=SHAPES).with_(
        curves=settings.curves, steps=steps, seed=settings.seed, threads=settings.threads, device="cpu",
        background="auto",
        recipe=replace(recipe, shared_opacity=SHARED_OPACITY, rate_opacities=0.0, edge_start=recipe.edge_end),
    )  # fmt: skip
    metric = _error_metric(255.0 * target)
    inputs = FitInputs(np.ascontiguousarray(small[..., 0]), ground=np.ascontiguousarray(behind), metric=metric)
    fitting = FitLoop(target, own, inputs=inputs)
    if fitting.relax():
        importance = fitting.importance()
        kept = np.flatnonzero(importance >= min(PRICE, float(importance.max())))
        if len(kept) < len(importance):
            fitting.resize(kept, len(kept))
    fitted = fitting.finish()
    if fitted.interrupted:
        raise KeyboardInterrupt
    scene = fitted.scene.scaled(width, height)
    points = scene.points + np.array([columns[0], rows[0]], np.float32)
    return replace(scene, points=points, background=None, width=goal.shape[1], height=goal.shape[0])


def _error_metric(colours: np.ndarray) -> np.ndarray:
    """Return the cost of errors at colours (h, w, 3) in levels, the square of CIEDE2000: see `Engine`."""
    rows = 255.0**2 * ciede2000_metric(colours)
    plain = PLAIN * rows[0].mean(axis=2, keepdims=True)
    rows *= 1.0 - PLAIN
    rows[0] += plain
    return np.ascontiguousarray(rows, np.float32)
