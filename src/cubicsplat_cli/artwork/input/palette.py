"""The fills of a picture with noise: where it is calm, the commonest colours and all that noise makes of them.

In small ones also what fills squares of 2 x 2 px, where hardly anything fills more.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA
from cubicsplat_cli.artwork.input.condition import BLOCK, Condition
from cubicsplat_cli.artwork.input.evenness import EDGE
from cubicsplat_cli.artwork.regions.fills import FEWEST_SQUARES, MOST_PALETTE
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import nearest_fills, spread

# Levels: what differs less is one fill, or times the noise of the means of 3 x 3 px. Between two fills lies a valley,
# with fewer px by this share than have the rarer one; without it, one is what noise makes of the other.
SAME, SAME_NOISE, VALLEY = 8.0, 4.0, 0.7
CALM = 1.5  # times the noise that 3 x 3 px may deviate, and a level for rounding
FEWEST, LEAST_SHARE = 16, 1e-4  # calm pixels that show a fill, and their share of the picture
# Within so many px of edges a fill is only what differs so many times as much from those found farther away.
NEAR, FAR = 8, 2.5
# A fill colour is missing where the mean residual of WINDOW x WINDOW px is over UNLIKE in luma or chroma, about 3 to 4
# in CIEDE2000, and makes up most of the squares: a thin line's does not. Px that show it.
WINDOW, UNLIKE, EXPLAINED, LEAST_MISSING = 5, 6.0, 0.5, 60
# What a JPEG leaves of edges, as a share of the range of values in the block around, px: of luma, and of chroma of half
# the size.
RINGING, BLOCKS = 0.05, ((BLOCK, slice(0, 1)), (2 * BLOCK, slice(1, 3)))
SMALL = 128  # px of the longer side, up to which details are so small
MOST_SQUARES = 24  # fills that squares show
# A square lies on a ramp where its colour is a blend of those up to so many px to either side of it: shares, and times
# the misfit that it is off that and these are apart.
REACH, BLENDED, MISFITS, CONTRAST = 2, (0.15, 0.85), 2.0, 6.0


def calm_pixels(levels: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) bool: pixels of (H, W, 4) whose 3 x 3 px are of one colour but for the noise; their means (H, W, 4)."""
    size = (3, 3, 1)
    mean = ndimage.uniform_filter(levels, size, mode="nearest")
    square = ndimage.uniform_filter(levels * levels, size, mode="nearest")
    deviation = np.sqrt(np.maximum(square - mean * mean, 0.0)).max(axis=-1)
    return deviation <= CALM * noise + 1.0, mean


def reach_of(condition: Condition) -> float:
    """Levels within which means of 3 x 3 px are of one fill."""
    return max(SAME, SAME_NOISE * condition.noise_of_means)


def noisy_fills(levels: np.ndarray, seen: np.ndarray, condition: Condition) -> np.ndarray:
    """(P, 4) float64 the fills of a picture (H, W, 4) in levels and of a condition, the commonest first.

    seen: (H, W, 4) the picture in coordinates whose distances tell fills apart.
    """
    noise, reach = condition.noise, reach_of(condition)
    calm, mean = calm_pixels(seen, noise)
    edge = spread(seen, 3, 3) > max(EDGE, 8.0 * noise)
    away = calm & ~ndimage.maximum_filter(edge, 2 * NEAR + 1)
    least = max(FEWEST, LEAST_SHARE * levels[..., 0].size)
    fills: list[np.ndarray] = []
    sizes: list[float] = []
    places = np.zeros((0, 4))
    for where, apart in ((away, 0.0), (calm & ~away, FAR * reach)):
        new = _peaks(mean[where], modes(mean[where], reach, least, places), reach)
        known = list(fills)
        colours, (nearest, gap) = levels[where], nearest_fills(mean[where], new)
        for k in range(len(new)):
            own = (gap <= reach) & (nearest == k)
            fill = np.median(colours[own], axis=0)
            if len(fills) < MOST_PALETTE and all(np.abs(fill - other).max() > apart for other in known):
                fills.append(fill)
                sizes.append(float(own.sum()))
        places = np.concatenate([places, new])
    if not fills:
        return np.median(levels.reshape(-1, 4), axis=0).astype(float)[None]
    return np.array(fills, dtype=float)[np.argsort(-np.array(sizes), kind="stable")]


