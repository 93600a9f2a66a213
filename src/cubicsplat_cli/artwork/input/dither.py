"""Undo what a palette does to GIFs and PNGs: dots of two or more colours that stand for a colour between them, and
gradients in bands.

Error diffusion (Floyd and Steinberg 1976) keeps the mean of every place, so a small blur shows the colours that were
meant, though no sharp edges. Guided by it, means of the pixels on one side of an edge are sharp. Ordered dither repeats
itself, and counts as pixel art, whose pixels are meant.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cubicsplat_cli.artwork.channels import are_few, largest, packed
from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA
from cubicsplat_cli.artwork.regions.fills import CONTACT, FLAT_RANGE, SEEN
from cubicsplat_cli.artwork.settings import MOST_COLORS
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import dither_dots, guided_means, spread
from cubicsplat_cli.scene.arrays import with_channels

# There is no dither without more than MOST_STRAY dots that have DENSE or more around them, in other rows and columns,
# within a square of WINDOW px. Dotted lines that cross have 8 there, and text hardly any.
WINDOW, DENSE, MOST_STRAY = 15, 9, 24
PERIOD = 4  # px of the patterns of ordered dither, and around a dot that it may stand for
# Share of dots that are like the pixels a period away to all four sides: 0.1 by error diffusion, but up to 0.48 where
# all is of a middle grey, and 0.57 and more by ordered dither.
REPEATED = 0.5
AROUND = 7  # px of the square in which residuals are compared; it holds a few dots at the densities that are seen
# px: standard deviations of the guide's blur; of the means on one side of an edge, and of the blur that takes dots off.
BLUR, SIDE = 1.0, 1.5
ALIKE = 20.0  # levels by which the guide differs on one side of an edge: what the blur leaves of dither in 216 colours
LEFT = 2.0  # levels of noise that the means leave, and the rounding of gradients to palettes


def without_dither(levels: np.ndarray) -> tuple[np.ndarray, float | None]:
    """Return a picture (H, W, 3 or 4) in levels in the colours that its palette stands for, and the levels of noise
    that means leave: LEFT if most of what is not even is dither, else 0; None if there are no means. Means replace
    dither by error diffusion, and gradients their bands; it is the same array if it has neither.
    """
    found = dithered(levels)
    if found is None:
        return _with_gradients(levels) if banded(levels) else levels, None
    dots, dense, most = found
    meant = dots if most else dense & _high_in_frequency(levels)
    if not meant.any():
        return levels, None
    guide = ndimage.gaussian_filter(levels, (BLUR, BLUR, 0.0), mode="nearest")
    means = guided_means(levels, guide, ndimage.binary_dilation(meant, ndimage.SQUARE, PERIOD), SIDE, ALIKE)
    # What differs from its mean by more than dots nearby do from their neighbours, in the mean, is drawn and no dither.
    contrast = np.where(meant, largest(np.abs(levels - np.roll(levels, 1, axis=1))), 0.0)
    total, count = (ndimage.uniform_filter(each.astype(float), WINDOW, mode="constant") for each in (contrast, meant))
    means = np.where((largest(np.abs(means - levels)) * count <= total)[..., None], means, levels)
    return (means, LEFT) if most else (_with_gradients(means), 0.0)


def banded(levels: np.ndarray) -> bool:
    """Return True if a picture (H, W, C) in levels with few colours has gradients in bands, as palettes leave them.

    Where neighbours in a gradient as it is drawn differ by more than a level, below which rounding to 8 bits makes
    bands too, the next ones differ as well. Fewer than eight tones that differ by little may be meant.
    """
    colours = packed(np.rint(levels))
    if not are_few(colours, MOST_COLORS):
        return False
    parts, count = ndimage.large_parts(spread(levels, 3, 3) <= SEEN, LEAST_AREA)
    steps, alone = (np.zeros(count + 1) for _ in range(2))
    for part, own, values in ((parts, colours, levels), (parts.T, colours.T, levels.swapaxes(0, 1))):
        before, first, last, after = (own[k : max(0, len(own) - 3) + k] for k in range(4))
        where = part[1:-2]
        step = (where == part[2:-1]) & (largest(np.abs(np.diff(values[1:-1], axis=0))) > 1.0)
        two = ((before == first) | (before == last)) & ((after == first) | (after == last))
        steps += np.bincount(where[step], minlength=count + 1)
        alone += np.bincount(where[step & two], minlength=count + 1)
    kinds = np.bincount(np.unique(parts.astype(np.int64) << 32 | colours) >> 32, minlength=count + 1)
    return bool(((kinds >= 8) & (2 * alone > steps) & (alone >= CONTACT * kinds))[1:].any())


def _with_gradients(levels: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 3 or 4) in levels with gradients in place of bands; the same array if none is found."""
    from cubicsplat_cli.artwork.gradients.noisy import with_exact_gradients  # few pictures need it

    whole = with_channels(levels, 4, 255.0)
    exact = with_exact_gradients(whole, LEFT)
    return levels if exact is whole else exact[..., : levels.shape[2]]


