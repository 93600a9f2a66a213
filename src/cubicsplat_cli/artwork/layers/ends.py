"""The ends of an outline where it vanishes behind an upper layer, their directions, and the cubic that joins two.

Among the cubics that stay hidden, the one that bends least is taken, by the integral of the squared curvature.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import arc_lengths, derivatives, points_at, polyline_places
from cubicsplat_cli.raster.outlines import end_heading
from cubicsplat_cli.record import record

REACH = 14.0  # px along an outline from which its tangent is taken
STRAIGHT = 0.12  # radians that an outline turns in REACH px, below which it counts as straight
HANDLES = (0.25, 0.4, 0.6, 0.9, 1.4)  # lengths of handles that are tried, of the distance between the ends
MOST_TRIED = 8
SAMPLES = np.linspace(0.0, 1.0, 33)
TOLERATED = 1  # px that a continuation may be wrong in


@record
class End:
    """at: (2,) px, the last visible place; tangent: (2,) unit, onwards into what is hidden, None where it is not known;
    straight: whether the outline is so up to there."""

    at: np.ndarray
    tangent: np.ndarray | None
    straight: bool


def ends_of(points: np.ndarray, sigma: np.ndarray, run: np.ndarray) -> tuple[End, End]:
    """The ends of what shows of a closed outline before and after a hidden run, indices in order; see `end_of`."""
    return end_of(points, sigma, run[0], -1), end_of(points, sigma, run[-1], 1)


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


@record
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


def continued(
    points: np.ndarray, sigma: np.ndarray, run: np.ndarray, most: float, wrong: Callable[[np.ndarray], int]
) -> np.ndarray | None:
    """(len(run), 2) points along the cubic that continues a closed outline where it is hidden; None where none does.

    points: (n, 2) px; sigma: (n,) inf where hidden; run: the indices of a hidden run, in order. most: radians
    that it may turn. wrong: how many px an outline of points (n, 2) covers or leaves wrongly.
    """
    before, after = ends_of(points, sigma, run)
    first, leaving, last, arriving = before.at, before.tangent, after.at, after.tangent
    span = float(np.hypot(*(last - first)))
    if leaving is None or arriving is None or span < 1.0:
        return None
    # By which the way from one end to the other turns off the tangents.
    turns = np.arccos(np.clip(np.array([leaving, -arriving]) @ (last - first) / span, -1.0, 1.0))
    if turns.sum() > most:
        return None
    cubics = np.array(
        [[first, first + a * span * leaving, last + b * span * arriving, last] for a in HANDLES for b in HANDLES]
    )
    for k in np.argsort(_bending(cubics), kind="stable")[:MOST_TRIED]:
        trial, fine = points.copy(), points_at(cubics[k], np.linspace(0.0, 1.0, 4 * len(run) + 8))
        trial[run] = polyline_places(fine, (np.arange(len(run)) + 1.0) / (len(run) + 1.0) * arc_lengths(fine)[-1])
        if wrong(trial) <= TOLERATED:
            return trial[run]
    return None


def _bending(cubics: np.ndarray) -> np.ndarray:
    """(k,) the integral of the squared curvature along cubics (k, 4, 2), times their chord."""
    first, second = derivatives(cubics, np.broadcast_to(SAMPLES, (len(cubics), len(SAMPLES))))
    speed = np.maximum(np.hypot(first[..., 0], first[..., 1]), 1e-9)
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    chord = np.hypot(*(cubics[:, 3] - cubics[:, 0]).T)
    return (cross**2 / speed**5).mean(axis=1) * chord
