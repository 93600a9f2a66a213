"""The ends of an outline where it vanishes behind an upper layer, and their directions."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.raster.outlines import end_heading
from cubicsplat_cli.records import dataclass

REACH = 14.0  # px along an outline from which its tangent is taken
STRAIGHT = 0.12  # radians that an outline turns in REACH px, below which it counts as straight


@dataclass(frozen=True)
class End:
    """at: (2,) px, the last visible place; tangent: (2,) unit, onwards into what is hidden, None where it is not known;
    straight: whether the outline is so up to there."""

    at: np.ndarray
    tangent: np.ndarray | None
    straight: bool


def end_of(points: np.ndarray, sigma: np.ndarray, start: int, step: int) -> End:
    """The end of what shows of a closed outline before the hidden run that begins at index `start`.

    points: (n, 2) px; sigma: (n,) inf where hidden. step: -1 where the visible part comes before the run, else 1.
    """
    n = len(points)
    index = (start + step * np.arange(1, n)) % n
    known = np.isfinite(sigma[index])
    index = index[: int(np.argmin(known)) if not known.all() else n]
    at = points[index[:1] if len(index) else [start]][0]
    found = heading(points[index], sigma[index], REACH)
    if found is None:
        return End(at, None, False)
    return End(found.at, found.tangent, found.bend * REACH <= STRAIGHT)


@dataclass(frozen=True)
class Heading:
    """at: (2,) px, where an outline ends; tangent: (2,) unit, onwards; error: its standard error, radians; bend: 1/px;
    misfit: mean squared residual of a smooth end, in sigmas."""

    at: np.ndarray
    tangent: np.ndarray
    error: float
    bend: float
    misfit: float


def heading(points: np.ndarray, sigma: np.ndarray, reach: float) -> Heading | None:
    """The direction of an outline at its end: points (n, 2) px from there on, `reach` px of them being looked at, and
    their standard errors (n,). None where too few are known.
    """
    found = end_heading(points, sigma, reach) if len(points) else None
    return None if found is None else Heading(found[:2], found[2:4], *found[4:].tolist())
