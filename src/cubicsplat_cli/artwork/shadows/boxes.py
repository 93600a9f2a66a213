"""Level boxes with round corners, and ellipses: what casts the shadows that can be drawn in gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.raster import ndimage

FAR = 400.0  # px beyond the canvas that a side lies which the canvas cuts off
ALIKE, RADII = 0.6, 33  # px by which a silhouette may be off its box in the mean of its outline; radii tried
LEAST_SIDE = 3  # px
FULL = 0.96  # share of half a side, from which on a corner's radius is all of it


@dataclass(frozen=True)
class Box:
    """A box by its sides, px of the picture, whose corners are quarters of ellipses with half axes rx, ry."""

    left: float
    top: float
    right: float
    bottom: float
    rx: float = 0.0
    ry: float = 0.0

    def grown(self, by: float, rounder: float = 0.0) -> Box:
        """The box larger by so many px on all sides, and its radii by as many, and by `rounder` besides; sharp corners
        do not become round by growing, as those of shadows in CSS do not."""
        rx, ry = (max((radius + by if radius > 0.0 else 0.0) + rounder, 0.0) for radius in (self.rx, self.ry))
        middle_x, middle_y = 0.5 * (self.left + self.right), 0.5 * (self.top + self.bottom)
        half_x = max(0.5 * (self.right - self.left) + by, 0.0)
        half_y = max(0.5 * (self.bottom - self.top) + by, 0.0)
        return Box(
            middle_x - half_x,
            middle_y - half_y,
            middle_x + half_x,
            middle_y + half_y,
            min(rx, half_x),
            min(ry, half_y),
        )

    def moved(self, dx: float, dy: float) -> Box:
        return Box(self.left + dx, self.top + dy, self.right + dx, self.bottom + dy, self.rx, self.ry)

    @property
    def round(self) -> bool:
        """Whether it is an ellipse."""
        return self.rx >= FULL * 0.5 * (self.right - self.left) and self.ry >= FULL * 0.5 * (self.bottom - self.top)

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(n,) px from points to the box with sharp corners, 0 within it."""
        across = np.maximum(np.maximum(self.left - x, x - self.right), 0.0)
        down = np.maximum(np.maximum(self.top - y, y - self.bottom), 0.0)
        return np.hypot(across, down)


def box_of(mask: np.ndarray, hidden: np.ndarray | None = None) -> Box | None:
    """The box that a silhouette (H, W) bool is, None where it is none. Sides at the border go on beyond it.

    hidden: (H, W) bool where it may go on beneath something else.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) < LEAST_SIDE or len(columns) < LEAST_SIDE:
        return None
    top, bottom, left, right = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    own = mask[top:bottom, left:right]
    counts = np.ones(own.shape, dtype=bool) if hidden is None else own | ~hidden[top:bottom, left:right]
    ends = [left == 0, top == 0, right == mask.shape[1], bottom == mask.shape[0]]
    perimeter = 2.0 * (right - left + bottom - top)
    if (~own & counts).sum() > (1.0 - math.pi / 4.0) * own.size + ALIKE * perimeter:
        return None
    whole = Box(*(v + s * FAR * e for v, s, e in zip((left, top, right, bottom), (-1, -1, 1, 1), ends, strict=True)))
    half_x, half_y = 0.5 * (right - left), 0.5 * (bottom - top)
    # Where the canvas cuts a side off, only the other sides bound the radius.
    most = min(half_x * (1 + (ends[0] or ends[2])), half_y * (1 + (ends[1] or ends[3])))
    radii = [(float(r), float(r)) for r in np.linspace(0.0, most, RADII)]
    if not any(ends):
        radii.append((half_x, half_y))
    x, y = np.arange(left, right)[None] + 0.5, np.arange(top, bottom)[:, None] + 0.5
    off, best = min(
        (
            (int(((_inside(box, x, y) != own) & counts).sum()), box)
            for box in (Box(whole.left, whole.top, whole.right, whole.bottom, *radius) for radius in radii)
        ),
        key=lambda found: found[0],
    )
    return best if off <= ALIKE * perimeter else None


def _inside(box: Box, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(h, w) bool the points of rows y (h, 1) and columns x (1, w) in a box, that lie within its sides."""
    if box.rx <= 0.0 or box.ry <= 0.0:
        return np.ones((len(y), x.shape[1]), dtype=bool)
    across = np.maximum(np.maximum(box.left + box.rx - x, x - box.right + box.rx), 0.0) / box.rx
    down = np.maximum(np.maximum(box.top + box.ry - y, y - box.bottom + box.ry), 0.0) / box.ry
    return across**2 + down**2 <= 1.0


def filled(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool a silhouette with its holes."""
    return np.asarray(ndimage.binary_fill_holes(mask))
