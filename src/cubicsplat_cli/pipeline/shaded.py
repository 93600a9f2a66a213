"""Shaded drawings: clean objects, and inside each a group of curves of the photo engine, clipped at its outline.

What shows of an object is its shading alone, over its opaque paint. So each is a fit of its own to the pixels in which
it shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shading import CLEAR, FULL, base_paint, objects_of, shown, silhouettes
from cubicsplat_cli.artwork.shapes import Drawing, Shape, scaled_drawing, shape_name
from cubicsplat_cli.artwork.vectorize import draw_flat
from cubicsplat_cli.evaluate.perceptual import metric
from cubicsplat_cli.pipeline.artwork import result_of_drawing
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.progress import Work, under_way, work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import nearest_paints
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.paint import painted
from cubicsplat_cli.settings import FitSettings, cpu_count

# At equal bytes triangles come nearer to soft shading than curves of 2 cubics, by a tenth in root mean square.
SHAPES = "triangle"
# Of all curves, so that none says its own. It stays as it is: left to the fit it falls, and what renderers round off
# more and fainter layers shows in even areas. A half takes the most from both.
SHARED_OPACITY = 0.5
SHADED = 2.0  # levels, of the root mean square off its paint, above which an object is shaded
PX_PER_CURVE = 42.0  # at first: leaving out many at the end is worse than to begin with fewer
# Px of a picture whose objects are shaded, 512 x 512: a larger one would need thousands of curves, and minutes.
MOST_PIXELS = 2**18
# What a curve must take away of the squared CIEDE2000, summed over pixels, to stay: what leaves the bytes of a photo of
# 128 curves, in the mean of 3D emoji.
PRICE = 43.0
# A picture of more objects has textures, not shading; and so has one that is rough in more of its objects' insides.
MOST_OBJECTS, MOST_ROUGH = 80, 0.08
ROUGH = 6.0  # levels by which a pixel is off the mean of its 3 x 3 neighbours, as none is within shading
LEAST_SHADED = 0.1  # of the picture's objects in px that have more than their paints
REACH = 3  # px from a pixel at an edge to those whose colour it has
# Of an error's cost that is the same in all directions: CIEDE2000 is a square for small errors only.
PLAIN = 0.1
FULL_STEPS = 100  # curves of a fit that takes all its steps; smaller ones converge sooner
LEAST_STEPS = 0.25  # of them


@record
class Objects:
    """levels: (H, W, 4) premultiplied. labels: (H, W) int32 the object of each pixel."""

    levels: np.ndarray
    labels: np.ndarray


def shaded_objects(target: np.ndarray) -> Objects | None:
    """The objects of a picture (H, W, 3) or premultiplied (H, W, 4), float32 in [0, 1]; None where it does not consist
    of few objects with soft shading inside, all opaque but for a transparent ground.
    """
    if target.shape[0] * target.shape[1] > MOST_PIXELS:
        return None
    levels = as_levels(target)
    labels = objects_of(levels)
    count = int(labels.max()) + 1
    inside = ndimage.alike(labels, 5)
    visible = inside & (levels[..., 3] >= CLEAR)
    if count > MOST_OBJECTS or not visible.any() or (levels[..., 3][visible] < 250.0).mean() > MOST_ROUGH:
        return None
    rough = np.abs(levels - ndimage.uniform_filter(levels, (3, 3, 1))).max(axis=2) > ROUGH
    if rough[visible].mean() > MOST_ROUGH:
        return None
    off = np.zeros(labels.shape)
    straight = _straight(levels)
    for number in range(count):
        own = visible & (labels == number)
        if own.any():
            plain = _in_paint(straight, None, own)
            off[own] = _off(straight, plain)[own].mean()
    shaded = off[visible] > SHADED**2
    return Objects(levels, labels) if shaded.mean() >= LEAST_SHADED else None


def drawn_shaded(task: Task, objects: Objects) -> Made:
    """The shaded drawing of a picture's objects."""
    request = task.request
    most = int(request.shading) if request.shading.isdecimal() else None
    with under_way(Work(task.on_progress, math.inf, request.settings.threads or cpu_count())) as doing:
        drawing = shaded_drawing(objects, task.settings(), most)
    made = result_of_drawing(scaled_drawing(drawing, *task.picture.size), request)
    facts = {**made.facts, "interrupted": doing.interrupted}
    return replace(made, facts=facts, may_be_photo=True)


def shaded_drawing(objects: Objects, settings: FitSettings, most: int | None = None) -> Drawing:
    """The drawing of objects with their shading; where the work under way is stopped, some are without. most: curves of
    an object, or None for as many as are of use.
    """
    outlined = draw_flat(silhouettes(objects.levels, objects.labels), ArtworkSettings())
    straight, shares = _straight(objects.levels), shown(outlined)
    shapes = [
        _in_paint(straight, shape, share >= min(FULL, float(share.max())))
        for shape, share in zip(outlined.shapes, shares, strict=True)
    ]
    with work().stoppable():
        spread = _spread(objects.levels, straight, shares)
        for index, share in enumerate(shares):
            work().at("shading objects", 0.85 + 0.15 * index / len(shares))
            shapes[index] = _shaded(straight, shapes[index], share, spread, settings, most)
    return replace(outlined, shapes=tuple(shapes))


