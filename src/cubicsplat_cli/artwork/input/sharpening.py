"""Undo the sharpening of a picture, which leaves halos along its edges.

Programs reduce pictures by Lanczos' filter or a cubic one, whose negative lobes overshoot at edges, or sharpen them by
an unsharp mask. A halo is lighter than the lighter side of an edge, or darker than the darker one, by a share of their
contrast. Lanczos' filter hardly changes pixels on the edge itself, so its halos are taken off and these stay. An
unsharp mask does, so it is undone.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.artwork.input.condition import CONTRAST, rippled
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import second_differences, spread

REACH = 5  # px from an edge, where Lanczos' filter of three lobes rings no more
EVEN = 3.0  # levels between two pixels of a side, and of the second differences of a fill or gradient: rounding makes 2
FLAT = 2.0  # levels within 3 x 3 px of a fill of one colour, at most: rounding, and the third lobe
LEAST = 0.1  # of 3 x 3 pixels, less than one: none is known
HALO = 0.02  # of the contrast: rounding and gradients make less at CONTRAST levels
MOST = 0.15  # of the contrast: what differs more from both sides of an edge is a shape between them
RIPPLE = 0.05  # of the contrast: the second lobes of Lanczos' filter, within the range of both sides, make 0.02 each
FEWEST = 32  # sides of edges that tell a filter
WINDOW = 128  # px of the part of a picture in which an unsharp mask is estimated
STARTS = tuple(itertools.product((0.4, 1.2), (1.0, 2.0, 3.2)))  # amounts and px of radius that are tried first
# Amounts, and px of radius. A narrower mask is like the filters that reduce pictures; a stronger or wider one flattens
# any picture.
WEAKEST, STRONGEST, NARROWEST, WIDEST = 0.2, 3.0, 0.8, 3.5
LEAST_FLATTENED = 0.06  # of the pixels that are not flat; reduction by Lanczos' filter leaves 0.05


class UnsharpMask(NamedTuple):
    """An unsharp mask: it adds to a picture `amount` times what a Gaussian blur of `radius` px takes away from it."""

    amount: float
    radius: float

    def of(self, levels: np.ndarray) -> np.ndarray:
        """Return a picture (H, W, 4) in 0..255 sharpened."""
        soft = ndimage.gaussian_filter(levels, (self.radius, self.radius, 0.0), mode="nearest", truncate=3.0)
        return np.clip(levels + self.amount * (levels - soft), 0.0, 255.0)

    def undone(self, levels: np.ndarray, passes: int = 3) -> np.ndarray:
        """Return the picture (H, W, 4) in 0..255 that the mask turns into the given one, by Richardson's iteration.

        Where halos were cut off at an end of the scale, many pictures are possible. The iteration starts from one
        without halos, which it finds better with each pass.
        """
        size = 2 * math.ceil(2.0 * self.radius) + 1
        highest = 0.5 * self.amount * _range(levels, size)  # of a halo along a straight edge
        # The mask has eigenvalues from 1 to 1 + amount, so each step leaves amount / (2 + amount) of the error.
        steps = math.ceil(6.0 / math.log(1.0 + 2.0 / self.amount))
        found = levels
        for _ in range(passes):
            low, high = _even_range(found, size + 4)
            clipped = np.clip(levels, low, high)
            found = np.where(np.abs(clipped - levels) <= highest, clipped, levels)
            for _ in range(steps):
                found = np.clip(found + (levels - self.of(found)) * (2.0 / (2.0 + self.amount)), 0.0, 255.0)
        return found


def unsharp_mask(levels: np.ndarray) -> UnsharpMask | None:
    """Return the unsharp mask by which an opaque picture (H, W, 4) in 0..255 was sharpened; None for none.

    It is the one without which most pixels are flat. A weaker one leaves halos, and a stronger one blurs edges.
    """
    if levels[..., 3].min() < 255.0:
        return None
    window = _busiest(levels)

    def rough(logarithms: np.ndarray) -> float:
        return _rough(UnsharpMask(*np.exp(logarithms).tolist()).undone(window, passes=1))

    starts, most = np.log(STARTS), _rough(window)
    start = min(starts, key=rough)
    if rough(start) >= most:
        return None
    from scipy.optimize import minimize

    bounds = np.log([(0.5 * WEAKEST, 1.5 * STRONGEST), (0.7 * NARROWEST, 1.5 * WIDEST)])
    around = np.add(start, [[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]])
    options = {"initial_simplex": around, "xatol": 0.03, "fatol": 1e-3 * most}
    found = minimize(rough, start, method="Nelder-Mead", bounds=bounds, options=options)
    mask = UnsharpMask(*np.exp(found.x).tolist())
    likely = WEAKEST <= mask.amount <= STRONGEST and NARROWEST <= mask.radius <= WIDEST
    return mask if likely and found.fun <= (1.0 - LEAST_FLATTENED) * most else None


def _busiest(levels: np.ndarray) -> np.ndarray:
    """Return the part of a picture, at most WINDOW px wide and high, with the most edges."""
    busy = ndimage.uniform_filter((second_differences(levels) > EVEN).astype(np.float32), WINDOW)
    y, x = (max(0, int(at) - WINDOW // 2) for at in np.unravel_index(busy.argmax(), busy.shape))
    return np.ascontiguousarray(levels[y : y + WINDOW, x : x + WINDOW])


def _rough(levels: np.ndarray) -> float:
    """Return the number of pixels that are not flat, where a difference of EVEN levels counts half."""
    squares = np.square(spread(levels, 3, 3), dtype=np.float64)
    return float((squares / (squares + EVEN**2)).sum())


def _even(levels: np.ndarray) -> np.ndarray:
    """Return (H, W) bool, true for the pixels of fills and gradients, away from edges and halos."""
    return np.asarray(ndimage.maximum_filter(second_differences(levels), 3) <= EVEN)


def _even_range(levels: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest value of the even pixels in windows of an odd size around each pixel, inf and
    -inf where there are none.
    """
    even, window = _even(levels)[..., None], (size, size, 1)
    low = ndimage.minimum_filter(np.where(even, levels, np.float32(np.inf)), window)
    high = ndimage.maximum_filter(np.where(even, levels, np.float32(-np.inf)), window)
    return low, high