def _peaks(values: np.ndarray, places: np.ndarray, reach: float) -> np.ndarray:
    """(k, 4) those of some places among values (n, 4) that have a valley between them and each denser one near."""

    def density(at: np.ndarray) -> int:
        return int(np.count_nonzero((np.abs(values - at) <= 0.5 * reach).all(axis=1)))

    found: list[np.ndarray] = []
    densities = [density(place) for place in places]
    for k in np.argsort(densities, kind="stable")[::-1]:
        near = [peak for peak in found if np.abs(peak - places[k]).max() <= 3.0 * reach]
        if all(density(0.5 * (places[k] + peak)) <= VALLEY * densities[k] for peak in near):
            found.append(places[k])
    return np.array(found).reshape(-1, 4)


def missing_colours(levels: np.ndarray, palette: np.ndarray, nearest: np.ndarray, condition: Condition) -> np.ndarray:
    """(k, 4) fill colours in levels that areas of a picture (H, W, 4) of a condition have and its palette (P, 4) lacks.

    nearest: (H, W) the colour of the palette nearest to each pixel.
    """
    seen = (levels @ LUMA_CHROMA).astype(np.float32)
    inner = ndimage.alike(nearest, 3)
    residual = np.where(inner[..., None], seen - (palette @ LUMA_CHROMA).astype(np.float32)[nearest], np.float32(0.0))
    share = np.maximum(ndimage.uniform_filter(inner.astype(np.float32), WINDOW), 1e-3)[..., None]
    mean = ndimage.uniform_filter(residual, (WINDOW, WINDOW, 1)) / share
    square = ndimage.uniform_filter(residual * residual, (WINDOW, WINDOW, 1)) / share
    # What a JPEG is off is alike over its blocks, and so no less in a mean.
    off_by = 0.0 if condition.jpeg else SAME_NOISE * condition.noise / WINDOW / np.sqrt(share)
    unlike = np.abs(mean) - np.maximum(UNLIKE, off_by)
    if condition.jpeg:
        unlike -= ringing(seen)
    calm, _ = calm_pixels(seen, condition.noise)
    off = calm & inner & (largest(unlike) > 0.0) & ((mean * mean).sum(axis=-1) > EXPLAINED * square.sum(axis=-1))
    values = ndimage.uniform_filter(levels, (3, 3, 1))[off]
    reach = reach_of(condition)
    found = [
        np.median(levels[off][np.abs(values - place).max(axis=-1) <= reach], axis=0)
        for place in modes(values, reach, LEAST_MISSING, np.zeros((0, 4)))
    ]
    return np.array(found, dtype=float).reshape(-1, 4)


def ringing(seen: np.ndarray) -> np.ndarray:
    """(H, W, 4) float32 levels by which a JPEG's edges are off, in a picture (H, W, 4) in luma, chroma and opacity."""
    out = np.zeros(seen.shape, dtype=np.float32)
    for block, channels in BLOCKS:
        window, values = (2 * block + 1, 2 * block + 1, 1), seen[..., channels]
        out[..., channels] = RINGING * (ndimage.maximum_filter(values, window) - ndimage.minimum_filter(values, window))
    return out


