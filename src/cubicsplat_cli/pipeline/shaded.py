"""Shaded drawings: clean objects, and inside each a group of curves of the photo engine, clipped a little inside it.

What shows of an object inside its edge is its shading alone, opaque over a ground of one colour. So each is a fit of
its own to the pixels in which it shows, over the very compositing that the file has.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.names import shape_name
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shading.insides import FULL, coverage_of, inside_of, shown
from cubicsplat_cli.artwork.shading.objects import objects_of
from cubicsplat_cli.artwork.shading.paints import base_paint
from cubicsplat_cli.artwork.shading.silhouettes import silhouettes
from cubicsplat_cli.artwork.shapes import Drawing, Shading, Shape
from cubicsplat_cli.artwork.vectorize import draw_flat
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.paint import painted
from cubicsplat_cli.settings import FitSettings

SEGMENTS = 2  # cubics of a curve: at equal bytes more curves are better than more of these (docs/lab/photos.md)
SHARED_OPACITY = 0.78  # of an object's curves, so that none says its own
SHADED = 2.0  # levels, of the root mean square off the base paint, above which an object is shaded
PX_PER_CURVE = 100.0
RIM, LEAST_SEEN = 0.9, 0.3  # of a pixel that the shading covers: below it shows base paint, or next to no shading
PRICE = 1000.0  # levels^2 px, of the sum over channels: what a curve must take away to stay


@dataclass(frozen=True, eq=False)
class _Inside:
    """The inside of a shape. clip: outlines; weights: (H, W) in [0, 1], where its shading shows."""

    clip: tuple
    weights: np.ndarray


def shaded_drawing(target: np.ndarray, settings: FitSettings, most: int | None = None) -> Drawing:
    """The drawing of the objects of a picture (H, W, 3) or premultiplied (H, W, 4), float32 in [0, 1], with shading.

    most: curves of an object, or None for as many as are of use.
    """
    levels = as_levels(target)
    outlined = draw_flat(silhouettes(levels, objects_of(levels)), ArtworkSettings(), 0.0)
    shapes = []
    for shape, share in zip(outlined.shapes, shown(outlined), strict=True):
        shapes.append(_painted(levels, shape, share, settings, most))
    return replace(outlined, shapes=tuple(shapes))


def _painted(levels: np.ndarray, shape: Shape, share: np.ndarray, settings: FitSettings, most: int | None) -> Shape:
    """A shape in its paint, and with shading where that leaves too much. share: (H, W) where it shows."""
    height, width = share.shape
    plain = _in_paint(levels, shape, share >= min(FULL, float(share.max())))
    if math.sqrt(float(_off(levels, plain)[share > FULL].mean())) < SHADED:
        return plain
    clip = inside_of(shape, width, height)
    inside = coverage_of(clip, width, height) * (share > FULL) if clip else np.zeros(share.shape)
    curves = round(min(float(inside.sum()) / PX_PER_CURVE, math.inf if most is None else most))
    if curves < 2:
        return plain
    rim = (share > FULL) & (inside < RIM)
    shaded = _in_paint(levels, shape, rim) if rim.any() else plain
    # A pixel that the clip cuts shows base paint beside the shading, which makes up for it as far as it can.
    seen, beneath = inside >= LEAST_SEEN, _paint(shaded, width, height)
    share_of = np.maximum(inside, LEAST_SEEN)[..., None]
    goal = np.clip(beneath + (_straight(levels) - beneath) / share_of, 0.0, 255.0)
    weights = np.where(seen, inside**2, 0.0)
    scene = _fitted(goal, weights, _paint(plain, width, height), settings.with_(curves=curves))
    return replace(shaded, shading=Shading(clip, plain.fill, plain.gradient, scene))


def _in_paint(levels: np.ndarray, shape: Shape, where: np.ndarray) -> Shape:
    """A shape in the paint of the pixels (H, W) bool of a picture."""
    y, x = np.nonzero(where)
    fill, gradient = base_paint(_straight(levels)[y, x], x, y)
    height, width = where.shape
    return replace(shape, fill=fill, gradient=gradient, name=shape_name(fill, shape.outlines, width, height))


def _straight(levels: np.ndarray) -> np.ndarray:
    """(H, W, 3) straight colours of premultiplied levels."""
    return levels[..., :3] * (255.0 / np.maximum(levels[..., 3:], 1.0))


def _paint(shape: Shape, width: int, height: int) -> np.ndarray:
    """(H, W, 3) levels of a shape's paint over the whole canvas."""
    if shape.gradient is None:
        return np.broadcast_to(np.array(shape.fill[:3], float), (height, width, 3))
    y, x = np.mgrid[:height, :width]
    return 255.0 * painted(shape.gradient, x + 0.5, y + 0.5)[..., :3]


def _off(levels: np.ndarray, shape: Shape) -> np.ndarray:
    """(H, W) the mean square of three channels, in levels^2, by which a shape's paint is off."""
    height, width = levels.shape[:2]
    return np.asarray(((_straight(levels) - _paint(shape, width, height)) ** 2).mean(axis=2))


def _fitted(goal: np.ndarray, weights: np.ndarray, ground: np.ndarray, settings: FitSettings) -> Scene:
    """Curves over a ground that are near a picture, both (H, W, 3) in levels, where there are weights (H, W)."""
    from cubicsplat_cli.photo import FitInputs, Fitting

    rows, columns = (np.flatnonzero(weights.any(axis=axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    own = np.ascontiguousarray(weights[window], np.float32)
    target, behind = ((each[window] / 255.0).astype(np.float32) for each in (goal, ground))
    recipe = replace(settings.recipe, shared_opacity=SHARED_OPACITY)
    fitting = Fitting(target, settings.with_(segments=SEGMENTS, recipe=recipe, device="cpu"), inputs=FitInputs(own, ground=behind))
    fitting.relax()
    importance = fitting.importance()
    keep = np.flatnonzero(importance * 255.0**2 >= PRICE)
    keep = keep if len(keep) else importance.argmax()[None]
    if len(keep) < len(importance):
        fitting.resize(keep, len(keep))
    scene = fitting.finish().scene
    points = scene.points + np.array([columns[0], rows[0]], np.float32)
    return replace(scene, points=points, background=None, width=goal.shape[1], height=goal.shape[0])
