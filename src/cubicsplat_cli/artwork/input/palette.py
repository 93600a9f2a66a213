"""Find the fills of a picture with noise: the commonest colours of its calm areas, and further ones of small parts.

Further ones are the fills of areas that the palette leaves unexplained, and in small pictures those of squares of 2 x 2
px, since hardly anything larger shows a fill there.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, commonest, largest, summed
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA
from cubicsplat_cli.artwork.input.condition import BLOCK, OUTLIER, Condition
from cubicsplat_cli.artwork.regions.fills import APART, MOST_PALETTE, MOST_SMALL, SEEN, TOGETHER
from cubicsplat_cli.artwork.regions.hairlines import NONE
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import nearest_fills, spread

CALM = 1.5  # standard deviations by which calm pixels may deviate
FAR = 2.5  # times as much as elsewhere, by which a fill near edges differs from others, as edges hold blends
UNLIKE = 6.0  # levels of luma or chroma, about 3 to 4 in CIEDE2000; areas whose mean is farther off have another fill
WINDOW = 5  # px of a window for means
SMALL = 128  # px of the longer side of a picture in which squares show fills
INNER, OUTER = 3, 8  # px from an area: beyond its blurred border, and still near it
BESIDE = 2  # px to either side of a square, the colours of which a square on a ramp blends


def calm_pixels(levels: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W) bool: where 3 x 3 px of (H, W, 4) are alike but for noise and rounding; and the means of all."""
    size = (3, 3, 1)
    mean = ndimage.uniform_filter(levels, size, mode="nearest")
    square = ndimage.uniform_filter(levels * levels, size, mode="nearest")
    deviation = np.sqrt(np.maximum(largest(square - mean * mean), 0.0))
    return deviation <= CALM * noise + 1.0, mean


def reach_of(condition: Condition) -> float:
    """Return the levels within which means of 3 x 3 px are of one fill."""
    return max(SEEN, OUTLIER * condition.error_of_mean(9))


def noisy_fills(levels: np.ndarray, seen: np.ndarray, condition: Condition) -> np.ndarray:
    """Return (P, 4) float64 the fills of a picture (H, W, 4) in levels and of a condition, the commonest first.

    seen: (H, W, 4) the picture in coordinates whose distances tell fills apart. At least 16 calm pixels show a fill,
    and one in 10,000. Within 8 px of edges, a fill differs more from those found elsewhere.
    """
    noise, reach = condition.noise, reach_of(condition)
    calm, mean = calm_pixels(seen, noise)
    edge = spread(seen, 3, 3) > max(APART, 8.0 * noise)
    away = calm & ~ndimage.maximum_filter(edge, 2 * 8 + 1)
    least = max(16, 1e-4 * levels[..., 0].size)
    fills, sizes, places = list[np.ndarray](), list[float](), NONE
    for mask, apart in ((away, 0.0), (calm & ~away, FAR * reach)):
        new = _peaks(mean[mask], modes(mean[mask], reach, least, places), reach)
        earlier = list(fills)
        colours, (nearest, gap) = levels[mask], nearest_fills(mean[mask], new)
        for k in range(len(new)):
            own = (gap <= reach) & (nearest == k)
            fill = np.median(colours[own], axis=0)
            if len(fills) < MOST_PALETTE and all(np.abs(fill - other).max() > apart for other in earlier):
                fills.append(fill)
                sizes.append(float(own.sum()))
        places = np.concatenate([places, new])
    return np.array(fills, dtype=float).reshape(-1, 4)[np.argsort(-np.array(sizes), kind="stable")]


def even_fills(levels: np.ndarray) -> np.ndarray:
    """Return (P, 4) float64 the fills of a picture (H, W, 4) in levels whose noise is that of edges only: the commonest
    colours of the pixels in the middle of 3 x 3 px exactly alike, of which each has as many as for `noisy_fills`.
    """
    fewest = max(16, 1e-4 * levels[..., 0].size)
    return commonest(levels[spread(levels, 3, 3) == 0.0], MOST_PALETTE, fewest).astype(float)


