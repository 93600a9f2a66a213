"""How far the outlines of a drawing lie from those of the truth."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.evaluate.colour import BLACK, WHITE, over

_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
_LEAST_CONTRAST = 8.0  # levels; less is no edge
_NEAR = 5  # px, the square whose range of levels is an edge's contrast


def edge_displacement(truth: np.ndarray, candidate: np.ndarray, scale: float) -> float | None:
    """Mean distance in px at 1x between both pictures' edges, worse of white and black ground; None without an edge.

    truth, candidate: straight RGBA at `scale` times the size. Along an edge of contrast c that lies d px away the
    difference of the pictures sums up to c d, and the truth's gradient to c, for each px of its length: the quotient of
    both sums, each divided by the contrast around its px, is the mean distance.
    """
    found = [_displacement(over(truth, ground) @ _LUMA, over(candidate, ground) @ _LUMA) for ground in (WHITE, BLACK)]
    return max((distance / scale for distance in found if distance is not None), default=None)


def _displacement(truth: np.ndarray, candidate: np.ndarray) -> float | None:
    from scipy.ndimage import maximum_filter, minimum_filter

    contrast = maximum_filter(truth, _NEAR) - minimum_filter(truth, _NEAR)
    edge = contrast > _LEAST_CONTRAST
    if min(truth.shape) < 2 or not edge.any():
        return None
    down, across = np.gradient(truth)
    length = (np.hypot(down, across)[edge] / contrast[edge]).sum(dtype=np.float64)
    moved = (np.abs(truth - candidate)[edge] / contrast[edge]).sum(dtype=np.float64)
    return float(moved / length)
