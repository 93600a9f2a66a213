"""The inks of a flat picture, from the interiors of its regions only: edges hold blends.

Pictures are (H, W, 4) float32 premultiplied RGBA in levels of 0..255.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.raster import ndimage

# Levels: a pixel is flat where its 3x3 neighbourhood spans at most so much; inks nearer than `SAME` are one.
FLAT_RANGE = 3.0
SAME = 3.5
# A component of flat pixels that spans more levels than this is a gradient, drawn in bands of BAND levels.
GRADIENT_RANGE = 14.0
BAND = 12.0
LEAST_FLAT = 0.02  # share of the pixels, below which a picture has no interiors
# Squares of 2 x 2 px that span at most so many levels show an ink, if enough have its colour; so many such inks.
SQUARE_RANGE, FEWEST_SQUARES, MOST_SMALL = 1.0, 3, 16
# A small ink that is a blend of a ground on both sides of its squares with another ink, of which thin lines have
# MORE times its px, is such a line's in the middle of two px: residual in levels, shares of that ink, and of squares so
# placed.
BLEND_LEVELS, BLEND_SHARES, BETWEEN, MORE = 3.0, (0.2, 0.95), 0.5, 4
MOST_INKS = 256
CLEAR = 2.0  # levels of opacity below which nothing is drawn


def flat_pixels(levels: np.ndarray, limit: float = FLAT_RANGE) -> np.ndarray:
    """(H, W) bool: the 3x3 neighbourhood spans at most `limit` levels in every channel."""
    size = (3, 3, 1)
    high = ndimage.maximum_filter(levels, size, mode="nearest")
    low = ndimage.minimum_filter(levels, size, mode="nearest")
    return largest(high - low) <= limit


def picture_inks(levels: np.ndarray) -> np.ndarray:
    """(P, 4) float64 the inks of the flat interiors in levels, the commonest first.

    A picture without flat interiors (noise, a photo) gives the bands of its smoothed colours.
    """
    flat = flat_pixels(levels)
    if flat.mean() < LEAST_FLAT:
        smooth = ndimage.uniform_filter(levels, (5, 5, 1), mode="nearest")
        return _limited(*_banded(smooth.reshape(-1, 4)))
    parts, count = ndimage.label(flat)
    values = levels[flat]
    owner = parts[flat] - 1
    order = np.argsort(owner, kind="stable")
    bounds = np.searchsorted(owner[order], np.arange(count + 1))
    inks: list[np.ndarray] = []
    weights: list[float] = []
    for start, end in pairwise(bounds):
        colours, sizes = _component_inks(values[order[start:end]])
        inks.extend(colours)
        weights.extend(sizes)
    small = _small_inks(levels, flat)
    # Every component has an ink of its own, so that most of them are there many times.
    others = np.unique(np.array(inks + [colour for colour, _ in small]), axis=0)
    lines = _lines(levels, flat, others) if small else np.zeros(0)
    for colour, size in small:
        if not _is_line(levels, colour, size, others, lines):
            inks.append(colour)
            weights.append(size)
    return _limited(np.array(inks), np.array(weights))


def _small_inks(levels: np.ndarray, flat: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Inks, and their px, of shapes too small for a flat pixel: blends on edges hardly ever fill a square of 2 x 2 px
    with one colour.
    """
    near = ndimage.binary_dilation(flat, np.ones((3, 3), dtype=bool))
    corners = [levels[y : levels.shape[0] - 1 + y, x : levels.shape[1] - 1 + x] for y in (0, 1) for x in (0, 1)]
    free = ~np.logical_or.reduce(
        [near[y : near.shape[0] - 1 + y, x : near.shape[1] - 1 + x] for y in (0, 1) for x in (0, 1)]
    )
    even = free & (largest(np.ptp(np.stack(corners), axis=0)) <= SQUARE_RANGE)
    colours, counts = np.unique(np.rint(corners[0][even]), axis=0, return_counts=True)
    common = np.argsort(-counts, kind="stable")[:MOST_SMALL]
    return [(colours[i].astype(float), float(counts[i])) for i in common if counts[i] >= FEWEST_SQUARES]


