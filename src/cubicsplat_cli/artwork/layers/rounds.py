"""Regions that are whole circles or ellipses: nothing that touches one covers any of it.

What another shape covers of a round one cuts a piece out of it. A region whose outline is round all the way, within its
errors, therefore lies above its neighbours, whichever of the two outlines runs straight on where they meet a third.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse
from cubicsplat_cli.artwork.regions.cracks import CrackLoop, trace
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.tracing.contours import EdgePositions, loop_points
from cubicsplat_cli.artwork.tracing.fitting import FINEST_SIGMA, PLAIN_MISFIT, parameter_price
from cubicsplat_cli.artwork.tracing.primitives import fit_primitive
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.contours import independent

VOTE = 3.0  # more than the two places count where the outlines of two regions usually meet a third
LEAST = 100  # px^2 of the box around a region, below which anything is round
FULLNESS = (
    0.02  # by which a region's area over the root of the determinant of its second moments may be off an ellipse's
)


def round_votes(regions: Regions, found: EdgePositions, clear: np.ndarray) -> dict[tuple[int, int], float]:
    """The evidence that a region lies above another: VOTE for each neighbour of one that is round all the way.

    found: where the outlines of the regions run. clear: (R,) bool, regions of which nothing is drawn.
    """
    votes: dict[tuple[int, int], float] = {}
    for region, box in enumerate(ndimage.find_objects(regions.labels + 1)):
        mask = regions.labels[box] == region
        if clear[region] or mask.size < LEAST:
            continue
        loop = max(trace(mask), key=lambda one: one.area)
        if not _full(loop):
            continue
        placed = CrackLoop(loop.x + box[1].start, loop.y + box[0].start, loop.direction)
        beside = _beside(regions.labels, placed)
        if len(beside) > 1 and _round(placed, found):
            votes |= {(region, other): VOTE for other in beside}
    return votes


def _full(loop: CrackLoop) -> bool:
    """Whether what a loop encloses is as full as an ellipse, which no rectangle is: by its area and second moments, in
    integrals along its cracks.
    """
    along = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[loop.direction]
    x, y = loop.x - loop.x.mean(), loop.y - loop.y.mean()
    area = float((x * along[:, 1]).sum())
    mean = np.array([(x**2 * along[:, 1]).sum(), -(y**2 * along[:, 0]).sum()]) / (2.0 * area)
    xx, yy = (x**3 * along[:, 1]).sum() / 3.0, -(y**3 * along[:, 0]).sum() / 3.0
    xy = (x**2 * (y + 0.5 * along[:, 1]) * along[:, 1]).sum() / 2.0
    spread = np.array([[xx, xy], [xy, yy]]) / area - np.outer(mean, mean)
    return bool(abs(area / (4.0 * math.pi * math.sqrt(float(np.linalg.det(spread)))) - 1.0) <= FULLNESS)


def _round(loop: CrackLoop, found: EdgePositions) -> bool:
    points, sigma, _ = loop_points(loop, found)
    weights = independent(points, np.maximum(sigma, FINEST_SIGMA) ** -2.0)
    fitted = fit_primitive(points, weights, parameter_price(points, 1.0))
    return fitted is not None and isinstance(fitted[0], Circle | Ellipse) and fitted[2] <= PLAIN_MISFIT


def _beside(labels: np.ndarray, loop: CrackLoop) -> set[int]:
    """The regions around a loop; none where it touches the canvas's border."""
    row, column = loop.outside
    beyond = (row < 0) | (column < 0) | (row >= labels.shape[0]) | (column >= labels.shape[1])
    return set() if beyond.any() else set(np.unique(labels[row, column]).tolist())
