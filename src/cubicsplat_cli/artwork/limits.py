"""Bounds on the work for one picture: how large a copy is drawn, and how many regions it may have."""

from __future__ import annotations

import logging
import math

import numpy as np

from cubicsplat_cli.artwork.regions.regions import Regions, find_regions
from cubicsplat_cli.artwork.shapes import Drawing, scaled_drawing

# A drawing loses nothing visible with this many px; outlines are as exact as ever, in px of the copy.
MOST_PIXELS = 2_000_000
# Of so many regions on, a picture is noise or a photo; each takes some hundredth of a second.
MOST_REGIONS = 600
# Beyond so many shapes the polish would take minutes.
MOST_POLISHED = 800

_log = logging.getLogger("cubicsplat")


def reduction(height: int, width: int) -> int:
    """By which whole number the sides of a picture are divided before it is drawn, 1 for all but very large ones."""
    return max(1, math.ceil(math.sqrt(height * width / MOST_PIXELS)))


def reduced(levels: np.ndarray, factor: int) -> np.ndarray:
    """The picture (H, W, 4), premultiplied, with the mean of each block of factor x factor px, which is what its shapes
    cover of the block; at the far edges blocks are filled up with the last px.
    """
    if factor == 1:
        return levels
    height, width = levels.shape[:2]
    fill = ((0, -height % factor), (0, -width % factor), (0, 0))
    padded = np.pad(levels, fill, mode="edge")
    blocks = padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor, 4)
    _log.warning("drawn at 1/%d of its size: it has more than %.0f megapixels", factor, MOST_PIXELS / 1e6)
    return blocks.mean(axis=(1, 3), dtype=np.float32)


def bounded_regions(
    levels: np.ndarray, palette: np.ndarray, min_area: float, most: int | None, known: np.ndarray | None
) -> Regions:
    """The regions of a picture, at most 600: where there are more, the smallest join their neighbours; otherwise as
    `find_regions`.
    """
    regions = find_regions(levels, palette, min_area, most, known)
    found = regions.count
    while regions.count > MOST_REGIONS:
        areas = np.sort(regions.areas())[::-1]
        min_area = max(2.0 * min_area, float(areas[MOST_REGIONS]) + 1.0, 4.0)
        regions = find_regions(levels, palette, min_area, most, known)
        if min_area > levels.shape[0] * levels.shape[1]:
            break
    if regions.count < found:
        _log.warning("%d regions are too many to draw: those below %.0f px joined their neighbours", found, min_area)
    return regions


def enlarged(drawing: Drawing, factor: int, width: int, height: int) -> Drawing:
    """The drawing of a reduced picture in px of the picture, of width x height px."""
    if factor == 1:
        return drawing
    whole = scaled_drawing(drawing, drawing.width * factor, drawing.height * factor)
    return Drawing(width, height, whole.shapes)
