"""Seals of the finish: no ground shows where the picture is opaque.

At a pixel in which outlines cross viewers multiply what each shape leaves of what is beneath: two edges that meet there
let the ground through if the hidden edge of a third shape is in it too, although the three leave nothing out. What
shows is little against the misfit of the visible edges, and nobody wants to see it, so it counts for more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from cubicsplat_cli.raster.stack import Crossings, Goal, normal_equations

# Weight of the squared share of the ground that shows: 1/255 of it counts as much as what a pixel is off by chance.
WEIGHT = 100.0
LEAST = 1e-6  # share of the ground that counts as showing
OPAQUE = 254.5 / 255.0


def leaks(image: np.ndarray, goal: Goal) -> np.ndarray:
    """(k,) the pixels, row times width plus column, in which an image (H, W, 4) shows the ground and the goal does not,
    nor next to them, where the edge of the whole drawing may be; none of a blurred goal, which spreads them.
    """
    target = goal.target
    if goal.reach:
        return np.zeros(0, dtype=np.intp)
    y, x = np.nonzero((image[..., 3] < 1.0 - LEAST) & (target[..., 3] >= OPAQUE))
    height, width = image.shape[:2]
    inside = np.ones(len(y), dtype=bool)
    for down in (-1, 0, 1):
        for across in (-1, 0, 1):
            row, column = np.clip(y + down, 0, height - 1), np.clip(x + across, 0, width - 1)
            inside &= target[row, column, 3] >= OPAQUE
    return np.asarray(y[inside] * width + x[inside])


def leak_misfit(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(H W,) the misfit of leaking pixels beyond that of their colours."""
    out = np.zeros(image.shape[0] * image.shape[1])
    out[pixels] = WEIGHT * (1.0 - image[..., 3].ravel()[pixels]) ** 2
    return out


def sealed_equations(
    goal: Goal, image: np.ndarray, crossings: Crossings, count: int, pixels: np.ndarray
) -> tuple[sparse.csr_matrix, np.ndarray]:
    """The Gram matrix and the gradient over the control points of `count` pieces, of colours and of leaking pixels."""
    gram, gradient = normal_equations(goal, image, crossings, count)
    gram, found = gram.tocsr(), np.isin(crossings.pixel, pixels)
    if not found.any():
        return gram, gradient
    parts = (crossings.piece, crossings.pixel, crossings.t, crossings.change, crossings.slope)
    few = Crossings(*(np.ascontiguousarray(part[found]) for part in parts))
    opaque = replace(goal, channels=(0.0, 0.0, 0.0, WEIGHT**0.5), bound=np.inf)
    more, slope = normal_equations(opaque, image, few, count)
    return gram + more.tocsr(), gradient + slope
