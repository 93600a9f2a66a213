"""The order of regions where three meet: the uppermost one has an outline that runs straight on there.

Outlines are known to hundredths of a px, so their headings on either side of a meeting point have standard errors of
about a degree. An outline that turns by less is far likelier to pass than two outlines are to meet by chance, provided
that the other two turn more.
"""

from __future__ import annotations

import math

from cubicsplat_cli.artwork.layers.ways import REACH
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.raster.borders import passings
from cubicsplat_cli.raster.outlines import EdgePositions

REACHES = (REACH, 0.5 * REACH)  # px along an outline from which its heading is taken, the first that is smooth
SMOOTH = 3.0  # mean squared residual, in sigmas, of a smooth one
LEAST_TURN = math.radians(2.5)  # standard error beyond that of the points
MEETING = 3  # px within which the outlines of three regions meet at one place


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
