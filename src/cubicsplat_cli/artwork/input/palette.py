"""The inks of a picture with noise: where it is calm, the commonest colours and all that noise makes of them."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

# Levels: what differs less is one ink, or times the noise.
SAME, SAME_NOISE = 8.0, 4.0
CALM = 1.5  # times the noise that 3 x 3 px may deviate, and a level for rounding
FEWEST, LEAST_SHARE = 16, 1e-4  # calm pixels that show an ink, and their share of the picture
MOST = 64
# Near edges, px, where 3 x 3 px span so many levels, an ink is only what differs so many times as much from those found
# farther away.
NEAR, EDGE, FAR = 8, 24.0, 2.5


def calm_pixels(levels: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) bool: pixels of (H, W, 4) whose 3 x 3 px are of one colour but for the noise; their means (H, W, 4)."""
    size = (3, 3, 1)
    mean = ndimage.uniform_filter(levels, size, mode="nearest")
    square = ndimage.uniform_filter(levels * levels, size, mode="nearest")
    deviation = np.sqrt(np.maximum(square - mean * mean, 0.0)).max(axis=-1)
    return deviation <= CALM * noise + 1.0, mean


def noisy_inks(levels: np.ndarray, seen: np.ndarray, noise: float) -> np.ndarray:
    """(P, 4) float64 the inks of a picture (H, W, 4) in levels, the commonest first.

    seen: (H, W, 4) the picture in coordinates whose distances tell inks apart. noise: its standard deviation in levels.
    """
    calm, mean = calm_pixels(seen, noise)
    spread = ndimage.maximum_filter(seen, (3, 3, 1)) - ndimage.minimum_filter(seen, (3, 3, 1))
    edge = spread.max(axis=-1) > max(EDGE, 8.0 * noise)
    away = calm & ~ndimage.maximum_filter(edge, 2 * NEAR + 1)
    reach = max(SAME, SAME_NOISE * noise)
    least = max(FEWEST, LEAST_SHARE * levels[..., 0].size)
    inks: list[np.ndarray] = []
    sizes: list[float] = []
    places = np.zeros((0, 4))
    for where, apart in ((away, 0.0), (calm & ~away, FAR * reach)):
        new = _modes(mean[where], reach, least, places)
        known = list(inks)
        for place in new:
            own = where & (np.abs(mean - place).max(axis=-1) <= reach)
            ink = np.median(levels[own], axis=0)
            if len(inks) < MOST and all(np.abs(ink - other).max() > apart for other in known):
                inks.append(ink)
                sizes.append(float(own.sum()))
        places = np.concatenate([places, new])
    if not inks:
        return np.median(levels.reshape(-1, 4), axis=0).astype(float)[None]
    return np.array(inks, dtype=float)[np.argsort(-np.array(sizes), kind="stable")]


def _modes(values: np.ndarray, reach: float, least: float, known: np.ndarray) -> np.ndarray:
    """(k, 4) the densest places among values (n, 4), each with `least` values within reach, beyond those known."""
    cell = reach / 4.0
    cells, counts = np.unique(np.rint(values / cell).astype(np.int16), axis=0, return_counts=True)
    colours, weight = cells * cell, counts.astype(float)
    for place in known:
        weight[np.abs(colours - place).max(axis=1) <= reach] = 0.0
    found: list[np.ndarray] = []
    while len(found) < MOST and len(weight):
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
