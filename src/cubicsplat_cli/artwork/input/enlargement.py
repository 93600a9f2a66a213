"""Undo the enlargement of a picture: the smaller picture holds all that is in it.

Enlarging is linear, by one of a few kernels along columns and then along rows, each time to whole levels from 0 to 255;
so least squares undo it. It makes the second differences of lines repeat with the factor, so that their spectrum has a
peak at the smaller length (Gallagher 2005). A picture was enlarged from such a length if enlarging the smaller one
gives it back, to a level or two, and from lengths a little off that it does not. One so soft that half the length
gives it back but for rounding is also drawn at that: nothing is lost, and edges are sharp there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache

import numpy as np

from cubicsplat_cli.artwork.channels import FULL, LUMA, largest
from cubicsplat_cli.artwork.input.grids import exact_grid
from cubicsplat_cli.artwork.regions.fills import EVEN
from cubicsplat_cli.raster import ndimage

# Levels between neighbours at an edge; by which repeating the enlargement may be off, at most and times the share of
# the pixels along an axis that the smaller picture lacks: 1.2 for a fifth.
EDGE, OFF, MISSING = 16.0, 2.5, 6.0
# The share of the steps at edges that may be sharp, as most of a clean picture's are; and that of an edge by which its
# sides may be off there: cubic kernels ring by 5 % and more.
SHARP, RINGS = 0.12, 0.02
FEWEST = 64  # pixels at edges, or blends, that are evidence enough
LOCAL = 31  # frequencies, and pixels of a side at least, among which a peak of the spectrum stands out
LINES, PEAKS = 32, 8  # columns and peaks that are tried; parts that repeat have peaks of their own
LEAST, MOST = 1.2, 16.0  # factors that are undone: less gains little, and more leaves few edges steep enough
USUAL = (1.25, 1.5, 1.75, 2.0, 3.0, 4.0)  # factors of screens and programs, tried whatever the spectrum
ASIDE, WORSE = 3, 2.2  # px by which other lengths are off, whose errors must be so many times as large


def before_enlargement(levels: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Return a picture (h, w, 4) in levels before it was enlarged, and the factors across and down, (1, 1) for none."""
    grid = exact_grid(levels)
    if grid.side > 1.0 and grid.x[1] == grid.y[1] == grid.side:
        small = grid.sampled(levels)
        # Shapes that merely lie on a grid have no blends at their edges.
        if _blends(small) >= FEWEST:
            return small, (grid.side, grid.side)
    if min(levels.shape[:2]) < LOCAL:
        return levels, (1.0, 1.0)
    seen = (levels[..., :3] @ LUMA.astype(levels.dtype))[..., None]  # chroma may be coarser
    if levels[..., 3].min() < FULL:
        seen = np.concatenate([seen, levels[..., 3:]], axis=-1)
    axes = seen, seen.swapaxes(0, 1)
    steepest = [_steepest(axis) for axis in axes]
    if _sharp(steepest):
        return levels, (1.0, 1.0)
    shares = {1.0 / times for times in USUAL} | {length / len(axis) for axis in axes for length in _peaks(axis)}
    lines = levels
    for axis in steepest:  # columns, then rows
        found = _before(axis, sorted({round(share * len(axis)) for share in shares}))
        if found is None:
            return levels, (1.0, 1.0)
        lines = _inverse(lines, *found)[0].swapaxes(0, 1)
    height, width = lines.shape[:2]
    return np.ascontiguousarray(lines, dtype=np.float32), (levels.shape[1] / width, levels.shape[0] / height)


def _blends(levels: np.ndarray) -> int:
    """Count the pixels whose colour lies between those of their neighbours to either side, as on smoothed edges."""
    before, here, after = levels[:, :-2], levels[:, 1:-1], levels[:, 2:]
    return int(((np.minimum(before, after) < here) & (here < np.maximum(before, after))).any(axis=-1).sum())


def _before(lines: np.ndarray, lengths: list[int]) -> tuple[int, Kernel] | None:
    """Return the likeliest of several lengths, give or take ASIDE px, from which lines (H, n, C) in levels were
    enlarged, and the kernel; half the length if they were from none of them, but hold no more than that; else None.
    """

    @cache
    def error(before: tuple[int, Kernel]) -> float:
        return _mean_error(lines, *before)

    def best(length: int) -> Kernel:
        return min(KERNELS, key=lambda kernel: error((length, kernel)))

    def stands_out(length: int) -> float:
        if error((length, KERNELS[0])) > 2.0 * OFF:
            return 0.0  # with another kernel the right length is never so far off
        kernel = best(length)
        # A smaller picture of nearly as many pixels holds much of any picture.
        if (least := error((length, kernel))) > min(OFF, MISSING * (1.0 - length / len(lines))):
            return 0.0
        return min(error((length + off, kernel)) for off in (-ASIDE, ASIDE)) / max(least, 1e-6)

    # Longer ones hold as much, but so do those beside them.
    length = max(lengths, key=stands_out)
    if stands_out(length) >= WORSE:
        near = range(length - ASIDE, length + ASIDE + 1)
        length = min(near, key=lambda other: error((other, best(length))))
        return length, best(length)
    half = len(lines) // 2, best(len(lines) // 2)
    return half if error(half) <= EVEN else None


