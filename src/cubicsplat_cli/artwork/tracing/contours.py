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


def edge_positions(
    levels: np.ndarray, regions: Regions, error: float = ROUNDING, share_error: float = FEW_SAMPLES
) -> EdgePositions:
    """Positions for all cracks between different regions of a picture (H, W, 4) in levels, known to an error.

    share_error: of the shares of pixels that shapes cover.
    """
    found = border_positions(levels, regions.labels, regions.fills, error, ROUNDING, share_error)
    return EdgePositions(*found, RIM if error > ROUNDING else 0.0)
