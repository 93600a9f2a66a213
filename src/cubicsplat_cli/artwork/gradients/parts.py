"""Connected parts of a picture in which colours change evenly.

Within a gradient colours change by straight lines, so second differences are those of rounding, and of circles where it
is radial; across an edge they are not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.channels import largest, packed
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import Pixels, bends_and_steps, trimmed_range
from cubicsplat_cli.record import record

BEND = 2.6  # levels of a second difference that rounding makes
TIP = 6.0  # px from the middle of a radial gradient, beyond which its circles bend it by at most a share of its slope
LEAST_AREA, FEW = 64, 16  # px, of a gradient, and in which one changes
MOST_PIECES = 8  # that a part is divided into
SAME_FILL, LEAST_PLATEAU = 1.0, 0.04  # levels around the commonest colour, and share of the area that has it
CLEAR = 0.5  # levels of opacity
OUTER = 0.02  # share of a part's values at either end that do not count for its range
RING = 4  # px of its surroundings that a part is looked at with


def smooth_parts(levels: np.ndarray, bend: float = BEND, tip: float = TIP) -> tuple[np.ndarray, int]:
    """(H, W) int32 the number of the connected part in which colours change evenly, 0 for edges; and how many.

    bend: levels of a second difference that is none of an edge, beyond those of circles around a middle at least `tip`
    px away: the slope divided by their radius.
    """
    bends, steps = bends_and_steps(levels)
    smooth = bends <= bend + steps / (2.0 * tip)
    # Opened with room around the canvas, so that its border takes nothing away.
    opened = ndimage.binary_opening(np.pad(smooth, 2, mode="edge"), ndimage.SQUARE)[2:-2, 2:-2]
    # Flat pictures, most drawings, need no more than this.
    if (opened & (steps > 0.0)).sum() < FEW:
        return np.zeros(smooth.shape, dtype=np.int32), 0
    return ndimage.label(opened)


@record
class Patch:
    """Some pixels of a picture. top, left: of a box that holds them; mask: (h, w) bool, those of the box."""

    top: int
    left: int
    mask: np.ndarray

    @property
    def window(self) -> tuple[slice, slice]:
        """The box's rows and columns."""
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

    def at(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """(n,) bool: whether places of the picture are among the pixels."""
        rows, columns = rows - self.top, columns - self.left
        inside = (rows >= 0) & (rows < self.mask.shape[0]) & (columns >= 0) & (columns < self.mask.shape[1])
        inside[inside] = self.mask[rows[inside], columns[inside]]
        return np.asarray(inside)

    def padded(self, by: int, shape: tuple[int, ...]) -> Patch:
        """The same pixels in a box larger by so many px on all sides, as far as a picture (H, W) goes."""
        height, width = self.mask.shape
        above, before = min(by, self.top), min(by, self.left)
        below = min(by, shape[0] - self.top - height)
        after = min(by, shape[1] - self.left - width)
        mask = np.pad(self.mask, ((above, below), (before, after)))
        return Patch(self.top - above, self.left - before, mask)

    def grown(self, by: int, shape: tuple[int, ...]) -> Patch:
        """The pixels within so many px of these in a picture (H, W)."""
        wide = self.padded(by, shape)
        return Patch(wide.top, wide.left, ndimage.binary_dilation(wide.mask, ndimage.SQUARE, iterations=by))


def joined(patches: Sequence[Patch]) -> Patch:
    """The pixels of all patches, one or more."""
    ends = np.array([(p.top, p.left, p.top + p.mask.shape[0], p.left + p.mask.shape[1]) for p in patches])
    top, left = ends[:, :2].min(axis=0).tolist()
    bottom, right = ends[:, 2:].max(axis=0).tolist()
    mask = np.zeros((bottom - top, right - left), dtype=bool)
    for patch in patches:
        rows, columns = patch.window
        mask[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] |= patch.mask
    return Patch(top, left, mask)


class Part:
    """Some pixels of a picture, and what they have. rows, columns: (n,)."""

    def __init__(self, levels: np.ndarray, patch: Patch) -> None:
        self.levels, self.patch = levels, patch
        self.rows, self.columns = patch.places()
        values = levels[self.rows, self.columns].astype(float)
        self.pixels = Pixels(self.columns + 0.5, self.rows + 0.5, values)

    def __len__(self) -> int:
        return len(self.rows)

    def within(self, own: np.ndarray) -> Patch:
        """The pixels for which own (n,) holds."""
        mask = np.zeros_like(self.patch.mask)
        mask[self.rows[own] - self.patch.top, self.columns[own] - self.patch.left] = True
        return Patch(self.patch.top, self.patch.left, mask)

    def pieces(self, own: np.ndarray) -> list[Part]:
        """The largest connected parts of the pixels for which own (n,) holds, without what is thinner than 3 px."""
        mask = ndimage.binary_opening(self.within(own).mask, ndimage.SQUARE)
        labels, count = ndimage.label(mask)
        boxes = ndimage.find_objects(labels)
        sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        most = np.argsort(-sizes, kind="stable")[:MOST_PIECES]
        return [self._piece(labels, k + 1, boxes[k]) for k in most if sizes[k] >= LEAST_AREA]

    def _piece(self, labels: np.ndarray, number: int, box: tuple[slice, slice]) -> Part:
        top, left = self.patch.top + box[0].start, self.patch.left + box[1].start
        return Part(self.levels, Patch(top, left, labels[box] == number))

    def range(self) -> float:
        """Levels between which the values of the widest channel are, but for a few."""
        return trimmed_range(self.pixels.values, OUTER)


def part_of(
    levels: np.ndarray, parts: np.ndarray, number: int, box: np.ndarray, claimed: np.ndarray | None = None
) -> Part:
    """A part of a picture by its number. parts: (H, W); box: its first and last row and column; claimed: (H, W) bool
    what belongs to others."""
    top, bottom, left, right = box.tolist()
    window = slice(top, bottom + 1), slice(left, right + 1)
    own = parts[window] == number
    return Part(levels, Patch(top, left, own if claimed is None else own & ~claimed[window]))


def plateau(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """The commonest colour (4,), and which pixels (n,) have it and are not on their way through it."""
    values = part.pixels.values
    clear = values[:, 3] <= CLEAR
    if clear.mean() >= LEAST_PLATEAU:
        return np.zeros(4), clear
    code = packed(np.rint(values))
    _, first, index, counts = np.unique(code, return_index=True, return_inverse=True, return_counts=True)
    best = int(counts.argmax())
    fill = values[index.reshape(-1) == best].mean(axis=0)
    near = largest(np.abs(values - np.rint(values[first[best]]))) <= SAME_FILL
    # A gradient passes through its colours in bands; what is even around about is none of them.
    even = ndimage.binary_erosion(part.within(near).mask, ndimage.SQUARE, iterations=RING)
    even = ndimage.binary_dilation(even, ndimage.SQUARE, iterations=RING)
    return fill, near & even[part.rows - part.patch.top, part.columns - part.patch.left]
