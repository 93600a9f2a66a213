"""Bounds on the work for one picture: how large a copy is drawn, and how many regions it may have."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.channels import in_blocks
from cubicsplat_cli.artwork.regions.regions import FlatPicture, PixelFills, Regions, pixel_fills
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.progress import log

# A screen of 1920 x 1200 px is drawn whole, since its text would be illegible at half the size. Such a page takes up to
# a minute and .6 GB a megapixel.
MOST_PIXELS = 3_000_000
# A map, a page of text or a halftone has very many regions. MOST_REGIONS are drawn, in about a minute: the larger below
# the smaller, each ending a little beneath its neighbours. Further ones join their neighbours, the smallest first.
# The order of regions, hidden parts and translucency take some milliseconds a region, so at most MOST_COMPLETED have
# them. A picture that must be blurred to have regions at all gets no more than these.
MOST_COMPLETED = 6000
MOST_REGIONS = 20_000
MOST_POLISHED = 8000  # shapes with regularities, at some 6 ms each


def reduction(height: int, width: int) -> int:
    """Return the whole number by which a picture's sides are divided before it is drawn: 1 unless it is very large."""
    return max(1, math.ceil(math.sqrt(height * width / MOST_PIXELS)))


def reduced(levels: np.ndarray, factor: int) -> np.ndarray:
    """Return the picture (H, W, 4), premultiplied, divided by its `reduction`, and log a warning."""
    if factor == 1:
        return levels
    log.warning("drawn at 1/%d of its size: it has more than %.0f megapixels", factor, MOST_PIXELS / 1e6)
    return blocks_of(levels, factor)


def blocks_of(levels: np.ndarray, factor: int) -> np.ndarray:
    """Return the mean of each block of factor x factor px of a picture (H, W, 4), premultiplied, as its shapes cover
    the block. Incomplete blocks are filled with the last px.
    """
    height, width = levels.shape[:2]
    padded = np.pad(levels, ((0, -height % factor), (0, -width % factor), (0, 0)), mode="edge")
    return in_blocks(padded, factor).mean(axis=(2, 3), dtype=np.float32)


def bounded_regions(picture: FlatPicture, min_area: float, most: int | None, limit: int) -> tuple[PixelFills, Regions]:
    """Return a picture's `pixel_fills`, and at most `limit` regions; the smallest join neighbours, with a warning."""
    fills = pixel_fills(picture, most)
    regions = fills.regions(min_area)
    count = regions.count
    while regions.count > limit and min_area <= fills.parts.size:
        min_area = max(2.0 * min_area, float(np.sort(regions.areas)[-1 - limit]) + 1.0, 4.0)
        regions = fills.regions(min_area)
    if regions.count < count:
        text = "%d regions are too many to draw: those below %.0f px joined their neighbours; --colors leaves fewer"
        log.warning(text, count, min_area)
    return fills, regions


def few_enough(drawing: Drawing) -> bool:
    """True if a drawing has few enough shapes for regularities; else log a warning."""
    count = len(drawing.shapes)
    if count > MOST_POLISHED:
        text = "%d shapes are many: symmetries and copies are not sought; --min-area and --colors leave fewer shapes"
        log.warning(text, count)
    return count <= MOST_POLISHED
