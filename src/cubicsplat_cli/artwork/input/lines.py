"""Inks that only lines too thin to be calm anywhere have: colours that no blend of the others explains."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.regions.hidden_inks import distance_to_blends

# Of the distance between two inks: steps by which the sharpening of an edge between them goes beyond either, and levels
# by which what it makes is off that.
BEYOND, BEYOND_OFF = np.linspace(0.02, 0.25, 12), 8.0
STRANGE = 6.0  # times the misfit from every blend of two inks
CELL, FEWEST, MOST = 16.0, 24, 4  # levels of what is one colour, pixels that show an ink, and inks


def line_inks(levels: np.ndarray, seen: np.ndarray, palette: np.ndarray, space: np.ndarray, sigma: float) -> np.ndarray:
    """(k, 4) inks in levels that a palette (P, 4) lacks: the farthest from it of the common colours that are strange.

    levels: (n, 4) pixels; seen: (n, 4) the same in the coordinates of `space` (4, 4), whose distances tell inks apart;
    sigma: levels by which pixels are off there.
    """
    found: list[np.ndarray] = []
    inks = palette
    gap = distance_to_blends(seen, inks @ space)
    while len(found) < MOST:
        strange = gap > STRANGE * sigma
        cells, index, counts = np.unique(
            np.floor(levels[strange] / CELL), axis=0, return_inverse=True, return_counts=True
        )
        common = np.flatnonzero(counts >= FEWEST)
        if not len(common):
            break
        index = index.reshape(-1)
        mean = np.bincount(index, gap[strange], len(cells)) / counts
        best = common[int(mean[common].argmax())]
        ink = np.median(levels[strange][index == best], axis=0)
        found.append(ink)
        inks = np.vstack([inks, ink])
        gap[strange] = distance_to_blends(seen[strange], inks @ space)
    return np.array(found, dtype=float).reshape(-1, 4)


def overshoots(ink: np.ndarray, palette: np.ndarray) -> bool:
    """Whether a colour (4,), in levels, is what sharpening makes of one ink of a palette (P, 4) beside another one."""
    step = BEYOND[:, None, None, None] * (palette[:, None] - palette[None])
    beyond = np.clip(palette[:, None] + step, 0.0, 255.0)
    apart = np.abs(palette[:, None] - palette[None]).max(axis=-1) > 0.0
    return bool(((np.abs(beyond - ink).max(axis=-1) <= BEYOND_OFF) & apart).any())