def _peaks(values: np.ndarray, places: np.ndarray, reach: float) -> np.ndarray:
    """Return (k, 4) the places among values (n, 4) that have a valley between them and each denser one nearby: at most
    0.7 of their density, since noise spreads one fill over several places otherwise.
    """

    def density(at: np.ndarray) -> int:
        return int(np.count_nonzero(largest(np.abs(values - at)) <= 0.5 * reach))

    peaks: list[np.ndarray] = []
    densities = [density(place) for place in places]
    for k in np.argsort(densities, kind="stable")[::-1]:
        near = [peak for peak in peaks if np.abs(peak - places[k]).max() <= 3.0 * reach]
        if all(density(0.5 * (places[k] + peak)) <= 0.7 * densities[k] for peak in near):
            peaks.append(places[k])
    return np.array(peaks).reshape(-1, 4)


def missing_colours(levels: np.ndarray, palette: np.ndarray, nearest: np.ndarray, condition: Condition) -> np.ndarray:
    """Return (k, 4) colours in levels of areas of a picture (H, W, 4) of a condition that its palette (P, 4) lacks.

    nearest: (H, W) the colour of the palette nearest to each pixel. A colour is missing if 60 px have a mean residual
    over UNLIKE in their windows that makes up most of its squares, as that of a thin line does not.
    """
    seen = (levels @ LUMA_CHROMA).astype(np.float32)
    inner = ndimage.alike(nearest, 3)
    residual = np.where(inner[..., None], seen - (palette @ LUMA_CHROMA).astype(np.float32)[nearest], np.float32(0.0))
    share = np.maximum(ndimage.uniform_filter(inner.astype(np.float32), WINDOW), 1e-3)[..., None]
    mean = ndimage.uniform_filter(residual, (WINDOW, WINDOW, 1)) / share
    square = ndimage.uniform_filter(residual * residual, (WINDOW, WINDOW, 1)) / share
    unlike = np.abs(mean) - max(UNLIKE, OUTLIER * condition.error_of_mean(WINDOW**2))
    if condition.jpeg:
        unlike -= ringing(seen)
    calm, _ = calm_pixels(seen, condition.noise)
    off = calm & inner & (largest(unlike) > 0.0) & (summed(mean * mean) > 0.5 * summed(square))
    values, reach, colours = ndimage.uniform_filter(levels, (3, 3, 1))[off], reach_of(condition), []
    for place in modes(values, reach, 60, NONE):
        own = off.copy()
        own[off] = largest(np.abs(values - place)) <= reach
        if has_border(mean, own, inner & ~off):
            colours.append(np.median(levels[own], axis=0))
    return np.array(colours, dtype=float).reshape(-1, 4)


def has_border(off: np.ndarray, own: np.ndarray, rest: np.ndarray) -> bool:
    """Return False if pixels (H, W) bool drift from the colour expected there and have no border with the rest (H, W)
    bool: a few px around, more of these are off by a quarter to three quarters as much than by less. off: (H, W, C) by
    which a picture is off the colours expected.
    """
    around = rest & ndimage.maximum_filter(own, 2 * OUTER + 1) & ~ndimage.maximum_filter(own, 2 * INNER + 1)
    step = off[own].mean(axis=0)
    share = off[around] @ step / (step @ step)
    return bool(((share > 0.25) & (share < 0.75)).sum() <= (share <= 0.25).sum())


def ringing(seen: np.ndarray) -> np.ndarray:
    """Return (H, W, 4) float32 levels by which a JPEG's edges are off, in a picture (H, W, 4) in luma, chroma and
    opacity: a twentieth of the range of values within a block, which for chroma of half the size is twice as large.
    """
    out = np.zeros(seen.shape, dtype=np.float32)
    for block, channels in ((BLOCK, slice(0, 1)), (2 * BLOCK, slice(1, 3))):
        out[..., channels] = 0.05 * ndimage.ranges(seen[..., channels], (2 * block + 1, 2 * block + 1, 1))
    return out


