"""Cubic Bezier curves at parameters: points and derivatives, of one cubic or of many at once.

Formulas: Bernstein's polynomials of degree 3, and de Casteljau's differences for the derivatives.
"""

from __future__ import annotations

import numpy as np


def bernstein(u: np.ndarray) -> np.ndarray:
    """The Bernstein polynomials of degree 3 at u (...): (..., 4), the weights of a cubic's control points."""
    v = 1.0 - u
    return np.stack([v * v * v, 3.0 * v * v * u, 3.0 * v * u * u, u * u * u], axis=-1)


def points_at(cubics: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Points (..., K, 2) of cubics (..., 4, 2) at u (..., K)."""
    return bernstein(u) @ cubics


def derivatives(cubics: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivatives, each (P, K, 2), of the cubics (P, 4, 2) at u (P, K)."""
    first, v = 3.0 * np.diff(cubics, axis=1), 1.0 - u
    second = 2.0 * np.diff(first, axis=1)
    return (
        np.stack([v * v, 2.0 * v * u, u * u], axis=-1) @ first,
        np.stack([v, u], axis=-1) @ second,
    )
