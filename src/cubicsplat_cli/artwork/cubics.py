"""Many cubics at once, each fitted to its own run of points with given ends and end tangents.

Least squares for the two handle lengths with the points' parameters found again after each step (Newton's step to the
foot point); after the first round only the distance along the normal counts, which converges in a few rounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ROUNDS = 4
SHORTEST_HANDLE = 0.03  # of the run's length
LONGEST_HANDLE = 1.0


@dataclass(frozen=True)
class CubicFits:
    """P cubics: control points (P, 4, 2) px, and the squared distances (P, K) px^2 of their points."""

    cubics: np.ndarray
    squares: np.ndarray


def basis(u: np.ndarray) -> np.ndarray:
    """Bernstein polynomials of degree 3 at u (...): (..., 4)."""
    v = 1.0 - u
    return np.stack([v * v * v, 3.0 * v * v * u, 3.0 * v * u * u, u * u * u], axis=-1)


def point(cubics: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Points (P, K, 2) of the cubics (P, 4, 2) at u (P, K)."""
    return basis(u) @ cubics


def derivatives(cubics: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivatives, each (P, K, 2), of the cubics (P, 4, 2) at u (P, K)."""
    first, v = 3.0 * np.diff(cubics, axis=1), 1.0 - u
    second = 2.0 * np.diff(first, axis=1)
    return (
        np.stack([v * v, 2.0 * v * u, u * u], axis=-1) @ first,
        np.stack([v, u], axis=-1) @ second,
    )


def nearer(cubics: np.ndarray, points: np.ndarray, u: np.ndarray) -> np.ndarray:
    """One Newton step of the parameters u (P, K) towards the feet of the points (P, K, 2), not clipped."""
    rest = point(cubics, u) - points
    first, second = derivatives(cubics, u)
    along = (rest * first).sum(-1)
    speed = (first * first).sum(-1)
    bend = speed + (rest * second).sum(-1)
    # Where the distance is not convex, the Gauss-Newton step still leads downhill.
    return u - along / np.maximum(np.where(bend > 0.3 * speed, bend, speed), 1e-12)


def fit_cubics(ends: np.ndarray, tangents: np.ndarray, points: np.ndarray, weights: np.ndarray) -> CubicFits:
    """The best cubics with given ends and tangents.

    ends: (P, 2, 2) px, start and end. tangents: (P, 2, 2), unit, both along the run. points: (P, K, 2) px in order
    along the run. weights: (P, K), 0 leaves a point out.
    """
    knots = np.concatenate([ends[:, :1], points, ends[:, 1:]], axis=1)
    along = np.cumsum(np.hypot(*np.moveaxis(np.diff(knots, axis=1), -1, 0)), axis=1)
    length = np.maximum(along[:, -1], 1e-9)
    u = along[:, :-1] / length[:, None]
    handles = np.repeat(length[:, None] / 3.0, 2, axis=1)
    cubics = _assemble(ends, tangents, handles)
    u = np.clip(nearer(cubics, points, u), 0.0, 1.0)
    for _ in range(ROUNDS):
        handles = _handles(ends, tangents, points, weights, u, cubics, handles, length)
        cubics = _assemble(ends, tangents, handles)
        u = np.clip(nearer(cubics, points, u), 0.0, 1.0)
    rest = point(cubics, u) - points
    return CubicFits(cubics, (rest * rest).sum(-1))


def _assemble(ends: np.ndarray, tangents: np.ndarray, handles: np.ndarray) -> np.ndarray:
    signed = handles[..., None] * tangents * np.array([1.0, -1.0])[:, None]
    return np.stack([ends[:, 0], ends[:, 0] + signed[:, 0], ends[:, 1] + signed[:, 1], ends[:, 1]], axis=1)


def _handles(ends, tangents, points, weights, u, cubics, handles, length) -> np.ndarray:
    first, _ = derivatives(cubics, u)
    normal = np.stack([-first[..., 1], first[..., 0]], axis=-1)
    normal /= np.maximum(np.hypot(normal[..., 0], normal[..., 1]), 1e-12)[..., None]
    b = basis(u)
    columns = np.stack(
        [
            (normal * tangents[:, None, 0]).sum(-1) * b[..., 1],
            -(normal * tangents[:, None, 1]).sum(-1) * b[..., 2],
        ],
        axis=-1,
    )
    rest = ((points - point(cubics, u)) * normal).sum(-1)
    weighted = columns * weights[..., None]
    gram = np.einsum("pki,pkj->pij", weighted, columns)
    # Straight runs leave the handles free: pull them gently towards thirds.
    ridge = 1e-4 * weights.sum(axis=1) * 1e-2 + 1e-12
    gram += ridge[:, None, None] * np.eye(2)
    pull = ridge[:, None] * (length[:, None] / 3.0 - handles)
    step = np.linalg.solve(gram, (np.einsum("pki,pk->pi", weighted, rest) + pull)[..., None])[..., 0]
    step = np.clip(step, -0.5 * length[:, None], 0.5 * length[:, None])
    return np.clip(handles + step, SHORTEST_HANDLE * length[:, None], LONGEST_HANDLE * length[:, None])
