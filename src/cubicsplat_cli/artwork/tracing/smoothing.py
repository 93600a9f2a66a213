"""Local fits along a chain of noisy boundary points: where the boundary is, where it heads and how it bends.

Each point gets a weighted parabola in arc length over a window of its neighbours. The window grows while the parabola
still explains the points, so straight and slowly bending stretches average many points and tight bends few (Lepski's
rule for the choice of a bandwidth).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

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


def most_misfit(freedom: int) -> float:
    """Mean squared residual, in sigmas, up to which a fit with that many degrees of freedom is believed."""
    return 1.0 + 2.0 * math.sqrt(2.0 / freedom)


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
    growing = np.arange(len(points))
    terms, errors, _ = _parabolas(points, weights, s, growing, HALF_WINDOWS[0])
    windows = np.full(len(points), HALF_WINDOWS[0])
    for half in HALF_WINDOWS[1:]:
        wider, wider_errors, misfit = _parabolas(points, weights, s, growing, half)
        believed = misfit <= most_misfit(2 * half - 2)
        growing = growing[believed]
        terms[growing], errors[growing], windows[growing] = wider[believed], wider_errors[believed], half
    positions, first, second = terms[:, 0], terms[:, 1], 2.0 * terms[:, 2]
    speed = np.maximum(np.hypot(*first.T), 1e-9)
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    return positions, first / speed[:, None], curvature, windows, errors


def _parabolas(
    points: np.ndarray, weights: np.ndarray, s: np.ndarray, where: np.ndarray, half: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (k, 3, 2) of 1, s and s^2 around the points `where` (k,), their errors (k, 2), and misfit (k,).

    The misfit is the mean squared residual across the run, in squared sigmas.
    """
    index = where[:, None] + np.arange(-half, half + 1)
    valid = (index >= 0) & (index < len(points))
    index = np.clip(index, 0, len(points) - 1)
    ds = (s[index] - s[where, None]) / half
    # Hidden points decide where nothing else does.
    w = (weights[index] + 1e-6) * valid
    powers = ds[..., None] ** np.arange(3)
    weighted = np.swapaxes(powers * w[..., None], 1, 2)
    gram = weighted @ powers
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    offsets = points[index] - points[where, None]
    inverse = np.linalg.inv(gram)
    terms = inverse @ (weighted @ offsets)
    errors = np.sqrt(np.stack([inverse[:, 0, 0], inverse[:, 1, 1] / half**2], axis=1))
    rest = offsets - powers @ terms
    slope = terms[:, 1] / np.maximum(np.hypot(*terms[:, 1].T), 1e-12)[:, None]
    across = rest[..., 0] * slope[:, None, 1] - rest[..., 1] * slope[:, None, 0]
    count = (w > 1e-4).sum(axis=1)
    misfit = (w * across**2).sum(axis=1) / np.maximum(count - 3, 1)
    terms = terms / (float(half) ** np.arange(3))[None, :, None]
    terms[:, 0] += points[where]
    return terms, errors, misfit
