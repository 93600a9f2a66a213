"""Pixel art, QR codes and checkers: pictures of square cells of one colour each, whose corners are the drawing itself.

Their steps are meant, so nothing is smoothed. What tells them from a smoothed drawing that was made larger is that no
colour is there only to blend two others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

# Along a side: cells of two px and more, and single pixels. Larger pictures of those without smoothing are drawings,
# whose staircases are not meant.
MOST_CELLS, MOST_PIXELS = 256, 64
MANY = 32  # with fewer each way, steps are those of shapes on a grid
# Colours that any picture may have, and cells for each where there are more.
FEW_COLOURS, CELLS_EACH, MOST_COLOURS = 16, 64, 64
# With more than those few most steps between cells of different colours are greater than this, levels: those of a photo
# in few colours, each pixel made larger, are not.
SOFT, MOST_SOFT = 24.0, 0.5
# Corners where cells of different colours meet, over all cells, and of cells of two px and more at least: with less
# it is a few shapes on a grid. In a picture of so few px each counts.
LEAST_SHARE, LEAST_CORNERS, FEW_PIXELS = 1.0 / 64.0, 16, 64
# A pixel is a blend where it lies between those to either side, so many levels off the line between their colours; a
# colour where so much of it is; a picture is smoothed where so many of the pixels at edges have such a colour.
OFF, BLENDING, SMOOTHED = 6.0, 2.0 / 3.0, 0.05
_ROWS = 64


@dataclass(frozen=True, eq=False)
class Cells:
    """numbers: (R, C) int, which of the colours each cell has. colours: (K, 4) float64 premultiplied RGBA in levels of
    0..255. x: (C + 1,) and y: (R + 1,) float64, px, where columns and rows of cells begin and end. side: of a whole
    cell, px.
    """

    numbers: np.ndarray
    colours: np.ndarray
    x: np.ndarray
    y: np.ndarray
    side: int

    @property
    def notes(self) -> list[str]:
        """What the user should know of it, a sentence each."""
        rows, columns = self.numbers.shape
        return [f"drawn as the {columns} x {rows} pixels that it is made of"] if self.side > 1 else []


def cells_of(target: np.ndarray) -> Cells | None:
    """The cells of a picture, (H, W, 3) or (H, W, 4) premultiplied, float32 in [0, 1]; None for all others."""
    height, width = target.shape[:2]
    changes = _changes(target)
    if changes is None:
        return None
    side, x, y = _grid(*changes, width, height)
    rows, columns = len(y) - 1, len(x) - 1
    if max(rows, columns) > (MOST_CELLS if side > 1 else MOST_PIXELS):
        return None
    small = 255.0 * target[np.ix_(y[:-1].astype(int), x[:-1].astype(int))].astype(np.float64)
    if small.shape[2] == 3:
        small = np.concatenate([small, np.full_like(small[..., :1], 255.0)], axis=2)
    colours, numbers = np.unique(small.reshape(-1, 4), axis=0, return_inverse=True)
    numbers = numbers.reshape(rows, columns)
    if len(colours) > min(MOST_COLOURS, max(FEW_COLOURS, numbers.size // CELLS_EACH)):
        return None
    if len(colours) > FEW_COLOURS and _soft(small) > MOST_SOFT:
        return None
    if height * width > FEW_PIXELS:
        least = max(LEAST_SHARE * numbers.size, LEAST_CORNERS if side > 1 else 1)
        if _corners(numbers) < least or _smoothed(small, numbers, len(colours)):
            return None
    return Cells(numbers, colours, x, y, side)


def without_repeats(target: np.ndarray) -> np.ndarray:
    """A picture (H, W, C) with one pixel for each of its cells, where these are of two px and more, and MANY or more
    each way; others as they are.
    """
    changes = _changes(target)
    if changes is None:
        return target
    side, x, y = _grid(*changes, target.shape[1], target.shape[0])
    if side < 2 or min(len(x), len(y)) <= MANY:
        return target
    return target[np.ix_(y[:-1].astype(int), x[:-1].astype(int))]


def _changes(target: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The columns (n,) and rows (m,) that differ from the one before; None as soon as they are those of no cells."""
    height, width = target.shape[:2]
    columns, rows = np.zeros(max(0, width - 1), dtype=bool), np.zeros(max(0, height - 1), dtype=bool)
    for top in range(0, height, _ROWS):
        part = target[top : top + _ROWS]
        columns |= (part[:, 1:] != part[:, :-1]).any(axis=(0, 2))
        down = target[max(0, top - 1) : top + _ROWS]
        rows[max(0, top - 1) : max(0, top - 1) + len(down) - 1] = (down[1:] != down[:-1]).any(axis=(1, 2))
        if max(height, width) > MOST_PIXELS and _step(columns, rows) == 1:
            return None
    return np.flatnonzero(columns) + 1, np.flatnonzero(rows) + 1


