"""The fills of a picture in several steps a pixel, for lines, counters and letters that are hardly a pixel wide."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.regions.regions import FlatPicture, PixelFills
from cubicsplat_cli.raster.phase_field import blend_pairs, finer_labels
from cubicsplat_cli.raster.unmix import REACH, components, near_fills

# Steps a pixel each way, as many as hardly any program takes more samples; fewer where there would be more than MOST in
# all, for their memory.
STEPS, MOST = 4, 10_000_000
# Times the error of pixels that a fill which is not near must explain one better than those that are.
FARTHER = 4.0


def steps_of(height: int, width: int) -> int:
    """Steps a pixel each way of a picture; 1 where it has too many pixels for more."""
    return max(1, min(STEPS, math.isqrt(MOST // (height * width))))


def in_steps(levels: np.ndarray, fills: PixelFills, steps: int, error: float, most: int) -> FlatPicture | None:
    """A picture (H, W, 4) in levels as one of so many steps a pixel each way, each of them a fill, or on an edge; None
    where it falls to more than `most` regions.

    error: in levels, of its pixels.
    """
    first = np.maximum(fills.pure, 0)
    second, share = first.copy(), np.zeros(first.shape, np.float32)
    y, x = np.nonzero(fills.pure < 0)
    near = near_fills(fills.pure, y, x, REACH)
    # Where nothing is pure, all that is known is what the pixel has most of.
    near[:, 0] = np.where(near[:, 0] < 0, fills.fills[y, x], near[:, 0])
    parts, _ = components((fills.pure < 0).astype(np.int32) - 1)
    pairs = blend_pairs(levels[y, x], parts[y, x], fills.palette, near, FARTHER * error)
    first[y, x], second[y, x], share[y, x] = pairs
    labels, finer = finer_labels(first, second, share, fills.palette, steps)
    return FlatPicture(finer, fills.palette, labels) if components(labels)[1] <= most else None
