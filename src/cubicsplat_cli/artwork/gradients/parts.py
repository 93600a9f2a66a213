"""Connected parts of a picture in which colours change evenly.

Within a gradient colours change by straight lines, so second differences are those of rounding; across an edge they are
not.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.shade import Shade
from cubicsplat_cli.raster import ndimage

# Levels: a second difference that rounding makes, the steepest change per px, and what a gradient explains of a pixel.
BEND, STEEP, CLOSE = 2.6, 12.0, 2.0
NEARLY = 8.0  # levels, of a few pixels that make no area of their own
LEAST_AREA, FEW = 64, 16  # px, of a gradient, and in which one changes
MOST_PIECES = 8  # that a part is divided into
SAME_INK, LEAST_PLATEAU = 1.0, 0.04  # levels around the commonest colour, and share of the area that has it
CLEAR = 0.5  # levels of opacity
RING = 4  # px of its surroundings that a part is looked at with
PLUS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)
SQUARE = np.ones((3, 3), dtype=bool)


def smooth_parts(levels: np.ndarray, bend: float = BEND) -> tuple[np.ndarray, int]:
    """(H, W) int32 the number of the connected part in which colours change evenly, 0 for edges; and how many.

    bend: levels of a second difference that is none of an edge; as much steeper may changes be.
    """
    around = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    height, width = levels.shape[:2]
    smooth, changing = np.ones((height, width), dtype=bool), np.zeros((height, width), dtype=bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        after = around[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]
        before = around[1 - dy : 1 - dy + height, 1 - dx : 1 - dx + width]
        smooth &= largest(np.abs(after - 2.0 * levels + before)) <= bend
        step = largest(np.abs(after - before))
        smooth &= step <= 2.0 * STEEP * bend / BEND
        changing |= step > 0.0
    # Opened with room around the canvas, so that its border takes nothing away.
    opened = ndimage.binary_opening(np.pad(smooth, 2, mode="edge"), SQUARE)[2:-2, 2:-2]
    # Flat pictures, most drawings, need no more than this.
    if (opened & changing).sum() < FEW:
        return np.zeros((height, width), dtype=np.int32), 0
    return ndimage.label(opened, PLUS)


class Part:
    """Some pixels of a picture. box: slices that hold them all."""

    def __init__(self, levels: np.ndarray, mask: np.ndarray, box: tuple[slice, slice]) -> None:
        self.levels, self.mask, self.box = levels, mask, box
        rows, columns = np.nonzero(mask[box])
        self.rows, self.columns = rows + box[0].start, columns + box[1].start
        self.x, self.y = self.columns + 0.5, self.rows + 0.5
        self.values = levels[self.rows, self.columns].astype(float)

    def within(self, own: np.ndarray) -> np.ndarray:
        """(H, W) bool: the pixels for which own (n,) holds."""
        mask = np.zeros_like(self.mask)
        mask[self.rows[own], self.columns[own]] = True
        return mask

    def pieces(self, own: np.ndarray) -> list[Part]:
        """The largest connected parts of the pixels for which own (n,) holds, without what is thinner than 3 px."""
        mask = ndimage.binary_opening(self.within(own), SQUARE)
        labels, count = ndimage.label(mask, PLUS)
        boxes = ndimage.find_objects(labels)
        sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        largest = np.argsort(-sizes, kind="stable")[:MOST_PIECES]
        return [Part(self.levels, labels == k + 1, boxes[k]) for k in largest if sizes[k] >= LEAST_AREA]

    def explained(self, shade: Shade) -> np.ndarray:
        """(n,) bool."""
        return np.abs(shade.at(self.x, self.y) - self.values).max(axis=1) <= CLOSE

    def with_rests(self, shade: Shade, known: np.ndarray) -> np.ndarray:
        """(H, W) bool: the explained pixels (n,), and the few that are nearly so."""
        nearly = np.abs(shade.at(self.x, self.y) - self.values).max(axis=1) <= NEARLY
        labels, count = ndimage.label(self.within(nearly & ~known), PLUS)
        if count == 0:
            return self.within(known)
        few = np.bincount(labels.ravel(), minlength=count + 1) < LEAST_AREA
        few[0] = False
        return self.within(known) | few[labels]

    def range(self) -> float:
        low, high = np.percentile(self.values, (2, 98), axis=0)
        return float((high - low).max())


def plateau(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """The commonest colour (4,), and which pixels (n,) have it and are not on their way through it."""
    clear = part.values[:, 3] <= CLEAR
    if clear.mean() >= LEAST_PLATEAU:
        return np.zeros(4), clear
    code = np.rint(part.values).astype(np.int64) @ (256 ** np.arange(4))
    _, first, index, counts = np.unique(code, return_index=True, return_inverse=True, return_counts=True)
    best = int(counts.argmax())
    ink = part.values[index.reshape(-1) == best].mean(axis=0)
    near = np.abs(part.values - np.rint(part.values[first[best]])).max(axis=1) <= SAME_INK
    # A gradient passes through its colours in bands; what is even around about is none of them.
    even = ndimage.binary_erosion(part.within(near), SQUARE, iterations=RING)
    even = ndimage.binary_dilation(even, SQUARE, iterations=RING)
    own = near & even[part.rows, part.columns]
    return ink, own


def widened(box: tuple[slice, slice], shape: tuple[int, ...]) -> tuple[slice, slice]:
    rows, columns = (
        slice(max(side.start - RING, 0), min(side.stop + RING, size)) for side, size in zip(box, shape, strict=False)
    )
    return rows, columns