def modes(values: np.ndarray, reach: float, least: float, known: np.ndarray) -> np.ndarray:
    """(k, 4) the densest places among values (n, 4), each with `least` values within reach, beyond those known."""
    cell = reach / 4.0
    cells = np.rint(values / cell).astype(np.int64)
    # As one number each: to sort rows takes numpy a hundred times as long.
    low = cells.min(axis=0, initial=0)
    spans = tuple(cells.max(axis=0, initial=0) - low + 1)
    numbers, counts = np.unique(np.ravel_multi_index(tuple((cells - low).T), spans), return_counts=True)
    colours, weight = (np.stack(np.unravel_index(numbers, spans), axis=1) + low) * cell, counts.astype(float)
    for place in known:
        weight[np.abs(colours - place).max(axis=1) <= reach] = 0.0
    found: list[np.ndarray] = []
    while len(found) < MOST_PALETTE and len(weight):
        first = int(weight.argmax())
        if weight[first] < 2.0:
            break
        own = (np.abs(colours - colours[first]).max(axis=1) <= reach) & (weight > 0.0)
        if weight[own].sum() < least:
            weight[first] = 0.0
            continue
        found.append(colours[first])
        weight[own] = 0.0
    return np.array(found).reshape(-1, 4)


def square_fills(
    levels: np.ndarray, seen: np.ndarray, known: np.ndarray, sigma: float, reach: float, apart: float
) -> np.ndarray:
    """(k, 4) fills in levels that squares of 2 x 2 px show and that are none of those known, the commonest first.

    levels: (H, W, 4) the picture; seen: (H, W, 4) the same in coordinates whose distances tell fills apart; known:
    (P, 4) in these; sigma: levels by which pixels are off there; reach: levels within which colours are one fill;
    apart: levels beyond which they are two.
    """
    if min(levels.shape[:2]) < 4 or max(levels.shape[:2]) > SMALL:
        return np.zeros((0, 4))
    corners = np.stack([seen[y : seen.shape[0] - 1 + y, x : seen.shape[1] - 1 + x] for y in (0, 1) for x in (0, 1)])
    mean = corners.mean(axis=0)
    calm = corners.std(axis=0).max(axis=-1) <= CALM * sigma
    calm &= ~_on_ramps(seen, mean, sigma)
    y, x = np.nonzero(calm & (np.abs(mean[..., None, :] - known).max(axis=-1).min(axis=-1) > apart))
    if not len(y):
        return np.zeros((0, 4))
    from scipy.spatial import cKDTree  # takes a while to import, and few pictures have such squares

    fills: list[np.ndarray] = []
    while len(y) and len(fills) < MOST_SQUARES:
        values = mean[y, x]
        # As many of the squares as there are within reach of each.
        around = cKDTree(values).query_ball_point(values, reach, p=np.inf, return_length=True)
        densest = values[int(around.argmax())]
        if around.max() < FEWEST_SQUARES:
            break
        gap = np.abs(values - densest).max(axis=1)
        own = gap <= reach
        fills.append(np.median([levels[y[own] + dy, x[own] + dx] for dy in (0, 1) for dx in (0, 1)], axis=(0, 1)))
        y, x = y[gap > apart], x[gap > apart]
    return np.array(fills, dtype=float).reshape(-1, 4)


def _on_ramps(seen: np.ndarray, mean: np.ndarray, sigma: float) -> np.ndarray:
    """(H - 1, W - 1) bool: the squares with means (H - 1, W - 1, 4) that blend what lies to either side of them."""
    padded = np.pad(seen, ((REACH, REACH), (REACH, REACH), (0, 0)), mode="edge")
    out = np.zeros(mean.shape[:2], dtype=bool)
    for turned in (False, True):
        around, middle = (padded.swapaxes(0, 1), mean.swapaxes(0, 1)) if turned else (padded, mean)
        height, width = middle.shape[:2]
        # The two pixels beside the square, in the rows or columns that it has.
        pair = 0.5 * (around[REACH : REACH + height] + around[REACH + 1 : REACH + height + 1])
        for off in range(1, REACH + 1):
            before, after = pair[:, REACH - off :][:, :width], pair[:, REACH + 1 + off :][:, :width]
            share, rest = blend_of(middle, before, after)
            ramp = (share > BLENDED[0]) & (share < BLENDED[1]) & (np.linalg.norm(rest, axis=-1) <= MISFITS * sigma)
            ramp &= np.linalg.norm(after - before, axis=-1) > CONTRAST * sigma
            out |= ramp.T if turned else ramp
    return out