def modes(values: np.ndarray, reach: float, least: float, earlier: np.ndarray) -> np.ndarray:
    """Return (k, 4) the densest places among values (n, 4), the densest first, with at least `least` values within
    `reach` of each that belong to no denser place, nor to earlier ones (m, 4).
    """
    cell = reach / 4.0
    cells = np.rint(values / cell).astype(np.int64)
    # One number for each, since numpy takes a hundred times as long to sort rows.
    low = cells.min(axis=0, initial=0)
    spans = tuple(cells.max(axis=0, initial=0) - low + 1)
    numbers, counts = np.unique(np.ravel_multi_index(tuple((cells - low).T), spans), return_counts=True)
    colours, weight = (np.stack(np.unravel_index(numbers, spans), axis=1) + low) * cell, counts.astype(float)
    for place in earlier:
        weight[largest(np.abs(colours - place)) <= reach] = 0.0
    places: list[np.ndarray] = []
    while len(places) < MOST_PALETTE and len(weight):
        first = int(weight.argmax())
        if weight[first] < 2.0:
            break
        own = (largest(np.abs(colours - colours[first])) <= reach) & (weight > 0.0)
        if weight[own].sum() < least:
            weight[first] = 0.0
            continue
        places.append(colours[first])
        weight[own] = 0.0
    return np.array(places).reshape(-1, 4)


def square_fills(
    levels: np.ndarray, seen: np.ndarray, palette: np.ndarray, sigma: float, reach: float, apart: float
) -> np.ndarray:
    """Return (k, 4) fills in levels that squares of 2 x 2 px show and a palette lacks, the commonest first.

    levels: (H, W, 4) the picture; seen: (H, W, 4) the same in coordinates whose distances tell fills apart; palette:
    (P, 4) in these; sigma: levels by which pixels are off there; reach: levels within which colours are one fill;
    apart: levels beyond which they are two.
    """
    if min(levels.shape[:2]) < 4 or max(levels.shape[:2]) > SMALL:
        return NONE
    corners = np.stack([seen[y : seen.shape[0] - 1 + y, x : seen.shape[1] - 1 + x] for y in (0, 1) for x in (0, 1)])
    mean = corners.mean(axis=0)
    calm = corners.std(axis=0).max(axis=-1) <= CALM * sigma
    calm &= ~_on_ramps(seen, mean, sigma)
    y, x = np.nonzero(calm & (np.abs(mean[..., None, :] - palette).max(axis=-1).min(axis=-1) > apart))
    if not len(y):
        return NONE
    from scipy.spatial import cKDTree  # takes a while to import, and few pictures have such squares

    fills: list[np.ndarray] = []
    while len(y) and len(fills) < MOST_SMALL:
        values = mean[y, x]
        # The number of squares within reach of each.
        around = cKDTree(values).query_ball_point(values, reach, p=np.inf, return_length=True)
        if around.max() < TOGETHER:
            break
        gap = np.abs(values - values[int(around.argmax())]).max(axis=1)
        own = gap <= reach
        fills.append(np.median([levels[y[own] + dy, x[own] + dx] for dy in (0, 1) for dx in (0, 1)], axis=(0, 1)))
        y, x = y[gap > apart], x[gap > apart]
    return np.array(fills, dtype=float).reshape(-1, 4)


def _on_ramps(seen: np.ndarray, mean: np.ndarray, sigma: float) -> np.ndarray:
    """Return (H - 1, W - 1) bool: squares with means (H - 1, W - 1, 4) that lie on a ramp. They are blends, by 0.15 to
    0.85 and to twice the misfit sigma, of the colours to either side, which are more than six times sigma apart.
    """
    padded = np.pad(seen, ((BESIDE, BESIDE), (BESIDE, BESIDE), (0, 0)), mode="edge")
    out = np.zeros(mean.shape[:2], dtype=bool)
    for part, around, middle in ((out, padded, mean), (out.T, padded.swapaxes(0, 1), mean.swapaxes(0, 1))):
        height, width = middle.shape[:2]
        # The two pixels beside the square, in its rows or columns.
        pair = 0.5 * (around[BESIDE : BESIDE + height] + around[BESIDE + 1 : BESIDE + height + 1])
        for off in range(1, BESIDE + 1):
            before, after = pair[:, BESIDE - off :][:, :width], pair[:, BESIDE + 1 + off :][:, :width]
            share, rest = blend_of(middle, before, after)
            ramp = (share > 0.15) & (share < 0.85) & (np.linalg.norm(rest, axis=-1) <= 2.0 * sigma)
            ramp &= np.linalg.norm(after - before, axis=-1) > 6.0 * sigma
            part |= ramp
    return out
