"""Find the cells of pixel art, QR codes and checkers: pictures of cells of one colour each, whose steps are meant.

An enlarged picture with anti-aliasing has colours that only blend two others; pixel art has none. In an aliased
drawing, whose steps are not meant, few pixels stand alone or at the end of a line one pixel wide; in pixel art many do.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import ROWS, blend_of, largest
from cubicsplat_cli.artwork.input.condition import OUTLIER
from cubicsplat_cli.artwork.input.dither import dithered
from cubicsplat_cli.artwork.input.enlargement import before_enlargement
from cubicsplat_cli.artwork.input.grids import Grid, exact_grid, noisy_grid
from cubicsplat_cli.artwork.regions.fewer import fewer_colours, nearest_colours
from cubicsplat_cli.artwork.regions.fills import APART, SEEN
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import distinct, steps
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels

# Colours that any picture may have; larger ones as many as the square root of their cells: drawn sprites and scenes
# have up to 0.6 times that, aliased flags and emoji 1.1 times and more.
FEW_COLOURS = 16
SMALL = 32  # px a side of pictures in which hardly anybody omits anti-aliasing but on purpose
# Of as many different ones the file has tens of megabytes, and to find as many px in an enlarged picture takes seconds.
MOST_CELLS = 2**20


@record
class Cells:
    """numbers: (R, C) int, the colour of each cell. colours: (K, 4) float64 premultiplied RGBA in levels of 0..255. x:
    (C + 1,) and y: (R + 1,) float64, px, the borders of the columns and rows of cells. side: of a cell, px, on average.
    merged: the number of colours before the likest were merged, 0 if none were.
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
        notes = [f"drawn as the {columns} x {rows} pixels that it is made of"] if self.side > 1 else []
        if self.merged:
            notes.append(f"drawn in {len(self.colours)} colours for {self.merged}, the likest of which were merged")
        return notes

    def limited(self, most: int | None) -> Cells:
        """Return the same in at most so many visible colours, the likest merged."""
        visible = int((np.rint(self.colours[:, 3]) > 0).sum())
        if most is None or visible <= most:
            return self
        areas = np.bincount(self.numbers.ravel(), minlength=len(self.colours))
        return self._merged(*fewer_colours(self.colours, areas, most), self.merged or visible)

    def in_palette(self, palette: tuple[tuple[int, int, int], ...], tolerance: float | None = None) -> Cells:
        """Return the same in the nearest colours of a palette by `nearest_colours`; unchanged if that is empty."""
        return self._merged(*nearest_colours(self.colours, palette, tolerance), self.merged) if palette else self

    def _merged(self, colours: np.ndarray, owner: np.ndarray, merged: int) -> Cells:
        return replace(self, numbers=owner[self.numbers], colours=colours, merged=merged)


def cells_of(target: np.ndarray) -> Cells | None:
    """Return the cells of a picture, (H, W, 3) or (H, W, 4) premultiplied, float32 in [0, 1]; None if it has none."""
    return _exact_cells(target) or _noisy_cells(target) or _enlarged_cells(target)


