"""Fills that are none: what lines of another fill make, again and again, of the pixels that they fill in part.

Drawing programs take few samples a pixel, so that lines of less than two px leave many pixels, and squares of them, the
same blend of their fill with the ground.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest
from cubicsplat_cli.artwork.regions.hairlines import STRANGE
from cubicsplat_cli.raster import ndimage

BLEND_LEVELS, SHARES = 1.5, (0.1, 0.95)  # levels that a blend is off, and shares of the line's fill in it
FLAT = 2  # pixels amid a square of 3 x 3 px of one colour, beyond which a fill is one
# Px within which the ground and more of the line show beside such a blend, the share of its pixels for which they do,
# and of the ground alone; share of the line that is more.
NEAR, BESIDE_BOTH, BESIDE_GROUND, MORE = 2, 0.25, 0.7, 0.15


def line_blends(levels: np.ndarray, palette: np.ndarray, pure: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """(P,) bool: the fills of a palette (P, 4) in levels that only show where more of another fill's lines and what
    these lie on show as well, are a blend of the two, and have fewer pixels than there are thin ones of the line's.

    levels: (H, W, 4) the picture; pure: (H, W) int, the fill of every pixel that is one, -1 of others; flat: (H, W)
    bool, those amid a square of one colour.
    """
    fills = np.arange(len(palette))
    doubtful = np.bincount(pure[flat & (pure >= 0)], minlength=len(palette)) <= FLAT
    counts = np.bincount(pure[pure >= 0], minlength=len(palette))
    thin = ~ndimage.binary_dilation(flat, ndimage.SQUARE) & (pure >= 0)
    lines = np.bincount(pure[thin], minlength=len(palette))
    out = np.zeros(len(palette), dtype=bool)
    beside = [ndimage.maximum_filter(pure == k, 2 * NEAR + 1) for k in fills] if doubtful.any() else []
    for k in fills[doubtful & (counts > 0)]:
        own = pure == k
        for line, ground in permutations(fills[fills != k], 2):
            if out[k] or lines[line] <= counts[k]:
                continue
            share, rest = blend_of(palette[k], palette[ground], palette[line])
            if not SHARES[0] <= share <= SHARES[1] or np.abs(rest).max() > BLEND_LEVELS:
                continue
            by_ground = beside[ground][own]
            if by_ground.mean() < BESIDE_GROUND:
                continue
            shares, rest = blend_of(levels, palette[ground], palette[line], within=False)
            more = ndimage.maximum_filter((shares > share + MORE) & (largest(np.abs(rest)) <= STRANGE), 2 * NEAR + 1)
            out[k] = (by_ground & more[own]).mean() >= BESIDE_BOTH
    return out
