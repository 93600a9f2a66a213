"""The anti-aliasing of the program that drew a picture, measured from the blends on its edges.

Some take 4 x 4 samples a pixel (tiny-skia, and with it resvg): then level and upright edges are known to a quarter of a
pixel only, and their places within that are anybody's guess. Others come close to the exact area.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.regions.regions import Regions

SAMPLES = 16
LEAST_CONTRAST = 100.0  # levels between two fills, whose blends tell sixteenths apart
NEAR = 0.12  # of a sample
FEWEST, MOST = 40, 20_000  # blends looked at
SAMPLED = 0.8  # share of them near whole samples; by chance it would be 0.24


def samples_across(levels: np.ndarray, regions: Regions) -> int:
    """4 where the picture (H, W, 4) in levels was drawn with 4 x 4 samples a pixel, else 0."""
    labels, shares = regions.labels, []
    for axis in (0, 1):
        first, second = (np.swapaxes(a, 0, axis) for a in (labels, labels))
        own, beside = first[:-1], second[1:]
        y, x = np.nonzero(own != beside)
        base, span = regions.fills[own[y, x]], regions.fills[beside[y, x]] - regions.fills[own[y, x]]
        size = (span * span).sum(axis=1)
        value = np.swapaxes(levels, 0, axis)[y, x]
        share = ((value - base) * span).sum(axis=1) / np.maximum(size, 1e-9)
        rest = np.abs(value - base - share[:, None] * span).max(axis=1)
        telling = (size > LEAST_CONTRAST**2) & (rest < 2.0) & (share > 0.5 / SAMPLES) & (share < 1.0 - 0.5 / SAMPLES)
        shares.append(share[telling][:MOST])
    found = SAMPLES * np.concatenate(shares)
    if len(found) < FEWEST:
        return 0
    return 4 if (np.abs(found - np.rint(found)) < NEAR).mean() > SAMPLED else 0