def _step(columns: np.ndarray, rows: np.ndarray) -> int:
    """The largest number of px that all distances between changes (bool) are whole times of, 0 where there are none."""
    gaps = np.concatenate([np.diff(np.flatnonzero(columns)), np.diff(np.flatnonzero(rows))])
    return int(np.gcd.reduce(gaps)) if len(gaps) else 0


def _grid(columns: np.ndarray, rows: np.ndarray, width: int, height: int) -> tuple[int, np.ndarray, np.ndarray]:
    """The side of the cells between changes in columns (n,) and rows (m,), and the ends of all cells across (C + 1,)
    and down (R + 1,).
    """
    gaps = np.concatenate([np.diff(columns), np.diff(rows)])
    # Without two changes along a side the canvas's border is as good as one.
    side = int(np.gcd.reduce(gaps)) if len(gaps) else math.gcd(*columns.tolist(), *rows.tolist(), width, height)
    return side, _ends(columns, side, width), _ends(rows, side, height)


def _ends(changes: np.ndarray, side: int, length: int) -> np.ndarray:
    first = int(changes[0]) % side if len(changes) else 0
    inner = np.arange(first or side, length, side)
    return np.concatenate([[0], inner, [length]]).astype(float)


def _soft(levels: np.ndarray) -> float:
    """The share of the steps between neighbouring cells (R, C, 4), levels, of different colours that are soft."""
    steps = np.concatenate([np.abs(np.diff(levels, axis=axis)).max(axis=2).ravel() for axis in (0, 1)])
    return float((steps[steps > 0.0] <= SOFT).mean())


def _smoothed(levels: np.ndarray, numbers: np.ndarray, count: int) -> bool:
    """Whether some of the colours of cells (R, C, 4), levels, are there to smooth edges."""
    blend = _between(levels) | _between(levels.swapaxes(0, 1)).swapaxes(0, 1)
    share = np.bincount(numbers[blend], minlength=count) / np.bincount(numbers.ravel(), minlength=count)
    edge = np.zeros(numbers.shape, dtype=bool)
    for axis in (0, 1):
        differs = np.diff(numbers, axis=axis) != 0
        ahead, behind = (np.zeros_like(edge) for _ in range(2))
        np.moveaxis(ahead, axis, 0)[:-1] = np.moveaxis(differs, axis, 0)
        np.moveaxis(behind, axis, 0)[1:] = np.moveaxis(differs, axis, 0)
        edge |= ahead | behind
    return bool((blend & (share >= BLENDING)[numbers]).sum() > SMOOTHED * edge.sum())


def _between(levels: np.ndarray) -> np.ndarray:
    """(R, C) bool: the colour lies on the line between those to the left and to the right, away from both."""
    before, here, after = levels[:, :-2], levels[:, 1:-1], levels[:, 2:]
    span = after - before
    length = (span * span).sum(axis=2)
    t = ((here - before) * span).sum(axis=2) / np.maximum(length, 1e-6)
    off = np.abs(here - before - t[..., None] * span).max(axis=2)
    out = np.zeros(levels.shape[:2], dtype=bool)
    out[:, 1:-1] = (off <= OFF) & (np.minimum(t, 1.0 - t) * np.sqrt(length) > OFF)
    return out


def _corners(numbers: np.ndarray) -> int:
    """The number of points at which an outline turns, or several meet."""
    a, b, c, d = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, :-1], numbers[1:, 1:]
    return int((~((a == b) & (c == d)) & ~((a == c) & (b == d))).sum())
