"""Connected parts of a picture in which colours change evenly.

Within a gradient colours change along straight lines. Its second differences are those of rounding, and of the circles
of a radial gradient; across an edge they are larger.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import largest, packed, widened
from cubicsplat_cli.artwork.regions.fills import CLEAR, EVEN, in_squares
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import Pixels, bends_and_steps, part_spreads, trimmed_range
from cubicsplat_cli.record import record

BEND = 2.6  # levels of a second difference that rounding makes
TIP = 6.0  # px from the middle of a radial gradient; farther away its circles bend it by a small share of its slope
LEAST_AREA = 64  # px of a gradient
LARGE_AREA = 400  # px of a part that shows a gradient in spite of noise, or a shadow
LEAST_PLATEAU = 0.04  # share of an area that has its commonest colour
OUTER = 0.02  # share of a part's values at either end that does not count for its range
RING = 4  # px around a part in which its surroundings are examined


def smooth_parts(levels: np.ndarray, bend: float = BEND, tip: float = TIP) -> Parts:
    """Return the connected parts of a picture (H, W, 4), premultiplied levels, in which colours change evenly. They are
    3 px wide, or else 2 where they are large enough for a gradient: rims and strokes of 6 px, of which edges bend two
    on either side. bend: levels of a second difference that no edge has. A gradient may bend more by its slope over
    `tip`, the least distance in px from the middle of its circles."""
    bends, steps = bends_and_steps(levels)
    smooth = bends <= bend + steps / (2.0 * tip)
    # The opening gets room around the canvas, so that the border takes nothing away.
    opened = ndimage.binary_opening(np.pad(smooth, 2, mode="edge"), ndimage.SQUARE)[2:-2, 2:-2]
    # Most drawings are flat. A gradient changes in a quarter of its pixels at least.
    if 4 * (smooth & (steps > 0.0)).sum() < LEAST_AREA:
        return Parts(levels, np.zeros(smooth.shape, dtype=np.int32), 0)
    parts, count = ndimage.label(opened)
    large = (np.bincount(parts.ravel(), minlength=count + 1) >= LEAST_AREA)[parts] & opened
    whole = smooth[:-1, :-1] & smooth[1:, :-1] & smooth[:-1, 1:] & smooth[1:, 1:]
    thin, more = ndimage.large_parts(in_squares(whole) & ~ndimage.binary_dilation(large, ndimage.SQUARE), LEAST_AREA)
    parts = np.where(thin > 0, thin + count, parts)
    numbers = ndimage.renumbered(parts, np.bincount(parts.ravel(), minlength=count + more + 1) > 0)
    return Parts(levels, *numbers)


@record
class Patch:
    """Some pixels of a picture. top, left: corner of a box around them; mask: (h, w) bool, their places in the box."""

    top: int
    left: int
    mask: np.ndarray

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the box."""
        height, width = self.mask.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)

    @property
    def size(self) -> int:
        """Px."""
        return int(np.count_nonzero(self.mask))

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns (n,) in the picture."""
        rows, columns = np.nonzero(self.mask)
        return rows + self.top, columns + self.left

    def pixels(self, levels: np.ndarray) -> Pixels:
        """Places and colours of the pixels in a picture (H, W, 4)."""
        rows, columns = self.places()
        return Pixels(columns + 0.5, rows + 0.5, levels[rows, columns].astype(float))

    def at(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (n,) bool: True for places of the picture that are among the pixels."""
        rows, columns = rows - self.top, columns - self.left
        inside = (rows >= 0) & (rows < self.mask.shape[0]) & (columns >= 0) & (columns < self.mask.shape[1])
        inside[inside] = self.mask[rows[inside], columns[inside]]
        return inside

    def padded(self, by: int, shape: tuple[int, ...]) -> Patch:
        """Return the same pixels in a box that is larger by so many px on all sides, cut at the border of a picture."""
        rows, columns = widened(self.window, by, shape)
        empty = np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=bool)
        return joined([Patch(rows.start, columns.start, empty), self])

    def grown(self, by: int, shape: tuple[int, ...]) -> Patch:
        """Return the pixels of a picture (H, W) within so many px of these."""
        wide = self.padded(by, shape)
        return replace(wide, mask=ndimage.binary_dilation(wide.mask, ndimage.SQUARE, iterations=by))

    def ring(self, by: int, shape: tuple[int, ...]) -> Patch:
        """Return the pixels within so many px around these, without these, in the box of `padded`."""
        wide = self.grown(by, shape)
        return replace(wide, mask=wide.mask & ~self.padded(by, shape).mask)