def _range(levels: np.ndarray, size: int) -> np.ndarray:
    """Return the differences of the largest and the least values in windows of an odd size around each pixel."""
    window = (size, size, 1)
    return ndimage.maximum_filter(levels, window) - ndimage.minimum_filter(levels, window)


def without_halos(levels: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 4) premultiplied RGBA in 0..255 without halos; the same array if it has none.

    Halos are clipped to the range of the even pixels around. Within that range, pixels that are nearly like the flat
    pixels on their side of an edge become like these. Halos beside steep gradients are within the range of these, so a
    picture with mostly steep ones stays. So does one that was compressed with loss, whose ringing looks like halos.
    """
    if not _sharpened(levels) or rippled(levels):
        return levels
    even, flat = _even(levels), spread(levels, 3, 3) <= FLAT
    if flat[even].sum() <= 0.5 * even.sum():
        return levels
    flat = flat[..., None]
    low, high = _even_range(levels, 2 * REACH + 1)
    clipped = np.clip(levels, low, high)
    clipped = np.where(np.abs(clipped - levels) <= MOST * (high - low), clipped, levels)
    known, side = flat, np.where(flat, clipped, np.float32(0.0))
    for _ in range(REACH):
        weight = ndimage.uniform_filter(known.astype(np.float32), (3, 3, 1), mode="nearest")
        mean = ndimage.uniform_filter(side, (3, 3, 1), mode="nearest") / np.maximum(weight, LEAST)
        side, known = np.where(known | (weight < LEAST), side, mean), known | (weight >= LEAST)
    ripple = known & (np.abs(clipped - side) <= RIPPLE * _range(levels, 2 * REACH + 1))
    found = np.where(ripple, side, clipped).astype(np.float32)
    found[..., :3] = np.minimum(found[..., :3], found[..., 3:])  # premultiplied
    return found


def _sharpened(levels: np.ndarray) -> bool:
    """Return True if at least half of a picture's edges have halos, on their light sides and on their dark ones."""
    lines = [line for channel in np.moveaxis(levels, 2, 0) for line in (channel, channel.T)]
    sides = [np.concatenate(found) for found in zip(*map(_halos, lines), strict=True)]
    told = [halos for halos in sides if len(halos) >= FEWEST]
    return bool(told) and all((halos > HALO).mean() >= 0.5 for halos in told)


def _halos(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sizes of the halos on the light (n,) and dark (m,) sides of edges along the rows of a channel (H, W),
    over the contrast. Sides too near to an end of the scale, where a halo was cut off, do not count.
    """
    if values.shape[1] <= 2 * REACH:
        return np.empty(0), np.empty(0)
    steep = np.abs(values[:, REACH + 1 : 1 - REACH] - values[:, REACH - 1 : -REACH - 1]) >= 0.5 * CONTRAST
    y, x = np.nonzero(steep)
    lines = values[y[:, None], x[:, None] + np.arange(2 * REACH + 1)].astype(np.float64)
    falling = lines[:, 0] > lines[:, -1]
    lines[falling] = lines[falling, ::-1]
    even = np.abs(np.diff(lines, axis=1)[:, [0, -1]]).max(axis=1) <= EVEN
    dark, light = lines[:, :2].mean(axis=1), lines[:, -2:].mean(axis=1)
    contrast, half = light - dark, 0.5 * (light + dark)
    # The pixel in the middle holds the point half of the way.
    edge = even & (contrast >= CONTRAST) & (lines[:, REACH - 1] < half) & (lines[:, REACH] >= half)
    room = light + MOST * contrast <= 255.0, dark - MOST * contrast >= 0.0
    sides = (edge & room[0], -lines[:, ::-1]), (edge & room[1], lines)
    near, found = np.arange(2, REACH), []
    for told, side in sides:
        own = side[told]
        # A side is a straight line through its far pixels: a soft shadow is darkest at the edge, too.
        line = own[:, :1] + (own[:, 2:3] - own[:, :1]) / 2.0 * near
        found.append((line - own[:, near]).max(axis=1) / contrast[told])
    return found[0], found[1]
