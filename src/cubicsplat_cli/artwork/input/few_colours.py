"""Tell pictures whose colours were rounded to a few without dither, as in GIFs and PNGs with a short palette.

A pixel on an edge should lie on the line between the colours that it blends. Rounded, it has the one of the few that is
nearest to the blend, and its distance from the line shows the error of all blends.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, packed, unpacked
from cubicsplat_cli.artwork.input.condition import OUTLIER, ROUGH
from cubicsplat_cli.artwork.input.restore import MISFIT
from cubicsplat_cli.artwork.regions.sampling import CONTRAST
from cubicsplat_cli.artwork.settings import MOST_COLORS

# Fewer different blends do not tell. Of the blends in pictures of 16 or 32 colours, 0.3 to 0.85 are rounded off their
# lines, unless the palette holds them all, and in those of 64 up to 0.7; in plain drawings at most 0.18.
FEWEST, ROUNDED = 20, 0.25
NEARLY = 1.0  # levels by which another colour may be nearer to a blend: palettes are not searched exactly


def rounding_noise(levels: np.ndarray) -> float:
    """Return the noise, in levels, that the rounding of a picture (H, W, 4) to a few colours makes of blends; 0 if it
    was not rounded, or by little. A uniform error of standard deviation s ends at sqrt(3) s. `restore` expects that
    noise, and the misfit of its model, end at OUTLIER times theirs.
    """
    numbers = packed(np.rint(levels))
    kinds, counts = np.unique(np.concatenate([_blends(numbers), _blends(numbers.T)]), axis=0, return_counts=True)
    first, value, last = (unpacked(column) for column in kinds.T)
    share, off = blend_of(value, first, last)
    error = np.linalg.norm(off, axis=-1)
    wide = np.linalg.norm(last - first, axis=-1) > CONTRAST
    if wide.sum() < FEWEST or (error[wide] > ROUGH).mean() < ROUNDED:
        return 0.0
    colours = np.unique(numbers)
    if len(colours) > MOST_COLORS:
        return 0.0
    from scipy.spatial import cKDTree  # takes a while to import, and few pictures come to it

    least, _ = cKDTree(unpacked(colours)).query(first + share[:, None] * (last - first))
    nearest = wide & (error <= least + NEARLY)
    if (nearest & (error > ROUGH)).sum() < ROUNDED * wide.sum():
        return 0.0
    # The error of a channel, of which two are off the line.
    deviation = float(np.sqrt(0.5 * np.average(error[nearest] ** 2, weights=counts[nearest])))
    return max(0.0, 3.0**0.5 * deviation / OUTLIER - MISFIT)


def _blends(numbers: np.ndarray) -> np.ndarray:
    """Return (n, 3): the colours of single pixels, between those of two runs of 2 px or more to the left and right of
    them, of a picture (H, W) in numbers for colours.
    """
    count = max(0, numbers.shape[1] - 4)
    before, left, middle, right, after = (numbers[:, k : k + count] for k in range(5))
    single = (before == left) & (left != middle) & (middle != right) & (right == after) & (left != right)
    return np.stack([left[single], middle[single], right[single]], axis=1)
