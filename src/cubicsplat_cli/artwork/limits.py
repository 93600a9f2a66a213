"""Bounds on the work for one picture: how large a copy is drawn, and how many regions it may have."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.channels import in_blocks
from cubicsplat_cli.artwork.regions.regions import FlatPicture, PixelFills, Regions, pixel_fills
from cubicsplat_cli.artwork.shapes import Drawing, scaled_drawing
from cubicsplat_cli.progress import log

# A screen of 1920 x 1200 px is drawn whole: half as large its text could not be read. Pages of text that large take up
# to a minute and .6 GB a megapixel.
MOST_PIXELS = 3_000_000
# A map, a page of text or a tone of dots has very many regions: MOST_REGIONS are drawn, about a minute's work, the
# larger beneath the smaller, each ending a little beneath its neighbours; beyond, the smallest join their neighbours.
# What else lies above what, hidden parts and translucency take some milliseconds a region, and are sought of so many;
# what has to be blurred to have any regions has no more.
MOST_COMPLETED = 6000
MOST_REGIONS = 20_000
MOST_POLISHED = 8000  # shapes, beyond which no regularities are sought: they take some 6 ms each


def reduction(height: int, width: int) -> int:
    """By which whole number the sides of a picture are divided before it is drawn, 1 for all but very large ones."""
    return max(1, math.ceil(math.sqrt(height * width / MOST_PIXELS)))


def reduced(levels: np.ndarray, factor: int) -> np.ndarray:
    """The picture (H, W, 4), premultiplied, divided by `reduction`."""
    if factor == 1:
        return levels
    log.warning("drawn at 1/%d of its size: it has more than %.0f megapixels", factor, MOST_PIXELS / 1e6)
    return blocks_of(levels, factor)


def blocks_of(levels: np.ndarray, factor: int) -> np.ndarray:
    """The picture (H, W, 4), premultiplied, with the mean of each block of factor x factor px, which is what its shapes
    cover of the block; at the far edges blocks are filled up with the last px.
    """
    height, width = levels.shape[:2]
    padded = np.pad(levels, ((0, -height % factor), (0, -width % factor), (0, 0)), mode="edge")
    return in_blocks(padded, factor).mean(axis=(2, 3), dtype=np.float32)


def bounded_regions(
    picture: FlatPicture, min_area: float, most: int | None = None, limit: int = MOST_REGIONS
) -> tuple[PixelFills, Regions]:
    """The fills of a picture's pixels (`pixel_fills`), and its regions; where there are more than `limit`, the smallest
    join their neighbours, which is logged.
    """
    fills = pixel_fills(picture, most)
    regions = fills.regions(min_area)
    found = regions.count
    while regions.count > limit and min_area <= fills.parts.size:
        areas = np.sort(regions.areas())[::-1]
        min_area = max(2.0 * min_area, float(areas[limit]) + 1.0, 4.0)
        regions = fills.regions(min_area)
    if regions.count < found:
        log.warning(
            "%d regions are too many to draw: those below %.0f px joined their neighbours; --colors leaves fewer",
            found,
            min_area,
        )
    return fills, regions


def few_enough(drawing: Drawing) -> bool:
    """Whether a drawing has so few shapes that regularities are sought; else that is logged."""
    few = len(drawing.shapes) <= MOST_POLISHED
    if not few:
        log.warning(
            "%d shapes are many: symmetries and copies are not sought; --min-area and --colors leave fewer shapes",
            len(drawing.shapes),
        )
    return few


def enlarged(drawing: Drawing, factor: int, width: int, height: int) -> Drawing:
    """The drawing of a reduced picture in px of the picture, of width x height px."""
    if factor == 1:
        return drawing
    whole = scaled_drawing(drawing, drawing.width * factor, drawing.height * factor)
    return Drawing(width, height, whole.shapes)
