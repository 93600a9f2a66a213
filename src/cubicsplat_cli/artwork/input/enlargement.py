"""Undo the enlargement of a picture by a whole number: the smaller picture holds all that is in it.

Enlarging is linear, by one of a few kernels along columns and then along rows, each time to whole levels from 0 to 255;
so least squares undo it. A picture was enlarged if enlarging the smaller one gives it back, to a level or two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.input.condition import LEAST_BLUR, edge_blur
from cubicsplat_cli.raster import ndimage

if TYPE_CHECKING:
    from scipy import sparse

EDGE, OFF = 16.0, 2.5  # levels between neighbours at an edge, and by which repeating the enlargement may be off
EXACT = 0.97  # share of the pixels at edges that must be as near as that
FEWEST = 64  # pixels at edges, or blends, that are evidence enough


def before_enlargement(levels: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the picture (H, W, 4) in levels as it was before it was enlarged, and the factor; itself and 1 if it was
    not.
    """
    times = _repeated(levels)
    if times > 1:
        return levels[::times, ::times], times
    blur = edge_blur(levels)
    if blur is not None and blur < LEAST_BLUR:
        return levels, 1
    factors = [factor for factor in (2, 3, 4) if 8 * factor <= min(levels.shape[:2])]
    if not factors:
        return levels, 1
    # The 16 columns that change most from one pixel to the next.
    steep = largest(np.abs(np.diff(levels, axis=0))).max(axis=0)
    columns = levels[:, np.argsort(-steep, kind="stable")[:16]]
    if _sharp(columns):
        return levels, 1
    for factor in factors:
        errors = [_mean_error(columns, factor, kernel) for kernel in KERNELS]
        best = KERNELS[int(np.argmin(errors))]
        small = _undone(levels, factor, best) if min(errors) <= OFF else None
        if small is not None:
            return small, factor
    return levels, 1


def _repeated(levels: np.ndarray) -> int:
    """Return how often each pixel is repeated along rows and columns, 8 times at most; 1 for shapes that merely lie on
    a grid, without blends at their edges.
    """
    for times in range(8, 1, -1):
        height, width = (side // times * times for side in levels.shape[:2])
        if min(height, width) < 8 * times:
            continue
        small = levels[:height:times, :width:times]
        others = (levels[y:height:times, x:width:times] for y in range(times) for x in range(times))
        if all((other == small).all() for other in others):
            return times if _blends(small) >= FEWEST else 1
    return 1


def _blends(levels: np.ndarray) -> int:
    """Count the pixels whose colour lies between those of their neighbours to either side, as on smoothed edges."""
    before, here, after = levels[:, :-2], levels[:, 1:-1], levels[:, 2:]
    between = (np.minimum(before, after) < here) & (here < np.maximum(before, after))
    return int(between.any(axis=-1).sum())


def _sharp(lines: np.ndarray) -> bool:
    """Return True if lines (H, n, 4) go from one even colour to another within two steps in too many places, since
    every kernel takes three steps or more, none of them small.
    """
    steps = largest(np.abs(np.diff(lines, axis=0)))
    across = largest(np.abs(lines[3:-1] - lines[1:-3]))
    sharp = (across > EDGE) & (steps[:-3] <= OFF) & (steps[3:] <= OFF)
    return bool(sharp.sum() > (1.0 - EXACT) * (steps > EDGE).sum())


def _mean_error(lines: np.ndarray, factor: int, kernel: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the mean error in levels, at edges, of lines (H, n, 4) that are made smaller and enlarged again."""
    down = _enlarging(len(lines), factor, kernel)
    off, edge = _off(lines, _inverse(lines, down), down)
    return float(off[edge].mean()) if edge.any() else np.inf


def _undone(levels: np.ndarray, factor: int, kernel: Callable[[np.ndarray], np.ndarray]) -> np.ndarray | None:
    """Return the smaller picture; None if the picture is not that one enlarged."""
    lines = levels
    for _ in range(2):  # columns, then rows
        enlarging = _enlarging(len(lines), factor, kernel)
        small = _inverse(lines, enlarging)
        off, edge = _off(lines, small, enlarging)
        if edge.sum() < FEWEST or (off[edge] <= OFF).mean() < EXACT:
            return None
        lines = small.swapaxes(0, 1)
    return np.ascontiguousarray(lines, dtype=np.float32)


def _off(lines: np.ndarray, small: np.ndarray, enlarging: sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, n) levels by which lines (H, n, 4) are off enlarged ones (h, n, 4); and (H, n) bool, the edges."""
    again = (enlarging @ small.reshape(len(small), -1)).reshape(lines.shape)
    off = largest(np.abs(np.clip(again, 0, 255) - lines))
    edge = largest(np.abs(np.gradient(lines, axis=0))) > EDGE
    return off, ndimage.maximum_filter(edge, (5, 1))


def _inverse(lines: np.ndarray, enlarging: sparse.csr_matrix) -> np.ndarray:
    """Return (h, n, 4) whole levels whose enlarged lines are nearest to the given ones (H, n, 4). Values that enlarging
    takes beyond 0 or 255 are clipped there; six rounds find them.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded  # see _enlarging

    gram = (enlarging.T @ enlarging).todia()
    bands = np.zeros((int(gram.offsets.max()) + 1, gram.shape[0]))
    for offset, diagonal in zip(gram.offsets, gram.data, strict=True):
        if offset <= 0:
            # In dia format, diagonals below the main one begin at the start of their rows.
            bands[-offset, : gram.shape[0] + offset] = diagonal[: gram.shape[0] + offset]
    factors = (cholesky_banded(bands, lower=True), True)
    flat = lines.reshape(len(lines), -1).astype(np.float64)
    low, high = flat <= 0.5, flat >= 254.5
    small = cho_solve_banded(factors, enlarging.T @ flat)
    for _ in range(6 if low.any() or high.any() else 0):
        small = np.clip(small, 0.0, 255.0)
        again = enlarging @ small
        target = np.where(low, np.minimum(again, flat), np.where(high, np.maximum(again, flat), flat))
        small = cho_solve_banded(factors, enlarging.T @ target)
    return np.clip(np.rint(small), 0.0, 255.0).reshape(-1, *lines.shape[1:])


def _enlarging(length: int, factor: int, kernel: Callable[[np.ndarray], np.ndarray]) -> sparse.csr_matrix:
    """Return (length, ceil(length / factor)) the weights of the pixels of a smaller line in those of the larger one."""
    from scipy import sparse  # takes a while to import, and few pictures are soft enough to get here

    count = -(-length // factor)
    at = (np.arange(length) + 0.5) / factor - 0.5
    weights = kernel(at[:, None] - np.arange(count))
    return sparse.csr_matrix(weights / weights.sum(axis=1, keepdims=True))


def _cubic(x: np.ndarray, a: float) -> np.ndarray:
    """Return the kernel of cubic convolution at x (Keys 1981)."""
    x = np.abs(x)
    inner = ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0
    outer = (((x - 5.0) * x + 8.0) * x - 4.0) * a
    return np.where(x <= 1.0, inner, np.where(x < 2.0, outer, 0.0))


# Catmull and Rom's cubic, linear, the cubic of OpenCV, and Lanczos'.
KERNELS: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    lambda x: _cubic(x, -0.5),
    lambda x: np.maximum(0.0, 1.0 - np.abs(x)),
    lambda x: _cubic(x, -0.75),
    lambda x: np.where(np.abs(x) < 3.0, np.sinc(x) * np.sinc(x / 3.0), 0.0),
)
