"""Where an outline vanishes behind an upper layer, and which way it is heading there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

# px along an outline from which its tangent is taken, those nearest to a junction left out; points at least.
REACH, NEAREST, FEWEST = 14.0, 1.5, 4
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
    """Where an outline is heading at its end: points (n, 2) px from there on, `reach` px of them being looked at, and
    their standard errors (n,). None where too few are known.
    """
    if len(points) < FEWEST:
        return None
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    near = (along <= reach) & (along >= NEAREST)
    if near.sum() < FEWEST:
        return None
    t = along[near]
    weight = 1.0 / sigma[near, None]
    design = np.stack([np.ones_like(t), t, t * t], axis=1) * weight
    value, *_ = np.linalg.lstsq(design, points[near] * weight, rcond=None)
    speed = max(float(np.hypot(*value[1])), 1e-9)
    tangent = -value[1] / speed
    normal = np.array([-tangent[1], tangent[0]])
    rest = (design @ value - points[near] * weight) @ normal
    error = math.sqrt(max(float(np.linalg.pinv(design.T @ design)[1, 1]), 0.0)) / speed
    bend = 2.0 * abs(float(value[2] @ normal)) / speed**2
    return Heading(value[0], tangent, error, bend, float(rest @ rest) / max(len(t) - 3, 1))
