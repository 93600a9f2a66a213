"""Undo the sharpening of a picture, which leaves halos along its edges.

Programs reduce pictures by Lanczos' filter or a cubic one, whose negative lobes overshoot at edges, or sharpen them
afterwards. A halo is lighter than the lighter side of an edge, or darker than the darker one, by a share of their
contrast. Pixels on the edge itself hardly differ from those without sharpening.
"""

from __future__ import annotations

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


def without_halos(levels: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 4) premultiplied RGBA in 0..255 without halos; the same array if it has none.

    Halos are clipped to the range of the even pixels around. Within that range, pixels that are nearly like the flat
    pixels on their side of an edge become like these. Halos beside steep gradients are within the range of these, so a
    picture with mostly steep ones stays. So does one that was compressed with loss, whose ringing looks like halos.
    """
    if not _sharpened(levels) or rippled(levels):
        return levels
    window = (2 * REACH + 1, 2 * REACH + 1, 1)
    even = (ndimage.maximum_filter(second_differences(levels), 3) <= EVEN)[..., None]
    flat = (spread(levels, 3, 3) <= FLAT)[..., None]
    if flat[even].sum() <= 0.5 * even.sum():
        return levels
    low = ndimage.minimum_filter(np.where(even, levels, np.float32(np.inf)), window)
    high = ndimage.maximum_filter(np.where(even, levels, np.float32(-np.inf)), window)
    clipped = np.minimum(np.maximum(levels, low), high)
    clipped = np.where(np.abs(clipped - levels) <= MOST * (high - low), clipped, levels)
    known, side = flat, np.where(flat, clipped, np.float32(0.0))
    for _ in range(REACH):
        weight = ndimage.uniform_filter(known.astype(np.float32), (3, 3, 1), mode="nearest")
        mean = ndimage.uniform_filter(side, (3, 3, 1), mode="nearest") / np.maximum(weight, LEAST)
        side, known = np.where(known | (weight < LEAST), side, mean), known | (weight >= LEAST)
    contrast = ndimage.maximum_filter(levels, window) - ndimage.minimum_filter(levels, window)
    ripple = known & (np.abs(clipped - side) <= RIPPLE * contrast)
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
