"""The order of regions where three meet: the uppermost one has an outline that runs straight on there.

Outlines are known to hundredths of a px, so their headings on either side of a meeting point have standard errors of
about a degree. An outline that turns by less is far likelier to pass than two outlines are to meet by chance, provided
that the other two turn more.

A shape that covers a part of a circle or an ellipse cuts a piece out of it. A region whose outline is round all the
way, within its errors, therefore lies above its neighbours.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.geometry.fitting import FINEST_SIGMA, PLAIN_MISFIT, parameter_price
from cubicsplat_cli.artwork.layers.ways import REACH
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.raster.borders import passings
from cubicsplat_cli.raster.outlines import CIRCLE, ELLIPSE, EdgePositions, independent, loop_points, nearest_primitive

REACHES = (REACH, 0.5 * REACH)  # px along an outline from which its heading is taken, the first that is smooth
SMOOTH = 3.0  # mean squared residual, in sigmas, of a smooth one
LEAST_TURN = math.radians(2.5)  # standard error beyond that of the points
MEETING = 3  # px within which the outlines of three regions meet at one place
VOTE = 3.0  # more than the two places count where the outlines of two regions usually meet a third
LEAST = 100  # px^2 of the box around a region, below which anything is round
# By which a region's area over the root of the determinant of its second moments may be off an ellipse's.
FULLNESS = 0.02


def junction_votes(regions: Regions, found: EdgePositions) -> dict[tuple[int, int], float]:
    """Votes that a region lies above another: for (above, below) the sum over their meeting points with a
    third, each from 0.3 to 1.
    """
    # Of the outlines that pass between three regions: own region, the others, the vertex, and the likelihood.
    places: dict[tuple[int, ...], list[tuple[int, tuple[int, int], int, int, float]]] = {}
    known = passings(regions.borders.loops, found, REACHES, SMOOTH, LEAST_TURN)
    for (region, before, after, x, y), (turn, error) in zip(*(each.tolist() for each in known), strict=True):
        names = tuple(sorted((region, before, after)))
        # Of a turn, radians, where the outline goes straight on, over that of any turn up to a right angle.
        likelihood = math.exp(-0.5 * (turn / error) ** 2) * math.sqrt(0.5 * math.pi) / error
        places.setdefault(names, []).append((region, (before, after), x, y, likelihood))
    votes: dict[tuple[int, int], float] = {}
    for same in places.values():
        for region, others, x, y, own in same:
            rivals = [p for r, _, u, v, p in same if r != region and max(abs(u - x), abs(v - y)) <= MEETING]
            sure = own / (1.0 + own + sum(rivals))
            if len(rivals) == 2 and sure >= 0.3:
                for other in others:
                    votes[region, other] = votes.get((region, other), 0.0) + sure
    return votes


def round_votes(regions: Regions, found: EdgePositions, clear: np.ndarray) -> dict[tuple[int, int], float]:
    """The evidence that a region lies above another: VOTE for each neighbour of one that is round all the way.

    found: where the outlines of the regions run. clear: (R,) bool, regions of which nothing is drawn.
    """
    votes: dict[tuple[int, int], float] = {}
    for region, cracks, beside in regions.borders.loops.outer():
        if clear[region] or np.ptp(cracks[:, :2], axis=0).prod() < LEAST or beside.min() < 0 or not _full(cracks):
            continue
        others = np.unique(beside).tolist()
        if len(others) > 1 and _round(cracks, found):
            votes |= {(region, other): VOTE for other in others}
    return votes


def _full(cracks: np.ndarray) -> bool:
    """True if what a loop of cracks (n, 3) encloses is as full as an ellipse, which no rectangle is: by its area and
    second moments, in integrals along the loop.
    """
    along = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[cracks[:, 2]]
    x, y = (cracks[:, :2] - cracks[:, :2].mean(axis=0)).T
    area = float((x * along[:, 1]).sum())
    mean = np.array([(x**2 * along[:, 1]).sum(), -(y**2 * along[:, 0]).sum()]) / (2.0 * area)
    xx, yy = (x**3 * along[:, 1]).sum() / 3.0, -(y**3 * along[:, 0]).sum() / 3.0
    xy = (x**2 * (y + 0.5 * along[:, 1]) * along[:, 1]).sum() / 2.0
    spread = np.array([[xx, xy], [xy, yy]]) / area - np.outer(mean, mean)
    return bool(abs(area / (4.0 * math.pi * math.sqrt(float(np.linalg.det(spread)))) - 1.0) <= FULLNESS)


def _round(cracks: np.ndarray, found: EdgePositions) -> bool:
    points, sigma, _ = loop_points(cracks, found)
    weights = independent(points, np.maximum(sigma, FINEST_SIGMA) ** -2.0)
    fitted = nearest_primitive(points, weights, parameter_price(points, 1.0))
    return fitted is not None and fitted[0] in (CIRCLE, ELLIPSE) and fitted[3] <= PLAIN_MISFIT
