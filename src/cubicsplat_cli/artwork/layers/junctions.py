"""The order of regions where three meet: uppermost is the one whose outline runs straight on there.

Outlines are known to hundredths of a px, so each one's heading on either side of a meeting point has a standard error
of a degree or so. An outline that turns by less than that is far likelier to be one that passes than two that happen
to meet; the others' turns must not be as small.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.regions.cracks import CrackLoop as Cracks
from cubicsplat_cli.artwork.regions.cracks import trace
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.tracing.contours import EdgePositions, loop_points
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.outlines import turns
from cubicsplat_cli.records import dataclass

REACHES = (14.0, 7.0)  # px along an outline from which its heading is taken, the first that is smooth
SMOOTH = 3.0  # mean squared residual, in sigmas, of a smooth one
LEAST_TURN = math.radians(2.5)  # standard error beyond that of the points
LEAST_VOTE = 0.3
MEETING = 3  # px within which the outlines of three regions meet at one place


@dataclass(frozen=True)
class _Passing:
    """Course of one region's outline through a meeting point. others: the regions before and after; at: (2,) vertex x,
    y; turn: radians; error: its standard error."""

    region: int
    others: tuple[int, int]
    at: tuple[int, int]
    turn: float
    error: float

    @property
    def likelihood(self) -> float:
        """Of this turn where the outline goes straight on, over that of any turn up to a right angle."""
        return math.exp(-0.5 * (self.turn / self.error) ** 2) * math.sqrt(0.5 * math.pi) / self.error


def junction_votes(regions: Regions, found: EdgePositions) -> dict[tuple[int, int], float]:
    """Votes that a region lies above another: for (above, below) the sum over their meeting points with a
    third, each from LEAST_VOTE to 1.
    """
    places: dict[tuple[int, ...], list[_Passing]] = {}
    for passing in _passings(regions, found):
        names = tuple(sorted((passing.region, *passing.others)))
        places.setdefault(names, []).append(passing)
    votes: dict[tuple[int, int], float] = {}
    for passings in places.values():
        for passing in passings:
            rivals = [p for p in passings if p.region != passing.region and _near(p.at, passing.at)]
            if len(rivals) != 2:
                continue
            sure = passing.likelihood / (1.0 + passing.likelihood + sum(p.likelihood for p in rivals))
            if sure >= LEAST_VOTE:
                for other in passing.others:
                    votes[passing.region, other] = votes.get((passing.region, other), 0.0) + sure
    return votes


def _near(a: tuple[int, int], b: tuple[int, int]) -> bool:
    return max(abs(a[0] - b[0]), abs(a[1] - b[1])) <= MEETING


def _passings(regions: Regions, found: EdgePositions) -> list[_Passing]:
    out = []
    labels = np.pad(regions.labels, 1, constant_values=-1)
    for region, box in enumerate(ndimage.find_objects(regions.labels + 1)):
        top, left = box[0].start, box[1].start
        for loop in trace(regions.labels[box] == region):
            placed = Cracks(loop.x + left, loop.y + top, loop.direction)
            row, column = placed.outside
            beside = labels[row + 1, column + 1]
            after = np.roll(beside, -1)
            change = np.flatnonzero((beside != after) & (beside >= 0) & (after >= 0))
            if not len(change):
                continue
            turn, error = turns(beside, loop_points(placed, found), change, REACHES, SMOOTH, LEAST_TURN)
            for k, radians, known_to in zip(change.tolist(), turn.tolist(), error.tolist(), strict=True):
                if not math.isnan(radians):
                    at = (k + 1) % len(beside)
                    others = int(beside[k]), int(after[k])
                    out.append(_Passing(region, others, (int(placed.x[at]), int(placed.y[at])), radians, known_to))
    return out
