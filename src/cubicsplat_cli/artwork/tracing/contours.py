"""Positions of the border between two fills within the pixels along it.

A crack is the unit edge between two neighbouring pixels. The blends on an edge say how much of each pixel either fill
covers. Summed along a column across a border that runs rather level (or along a row across a steep one) the shares give
the border's mean height over that column exactly, whatever its slope, because a pixel's share is an area. That is taken
as a point at the column's middle.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.regions.sampling import FEW_SAMPLES
from cubicsplat_cli.raster.borders import border_positions
from cubicsplat_cli.raster.outlines import EdgePositions

ROUNDING = 0.8  # levels by which a clean picture's pixels are off
RIM = 1.0  # px; the first row of a picture that is not clean is one fill or the other


COVERS = np.array([np.zeros(4), np.full(4, 255.0)])  # levels of nothing and of all, for shares as a picture


def edge_positions(
    levels: np.ndarray, regions: Regions, error: float = ROUNDING, share_error: float = FEW_SAMPLES
) -> EdgePositions:
    """Positions for all cracks between different regions of a picture (H, W, 4) in levels, known to an error.

    share_error: of the shares of pixels that shapes cover.
    """
    found = border_positions(levels, regions.labels, regions.fills, error, ROUNDING, share_error)
    return EdgePositions(*found, RIM if error > ROUNDING else 0.0)


def share_positions(share: np.ndarray, cover: np.ndarray, error: float) -> EdgePositions:
    """Positions around what covers a share (H, W) in 0..1 of each pixel, and has those of cover (H, W) bool; error in
    levels of 255 for all.
    """
    regions = Regions(cover.astype(np.int32), COVERS, np.arange(2))
    return edge_positions(np.repeat((255.0 * share)[..., None], 4, axis=2), regions, max(ROUNDING, error))
