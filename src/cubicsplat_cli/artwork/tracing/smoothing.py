"""Local fits along a chain of noisy boundary points: where the boundary is, where it heads and how it bends.

Each point gets a weighted parabola in arc length over a window of its neighbours. The window grows while the parabola
still explains the points, so straight and slowly bending stretches average many points and tight bends few (Lepski's
rule for the choice of a bandwidth).
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.raster.outlines import parabolas
from cubicsplat_cli.records import dataclass

HALF_WINDOWS = (2, 4, 7, 12, 20)
# A point whose standard error is larger tells nothing (it is hidden or unknown).
HIDDEN_SIGMA = 3.0


@dataclass(frozen=True)
class LocalFits:
    """Of n points: positions (n, 2) px, unit tangents (n, 2), curvature (n,) 1/px, half-windows (n,) in points.

    errors: (n, 2) standard errors of the position across the run in px, and of the tangent in radians.
    """

    positions: np.ndarray
    tangents: np.ndarray
    curvature: np.ndarray
    windows: np.ndarray
    errors: np.ndarray

    def taken(self, index: np.ndarray) -> LocalFits:
        """The fits of some points, in their order."""
        return LocalFits(
            self.positions[index],
            self.tangents[index],
            self.curvature[index],
            self.windows[index],
            self.errors[index],
        )


def arc_lengths(points: np.ndarray) -> np.ndarray:
    """(n,) length of the polyline up to each point, in px."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def most_misfit(parameters: int) -> float:
    """Mean squared residual, in sigmas, up to which a fit with that many degrees of freedom is believed."""
    return 1.0 + 2.0 * math.sqrt(2.0 / parameters)


def local_fits(points: np.ndarray, weights: np.ndarray, closed: bool) -> LocalFits:
    """Local parabolas at each point of a chain or a loop.

    points: (n, 2) px in order, n >= 3. weights: (n,) 1/px^2, the inverse squared standard errors; 0 where unknown.
    """
    pad = min(HALF_WINDOWS[-1], len(points)) if closed else 0
    index = np.arange(-pad, len(points) + pad) % len(points)
    fits = _open_fits(points[index], weights[index])
    inner = slice(pad, pad + len(points))
    return LocalFits(*(part[inner] for part in fits))


def _open_fits(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, ...]:
    s = arc_lengths(points)
    kinds = [(half, most_misfit(2 * half - 2)) for half in HALF_WINDOWS]
    terms, errors, windows = parabolas(points, weights, s, kinds)
    positions, first, second = terms[:, 0], terms[:, 1], 2.0 * terms[:, 2]
    speed = np.maximum(np.hypot(*first.T), 1e-9)
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    return positions, first / speed[:, None], curvature, windows, errors
