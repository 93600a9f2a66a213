"""Parts of a px or two across in pictures without anti-aliasing, as letters of small text: their pixels themselves.

Their outlines are known to half a px, which is half of what they are. Where the outlines that were fitted leave a
pixel out, or go where none is, the part is no line drawn through its steps, and its pixels are drawn instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Outline, pieces_of_rings, polygon
from cubicsplat_cli.artwork.layers.extents import Extent
from cubicsplat_cli.artwork.plan import Plan
from cubicsplat_cli.artwork.regions.fills import PURE
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.borders import border_map
from cubicsplat_cli.raster.outlines import coverage

# Share of a pixel that a line may be off: one that runs through the pixel's middle covers half of it and more.
# In a letter of fewer than 50 px one that is off more counts, in a long line several.
MOST_OFF, FEW = 0.75, 0.02


def with_pixels(drawing: Drawing, plan: Plan) -> Drawing:
    """The drawing of a plan's parts, one shape each, in their order, with the pixels of thin parts that it misses."""
    pairs = zip(drawing.shapes, plan.parts, strict=True)
    shapes = [_of_pixels(shape, part.extent, plan.levels, part.fill) for shape, part in pairs]
    return replace(drawing, shapes=tuple(shapes))


def _of_pixels(shape: Shape, extent: Extent, levels: np.ndarray, fill: np.ndarray) -> Shape:
    """The shape of an extent, or its pixels in a picture (H, W, 4) of such a fill (4,), both in levels."""
    around = ndimage.binary_dilation(extent.shown, ndimage.SQUARE) & ~extent.shown
    # Pixels would leave gaps to smooth outlines of what lies above.
    if ndimage.binary_erosion(extent.shown, ndimage.SQUARE).any() or (around & extent.allowed).any():
        return shape
    height, width = extent.shown.shape
    levels = levels[extent.top : extent.top + height, extent.left : extent.left + width]
    own = extent.shown & (np.abs(levels - fill).max(axis=2) <= PURE)
    drawn = coverage(*pieces_of_rings(shape.oriented()), extent.top, extent.left, height, width)
    off = drawn - own
    if not own.any() or (np.abs(off) > MOST_OFF).sum() <= FEW * own.sum():
        return shape
    return replace(shape, outlines=tuple(_along_pixels(own, np.array([extent.left, extent.top]))))


def _along_pixels(own: np.ndarray, corner: np.ndarray) -> Iterator[Outline]:
    """The outlines of pixels (h, w) bool in a window with such a corner x, y."""
    for inside, cracks, _ in border_map(own.astype(np.int32)).loops:
        if inside:
            yield polygon(cracks[cracks[:, 2] != np.roll(cracks[:, 2], 1), :2] + corner.astype(float))
