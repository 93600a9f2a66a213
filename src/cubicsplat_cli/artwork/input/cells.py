"""Pixel art, QR codes and checkers: pictures of cells of one colour each, whose corners are the drawing itself.

Their steps are meant, so nothing is smoothed. What tells them from a smoothed drawing that was made larger is that no
colour is there only to blend two others; what tells single pixels from a drawing without smoothing, whose steps are not
meant, is how many of them stand alone or at the end of a line one pixel wide.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import ROWS, blend_of, largest
from cubicsplat_cli.artwork.input.grids import Grid, exact_grid, noisy_grid
from cubicsplat_cli.artwork.regions.fewer import fewer_colours, nearest_colours
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import distinct, steps
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels

# Colours that any picture may have; larger ones as many as the square root of their cells. Chosen on drawn sprites and
# scenes (K <= 0.6 sqrt(N)) against unsmoothed flags and emoji (1.1 sqrt(N) and more).
FEW_COLOURS = 16
# Share of the pixels at borders with at most one like neighbour of four: 0.20 to 0.55 in drawn sprites and scenes,
# below 0.2 in drawings without smoothing of 48 px and more. In pictures of up to SMALL px a side, where hardly anybody
# leaves smoothing out but on purpose: 0.04 and more in sprites, below 0.03 in plain symbols.
LEAST_ALONE, SMALL, LEAST_ALONE_SMALL = 0.2, 32, 0.03
# Share of the steps between cells of different colours that are soft, of up to SOFT levels: at most so many of single
# pixels, and of larger cells in more than FEW_COLOURS. Photos reduced to 16 colours have 0.24 and more.
SOFT, MOST_SOFT_PIXELS, MOST_SOFT = 24.0, 0.2, 0.5
# Corners where cells of different colours meet, over all cells, and of larger cells at least: with less it is a few
# shapes on a grid. In a picture of so few px each counts.
LEAST_SHARE, LEAST_CORNERS, FEW_PIXELS = 1.0 / 64.0, 16, 64
# More corners than that are the dots that stand for a photo's greys (0.65 to 0.79 by error diffusion), unless so much
# of the borders repeats every PERIOD px, as ordered dithering does (0.84 and more, error diffusion 0.22).
MOST_SHARE, PERIOD, REPEATS = 0.62, 4, 0.5
# A pixel is a blend where it lies between those to either side, so many levels off the line between their colours; a
# colour where so much of it is; a picture is smoothed where so many of the pixels at edges have such a colour.
OFF, BLENDING, SMOOTHED = 6.0, 2.0 / 3.0, 0.05
MANY = 32  # cells each way, from which on the style is measured on one pixel of each
MOST_CELLS = 2**20  # drawn; of a picture of that many different ones the file has tens of megabytes
# Colours of cells that are asked for, and the product with their number: each colour is sought among all cells.
MOST_COLOURS, MOST_WORK = 4096, 2**28
# A noisy picture is made of cells where its pixels inside these differ from their middles by so much of the steps
# between cells at most, rms, and where at most that share of them are off by a step: up to 0.0024 in JPEGs of sprites,
# 0.0055 and more in drawings whose borders happen to lie on a grid.
MOST_NOISE, MOST_STRANGE = 0.25, 0.004
# Colours within so many units of CIELAB are one, and those of few cells within that many times the noise.
SAME, SAME_NOISE = 5.0, 4.0
_SAMPLE = 2**16


@record
class Cells:
    """numbers: (R, C) int, which of the colours each cell has. colours: (K, 4) float64 premultiplied RGBA in levels of
    0..255. x: (C + 1,) and y: (R + 1,) float64, px, where columns and rows of cells begin and end. side: of a cell, px,
    on average. merged: how many colours there were before the likest were merged, 0 where none were.
    """

    numbers: np.ndarray
    colours: np.ndarray
    x: np.ndarray
    y: np.ndarray
    side: float
    merged: int = 0

    @property
    def notes(self) -> list[str]:
        """Notes for the user, a sentence each."""
        rows, columns = self.numbers.shape
        found = [f"drawn as the {columns} x {rows} pixels that it is made of"] if self.side > 1 else []
        if self.merged:
            found.append(f"drawn in {len(self.colours)} colours for {self.merged}, the likest of which were merged")
        return found

    def limited(self, most: int | None) -> Cells:
        """The same in at most so many visible colours, the likest merged."""
        visible = int((np.rint(self.colours[:, 3]) > 0).sum())
        if most is None or visible <= most:
            return self
        areas = np.bincount(self.numbers.ravel(), minlength=len(self.colours))
        return self._merged(*fewer_colours(self.colours, areas, most), self.merged or visible)

    def in_palette(self, palette: tuple[tuple[int, int, int], ...], tolerance: float | None = None) -> Cells:
        """The same in the nearest colours of a palette by `nearest_colours`; as it is where that is empty."""
        return self._merged(*nearest_colours(self.colours, palette, tolerance), self.merged) if palette else self

    def _merged(self, colours: np.ndarray, owner: np.ndarray, merged: int) -> Cells:
        return replace(self, numbers=owner[self.numbers], colours=colours, merged=merged)


def cells_of(target: np.ndarray) -> Cells | None:
    """The cells of a picture, (H, W, 3) or (H, W, 4) premultiplied, float32 in [0, 1]; None for all others."""
    return _exact_cells(target) or _noisy_cells(target)


def forced_cells(target: np.ndarray) -> Cells:
    """The cells that a picture is made of, whatever else it is; single pixels where it has none larger.

    In at most MOST_COLOURS colours, fewer of very many cells. Raises InputError where there are more than MOST_CELLS.
    """
    grid = exact_grid(target)
    rows, columns = len(grid.y) - 1, len(grid.x) - 1
    if rows * columns > MOST_CELLS:
        raise InputError(
            f"{columns} x {rows} cells are too many for the style pixel, which draws {MOST_CELLS:,} at most; "
            "give --max-size, or --style photo"
        )
    return _cells_on(target, grid).limited(min(MOST_COLOURS, MOST_WORK // (rows * columns)))


def without_repeats(target: np.ndarray) -> np.ndarray:
    """A picture (H, W, C) with one pixel for each of its cells, where these are larger than that, and MANY or more
    each way; others as they are.
    """
    grid = exact_grid(target)
    return target if min(len(grid.x), len(grid.y)) <= MANY else _sampled(target, grid)


def _exact_cells(target: np.ndarray) -> Cells | None:
    height, width = target.shape[:2]
    # Most photos have more colours in a few of their rows than any cells may have.
    if len(distinct(_keys(_levels(target[:ROWS, : _SAMPLE // ROWS])))[0]) > _most_colours(height * width):
        return None
    grid = exact_grid(target)
    count = (len(grid.x) - 1) * (len(grid.y) - 1)
    if count > MOST_CELLS:
        return None
    cells = _cells_on(target, grid)
    if len(cells.colours) > _most_colours(count):
        return None
    return cells if _are_meant(cells) else None


def _noisy_cells(target: np.ndarray) -> Cells | None:
    """The cells of a picture with noise, or a JPEG's artefacts; None where it is not made of cells."""
    levels = _levels(target)
    if levels.shape[2] == 4 and levels[..., 3].min() < 255.0:
        return None
    grid = noisy_grid(levels[..., :3])
    if grid is None or (len(grid.x) - 1) * (len(grid.y) - 1) > MOST_CELLS:
        return None
    middle = _medians(levels[..., :3], grid)
    off = largest(np.abs(levels[..., :3] - grid.enlarged(middle)))[_inner(grid)]
    noise, step = float(np.sqrt(np.mean(off**2))), _step(middle)
    if not 0.0 < noise <= MOST_NOISE * step or (off > step).mean() > MOST_STRANGE:
        return None
    colours, numbers = _distinct(middle)
    areas = np.bincount(numbers.ravel())
    colours, owner = fewer_colours(colours, areas, None, SAME, (SAME_NOISE * noise) ** 2)
    cells = Cells(owner[numbers], colours, grid.x.astype(float), grid.y.astype(float), grid.side)
    return cells if len(colours) <= _most_colours(numbers.size) and _are_meant(cells) else None


