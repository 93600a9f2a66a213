"""Read from the blends on edges the anti-aliasing of the program that drew a picture, and where its borders lie.

Some programs take 4 x 4 samples a pixel (tiny-skia, and with it resvg): then level and upright edges are known to a
quarter of a pixel only, and their places within that are anybody's guess. Others come close to the exact area.

A crack is the unit edge between two neighbouring pixels. Summed along a column across a border that runs rather level
(or along a row across a steep one) the shares of the fills give the border's mean height over that column exactly,
whatever its slope, because a pixel's share is an area. That is taken as a point at the column's middle.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import FULL, blend_of, largest
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.borders import border_positions
from cubicsplat_cli.raster.outlines import EdgePositions

# Standard deviations of the share of a pixel that a shape is drawn to cover: from 4 x 4 samples, which areas in 8 bits
# are hardly better than where other shapes are near; and from one, all or nothing of it.
FEW_SAMPLES, ONE_SAMPLE = 0.04, 12.0**-0.5
SAMPLES = 16
CONTRAST = 60.0  # levels of an edge whose width, place or steps are measured
FEWEST, EXAMINED = 40, 20_000  # blends, steps or edges that tell, and pixels that are examined
# An edge of CONTRAST levels has blends, pixels that are between its colours by a share of BETWEEN, or steps, by which
# it goes on a pixel higher or lower in the next column. An aliased picture has MORE_STEPS times as many steps
# as blends, and FEWEST steps at least, in rows and columns of LOOKED_AT px.
BETWEEN, MORE_STEPS, LOOKED_AT = 0.1, 4.0, 262_144
STRAIGHT = 4  # px: a smooth edge that runs level for longer, between steps of a pixel, is rare
ROUNDING = 0.8  # levels by which a clean picture's pixels are off
RIM = 1.0  # px; the first row of a picture that is not clean is one fill or the other
COVERS = np.array([np.zeros(4), np.full(4, FULL)])  # levels of nothing and of all, for shares as a picture


def aliased(levels: np.ndarray) -> bool:
    """True if the edges of a picture (H, W, 4) in levels were drawn from one sample a pixel: in steps, without blends.

    Edges that are level or upright, and those of pixels that were made larger, have no steps of a pixel.
    """
    found = [_steps_and_blends(each) for each in (levels, levels.swapaxes(0, 1))]
    steps, blends = (sum(numbers) for numbers in zip(*found, strict=True))
    return steps >= FEWEST and steps > MORE_STEPS * blends


def _steps_and_blends(levels: np.ndarray) -> tuple[int, int]:
    """Count the steps and blends that nearly level edges of a picture (H, W, 4) have."""
    every = 1 + levels[..., 0].size // LOOKED_AT
    upper, here, lower = (levels[k : len(levels) - 2 + k : every] for k in range(3))
    y, x = np.nonzero(largest(np.abs(lower - upper))[:, :-1] > CONTRAST)
    above, below = here[y, x] - upper[y, x], lower[y, x] - here[y, x]
    between = np.minimum(np.abs(above), np.abs(below)) > BETWEEN * np.abs(above + below)
    blends = (between & (above * below > 0.0)).any(axis=1)
    even = (upper[y, x] == upper[y, x + 1]).all(axis=1) & (lower[y, x] == lower[y, x + 1]).all(axis=1)
    ends = np.stack([upper[y, x], lower[y, x]])
    first, second = ((here[y, x + k] == ends).all(axis=2) for k in (0, 1))
    steps = even & ((first[0] & second[1]) | (first[1] & second[0]))
    return int(steps.sum()), int(blends.sum())


def error_of_steps(levels: np.ndarray) -> float:
    """Return the root mean square error in levels, over white, that smooth edges have where those of an aliased picture
    (H, W, 4) are: ONE_SAMPLE of the contrast in each pixel whose right or lower neighbour differs.

    None where an edge runs straight for STRAIGHT px to both sides: level and upright ones have no steps.
    """
    colours, squares = levels[..., :3] + FULL - levels[..., 3:], np.zeros((*levels.shape[:2], 3))
    for axis in (0, 1):
        off = np.diff(colours, axis=axis, append=np.take(colours, [-1], axis))
        along = np.ones((1, 2 * STRAIGHT + 1) if axis == 0 else (2 * STRAIGHT + 1, 1), dtype=bool)
        off[ndimage.binary_erosion(off.any(axis=2), along)] = 0.0
        squares = np.maximum(squares, off**2)
    return ONE_SAMPLE * float(np.sqrt(squares.mean()))


def samples_across(levels: np.ndarray, regions: Regions) -> int:
    """4 where the picture (H, W, 4) in levels was drawn with 4 x 4 samples a pixel, else 0. Blends of fills that are
    100 levels apart tell sixteenths apart, of which by chance 0.24 would be near whole samples."""
    labels, shares = regions.labels, []
    for axis in (0, 1):
        turned = np.swapaxes(labels, 0, axis)
        own, beside = turned[:-1], turned[1:]
        y, x = np.nonzero(own != beside)
        first, second = regions.fills[own[y, x]], regions.fills[beside[y, x]]
        share, rest = blend_of(np.swapaxes(levels, 0, axis)[y, x], first, second)
        telling = (np.linalg.norm(second - first, axis=1) > 100.0) & (largest(np.abs(rest)) < 2.0)
        telling &= (share > 0.5 / SAMPLES) & (share < 1.0 - 0.5 / SAMPLES)
        shares.append(share[telling][:EXAMINED])
    found = SAMPLES * np.concatenate(shares)
    return 4 if len(found) >= FEWEST and (np.abs(found - np.rint(found)) < 0.12).mean() > 0.8 else 0


def edge_positions(
    levels: np.ndarray, regions: Regions, error: float = ROUNDING, share_error: float = FEW_SAMPLES
) -> EdgePositions:
    """Positions for all cracks between different regions of a picture (H, W, 4), levels; errors: of these, and of the
    shares of pixels that shapes cover.
    """
    found = border_positions(levels, regions.labels, regions.fills, error, ROUNDING, share_error)
    return EdgePositions(*found, RIM if error > ROUNDING else 0.0)


def share_positions(share: np.ndarray, cover: np.ndarray, error: float) -> EdgePositions:
    """Positions around what covers a share (H, W) in 0..1 of each pixel, and has those of cover (H, W) bool; error in
    levels of 255 for all.
    """
    regions = Regions(cover.astype(np.int32), COVERS, np.arange(2))
    return edge_positions(np.repeat((255.0 * share)[..., None], 4, axis=2), regions, max(ROUNDING, error))
