"""Whole loops that are circles, ellipses or rectangles, fitted to their points by least squares.

Each kind, level and turned, with sharp and with round corners, is fitted by distances with Huber's tails. Points near a
sharp corner are biased and count less. A loop is no primitive where every fit is far off, where its area does not suit
its second moments, or where it does not run around what was fitted.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle
from cubicsplat_cli.raster.outlines import CIRCLE, ELLIPSE, nearest_primitive

WHOLE = 0.1  # px that the points around a dot may be off the edges of whole pixels


def fit_primitive(points: np.ndarray, weights: np.ndarray, price: float) -> tuple[Outline, float, float] | None:
    """The cheapest primitive through a closed loop, its description length, and its misfit; None when none comes near.

    points: (n, 2) px. weights: (n,) 1/px^2, 0 where unknown. price: of a parameter, in nats. The misfit is the mean
    squared residual in sigmas.
    """
    found = nearest_primitive(points, weights, price)
    if found is None:
        return None
    kind, values, cost, misfit = found
    return primitive_of(kind, values), cost, misfit


def primitive_of(form: int, values: np.ndarray) -> Outline:
    """The primitive of a form, CIRCLE, ELLIPSE or BOX, and its values (6,): see `nearest_primitive`."""
    x, y, a, b, radius, angle = values.tolist()
    if form == CIRCLE:
        return Circle(x, y, a)
    if form == ELLIPSE:
        return Ellipse(x, y, a, b, angle)
    return Rectangle(x - a, y - b, 2.0 * a, 2.0 * b, radius, angle)


def dot_of(points: np.ndarray, shown: np.ndarray, corner: tuple[int, int]) -> Outline:
    """The outline of very few px, shown (h, w) bool in a window with such a corner x, y: a box of whole pixels if its
    points (n, 2) keep to their edges, else a circle.
    """
    y, x = np.nonzero(shown)
    low = np.array([x.min(), y.min()], dtype=float) + corner
    high = np.array([x.max() + 1, y.max() + 1], dtype=float) + corner
    off = np.minimum(np.abs(points - low), np.abs(points - high)).min(axis=1)
    if len(x) == np.prod(high - low) and off.max() < WHOLE:
        return Rectangle(*low.tolist(), *(high - low).tolist())
    middle = points.mean(axis=0)
    return Circle(float(middle[0]), float(middle[1]), math.sqrt(len(x) / math.pi))
