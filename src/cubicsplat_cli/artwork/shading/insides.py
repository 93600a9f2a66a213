"""Where the shapes of a drawing show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.geometry.coverage import coverage
from cubicsplat_cli.artwork.geometry.outlines import Ring, pieces_of_rings
from cubicsplat_cli.artwork.shapes import Drawing

FULL = 0.995  # of a pixel that a shape covers: all of it


def coverage_of(rings: Sequence[Ring], width: int, height: int) -> np.ndarray:
    """(H, W) float64 the share of each pixel that rings cover by the nonzero rule."""
    return coverage(*pieces_of_rings(rings), 0, 0, height, width)


def shown(drawing: Drawing) -> list[np.ndarray]:
    """For each shape, all opaque, (H, W) the share of each pixel that it covers and no shape above it does."""
    clear = np.ones((drawing.height, drawing.width))
    shares = []
    for shape in reversed(drawing.shapes):
        own = coverage_of(shape.oriented(), drawing.width, drawing.height)
        shares.append(own * clear)
        clear = clear * (1.0 - own)
    return shares[::-1]