def forced_cells(target: np.ndarray) -> Cells:
    """Return the cells of any picture, single pixels if it has none larger, in at most 4096 colours: fewer if they are
    very many, since each colour is sought among all cells. Raises InputError if there are more than MOST_CELLS.
    """
    grid = exact_grid(target)
    rows, columns = len(grid.y) - 1, len(grid.x) - 1
    if rows * columns > MOST_CELLS:
        raise InputError(
            f"{columns} x {rows} cells are too many for the style pixel, which draws {MOST_CELLS:,} at most; "
            "give --max-size, or --style photo"
        )
    return _cells_on(target, grid).limited(min(4096, 2**28 // (rows * columns)))


def without_repeats(target: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, C) with one pixel for each of its cells; unchanged if a side has less than 32 cells."""
    grid = exact_grid(target)
    return target if min(len(grid.x), len(grid.y)) <= 32 else grid.sampled(target)


def _exact_cells(target: np.ndarray) -> Cells | None:
    height, width = target.shape[:2]
    # Most photos have more colours in 2^16 pixels of their first rows than any cells may have.
    if len(distinct(_keys(_levels(target[:ROWS, : 2**16 // ROWS])))[0]) > _most_colours(height * width):
        return None
    grid = exact_grid(target)
    if (len(grid.x) - 1) * (len(grid.y) - 1) > MOST_CELLS:
        return None
    cells = _cells_on(target, grid)
    return cells if _are_meant(cells) else None


def _noisy_cells(target: np.ndarray) -> Cells | None:
    """Return the cells of a picture with noise, or a JPEG's artefacts; None if it is not made of cells.

    In cells, pixels differ from the middles by at most a quarter of the steps between cells, rms, and at most 0.004 of
    them by more than such a step: up to 0.0024 in JPEGs of sprites, 0.0055 and more in drawings whose borders happen to
    lie on a grid. At most 1 in 100 cells is several times less even than nine in ten are.
    """
    levels = _levels(target)
    if levels.shape[2] == 4 and levels[..., 3].min() < 255.0:
        return None
    grid = noisy_grid(levels[..., :3])
    if grid is None or (len(grid.x) - 1) * (len(grid.y) - 1) > MOST_CELLS:
        return None
    middle = _medians(levels[..., :3], grid)
    # Pixels beside a border of cells do not count.
    rows, columns = (~np.isin(np.arange(ends[-1]), [ends[1:-1], ends[1:-1] - 1]) for ends in (grid.y, grid.x))
    inner = rows[:, None] & columns
    off = largest(np.abs(levels[..., :3] - grid.enlarged(middle))) * inner
    noise = float(np.sqrt(np.mean(off[inner] ** 2)))
    step = math.sqrt(np.mean(np.concatenate([np.diff(middle, axis=axis).ravel() ** 2 for axis in (0, 1)])))
    if not 0.0 < noise <= 0.25 * step or (off[inner] > step).mean() > 0.004:
        return None
    # Where a logo lies on a code, more than noise differs within cells.
    # Cells of a px at the picture's border, and of 2 px, have no pixel that is not beside a border.
    uneven = np.sqrt(_cell_means(off**2, grid) / np.maximum(_cell_means(inner, grid), 1e-9))
    if (uneven > max(0.15 * step, 4.0 * float(np.quantile(uneven, 0.9)))).mean() > 0.01:
        return None
    # Colours within 5 units of CIELAB are one, and those of few cells within four times the noise.
    colours, numbers = _merged(middle, 5.0, (OUTLIER * noise) ** 2)
    cells = Cells(numbers, colours, grid.x.astype(float), grid.y.astype(float), grid.side)
    return cells if _are_meant(cells) else None


def _enlarged_cells(target: np.ndarray) -> Cells | None:
    """Return the cells of a picture that was enlarged smoothly; None if it has none, or to find them takes seconds."""
    if target.shape[0] * target.shape[1] > MOST_CELLS:
        return None
    small, (across, down) = before_enlargement(with_channels(_levels(target), 4, 255.0))
    if across == down == 1.0:
        return None
    colours, numbers = _merged(small, 2.0)  # rounded twice
    plain = colours[numbers].astype(np.float32) / np.float32(255.0)
    cells = _cells_on(plain, exact_grid(plain))
    if not _are_meant(cells, enlarged=True):
        return None
    return replace(cells, x=cells.x * across, y=cells.y * down, side=cells.side * math.sqrt(across * down))


def _cells_on(target: np.ndarray, grid: Grid) -> Cells:
    colours, numbers = _distinct(_levels(grid.sampled(target)))
    return Cells(numbers, colours, grid.x.astype(float), grid.y.astype(float), grid.side)


def _levels(target: np.ndarray) -> np.ndarray:
    return np.asarray(target, dtype=np.float32) * np.float32(255.0)


def _keys(levels: np.ndarray) -> np.ndarray:
    """Return (...) uint64 a number for each colour (..., 3 or 4) in levels."""
    parts = np.zeros((*levels.shape[:-1], 4), "<u2")
    np.rint(levels * 257.0, out=parts[..., : levels.shape[-1]], casting="unsafe")
    return parts.view("<u8")[..., 0]


def _distinct(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the different colours (K, 4) of cells (R, C, 3 or 4) in levels, and (R, C) the number of each cell's."""
    first, numbers = distinct(_keys(levels))
    return with_channels(levels.reshape(-1, levels.shape[2])[first].astype(np.float64), 4, 255.0), numbers


def _merged(levels: np.ndarray, apart: float, free: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the same as `_distinct`, with like colours merged by `fewer_colours`."""
    colours, numbers = _distinct(levels)
    colours, owner = fewer_colours(colours, np.bincount(numbers.ravel()), None, apart, free)
    return colours, owner[numbers]


def _most_colours(cells: int) -> int:
    return max(FEW_COLOURS, math.isqrt(cells))


def _are_meant(cells: Cells, *, enlarged: bool = False) -> bool:
    """Return True if a picture is made of cells: pixel art, and no photo or drawing that has them by chance. enlarged:
    True if the picture was enlarged smoothly, to these pixels times a factor.
    """
    numbers, count, larger = cells.numbers, len(cells.colours), cells.side > 1.0
    small, levels = max(numbers.shape) <= SMALL, cells.colours[numbers]
    pixels = not (larger or small)
    if not 1 < count <= _most_colours(numbers.size):
        return False
    if numbers.size * cells.side**2 <= 64:  # px, so few that each counts
        return True
    # With fewer corners it is a few shapes on a grid.
    if _corners(numbers) < max(numbers.size / 64.0, 16 if larger else 1):
        return False
    # Of the pixels at borders, 0.2 to 0.55 stand alone in drawn sprites and scenes, and less in aliased drawings of 48
    # px and more; in small pictures 0.04 and more in sprites, less than 0.03 in plain symbols.
    if not larger and _alone(numbers) < (0.03 if small else 0.2):
        return False
    # Colours that dots stand for are meant, and not their pixels; but a program dithers whole pictures, and no small
    # sprite. Who enlarges a picture sees its pixels.
    dither = dithered(levels) if pixels and not enlarged else None
    if dither is not None and dither.most:
        return False
    # Photos reduced to 16 colours have 0.24 or more of soft steps.
    if (pixels or count > FEW_COLOURS) and _soft(levels) > (0.2 if pixels else 0.5):
        return False
    return not _smoothed(levels, numbers, count)


def _alone(numbers: np.ndarray) -> float:
    """Return the share of the pixels at borders of cells that have at most one like neighbour of four."""
    inner = numbers[1:-1, 1:-1]
    around = numbers[:-2, 1:-1], numbers[2:, 1:-1], numbers[1:-1, :-2], numbers[1:-1, 2:]
    like = np.sum([each == inner for each in around], axis=0)
    borders = int((like < 4).sum())
    return float((like <= 1).sum()) / borders if borders else 0.0


def _medians(levels: np.ndarray, grid: Grid) -> np.ndarray:
    """Return (R, C, 3) the median of the middle half of each cell of (H, W, 3), and of 3 x 3 px at least."""
    reach = max(1, int(grid.side / 4.0))
    rows, columns = (0.5 * (ends[1:] + ends[:-1] - 1) for ends in (grid.y, grid.x))
    offsets = np.arange(-reach, reach + 1) * 0.999
    at = [np.rint(np.add.outer(middles, offsets)).astype(int) for middles in (rows, columns)]
    at = [np.clip(index, 0, length - 1) for index, length in zip(at, levels.shape[:2], strict=True)]
    return np.median(levels[at[0][:, None, :, None], at[1][None, :, None, :]], axis=(2, 3))


def _cell_means(values: np.ndarray, grid: Grid) -> np.ndarray:
    """Return (R, C) the mean of the values (H, W) in each cell."""
    sums = np.add.reduceat(np.add.reduceat(values, grid.y[:-1], axis=0, dtype=float), grid.x[:-1], axis=1)
    return sums / np.outer(np.diff(grid.y), np.diff(grid.x))


def _soft(levels: np.ndarray) -> float:
    """Return the share of the steps between neighbouring cells (R, C, 4) of different colours that are no edges."""
    sizes = np.concatenate([plane.ravel() for plane in steps(levels)])
    return float((sizes[sizes > 0.0] <= APART).mean())


def _smoothed(levels: np.ndarray, numbers: np.ndarray, count: int) -> bool:
    """Return True if over 0.05 of the cells at edges, (R, C, 4) levels, have colours of which 2/3 are blends."""
    blend = _between(levels) | _between(levels.swapaxes(0, 1)).swapaxes(0, 1)
    share = np.bincount(numbers[blend], minlength=count) / np.bincount(numbers.ravel(), minlength=count)
    edge = ~(ndimage.alike(numbers, (3, 1)) & ndimage.alike(numbers, (1, 3)))
    return bool((blend & (share >= 2.0 / 3.0)[numbers]).sum() > 0.05 * edge.sum())


def _between(levels: np.ndarray) -> np.ndarray:
    """Return (R, C) bool: cells whose colour is on the line between those to the left and right, away from both."""
    differs = steps(levels)[1] > 0.0
    y, x = np.nonzero(differs[:, :-1] & differs[:, 1:])
    before, here, after = (levels[y, x + k] for k in range(3))
    t, rest = blend_of(here, before, after)
    away = np.minimum(t, 1.0 - t) * np.linalg.norm(after - before, axis=1)
    out = np.zeros(levels.shape[:2], dtype=bool)
    out[y, x + 1] = (largest(np.abs(rest)) <= SEEN) & (away > SEEN)
    return out


def _corners(numbers: np.ndarray) -> int:
    """Count the points at which an outline turns, or several meet."""
    a, b, c, d = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, :-1], numbers[1:, 1:]
    return int((~((a == b) & (c == d)) & ~((a == c) & (b == d))).sum())
