"""From a flat picture to a drawing: inks, regions, layers, contours, outlines, finish."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.completion import outlines_of
from cubicsplat_cli.artwork.contours import crossings
from cubicsplat_cli.artwork.extents import extents
from cubicsplat_cli.artwork.inks import eight_bit, picture_inks
from cubicsplat_cli.artwork.limits import MOST_POLISHED, bounded_regions, enlarged, reduced, reduction
from cubicsplat_cli.artwork.polish import polish
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.stacking import stack


def draw(target: np.ndarray, settings: ArtworkSettings | None = None) -> Drawing:
    """The drawing of a flat picture: (H, W, 3) or (H, W, 4) premultiplied, float32 in [0, 1].

    Very large pictures, and those of very many regions, are drawn with less detail (`limits`), which is logged.
    """
    settings = settings or ArtworkSettings()
    full_height, full_width = target.shape[:2]
    factor = reduction(full_height, full_width)
    levels = reduced(as_levels(target), factor)
    height, width = levels.shape[:2]
    regions = bounded_regions(levels, picture_inks(levels, settings.colors), settings.min_area / factor**2)
    layers = stack(regions)
    found = crossings(levels, regions)
    shapes = []
    for extent in extents(regions, layers, found):
        ink = eight_bit(regions.inks[layers.layers[extent.layer].region])
        shapes.append(Shape(ink, outlines_of(extent, (height, width), settings.detail), f"shape-{len(shapes) + 1}"))
    drawing = Drawing(width, height, tuple(shapes))
    if len(shapes) <= MOST_POLISHED:
        drawing = polish(drawing, levels.astype(float) / 255.0, settings.detail)
    return enlarged(drawing, factor, full_width, full_height)


def as_levels(target: np.ndarray) -> np.ndarray:
    """(H, W, 4) float32 premultiplied RGBA in levels of 0..255."""
    levels = np.asarray(target, dtype=np.float32) * np.float32(255.0)
    if levels.shape[-1] == 3:
        levels = np.concatenate([levels, np.full_like(levels[..., :1], 255.0)], axis=-1)
    return levels
