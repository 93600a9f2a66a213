"""Many cubics at once, each fitted to its own run of points between ends that are known only roughly.

Gauss-Newton on the handle lengths and, as far as the standard errors of the ends and tangents allow, on those too;
only the distance along the normal counts, and the points' parameters are found again after each step (Newton's step to
the foot point).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.geometry.beziers import bernstein, points_at
from cubicsplat_cli.raster.cubics import gauss_newton, newton_steps

ROUNDS = 3
SHORTEST_HANDLE = 0.03  # of the run's length
LONGEST_HANDLE = 1.0


@dataclass(frozen=True)
class Ends:
    """Both ends of P runs: positions (P, 2, 2) px, unit tangents along the run (P, 2, 2), and their standard errors.

    errors: (P, 2, 2), of each end the position across the run in px and the tangent in radians.
    """

    positions: np.ndarray
    tangents: np.ndarray
    errors: np.ndarray

    def taken(self, which: np.ndarray) -> Ends:
        """Those of some runs."""
        return Ends(self.positions[which], self.tangents[which], self.errors[which])


@dataclass(frozen=True)
class CubicFits:
    """P cubics (P, 4, 2) px, the squared distances of their points (P, K) px^2, and chi^2 of their ends (P,)."""

    cubics: np.ndarray
    squares: np.ndarray
    strain: np.ndarray


def rough_cubics(ends: Ends, points: np.ndarray, weights: np.ndarray) -> CubicFits:
    """Cubics with the ends and tangents as given, after one step of least squares for the handle lengths.

    points: (P, K, 2) px in order along the run. weights: (P, K) 1/px^2, 0 leaves a point out.
    """
    u, length = _start(ends, points)
    b = bernstein(u)
    across = points - (b[..., :2].sum(-1)[..., None] * ends.positions[:, None, 0])
    across -= b[..., 2:].sum(-1)[..., None] * ends.positions[:, None, 1]
    first, last = ends.tangents[:, None, 0], -ends.tangents[:, None, 1]
    b1, b2 = b[..., 1], b[..., 2]
    a11, a22 = (weights * b1 * b1).sum(1), (weights * b2 * b2).sum(1)
    a12 = (weights * b1 * b2).sum(1) * (first * last).sum(-1)[:, 0]
    r1, r2 = (weights * b1 * (across * first).sum(-1)).sum(1), (weights * b2 * (across * last).sum(-1)).sum(1)
    ridge = 1e-3 * (a11 + a22) + 1e-9
    third = length / 3.0
    a11, a22, r1, r2 = a11 + ridge, a22 + ridge, r1 + ridge * third, r2 + ridge * third
    scale = a11 * a22 - a12 * a12
    sizes = np.stack([a22 * r1 - a12 * r2, a11 * r2 - a12 * r1], axis=1) / scale[:, None]
    sizes = np.clip(sizes, SHORTEST_HANDLE * length[:, None], LONGEST_HANDLE * length[:, None])
    start, stop = ends.positions[:, 0], ends.positions[:, 1]
    handles = sizes[..., None] * np.stack([first[:, 0], last[:, 0]], axis=1)
    cubics = np.stack([start, start + handles[:, 0], stop + handles[:, 1], stop], axis=1)
    u = np.clip(newton_steps(cubics, points, u), 0.0, 1.0)
    rest = points_at(cubics, u) - points
    return CubicFits(cubics, (rest * rest).sum(-1), np.zeros(len(points)))


def fit_cubics(ends: Ends, points: np.ndarray, weights: np.ndarray) -> CubicFits:
    """The best cubics between roughly known ends; arguments as for rough_cubics."""
    u, length = _start(ends, points)
    frame = _Frame(ends, length)
    limits = length[:, None] * [SHORTEST_HANDLE, LONGEST_HANDLE]
    given = (frame.base, frame.directions, frame.expected, frame.stiffness, limits)
    values, cubics, u = gauss_newton(*given, points, weights, u, ROUNDS)
    rest = points_at(cubics, u) - points
    return CubicFits(cubics, (rest * rest).sum(-1), frame.strain(values))


def _start(ends: Ends, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters (P, K) by chord length, and the lengths (P,) of the runs, px."""
    knots = np.concatenate([ends.positions[:, :1], points, ends.positions[:, 1:]], axis=1)
    steps = np.diff(knots, axis=1)
    along = np.cumsum(np.hypot(steps[..., 0], steps[..., 1]), axis=1)
    length = np.maximum(along[:, -1], 1e-9)
    return along[:, :-1] / length[:, None], length


class _Frame:
    """The six values of each cubic: two handle lengths, two shifts of the ends and two of the handles across the run.

    Control points are linear in them: base (P, 4, 2) + sum over the six of value * direction (P, 6, 4, 2).
    """

    def __init__(self, ends: Ends, length: np.ndarray) -> None:
        first, last = ends.tangents[:, 0], ends.tangents[:, 1]
        across = np.stack([-ends.tangents[..., 1], ends.tangents[..., 0]], axis=-1)
        count = len(length)
        self.length = length
        self.base = np.stack([ends.positions[:, k] for k in (0, 0, 1, 1)], axis=1)
        self.directions = np.zeros((count, 6, 4, 2))
        self.directions[:, 0, 1], self.directions[:, 1, 2] = first, -last
        self.directions[:, 2, 0] = self.directions[:, 2, 1] = self.directions[:, 4, 1] = across[:, 0]
        self.directions[:, 3, 3] = self.directions[:, 3, 2] = self.directions[:, 5, 2] = across[:, 1]
        # Straight runs leave the handles open: they are pulled gently towards thirds.
        self.expected = np.zeros((count, 6))
        self.expected[:, :2] = length[:, None] / 3.0
        sizes = np.concatenate(
            [
                np.repeat(0.5 * length[:, None], 2, axis=1),
                ends.errors[..., 0],
                ends.errors[..., 1] * length[:, None] / 3.0,
            ],
            axis=1,
        )
        self.stiffness = 1.0 / np.maximum(sizes, 1e-6) ** 2
        self.stiffness[:, :2] *= 0.1

    def strain(self, values: np.ndarray) -> np.ndarray:
        """(P,) chi^2 of the ends."""
        return (self.stiffness * (values - self.expected) ** 2)[:, 2:].sum(-1)