def _peaks(seen: np.ndarray) -> Iterator[int]:
    """Yield the lengths at which the spectrum of second differences of lines (H, W, C) has peaks, highest first."""
    height = len(seen)
    bends = np.abs(np.diff(seen, 2, axis=0)).sum(axis=(1, 2), dtype=np.float64)
    spectrum = np.abs(np.fft.rfft(bends - bends.mean(), height))
    height_of = spectrum / (ndimage.uniform_filter(spectrum, LOCAL) + 1e-9)
    for frequency in np.argsort(-height_of, kind="stable")[:PEAKS]:
        # Of factors below 2, the frequency is beyond the highest one, and appears mirrored.
        for length in (int(frequency), height - int(frequency)):
            if LEAST <= height / max(length, 1) <= MOST:
                yield length


def _steepest(seen: np.ndarray) -> np.ndarray:
    """Return the columns (H, n, C) of lines (H, W, C) with the steepest edges, steepest first."""
    changes = largest(np.abs(np.diff(seen, axis=0))).max(axis=0)
    return seen[:, np.argsort(-changes, kind="stable")[:LINES]]


def _sharp(axes: Sequence[np.ndarray]) -> bool:
    """Return True if the lines (H, n, C) along both axes go from one even colour to another within two steps in too
    many places, since every kernel takes three steps or more, none of them small.
    """
    sharp = edges = 0
    for lines in axes:
        steps = largest(np.abs(np.diff(lines, axis=0)))
        across = largest(np.abs(lines[3:-1] - lines[1:-3]))
        even = np.maximum(steps[:-3], steps[3:]) <= np.minimum(OFF, RINGS * across)
        sharp += int((even & (across > EDGE)).sum())
        edges += int((steps > EDGE).sum())
    return sharp > SHARP * edges


def _mean_error(lines: np.ndarray, length: int, kernel: Kernel) -> float:
    """Return the mean error in levels, at edges, of lines (H, n, C) reduced and enlarged again; inf with few edges."""
    _, again = _inverse(lines, length, kernel)
    off = largest(np.abs(np.clip(again, 0, 255) - lines))
    # Enlarged more than 4 times, a step of 4 EDGE is an edge still, though spread over more px.
    steep = EDGE * min(1.0, 4.0 * length / len(lines))
    edge = ndimage.maximum_filter(largest(np.abs(np.gradient(lines, axis=0))) > steep, (5, 1))
    return float(off[edge].mean()) if edge.sum() >= FEWEST else np.inf


def _inverse(lines: np.ndarray, length: int, kernel: Kernel) -> tuple[np.ndarray, np.ndarray]:
    """Return lines (H, n, C) as they were before they were enlarged from (length, n, C), and enlarged again."""
    at = (np.arange(len(lines)) + 0.5) * (length / len(lines)) - 0.5
    near = np.floor(at).astype(int)[:, None] + np.arange(-2, 4)  # no kernel reaches 3 px
    weights = np.where((near >= 0) & (near < length), kernel(at[:, None] - near), 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    return ndimage.before_enlarging(lines, length, near[:, 0], weights)


def _cubic(x: np.ndarray, b: float, c: float) -> np.ndarray:
    """Return the cubic kernel of parameters b and c at x (Mitchell and Netravali 1988)."""
    x = np.abs(x)
    inner = (12.0 - 9.0 * b - 6.0 * c) * x**3 + (12.0 * b + 6.0 * c - 18.0) * x**2 + 6.0 - 2.0 * b
    outer = -(b + 6.0 * c) * x**3 + (6.0 * b + 30.0 * c) * x**2 - (12.0 * b + 48.0 * c) * x + 8.0 * b + 24.0 * c
    return np.where(x <= 1.0, inner, np.where(x < 2.0, outer, 0.0)) / 6.0


Kernel = Callable[[np.ndarray], np.ndarray]
# Catmull and Rom's cubic, linear, Mitchell and Netravali's, the cubic of OpenCV, and Lanczos'.
KERNELS: tuple[Kernel, ...] = (
    lambda x: _cubic(x, 0.0, 0.5),
    lambda x: np.maximum(0.0, 1.0 - np.abs(x)),
    lambda x: _cubic(x, 1.0 / 3.0, 1.0 / 3.0),
    lambda x: _cubic(x, 0.0, 0.75),
    lambda x: np.where(np.abs(x) < 3.0, np.sinc(x) * np.sinc(x / 3.0), 0.0),
)
