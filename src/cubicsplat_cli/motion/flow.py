"""Where the pixels of a frame are in the next: optical flow by least squares, from coarse to fine."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.raster.ndimage import uniform_filter1d

WINDOW = 9  # px: side of the square that moves as one
SMALLEST = 16  # px: no coarser copy of the frames has a shorter side
ROUNDS = 3  # of each copy
LONGEST = 1.0  # px: of a round, for which the pictures may be taken as linear
STIFFNESS = 3e-3  # squared gradient, in values a px, below which a place moves as little as it can


def flow(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(H, W, 2) float32: by how many px, x and y, what is at each pixel of a picture (H, W, C) moves to the next one.

    Lucas and Kanade (1981): the shift of a window with the least squared difference, of linearised pictures; first
    of copies of half the size (Bouguet, 2000).
    """
    height, width = before.shape[:2]
    shifts = np.zeros((height, width, 2), np.float32)
    if min(height, width) >= 2 * SMALLEST:
        coarse = 2.0 * flow(_halved(before), _halved(after)).repeat(2, axis=0).repeat(2, axis=1)
        shifts = np.pad(coarse, [(0, height - len(coarse)), (0, width - coarse.shape[1]), (0, 0)], mode="edge")
    around = np.pad(before, [(1, 1), (1, 1), (0, 0)], mode="edge")
    across, down = 0.5 * (around[1:-1, 2:] - around[1:-1, :-2]), 0.5 * (around[2:, 1:-1] - around[:-2, 1:-1])
    xx, xy, yy = (
        _windowed((first * second).sum(axis=2)) for first, second in ((across, across), (across, down), (down, down))
    )
    xx, yy = xx + STIFFNESS, yy + STIFFNESS
    determinant = xx * yy - xy * xy
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    for _ in range(ROUNDS):
        left = sampled(after, columns + shifts[..., 0], rows + shifts[..., 1]) - before
        x, y = _windowed((across * left).sum(axis=2)), _windowed((down * left).sum(axis=2))
        move = np.stack([xy * y - yy * x, xy * x - xx * y], axis=-1) / determinant[..., None]
        shifts = _windowed(shifts + move.clip(-LONGEST, LONGEST), WINDOW // 2)
    return shifts


def sampled(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(..., C): the values of a picture (H, W, C) between the middles of pixels, at these places (...) from the first;
    beyond the edge those of the edge.
    """
    height, width, channels = picture.shape
    x, y = x.clip(0.0, width - 1.0), y.clip(0.0, height - 1.0)
    left, top = x.astype(np.int32).clip(0, max(width - 2, 0)), y.astype(np.int32).clip(0, max(height - 2, 0))
    across, down = ((each - at).astype(np.float32)[..., None] for each, at in ((x, left), (y, top)))
    values, first = picture.reshape(-1, channels), top * width + left
    right, below = min(1, width - 1), width * min(1, height - 1)

    def between(at: np.ndarray) -> np.ndarray:
        here = values.take(at, axis=0)
        return here + across * (values.take(at + right, axis=0) - here)

    upper = between(first)
    return upper + down * (between(first + below) - upper)


def _windowed(values: np.ndarray, side: int = WINDOW) -> np.ndarray:
    """The mean over the square around each pixel."""
    across = uniform_filter1d(values, side, 1, mode="nearest")
    return uniform_filter1d(across, side, 0, mode="nearest").astype(np.float32)


def _halved(picture: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 pixels, without an odd last row or column."""
    height, width = (size // 2 * 2 for size in picture.shape[:2])
    even = picture[:height, :width]
    return (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / np.float32(4.0)