class Dither(NamedTuple):
    """dots: (H, W) bool, all dots of a picture; dense: (H, W) bool, those that may be dither by error diffusion; most:
    whether most of what is not even is near these.
    """

    dots: np.ndarray
    dense: np.ndarray
    most: bool


def dithered(levels: np.ndarray) -> Dither | None:
    """Return the dither of a picture (H, W, C) in levels with few colours; None if it has hardly any."""
    dots = dither_dots(levels, FLAT_RANGE)
    if dots.sum() <= MOST_STRAY:
        return None
    dense = dots & (_around(dots) >= DENSE - 0.5)
    if dense.sum() <= MOST_STRAY:
        return None
    colours = packed(np.rint(levels))
    if not are_few(colours, MOST_COLORS) or _repeated(colours, dense) >= REPEATED:
        return None
    uneven = spread(levels, 3, 3) > 0.0
    near = ndimage.binary_dilation(dense, ndimage.SQUARE, PERIOD) & uneven
    return Dither(dots, dense, bool(2 * near.sum() > uneven.sum()))


def _around(dots: np.ndarray) -> np.ndarray:
    """Return (H, W) the number of dots (H, W) bool in the square around each pixel, without those of its row, or of its
    column if these are more: where dotted lines cross, most are of one line."""
    square, row, column = (
        ndimage.uniform_filter(dots.astype(np.float32), sides, mode="constant") * float(np.prod(sides))
        for sides in ((WINDOW, WINDOW), (1, WINDOW), (WINDOW, 1))
    )
    return square - np.maximum(row, column)


def _high_in_frequency(levels: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: True where what a blur takes from a picture (H, W, C) alternates from pixel to pixel.

    Error diffusion leaves high frequencies only (Ulichney 1988), so neighbours' residuals are of opposite signs; those
    of strokes and edges are alike along these.
    """
    residual = levels - ndimage.gaussian_filter(levels, (SIDE, SIDE, 0.0), mode="nearest")
    products = np.zeros(levels.shape[:2], dtype=np.float32)
    products[:, 1:] += (residual[:, 1:] * residual[:, :-1]).sum(axis=-1)
    products[1:] += (residual[1:] * residual[:-1]).sum(axis=-1)
    return ndimage.uniform_filter(products, AROUND, mode="constant") < 0.0


def _repeated(colours: np.ndarray, dots: np.ndarray) -> float:
    """Return the share of dots (H, W) bool of the colours (H, W) of the pixels a PERIOD away to all four sides."""
    inner = (slice(PERIOD, -PERIOD),) * 2
    moved = (np.roll(colours, by, axis) for axis in (0, 1) for by in (PERIOD, -PERIOD))
    like = np.all([each[inner] == colours[inner] for each in moved], axis=0)
    return float(like[dots[inner]].mean()) if dots[inner].any() else 1.0
