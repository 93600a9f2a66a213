"""Lines too thin to be calm anywhere: their colours, which no blend of the others explains, and where they run."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.regions.hairlines import CLOSE, nearest_line_inks
from cubicsplat_cli.artwork.regions.hidden_inks import distance_to_blends
from cubicsplat_cli.artwork.regions.regions import near_inks

# Of the distance between two inks: steps by which the sharpening of an edge between them goes beyond either, and levels
# by which what it makes is off that.
BEYOND, BEYOND_OFF = np.linspace(0.02, 0.25, 12), 8.0
STRANGE = 6.0  # times the misfit from every blend of two inks
CELL, FEWEST, MOST = 16.0, 24, 4  # levels of what is one colour, pixels that show an ink, and inks

# Px along which pixels hang together that are off by so many times the misfit, for a line to be there.
LENGTH, OFF = 8, 3.0


def with_lines(
    seen: np.ndarray, inks: np.ndarray, labels: np.ndarray, solid: np.ndarray, drawn: np.ndarray, sigma: float
) -> np.ndarray:
    """(H, W) int32 the labels of a picture with those of the thin lines that they lack.

    seen: (H, W, 4) the picture, inks: (P, 4) the colours of the labels, drawn: (H, W, 4) what the labels make of the
    picture, all in coordinates whose distances tell colours apart; solid: (H, W) the labels that are not thin, else -1;
    sigma: levels by which pixels are off there.
    """
    off = ((seen - drawn) ** 2).sum(axis=-1) > (OFF * sigma) ** 2
    square = np.ones((3, 3), dtype=bool)
    parts, _ = ndimage.label(ndimage.binary_dilation(off, square) | (solid < 0), square)
    count = np.bincount(parts[off], minlength=int(parts.max()) + 1)
    boxes = ndimage.find_objects(parts)
    long = [False] + [max(s.stop - s.start for s in box) >= LENGTH for box in boxes]
    y, x = np.nonzero((np.array(long) & (count > 0))[parts])
    near = near_inks(solid, y, x)
    y, x, near = (each[near[:, 0] >= 0] for each in (y, x, near))
    if not len(y):
        return labels
    ink, own = nearest_line_inks(seen[y, x], (y, x), labels.shape, inks, near, max(CLOSE, OFF * sigma))
    own &= (near == labels[y, x][:, None]).any(axis=1)
    out = labels.copy()
    out[y[own], x[own]] = ink[own]
    return out


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
