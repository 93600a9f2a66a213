"""Level boxes with round corners, and ellipses: what casts the shadows that can be drawn in gradients."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.records import dataclass, replace

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

    def numbers(self) -> np.ndarray:
        """(6,) its sides and half axes."""
        return np.array([self.left, self.top, self.right, self.bottom, self.rx, self.ry])

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
    x, y = np.arange(left, right)[None] + 0.5, np.arange(top, bottom)[:, None] + 0.5
    radii = np.linspace(0.0, most, RADII)
    off = _pixels_off(whole, radii, x, y, own, counts)
    best = int(off.argmin())
    trials = [(int(off[best]), replace(whole, rx=float(radii[best]), ry=float(radii[best])))]
    if not any(ends):
        oval = ((x - left - half_x) / half_x) ** 2 + ((y - top - half_y) / half_y) ** 2 <= 1.0
        trials.append((int(((oval != own) & counts).sum()), replace(whole, rx=half_x, ry=half_y)))
    least, box = min(trials, key=lambda trial: trial[0])
    return box if least <= ALIKE * perimeter else None


def _pixels_off(
    box: Box, radii: np.ndarray, x: np.ndarray, y: np.ndarray, own: np.ndarray, counts: np.ndarray
) -> np.ndarray:
    """(r,) of the pixels that count, rows y (h, 1) and columns x (1, w), how many are wrongly in the box or out of it
    with each of some ascending radii."""
    across = np.minimum(x - box.left, box.right - x)
    down = np.minimum(y - box.top, box.bottom - y)
    # A corner of a larger radius than this leaves the pixel out.
    reach = (across + down + np.sqrt(2.0 * across * down))[counts]
    inside = np.searchsorted(radii, reach, side="right")
    lacked, had = (np.bincount(inside[is_own], minlength=len(radii) + 1) for is_own in (own[counts], ~own[counts]))
    return np.asarray(np.cumsum(lacked)[:-1] + had.sum() - np.cumsum(had)[:-1])