def _cells_on(target: np.ndarray, grid: Grid) -> Cells:
    colours, numbers = _distinct(_levels(_sampled(target, grid)))
    return Cells(numbers, colours, grid.x.astype(float), grid.y.astype(float), grid.side)


def _sampled(target: np.ndarray, grid: Grid) -> np.ndarray:
    """(R, C, ...) the first pixel of every cell; the same array where that is each."""
    return target if grid.side == 1.0 else target[grid.y[:-1]][:, grid.x[:-1]]


def _levels(target: np.ndarray) -> np.ndarray:
    return np.asarray(target, dtype=np.float32) * np.float32(255.0)


def _keys(levels: np.ndarray) -> np.ndarray:
    """(...) uint64 a number for each colour (..., 3 or 4) in levels."""
    parts = np.zeros((*levels.shape[:-1], 4), "<u2")
    np.rint(levels * 257.0, out=parts[..., : levels.shape[-1]], casting="unsafe")
    return parts.view("<u8")[..., 0]


def _distinct(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The different colours (K, 4) of cells (R, C, 3 or 4) in levels, and (R, C) which of them each has."""
    first, numbers = distinct(_keys(levels))
    colours = levels.reshape(-1, levels.shape[2])[first].astype(np.float64)
    return with_channels(colours, 4, 255.0), numbers


def _most_colours(cells: int) -> int:
    return max(FEW_COLOURS, math.isqrt(cells))


def _are_meant(cells: Cells) -> bool:
    """True if cells are what a picture is made of: pixel art, and no photo or drawing that has them by chance."""
    numbers, count = cells.numbers, len(cells.colours)
    small = max(numbers.shape) <= SMALL
    if count == 1:
        return False
    if numbers.size * cells.side**2 <= FEW_PIXELS:
        return True
    larger = cells.side > 1.0
    if _corners(numbers) < max(LEAST_SHARE * numbers.size, LEAST_CORNERS if larger else 1):
        return False
    if not larger and _alone(numbers) < (LEAST_ALONE_SMALL if small else LEAST_ALONE):
        return False
    if not larger and not small and _corners(numbers) > MOST_SHARE * numbers.size and _repeated(numbers) < REPEATS:
        return False
    levels = cells.colours[numbers]
    if larger or small:
        too_soft = count > FEW_COLOURS and _soft(levels) > MOST_SOFT
    else:
        too_soft = _soft(levels) > MOST_SOFT_PIXELS
    return not too_soft and not _smoothed(levels, numbers, count)


def _alone(numbers: np.ndarray) -> float:
    """The share of the pixels at borders, but for those of the picture, with at most one like neighbour of four."""
    like = _like(numbers, 1, 1).sum(axis=0)
    borders = int((like < 4).sum())
    return float((like <= 1).sum()) / borders if borders else 0.0


def _repeated(numbers: np.ndarray) -> float:
    """The share of the cells unlike a neighbour that are like those PERIOD cells to all four sides."""
    if min(numbers.shape) <= 2 * PERIOD:
        return 0.0
    border = ~_like(numbers, PERIOD, 1).all(axis=0)
    like = np.asarray(_like(numbers, PERIOD, PERIOD).all(axis=0))
    return float(like[border].mean()) if border.any() else 0.0


def _like(numbers: np.ndarray, rim: int, apart: int) -> np.ndarray:
    """(4, R - 2 rim, C - 2 rim) bool: the cells but for a rim that are like those so far above, below, and beside."""
    around = np.pad(numbers, apart)
    ways = ((0, apart), (2 * apart, apart), (apart, 0), (apart, 2 * apart))
    like = [around[y:, x:][: len(numbers), : numbers.shape[1]] == numbers for y, x in ways]
    return np.array(like)[:, rim:-rim, rim:-rim]


def _step(cells: np.ndarray) -> float:
    """Levels between neighbouring cells (R, C, 3) in the channel with most, rms."""
    return math.sqrt(np.mean(np.concatenate([np.diff(cells, axis=axis).ravel() ** 2 for axis in (0, 1)])))


def _medians(levels: np.ndarray, grid: Grid) -> np.ndarray:
    """(R, C, 3) the median of each cell of (H, W, 3), leaving out its rim where it is wide enough."""
    reach = max(1, int(grid.side / 4.0))
    rows, columns = (0.5 * (ends[1:] + ends[:-1] - 1) for ends in (grid.y, grid.x))
    offsets = np.arange(-reach, reach + 1) * 0.999
    at = [np.rint(np.add.outer(middles, offsets)).astype(int) for middles in (rows, columns)]
    at = [np.clip(each, 0, length - 1) for each, length in zip(at, levels.shape[:2], strict=True)]
    blocks = levels[at[0][:, None, :, None], at[1][None, :, None, :]]
    return np.median(blocks, axis=(2, 3))


def _inner(grid: Grid) -> np.ndarray:
    """(H, W) bool: the pixels that are not beside a border of cells."""
    inside = []
    for ends in (grid.y, grid.x):
        line = np.ones(int(ends[-1]), dtype=bool)
        line[ends[1:-1]] = line[ends[1:-1] - 1] = False
        inside.append(line)
    return inside[0][:, None] & inside[1][None]


def _soft(levels: np.ndarray) -> float:
    """The share of the steps between neighbouring cells (R, C, 4), levels, of different colours that are soft."""
    every = np.concatenate([each.ravel() for each in steps(levels)])
    return float((every[every > 0.0] <= SOFT).mean())


def _smoothed(levels: np.ndarray, numbers: np.ndarray, count: int) -> bool:
    """Return whether some of the colours of cells (R, C, 4), levels, are there to smooth edges."""
    blend = _between(levels) | _between(levels.swapaxes(0, 1)).swapaxes(0, 1)
    share = np.bincount(numbers[blend], minlength=count) / np.bincount(numbers.ravel(), minlength=count)
    edge = ~(ndimage.alike(numbers, (3, 1)) & ndimage.alike(numbers, (1, 3)))
    return bool((blend & (share >= BLENDING)[numbers]).sum() > SMOOTHED * edge.sum())


def _between(levels: np.ndarray) -> np.ndarray:
    """(R, C) bool: the colour lies on the line between those to the left and to the right, away from both."""
    differs = steps(levels)[1] > 0.0
    y, x = np.nonzero(differs[:, :-1] & differs[:, 1:])
    before, here, after = (levels[y, x + k] for k in range(3))
    t, rest = blend_of(here, before, after)
    away = np.minimum(t, 1.0 - t) * np.linalg.norm(after - before, axis=1)
    out = np.zeros(levels.shape[:2], dtype=bool)
    out[y, x + 1] = (largest(np.abs(rest)) <= OFF) & (away > OFF)
    return out


def _corners(numbers: np.ndarray) -> int:
    """The number of points at which an outline turns, or several meet."""
    a, b, c, d = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, :-1], numbers[1:, 1:]
    return int((~((a == b) & (c == d)) & ~((a == c) & (b == d))).sum())
