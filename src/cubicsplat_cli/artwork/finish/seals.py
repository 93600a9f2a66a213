"""Seals of the finish: no ground shows where the picture is opaque.

At a pixel in which outlines cross viewers multiply what each shape leaves of what is beneath: two edges that meet there
let the ground through if the hidden edge of a third shape is in it too, although the three leave nothing out. What
shows is little against the misfit of the visible edges, and nobody wants to see it, so it counts for more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from cubicsplat_cli.raster.stack import CoverageJacobian, Goal, normal_equations

# Weight of the squared share of the ground that shows: 1/255 of it counts as much as what a pixel is off by chance.
WEIGHT = 100.0
LEAST = 1e-6  # share of the ground that counts as showing


def leaks(image: np.ndarray, goal: Goal) -> np.ndarray:
    """(k,) the pixels, row times width plus column, in which an image (H, W, 4) shows the ground and the goal does not,
    nor next to them; none of a blurred goal, which spreads them.
    """
    if goal.reach:
        return np.zeros(0, dtype=np.intp)
    return np.flatnonzero((image[..., 3] < 1.0 - LEAST) & goal.inside)


def leak_misfit(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(k,) the misfit of leaking pixels beyond that of their colours."""
    return WEIGHT * (1.0 - image.reshape(-1, 4)[pixels, 3]) ** 2


def sealed_equations(
    goal: Goal, image: np.ndarray, crossings: CoverageJacobian, count: int, pixels: np.ndarray
) -> tuple[sparse.csr_matrix, np.ndarray]:
    """The Gram matrix and the gradient over the control points of `count` pieces, of colours and of leaking pixels."""
    gram, gradient = normal_equations(goal, image, crossings, count)
    gram, found = gram.tocsr(), np.isin(crossings.pixel, pixels)
    if not found.any():
        return gram, gradient
    parts = (crossings.piece, crossings.pixel, crossings.t, crossings.change, crossings.slope)
    few = CoverageJacobian(*(np.ascontiguousarray(part[found]) for part in parts))
    opaque = replace(goal, channels=(0.0, 0.0, 0.0, WEIGHT**0.5), bound=np.inf)
    more, slope = normal_equations(opaque, image, few, count)
    return gram + more.tocsr(), gradient + slope
