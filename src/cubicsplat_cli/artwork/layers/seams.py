"""The seams of the input itself: where two shapes abut within a pixel, the ground beneath them shines through.

The front shape covers a share a of the pixel, the one behind a share 1 - a of the rest. The pixel is therefore
a F + (1 - a)^2 B + a (1 - a) G. The ground G is an artefact there, and a pixel taken for a blend of the two fills
shows the wrong place. The right blend follows from a. Where three opaque shapes meet no ground should shine through
either; the rest of the pixel shows their shares.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest
from cubicsplat_cli.artwork.regions.fills import OPAQUE, SAME
from cubicsplat_cli.artwork.regions.pixel_lines import MOST_GROUNDS
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.regions.sampling import EXAMINED
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import SEAM_STEPS, seam_shares

ODD = 6.0  # levels; a pixel is a seam if a blend of its two fills leaves more, and a seam of them at most SAME
RUN = 9  # px of a level or upright seam
NEAR = 2  # px from a pixel to the regions of a junction


def without_seams(levels: np.ndarray, regions: Regions) -> np.ndarray:
    """The picture (H, W, 4) in levels with the pixels of seams as they should have been; itself without any."""
    levels = _closed_junctions(levels, regions)
    y, x, other = _odd(levels, regions)
    if not 0 < len(y) <= EXAMINED:
        return levels
    own, beside = regions.fills[regions.labels[y, x]], regions.fills[other]
    fills, index = np.unique(regions.fills, axis=0, return_inverse=True)
    areas = np.bincount(index.reshape(-1), regions.areas, len(fills))
    commonest = fills[np.argsort(-areas, kind="stable")[:MOST_GROUNDS]]
    clear, filled = np.full((2, *regions.labels.shape), np.nan)
    for shares, grounds in ((clear, np.zeros((1, 4))), (filled, commonest)):
        share, rest = seam_shares(levels[y, x], own, beside, grounds, ODD)
        shares[y, x] = np.where(rest <= SAME, share, np.nan)
    share = np.where(np.isnan(clear), _along_runs(filled), clear)[y, x]
    seam = ~np.isnan(share)
    healed = levels.copy()
    healed[y[seam], x[seam]] = own[seam] + (beside - own)[seam] * share[seam, None]
    return healed


def _closed_junctions(levels: np.ndarray, regions: Regions) -> np.ndarray:
    """The picture with pixels within two px of where three opaque regions meet, and beside no other, opaque."""
    labels = regions.labels
    y, x = np.nonzero((levels[..., 3] < OPAQUE) & (levels[..., 3] > 0.0))
    solid = regions.fills[:, 3] >= OPAQUE
    inside = ndimage.minimum_filter(solid[labels], 3)[y, x]
    y, x = y[inside], x[inside]
    if not len(y):
        return levels
    around = np.pad(labels, NEAR, mode="edge")
    near = [around[y + i, x + j] for i, j in np.ndindex(2 * NEAR + 1, 2 * NEAR + 1)]
    ordered = np.sort(np.stack(near, axis=-1), axis=-1)
    first = np.concatenate([np.ones((len(y), 1), dtype=bool), np.diff(ordered, axis=-1) != 0], axis=-1)
    several = (first & solid[ordered]).sum(axis=-1) >= 3
    y, x = y[several], x[several]
    healed = levels.copy()
    healed[y, x] *= 255.0 / levels[y, x, 3:]
    return healed


def _along_runs(shares: np.ndarray) -> np.ndarray:
    """The shares (H, W) that are the same along RUN px of a row or column: many explain single pixels."""
    known = np.nan_to_num(shares, nan=-9.0)
    even = np.zeros(shares.shape, dtype=bool)
    for run in ((RUN, 1), (1, RUN)):
        alike = (ndimage.ranges(known, run) <= 1.5 / SEAM_STEPS) & (known >= 0.0)
        even |= ndimage.maximum_filter(alike, run)
    return np.where(even, shares, np.nan)


def _odd(levels: np.ndarray, regions: Regions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows and columns (n,) of pixels that border on one other region and are no blend with it, and that region."""
    labels = regions.labels
    around = np.stack([ndimage.minimum_filter(labels, 3), ndimage.maximum_filter(labels, 3)])
    y, x = np.nonzero(around[0] != around[1])
    low, high, own = around[0][y, x], around[1][y, x], labels[y, x]
    other = np.where(low == own, high, low)
    # Where three regions meet nothing is certain.
    two = (low == own) | (high == own)
    y, x, own, other = y[two], x[two], own[two], other[two]
    odd = largest(np.abs(blend_of(levels[y, x], regions.fills[own], regions.fills[other])[1])) > ODD
    return y[odd], x[odd], other[odd]