def _shaded(
    straight: np.ndarray, plain: Shape, share: np.ndarray, spread: np.ndarray, settings: FitSettings, most: int | None
) -> Shape:
    """A shape in the paint of all that shows of it; with shading where that leaves too much.

    share: (H, W) where it shows. spread: see `_spread`. Raises KeyboardInterrupt when the fit is interrupted.
    """
    height, width = share.shape
    whole = share > FULL
    if not whole.any() or math.sqrt(float(_off(straight, plain)[whole].mean())) < SHADED:
        return plain
    curves = round(min(float(whole.sum()) / PX_PER_CURVE, math.inf if most is None else most))
    if curves < 1:
        return plain
    goal, weights = _continued(straight, share)
    goal += np.where(whole, 0.0, share)[..., None] * spread
    scene = _fitted(np.clip(goal, 0.0, 255.0), weights, _paint(plain, width, height), settings.with_(curves=curves))
    return replace(plain, shading=scene)


def _continued(straight: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The colours (H, W, 3) of a shape, where it is half covered those of the nearest pixel of it that is not; and the
    weight (H, W) of each, the square of what shows of it.
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
    """(H, W, 3) what the colours of shapes, continued to their edges, are to be off there, times the share of each, so
    that together they are the picture: the least change that brings it about.
    """
    rest, squares = levels[..., :3].astype(float), np.full(levels.shape[:2], 1e-3)
    for share in shares:
        rest -= share[..., None] * _continued(straight, share)[0]
        squares += share**2
    return rest / squares[..., None]


def _in_paint(straight: np.ndarray, shape: Shape | None, where: np.ndarray) -> Shape:
    """A shape in the paint of the pixels (H, W) bool of a picture (H, W, 3); without one, the paint alone."""
    y, x = np.nonzero(where)
    fill, gradient = base_paint(straight[y, x], x, y)
    if shape is None:
        return Shape(fill, (), "", gradient)
    height, width = where.shape
    return replace(shape, fill=fill, gradient=gradient, name=shape_name(fill, shape.outlines, width, height))


def _straight(levels: np.ndarray) -> np.ndarray:
    """(H, W, 3) straight colours of premultiplied levels."""
    return np.asarray(levels[..., :3] * (255.0 / np.maximum(levels[..., 3:], 1.0)))


def _paint(shape: Shape, width: int, height: int) -> np.ndarray:
    """(H, W, 3) levels of a shape's paint over the whole canvas."""
    if shape.gradient is None:
        return np.broadcast_to(np.array(shape.fill[:3], float), (height, width, 3))
    y, x = np.mgrid[:height, :width]
    return 255.0 * painted(shape.gradient, x + 0.5, y + 0.5)[..., :3]


def _off(straight: np.ndarray, shape: Shape) -> np.ndarray:
    """(H, W) the mean square of three channels, in levels^2, by which a shape's paint is off."""
    height, width = straight.shape[:2]
    return np.asarray(((straight - _paint(shape, width, height)) ** 2).mean(axis=2))


def _fitted(goal: np.ndarray, weights: np.ndarray, ground: np.ndarray, settings: FitSettings) -> Scene:
    """Curves over a ground that are near a picture, both (H, W, 3) in levels, where there are weights (H, W)."""
    from cubicsplat_cli.photo.inputs import FitInputs
    from cubicsplat_cli.photo.loop import FitLoop

    rows, columns = (np.flatnonzero(weights.any(axis=axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    target, behind = ((each[window] / 255.0).astype(np.float32) for each in (goal, ground))
    steps = round(settings.steps * min(1.0, max(LEAST_STEPS, settings.curves / FULL_STEPS)))
    recipe = settings.recipe  # whose first edges are as wide as these curves
    given = {**vars(FitSettings.from_preset(preset=settings.preset, shapes=SHAPES)), "curves": settings.curves}
    own = FitSettings(**given).with_(
        steps=steps, seed=settings.seed, threads=settings.threads, device="cpu", background="auto",
        recipe=replace(recipe, shared_opacity=SHARED_OPACITY, rate_opacities=0.0, edge_start=recipe.edge_end),
    )  # fmt: skip
    inputs = FitInputs(np.ascontiguousarray(weights[window], np.float32), ground=behind, metric=_seen(goal[window]))
    fitting = FitLoop(target, own, inputs=inputs)
    if fitting.relax():
        importance = fitting.importance()
        kept = np.flatnonzero(importance >= min(PRICE, float(importance.max())))
        if len(kept) < len(importance):
            fitting.resize(kept, len(kept))
    fitted = fitting.finish()
    if fitted.interrupted:
        raise KeyboardInterrupt
    scene = fitted.scene
    points = scene.points + np.array([columns[0], rows[0]], np.float32)
    return replace(scene, points=points, background=None, width=goal.shape[1], height=goal.shape[0])


def _seen(colours: np.ndarray) -> np.ndarray:
    """What the engine is to take for errors of colours (h, w, 3) in levels, the square of CIEDE2000: see `Engine`."""
    rows = 255.0**2 * metric(colours)
    plain = PLAIN * rows[0].mean(axis=2, keepdims=True)
    rows *= 1.0 - PLAIN
    rows[0] += plain
    return np.ascontiguousarray(rows, np.float32)
