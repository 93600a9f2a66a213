"""Pictures that were made larger by a whole number: how they were before, which holds all that is in them.

Enlarging is linear, by a known kernel along columns and then along rows, each time to whole levels from 0 to 255; so it
is undone by least squares. That it was done shows in that doing it again gives the picture, to a level or two.
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

FACTORS = (2, 3, 4)
MOST_REPEATED = 8  # times that pixels are looked for
# Differences in levels, along a line of pixels, that are an edge; what doing it again may be off, and for which share
# of the pixels at edges; how many of these and how many lines are looked at to begin with.
EDGE, OFF, EXACT, FEWEST, LINES = 16.0, 2.5, 0.97, 64, 16
CLIPPED = 6  # rounds in which values beyond 0 and 255 are found


def before_enlargement(levels: np.ndarray) -> tuple[np.ndarray, int]:
    """The picture (H, W, 4) in levels as it was, and by what it was made larger: itself and 1 where it was not."""
    times = _repeated(levels)
    if times > 1:
        return levels[::times, ::times], times
    blur = edge_blur(levels)
    if blur is not None and blur < LEAST_BLUR:
        return levels, 1
    factors = [factor for factor in FACTORS if 8 * factor <= min(levels.shape[:2])]
    if not factors or _sharp(few := _steepest(levels)):
        return levels, 1
    for factor in factors:
        kernel, off = min(((kernel, _tried(few, factor, kernel)) for kernel in KERNELS), key=lambda found: found[1])
        small = _undone(levels, factor, kernel) if off <= OFF else None
        if small is not None:
            return small, factor
    return levels, 1


def _repeated(levels: np.ndarray) -> int:
    """Return how often each pixel is repeated along rows and columns; 1 for shapes that merely lie on a grid."""
    for times in range(MOST_REPEATED, 1, -1):
        height, width = (side // times * times for side in levels.shape[:2])
        if min(height, width) < 8 * times:
            continue
        small = levels[:height:times, :width:times]
        others = (levels[y:height:times, x:width:times] for y in range(times) for x in range(times))
        if all((other == small).all() for other in others):
            return times if _blends(small) >= FEWEST else 1
    return 1


def _blends(levels: np.ndarray) -> int:
    """The number of pixels that lie between their neighbours to either side: smoothed edges have them."""
    before, here, after = levels[:, :-2], levels[:, 1:-1], levels[:, 2:]
    between = (np.minimum(before, after) < here) & (here < np.maximum(before, after))
    return int(between.any(axis=-1).sum())


def _steepest(levels: np.ndarray) -> np.ndarray:
    """(H, LINES, 4) the columns of a picture that change most from one pixel to the next."""
    steep = largest(np.abs(np.diff(levels, axis=0))).max(axis=0)
    return levels[:, np.argsort(-steep, kind="stable")[:LINES]]


def _sharp(lines: np.ndarray) -> bool:
    """True if lines (H, n, 4) go from one even colour to another within two steps, in too many places: any kernel that
    spans a pixel of the smaller picture takes three and more, none of them small.
    """
    steps = largest(np.abs(np.diff(lines, axis=0)))
    across = largest(np.abs(lines[3:-1] - lines[1:-3]))
    sharp = (across > EDGE) & (steps[:-3] <= OFF) & (steps[3:] <= OFF)
    return bool(sharp.sum() > (1.0 - EXACT) * (steps > EDGE).sum())


def _tried(few: np.ndarray, factor: int, kernel: Callable[[np.ndarray], np.ndarray]) -> float:
    """By how many levels lines (H, n, 4) are off, in the mean at edges, when they are made smaller and larger."""
    down = _enlarging(len(few), factor, kernel)
    off, edge = _off(few, _inverse(few, down), down)
    return float(off[edge].mean()) if edge.any() else np.inf


def _undone(levels: np.ndarray, factor: int, kernel: Callable[[np.ndarray], np.ndarray]) -> np.ndarray | None:
    """The smaller picture, None where the picture is not that one made larger."""
    height, width = levels.shape[:2]
    down, across = _enlarging(height, factor, kernel), _enlarging(width, factor, kernel)
    half = _inverse(levels, down)
    rows = half.swapaxes(0, 1)
    small = _inverse(rows, across)
    if not (_exact(levels, half, down) and _exact(rows, small, across)):
        return None
    return np.ascontiguousarray(small.swapaxes(0, 1), dtype=np.float32)


def _exact(lines: np.ndarray, small: np.ndarray, enlarging: sparse.csr_matrix) -> bool:
    """Return whether lines (H, n, 4) are small ones (h, n, 4) made larger."""
    off, edge = _off(lines, small, enlarging)
    return bool(edge.sum() >= FEWEST and (off[edge] <= OFF).mean() >= EXACT)


def _off(lines: np.ndarray, small: np.ndarray, enlarging: sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray]:
    """(H, n) levels by which lines (H, n, 4) are off small ones (h, n, 4) made larger, and where edges are."""
    again = (enlarging @ small.reshape(len(small), -1)).reshape(lines.shape)
    off = largest(np.abs(np.clip(again, 0, 255) - lines))
    edge = largest(np.abs(np.gradient(lines, axis=0))) > EDGE
    return off, ndimage.maximum_filter(edge, (5, 1))


def _inverse(lines: np.ndarray, enlarging: sparse.csr_matrix) -> np.ndarray:
    """(h, n, 4) whole levels whose enlarged lines are nearest to those given (H, n, 4), beyond 0 and 255 anywhere."""
    from scipy.linalg import cho_solve_banded, cholesky_banded  # see _enlarging

    gram = (enlarging.T @ enlarging).todia()
    bands = np.zeros((int(gram.offsets.max()) + 1, gram.shape[0]))
    for offset, diagonal in zip(gram.offsets, gram.data, strict=True):
        if offset <= 0:
            # Below the diagonal a row of dia format begins where the diagonal does.
            bands[-offset, : gram.shape[0] + offset] = diagonal[: gram.shape[0] + offset]
    factors = (cholesky_banded(bands, lower=True), True)
    flat = lines.reshape(len(lines), -1).astype(np.float64)
    low, high = flat <= 0.5, flat >= 254.5
    small = cho_solve_banded(factors, enlarging.T @ flat)
    for _ in range(CLIPPED if low.any() or high.any() else 0):
        small = np.clip(small, 0.0, 255.0)
        drawn = enlarging @ small
        wanted = np.where(low, np.minimum(drawn, flat), np.where(high, np.maximum(drawn, flat), flat))
        small = cho_solve_banded(factors, enlarging.T @ wanted)
    return np.clip(np.rint(small), 0.0, 255.0).reshape(-1, *lines.shape[1:])


def _enlarging(length: int, factor: int, kernel: Callable[[np.ndarray], np.ndarray]) -> sparse.csr_matrix:
    """(length, ceil(length / factor)) what each px of the larger line takes of those of the smaller one."""
    from scipy import sparse  # takes a while to import, and few pictures are soft enough to be looked at here

    count = -(-length // factor)
    at = (np.arange(length) + 0.5) / factor - 0.5
    weights = kernel(at[:, None] - np.arange(count))
    return sparse.csr_matrix(weights / weights.sum(axis=1, keepdims=True))


def _cubic(x: np.ndarray, a: float) -> np.ndarray:
    """Cubic convolution (Keys 1981)."""
    x = np.abs(x)
    inner = ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0
    outer = (((x - 5.0) * x + 8.0) * x - 4.0) * a
    return np.where(x <= 1.0, inner, np.where(x < 2.0, outer, 0.0))


# Linear, cubic of two kinds, and Lanczos'.
KERNELS: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
    lambda x: _cubic(x, -0.5),
    lambda x: np.maximum(0.0, 1.0 - np.abs(x)),
    lambda x: _cubic(x, -0.75),
    lambda x: np.where(np.abs(x) < 3.0, np.sinc(x) * np.sinc(x / 3.0), 0.0),
)