def joined_pixels(parts: Sequence[Pixels]) -> Pixels:
    """Return the pixels of all parts; none without any."""
    if not parts:
        return Pixels(np.zeros(0), np.zeros(0), np.zeros((0, 4)))
    return Pixels(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def patches_of(labels: np.ndarray) -> list[Patch]:
    """Return the pixels of each label from 1 on of a map (H, W)."""
    boxes = enumerate(ndimage.find_objects(labels), start=1)
    return [Patch(rows.start, columns.start, labels[rows, columns] == k) for k, (rows, columns) in boxes]


def joined(patches: Sequence[Patch]) -> Patch:
    """Return the pixels of all patches, one or more."""
    ends = np.array([(p.top, p.left, p.top + p.mask.shape[0], p.left + p.mask.shape[1]) for p in patches])
    top, left = ends[:, :2].min(axis=0).tolist()
    bottom, right = ends[:, 2:].max(axis=0).tolist()
    mask = np.zeros((bottom - top, right - left), dtype=bool)
    for patch in patches:
        rows, columns = patch.window
        mask[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] |= patch.mask
    return Patch(top, left, mask)


class Part:
    """Pixels of a picture (H, W, 4) with their rows and columns (n,) and their colours."""

    def __init__(self, levels: np.ndarray, patch: Patch) -> None:
        self.levels, self.patch = levels, patch
        self.rows, self.columns = patch.places()
        self.pixels = patch.pixels(levels)

    def __len__(self) -> int:
        return len(self.rows)

    def within(self, chosen: np.ndarray) -> Patch:
        """Return the pixels for which `chosen` (n,) is True."""
        mask = np.zeros_like(self.patch.mask)
        mask[self.patch.mask] = chosen
        return replace(self.patch, mask=mask)

    def pieces(self, chosen: np.ndarray) -> list[Part]:
        """Return the connected parts of the chosen pixels (n,) bool, largest first, without what is under 3 px."""
        labels, _ = ndimage.label(ndimage.binary_opening(self.within(chosen).mask, ndimage.SQUARE))
        large = [piece for piece in patches_of(labels) if piece.size >= LEAST_AREA]
        top, left, pieces = self.patch.top, self.patch.left, sorted(large, key=lambda piece: -piece.size)
        return [Part(self.levels, Patch(top + piece.top, left + piece.left, piece.mask)) for piece in pieces]

    def around(self, piece: Part) -> Part:
        """Return a piece of this part with the pixels of the part within RING px."""
        near = Part(self.levels, piece.patch.grown(RING, self.levels.shape))
        return Part(self.levels, near.within(self.patch.at(near.rows, near.columns)))

    def range(self) -> float:
        """Return the range of the channel that varies most, in levels, without a few outliers."""
        return trimmed_range(self.pixels.values, OUTER)

    def plateau(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the commonest colour (4,), and (n,) bool: the pixels that have it and belong to no gradient, if they
        are LEAST_PLATEAU of the part at least."""
        values = self.pixels.values
        clear = values[:, 3] <= CLEAR
        if clear.mean() >= LEAST_PLATEAU:
            return np.zeros(4), clear
        code = packed(np.rint(values))
        _, first, index, counts = np.unique(code, return_index=True, return_inverse=True, return_counts=True)
        best = int(counts.argmax())
        fill = values[index.reshape(-1) == best].mean(axis=0)
        near = largest(np.abs(values - np.rint(values[first[best]]))) <= EVEN
        # A gradient passes through each of its colours in a narrow band, which the erosion removes.
        wide = ndimage.binary_erosion(self.within(near).mask, ndimage.SQUARE, iterations=RING)
        even = near & ndimage.binary_dilation(wide, ndimage.SQUARE, iterations=RING)[self.patch.mask]
        return fill, even & (even.mean() >= LEAST_PLATEAU)


@record
class Parts:
    """Parts of a picture. levels: (H, W, 4) premultiplied; numbers: (H, W) int32, from 1 to `count`, 0 for no part."""

    levels: np.ndarray
    numbers: np.ndarray
    count: int

    @cached_property
    def measured(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Their sizes, boxes and spreads, as of `part_spreads`."""
        return part_spreads(self.levels, self.numbers, self.count)

    def uneven(self, area: int, span: float) -> list[int]:
        """Return the numbers of the parts of at least `area` px that span more than so many levels, largest first."""
        sizes, _, spreads = self.measured
        uneven = np.flatnonzero((sizes >= area) & (spreads > span))
        return (uneven[np.argsort(-sizes[uneven], kind="stable")] + 1).tolist()

    def part(self, number: int, claimed: np.ndarray | None = None) -> Part:
        """Return a part by its number, without the pixels claimed by others, (H, W) bool."""
        top, bottom, left, right = self.measured[1][number - 1].tolist()
        window = slice(top, bottom + 1), slice(left, right + 1)
        mask = self.numbers[window] == number
        return Part(self.levels, Patch(top, left, mask if claimed is None else mask & ~claimed[window]))
