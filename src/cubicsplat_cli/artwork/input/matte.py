"""Take the remains of a removed background off the edges of a cut-out picture.

Programs that make a ground clear by its colour leave blends with it along the edges, hard and pale. Such a blend of a
shape's colour and the ground's shows the share of the pixel that the shape covers, which is the opacity that it had.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import FULL, largest
from cubicsplat_cli.artwork.regions.fills import BLEND, in_even_squares, near_colours
from cubicsplat_cli.artwork.regions.sampling import CONTRAST, FEWEST
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import blends
from cubicsplat_cli.raster.unmix import SLOTS

RIM = 2  # px from clear ones within which pixels may be blends with the ground
# Least shares of the uneven pixels of the rim that are, where a ground was removed: of those that could be, and of all.
MOST, SEVERAL = 0.75, 0.25
SHADES = 8  # different ones of edges that were smoothed; an outline of 1 px has one for each fill


def without_matte(levels: np.ndarray) -> tuple[np.ndarray, str]:
    """Return a picture (H, W, 4), premultiplied levels, without a removed ground at its edges, and the ground's colour;
    the same array and "" if it shows none.

    A white ground may be left at hard edges. Either may be left at soft ones, whose opacity then says the same.
    """
    clear = levels[..., 3] == 0.0
    rim = ndimage.maximum_filter(clear, 2 * RIM + 1) & ~clear
    if not rim.any() or min(levels.shape[:2]) < 2:
        return levels, ""
    even = in_even_squares(levels)
    rim &= ~even
    if rim.sum() < FEWEST:
        return levels, ""
    near, ends = near_colours(levels, even & (levels[..., 3] == FULL), rim)
    seen = levels[rim]
    straight, soft = seen * (FULL / seen[:, 3:]), seen[:, 3] < FULL
    # The ground comes after the last of the paints nearby.
    slot = np.arange(SLOTS + 1) == (near >= 0).sum(axis=1, keepdims=True)
    paints = np.where(slot, near.max(initial=0) + 1, np.pad(near, ((0, 0), (0, 1)), constant_values=-1))
    others = np.where(slot[..., None], 0.0, np.pad(ends, ((0, 0), (0, 1), (0, 0))))
    for name, level in (("white", FULL), ("black", 0.0)):
        tells = largest(np.abs(ends[..., :3] - level)).max(axis=1, where=near >= 0, initial=0.0) > CONTRAST
        colours = np.where(slot[..., None], [level, level, level, FULL], others)
        whole, off = blends(straight, paints, colours, others, three=True)
        same = np.where(soft, np.abs(whole[:, 3] - seen[:, 3]) <= BLEND, level == FULL)
        blend = same & (off <= BLEND)
        # A pixel of nothing but the ground would have been removed: it is an outline in the ground's colour.
        mixed = blend & (whole[:, 3] > BLEND) & (whole[:, 3] < FULL - BLEND)
        # Paints without contrast to the ground tell nothing of it, nor do blends of two paints.
        could = tells & ~(blend & (whole[:, 3] >= FULL - BLEND))
        told = mixed & tells
        shades = len(np.unique(np.rint(whole[told, 3])))
        if told.sum() >= max(FEWEST, MOST * could.sum(), SEVERAL * len(seen)) and shades >= SHADES:
            out = levels.copy()
            out[rim] = np.where(mixed[:, None], np.rint(whole), seen)
            return out, name
    return levels, ""
