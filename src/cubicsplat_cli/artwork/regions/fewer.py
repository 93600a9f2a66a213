"""Fewer colours for a picture: the likest are merged, by how far people see them apart and by how much area they have.

Merging two colours of areas a and b at a distance d in CIELAB costs a b / (a + b) d^2, the squared error that their
mean makes (Ward's criterion): thin black lines stay, and two hues of a large area become one.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import light_of_srgb, packed
from cubicsplat_cli.artwork.regions.fills import CLEAR
from cubicsplat_cli.scene.paint import Rgba

MOST_COMPARED = 512  # colours; more are gathered in bins before they are compared in pairs
_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.072175], [0.0193339, 0.119192, 0.9503041]]
)


def fewer_colours(
    colours: np.ndarray, areas: np.ndarray, most: int | None, apart: float = 0.0, free: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """At most so many visible colours for those of a picture, the likest merged, and all that are nearer than `apart`
    or cost no more than `free` to merge.

    colours: (K, 4) premultiplied RGBA in levels. areas: (K,) > 0. apart: in units of CIELAB, opacity counting as
    lightness; free: in squared ones times areas. Returns (k, 4) colours, each that of the largest area merged into it,
    and (K,) int which of them each becomes. What is transparent stays so, and does not count.
    """
    visible = colours[:, 3] > CLEAR
    owner = np.zeros(len(colours), dtype=np.int64)
    bins = _binned(colours[visible]) if visible.sum() > MOST_COMPARED else np.arange(visible.sum())
    weights = areas[visible].astype(float)
    total = np.bincount(bins, weights)
    means = np.stack([np.bincount(bins, weights * channel) for channel in colours[visible].T], axis=1) / total[:, None]
    groups = _merged(means, total, most, apart, free)[bins]
    owner[visible] = groups
    owner[~visible] = groups.max(initial=-1) + 1
    largest = np.lexsort((-areas, owner))
    first = largest[np.unique(owner[largest], return_index=True)[1]]
    return colours[first], owner


def nearest_colours(
    colours: np.ndarray, palette: tuple[tuple[int, int, int], ...], tolerance: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The colours of a palette, 8-bit sRGB, nearest to those of a picture (K, 4), premultiplied RGBA in levels.

    tolerance: in CIEDE2000, by which the nearest colour is told then; what is farther from all stays as it is. Returns
    (k, 4), no two alike, with the opacities that there were, and (K,) int which of them each becomes.
    """
    chosen, opacity = np.array(palette, dtype=float), np.rint(colours[:, 3:])
    straight = colours[:, :3] * 255.0 / np.maximum(colours[:, 3:], 1e-6)
    if tolerance is None:
        # Nearest as numbers: in CIELAB pure primaries are so far from everything that sky is nearer to black than blue.
        gaps = ((straight[:, None] - chosen) ** 2).sum(axis=2)
    else:
        from skimage.color import deltaE_ciede2000  # takes a while to import, and is hardly ever asked for

        seen, known = (to_lab(np.pad(each, ((0, 0), (0, 1)), constant_values=255.0)) for each in (straight, chosen))
        gaps = deltaE_ciede2000(seen[:, None, :3], known[None, :, :3])
    new = np.concatenate([chosen[gaps.argmin(axis=1)] * opacity / 255.0, opacity], axis=1)
    near = gaps.min(axis=1, keepdims=True) <= (np.inf if tolerance is None else tolerance)
    return np.unique(np.where(near, new, colours), axis=0, return_inverse=True)


def nearest_in(palette: tuple[tuple[int, int, int], ...], fill: Rgba, tolerance: float | None = None) -> Rgba:
    """The same opacity of the colour of a palette that is nearest; tolerance as in `nearest_colours`."""
    red, green, blue, alpha = fill
    found = nearest_colours(np.array([[red, green, blue, 255.0]]), palette, tolerance)[0][0]
    return round(found[0]), round(found[1]), round(found[2]), alpha


def to_lab(colours: np.ndarray) -> np.ndarray:
    """(K, 4) what is seen of colours (K, 4), premultiplied RGBA in levels: CIELAB, and opacity from 0 to 100."""
    opacity = colours[:, 3:] / 255.0
    straight = np.clip(colours[:, :3] / np.maximum(colours[:, 3:], 1e-6), 0.0, 1.0)
    xyz = light_of_srgb(straight) @ _TO_XYZ.T / _TO_XYZ.sum(axis=1)
    f = np.where(xyz > 216.0 / 24389.0, np.cbrt(xyz), (24389.0 / 27.0 * xyz + 16.0) / 116.0)
    lab = np.stack([116.0 * f[:, 1] - 16.0, 500.0 * (f[:, 0] - f[:, 1]), 200.0 * (f[:, 1] - f[:, 2])], axis=1)
    return np.concatenate([lab, 100.0 * opacity], axis=1)


def _binned(colours: np.ndarray) -> np.ndarray:
    """(K,) int the bin of each colour, at most MOST_COMPARED of them, of as few levels as that takes."""
    for bits in range(1, 9):
        _, bins = np.unique(packed(np.rint(colours).astype(np.int64) >> bits), return_inverse=True)
        if bins.max() < MOST_COMPARED:
            break
    return bins


def _merged(colours: np.ndarray, areas: np.ndarray, most: int | None, apart: float, free: float) -> np.ndarray:
    """(K,) int the group of each colour (K, 4), numbered from 0."""
    count = len(colours)
    owner = np.arange(count)
    seen, areas, left = to_lab(colours), areas.copy(), count
    squared = ((seen[:, None] - seen[None]) ** 2).sum(axis=2)
    squared[np.diag_indices(count)] = np.inf
    cost = squared * areas[:, None] * areas[None] / (areas[:, None] + areas[None])
    while left > 1:
        a, b = divmod(int(cost.argmin()), count)
        if left <= (most or count) and cost[a, b] > free:
            a, b = divmod(int(squared.argmin()), count)
            if squared[a, b] >= apart**2:
                break
        seen[a] = (areas[a] * seen[a] + areas[b] * seen[b]) / (areas[a] + areas[b])
        areas[a] += areas[b]
        owner[owner == b] = a
        distance = np.where(np.isinf(squared[a]), np.inf, ((seen - seen[a]) ** 2).sum(axis=1))
        distance[[a, b]] = np.inf
        squared[a], squared[:, a] = distance, distance
        cost[a] = cost[:, a] = distance * areas * areas[a] / (areas + areas[a])
        squared[b] = squared[:, b] = cost[b] = cost[:, b] = np.inf
        left -= 1
    return np.unique(owner, return_inverse=True)[1]
