"""Whether a picture was even before noise, JPEG or blur. In numpy alone, since photos are asked this too."""

from __future__ import annotations

import numpy as np

COUNTED = 64
WINDOW, CELL = 5, 4.0  # px of the means, and levels of what counts as one colour of them
GROUND = 8.0  # levels around the commonest mean: the ground, which says nothing of what is on it
FEWEST_COLOURS = 257  # fewer are a palette, which photos have too
# Colours, and levels around each, that cover most of a drawing but not of a photo with an even sky.
FEW_INKS, NEAR = 12, 8.0
FEWEST = 0.02  # share of the pixels besides the ground, below which there is nothing on it


def evenness(levels: np.ndarray, drawn: np.ndarray) -> float:
    """0..2: the share of the pixels (besides the ground) in the commonest colours, and that of means in theirs.

    levels: (H, W, C) whole numbers of 0..255; drawn: (H, W) bool, what counts. Twelve Kodak
    photos have at most 0.56, as JPEG, enlarged or small 0.51; 48 drawings as JPEG of quality 80, with noise, blurred or
    enlarged 0.62 and more. 0 for few colours.
    """
    if min(levels.shape[:2]) < WINDOW:
        return 0.0
    code = _code(levels)
    if len(np.unique(code)) < FEWEST_COLOURS:
        return 0.0
    means = _means(levels)
    inner = (slice(WINDOW // 2, levels.shape[0] - WINDOW // 2), slice(WINDOW // 2, levels.shape[1] - WINDOW // 2))
    code, drawn = code[inner][drawn[inner]], drawn[inner]
    means = means[drawn]
    cells = np.floor(means / CELL)
    keys = _code(cells)
    found, first, counts = np.unique(keys, return_index=True, return_counts=True)
    if not len(found):
        return 0.0
    middle = CELL * (cells[first[counts.argmax()]] + 0.5)
    rest = np.abs(means - middle).max(axis=1) > GROUND
    if rest.sum() < FEWEST * len(rest):
        return 2.0
    return _in_commonest(code[rest]) + _in_commonest(keys[rest])


def covered(levels: np.ndarray, drawn: np.ndarray) -> float:
    """0..1: the share of the means that are near one of a few colours: the ground, and the commonest besides it.

    Arguments as of `evenness`. Drawings as JPEG, with noise or blurred whose evenness is below 0.7 have 0.91 and more,
    a photo of a launch that has an evenness of 0.65 has 0.74.
    """
    if min(levels.shape[:2]) < WINDOW:
        return 0.0
    edge = WINDOW // 2
    means = _means(levels)[drawn[edge : levels.shape[0] - edge, edge : levels.shape[1] - edge]]
    cells, counts = np.unique(_code(np.floor(means / CELL)), return_counts=True)
    colours = CELL * (cells[:, None] // 256 ** np.arange(levels.shape[-1]) % 256 + 0.5)
    left = counts.astype(float)
    for reach in (GROUND, *[NEAR] * FEW_INKS):
        if not left.any():
            break
        left[np.abs(colours - colours[left.argmax()]).max(axis=1) <= reach] = 0.0
    return float(1.0 - left.sum() / counts.sum()) if len(counts) else 0.0


def _means(levels: np.ndarray) -> np.ndarray:
    """(H - WINDOW + 1, W - WINDOW + 1, C) of every window."""
    sums = np.zeros((levels.shape[0] + 1, levels.shape[1] + 1, levels.shape[2]))
    sums[1:, 1:] = levels.cumsum(axis=0, dtype=np.float64).cumsum(axis=1)
    n = WINDOW
    return (sums[n:, n:] - sums[:-n, n:] - sums[n:, :-n] + sums[:-n, :-n]) / n**2


def _code(levels: np.ndarray) -> np.ndarray:
    return levels.astype(np.int64) @ (256 ** np.arange(levels.shape[-1]))


def _in_commonest(codes: np.ndarray) -> float:
    counts = np.sort(np.unique(codes, return_counts=True)[1])
    return float(counts[-COUNTED:].sum() / counts.sum())
