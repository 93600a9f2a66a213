"""Fills that hardly any pixel shows pure: the farthest common colours that no blend of two others explains.

Blends lie between fills, so the colour farthest from all blends of the known fills is the least blended with them.

False fills are the blends that lines of another fill make, always the same ones since drawing programs take few samples
a pixel.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest
from cubicsplat_cli.artwork.regions.fills import CLEAR, MOST_SMALL, OPAQUE, ROUNDED, SEEN
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import STRANGE, blend_with, distance_to_blends

TRIES = 400  # colours
ONE_OF_THREE = 0.6  # ratio of a fill's least distances from blends of three and of two other fills
BEYOND = np.linspace(0.02, 0.25, 12)  # shares of the step between two fills by which sharpening goes beyond either
LEAST_SHARE = 0.1  # of a line's fill in the blends that look like a fill
FLAT = 2  # pixels amid a square of 3 x 3 px of one colour, beyond which a fill is no blend
NEAR = 5  # px of the window in which the ground and more of the line show beside a false fill
# Shares of the pixels of a false fill with both beside them, and with the ground alone; share of the line that is more.
BESIDE_BOTH, BESIDE_GROUND, MORE = 0.25, 0.7, 0.15


def hidden_fills(levels: np.ndarray, palette: np.ndarray, least: float, reach: float, fewest: float) -> np.ndarray:
    """Return (k, 4) the fills that a palette (P, 4) lacks, of pixels (n, 4), all premultiplied RGBA in levels.

    least: levels by which a fill differs from all blends of two others; reach: levels within which pixels have one
    colour; fewest: pixels that show a fill.
    """
    found: list[np.ndarray] = []
    gap = distance_to_blends(levels, palette)
    # Translucent colours are seams between shapes, or blends of a fill with nothing where nothing is a fill.
    strange = (gap > least) & (levels[:, 3] >= (CLEAR if (palette[:, 3] < CLEAR).any() else OPAQUE))
    levels, gap = levels[strange], gap[strange]
    for _ in range(TRIES):
        if len(found) == MOST_SMALL or not (gap > least).any():
            break
        farthest = int(gap.argmax())
        same = largest(np.abs(levels - levels[farthest])) <= reach
        fill = np.median(levels[same], axis=0)
        if same.sum() >= fewest and not _blend_of_three(fill, palette, ONE_OF_THREE * least):
            # A fill that only shows translucent is taken for opaque: its pixels are blends with nothing.
            found.append(fill * (255.0 / fill[3]))
            palette = np.vstack([palette, found[-1]])
            gap = np.minimum(gap, distance_to_blends(levels, palette, len(palette) - 1))
        gap[farthest] = 0.0
    return np.array(found, dtype=float).reshape(-1, 4)


def _blend_of_three(fill: np.ndarray, palette: np.ndarray, gap: float) -> bool:
    """Return True if a fill (4,) is a blend of three of a palette, to so many levels, as in corners of shapes."""
    for k in range(len(palette) - 2):
        first, second = (k + 1 + each for each in np.triu_indices(len(palette) - k - 1, 1))
        if (blend_with(fill, palette[k], palette[first], palette[second])[1] <= gap).any():
            return True
    return False


def overshoots(fill: np.ndarray, palette: np.ndarray) -> bool:
    """Return True if a colour (4,), in levels, comes from sharpening one fill of a palette (P, 4) beside another."""
    return lies_beyond(fill, palette, palette[:, None] - palette, BEYOND, SEEN)


def lies_beyond(fill: np.ndarray, palette: np.ndarray, steps: np.ndarray, times: np.ndarray, off: float) -> bool:
    """Return True if a colour (4,) is, to `off` levels, a fill of a palette (P, 4) plus some of the `times` (n,) a step
    (P, P, 4), in levels, towards it from another fill; (0, 0, 0, 0) is no step.
    """
    beyond = np.clip(palette[:, None] + times[:, None, None, None] * steps, 0.0, 255.0)
    return bool(((largest(np.abs(beyond - fill)) <= off) & steps.any(axis=-1)).any())


def line_blends(levels: np.ndarray, palette: np.ndarray, pure: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Return (P,) bool: True for false fills of a palette (P, 4) in levels: blends of another fill's lines with the
    ground of the lines. They show only beside both, in fewer pixels than show more of the lines; where these are hardly
    narrower than their pixels, beside the ground.

    levels: (H, W, 4) the picture; pure: (H, W) int, the fill of every pixel that shows one, -1 of others; flat: (H, W)
    bool, pixels amid a square of one colour.
    """
    fills = np.arange(len(palette))
    doubtful = np.bincount(pure[flat & (pure >= 0)], minlength=len(palette)) <= FLAT
    counts = np.bincount(pure[pure >= 0], minlength=len(palette))
    out = np.zeros(len(palette), dtype=bool)
    if not doubtful.any():
        return out
    beside, areas = ([ndimage.maximum_filter((pure == k) & where, NEAR) for k in fills] for where in (True, flat))
    thin, more = ~flat, np.zeros(pure.shape, dtype=bool)
    colours = levels[thin]
    for k in fills[doubtful & (counts > 0)]:
        shown = pure == k
        for line, ground in permutations(fills[fills != k], 2):
            if out[k]:
                break
            share, rest = blend_of(palette[k], palette[ground], palette[line])
            if share < LEAST_SHARE or np.abs(rest).max() > ROUNDED:
                continue
            by_ground = beside[ground][shown]
            if by_ground.mean() < BESIDE_GROUND:
                continue
            shares, rest = blend_of(colours, palette[ground], palette[line], most=None)
            more[thin] = (shares > share + MORE) & (largest(np.abs(rest)) <= STRANGE) & ~areas[line][thin]
            if share > 1.0 - MORE:
                out[k] = counts[line] > counts[k]
            elif more.sum() > counts[k]:
                out[k] = (by_ground & ndimage.maximum_filter(more, NEAR)[shown]).mean() >= BESIDE_BOTH
    return out