def _lines(levels: np.ndarray, flat: np.ndarray, inks: np.ndarray) -> np.ndarray:
    """(P,) of how many px away from all flat ones every ink (P, 4) is."""
    thin = levels[~ndimage.binary_dilation(flat, np.ones((3, 3), dtype=bool))]
    colours, counts = np.unique(thin, axis=0, return_counts=True)
    return np.array([counts[largest(np.abs(colours - ink)) <= SQUARE_RANGE].sum() for ink in inks])


def _is_line(levels: np.ndarray, colour: np.ndarray, size: float, inks: np.ndarray, lines: np.ndarray) -> bool:
    """Whether a small ink is what a line of another ink makes of two rows of pixels that it fills in part.

    A line of 1.5 px in the middle of two rows leaves both the same blend of it with the ground. inks: (P, 4) all that
    there are; lines: (P,) their px in thin lines.
    """
    here = largest(np.abs(levels - colour)) <= SQUARE_RANGE
    square = here[:-1, :-1] & here[1:, :-1] & here[:-1, 1:] & here[1:, 1:]
    y, x = np.nonzero(square)
    if not len(y):
        return False
    padded = np.pad(levels, ((1, 2), (1, 2), (0, 0)), mode="edge")
    above, below = padded[y, x + 1], padded[y + 3, x + 1]
    left, right = padded[y + 1, x], padded[y + 1, x + 3]
    sides = np.stack([[above, below], [left, right]])
    for ground in inks:
        between = np.all(largest(np.abs(sides - ground)) <= SAME, axis=1)
        if np.any(between, axis=0).mean() < BETWEEN:
            continue
        spans = inks - ground
        share = (spans @ (colour - ground)) / np.maximum((spans * spans).sum(axis=1), 1e-9)
        rest = np.abs(colour - ground - share[:, None] * spans).max(axis=1)
        blended = (rest <= BLEND_LEVELS) & (share > BLEND_SHARES[0]) & (share < BLEND_SHARES[1])
        if (blended & (lines > MORE * size)).any():
            return True
    return False


def _component_inks(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if np.ptp(values, axis=0).max() <= GRADIENT_RANGE:
        return _mode(values)[None], np.array([float(len(values))])
    return _banded(values)


def _mode(values: np.ndarray) -> np.ndarray:
    """The commonest colour, or the median where none is common."""
    whole = np.rint(values).astype(np.int64)
    keys = ((whole[:, 0] * 256 + whole[:, 1]) * 256 + whole[:, 2]) * 256 + whole[:, 3]
    _, first, counts = np.unique(keys, return_index=True, return_counts=True)
    best = int(counts.argmax())
    if counts[best] * 4 >= len(values):
        return values[first[best]].astype(float)
    return np.median(values, axis=0).astype(float)


def _banded(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    cells = np.floor(values / (2.0 * BAND)).astype(np.int64)
    _, index, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    sums = np.stack([np.bincount(index, values[:, c], len(counts)) for c in range(4)], axis=1)
    return sums / counts[:, None], counts.astype(float)


def _limited(inks: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Near inks joined to the commoner one; then the commonest."""
    kept: list[np.ndarray] = []
    sizes: list[float] = []
    for i in np.argsort(-weights, kind="stable"):
        if kept:
            gaps = np.abs(np.array(kept) - inks[i]).max(axis=1)
            nearest = int(gaps.argmin())
            if gaps[nearest] <= SAME:
                sizes[nearest] += weights[i]
                continue
        if len(kept) < 512:
            kept.append(inks[i])
            sizes.append(float(weights[i]))
    order = np.argsort(-np.array(sizes), kind="stable")[:MOST_INKS]
    return np.array(kept)[order]


def eight_bit(ink: np.ndarray) -> tuple[int, int, int, int]:
    """An ink in levels, premultiplied, as the 8-bit colour and opacity that a file holds."""
    alpha = int(np.clip(round(float(ink[3])), 0, 255))
    if alpha == 0:
        return (0, 0, 0, 0)
    r, g, b = (int(np.clip(round(float(v) * 255.0 / float(ink[3])), 0, 255)) for v in ink[:3])
    return (r, g, b, alpha)
