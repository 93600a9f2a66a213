"""Level boxes with round corners, and ellipses; their soft shadows, which are moved, enlarged, blurred and translucent,
and fitted to the pixels that show them.

A layer of a shadow darkens by s = alpha (G_sigma * M)(p - d), M the coverage of the box grown by `grown` px. Layers
multiply what they let through: 1 - s = prod (1 - s_i), as several shadows of one card do in CSS (Backgrounds and
Borders, 6.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.raster.shades import ShadowSamples, shadow_box, shadow_window

FAR = 400.0  # px beyond the canvas at which a side lies that the canvas cuts off
OFF, RADII = 0.6, 33  # mean px by which a silhouette's outline may differ from its box; radii tried
FULL = 0.96  # share of half a side, from which on a corner's radius is all of it
BEYOND = 4.2  # sigmas from a box at which its shadow ends


class Box(NamedTuple):
    """A box by its sides, px of the picture, whose corners are quarters of ellipses with half axes rx, ry."""

    left: float
    top: float
    right: float
    bottom: float
    rx: float = 0.0
    ry: float = 0.0

    @property
    def round(self) -> bool:
        """True for an ellipse."""
        return self.rx >= FULL * 0.5 * (self.right - self.left) and self.ry >= FULL * 0.5 * (self.bottom - self.top)

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return (n,) px from points to the box with sharp corners, 0 within it."""
        across = np.maximum(np.maximum(self.left - x, x - self.right), 0.0)
        down = np.maximum(np.maximum(self.top - y, y - self.bottom), 0.0)
        return np.hypot(across, down)


def box_of(mask: np.ndarray, hidden: np.ndarray | None = None) -> Box | None:
    """Return the box with a silhouette (H, W) bool, or None. Sides at the border go on beyond it. hidden: (H, W) bool,
    pixels in which the box may go on beneath other shapes."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, bottom, left, right = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    inside = mask[top:bottom, left:right]
    counts = np.ones(inside.shape, dtype=bool) if hidden is None else inside | ~hidden[top:bottom, left:right]
    ends = [left == 0, top == 0, right == mask.shape[1], bottom == mask.shape[0]]
    perimeter = 2.0 * (right - left + bottom - top)
    if (~inside & counts).sum() > (1.0 - math.pi / 4.0) * inside.size + OFF * perimeter:
        return None
    whole = Box(*(v + s * FAR * e for v, s, e in zip((left, top, right, bottom), (-1, -1, 1, 1), ends, strict=True)))
    half_x, half_y = 0.5 * (right - left), 0.5 * (bottom - top)
    # Where the canvas cuts a side off, only the other sides bound the radius.
    most = min(half_x * (1 + (ends[0] or ends[2])), half_y * (1 + (ends[1] or ends[3])))
    x, y = np.arange(left, right)[None] + 0.5, np.arange(top, bottom)[:, None] + 0.5
    radii = np.linspace(0.0, most, RADII)
    off = _pixels_off(whole, radii, x, y, inside, counts)
    best = int(off.argmin())
    least, box = int(off[best]), whole._replace(rx=float(radii[best]), ry=float(radii[best]))
    if not any(ends):
        oval = ((x - left - half_x) / half_x) ** 2 + ((y - top - half_y) / half_y) ** 2 <= 1.0
        if (wrong := int(((oval != inside) & counts).sum())) < least:
            least, box = wrong, whole._replace(rx=half_x, ry=half_y)
    return box if least <= OFF * perimeter else None


def _pixels_off(
    box: Box, radii: np.ndarray, x: np.ndarray, y: np.ndarray, own: np.ndarray, counts: np.ndarray
) -> np.ndarray:
    """Return (r,) how many of the pixels that count lie wrongly in or out of the box with each of some ascending radii.
    x, y: middles of the columns (1, w) and rows (h, 1); own, counts: (h, w) bool."""
    across = np.minimum(x - box.left, box.right - x)
    down = np.minimum(y - box.top, box.bottom - y)
    # A corner of a larger radius than this leaves the pixel out.
    reach = (across + down + np.sqrt(2.0 * across * down))[counts]
    inside = np.searchsorted(radii, reach, side="right")
    lacked, had = (np.bincount(inside[is_own], minlength=len(radii) + 1) for is_own in (own[counts], ~own[counts]))
    return np.cumsum(lacked)[:-1] + had.sum() - np.cumsum(had)[:-1]


class BlurredBox(NamedTuple):
    """A blurred copy of a box. dx, dy: its offset, px; grown: px by which it is larger on all sides; rounder: px by
    which its corners' radius is larger; sigma: standard deviation of its blur, px; alpha: its opacity, 0..1."""

    dx: float
    dy: float
    grown: float
    rounder: float
    sigma: float
    alpha: float

    def numbers(self) -> np.ndarray:
        alpha = min(max(self.alpha, 1e-3), 1.0 - 1e-3)
        return np.array([self.dx, self.dy, self.grown, self.rounder, np.log(self.sigma), np.log(alpha / (1.0 - alpha))])

    def of(self, box: Box) -> Box:
        """Return a box moved and grown."""
        return Box(*shadow_box(np.array(box), self.numbers()).tolist())


def numbers_of(layers: Sequence[BlurredBox]) -> np.ndarray:
    """Return (k, 6) the numbers of layers."""
    return np.stack([layer.numbers() for layer in layers])


def shaded(box: Box, layers: Sequence[BlurredBox], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (h, w) how much the layers of a box darken rows y (h,) and columns x (w,), px; 0..1."""
    return 1.0 - shadow_window(np.array(box), numbers_of(layers), x, y)


def nearest_layers(samples: ShadowSamples, layers: Sequence[BlurredBox]) -> tuple[tuple[BlurredBox, ...], float]:
    """Return the layers nearest to samples, fitted from these, and the mean square error in levels^2."""
    numbers, left = samples.fitted(numbers_of(layers))
    found = (
        BlurredBox(dx, dy, grown, rounder, float(np.exp(sigma)), float(1.0 / (1.0 + np.exp(-odds))))
        for dx, dy, grown, rounder, sigma, odds in numbers.tolist()
    )
    return tuple(found), left


def reached(box: Box, layers: Sequence[BlurredBox], shape: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of a picture (H, W) that the shadow of a box may reach."""
    boxes, reach = np.array([layer.of(box) for layer in layers]), BEYOND * np.array([layer.sigma for layer in layers])
    left, top = (boxes[:, :2].T - reach).min(axis=1)
    right, bottom = np.ceil((boxes[:, 2:4].T + reach).max(axis=1))
    rows, columns = np.clip((top, bottom), 0, shape[0]), np.clip((left, right), 0, shape[1])
    return slice(*rows.astype(int).tolist()), slice(*columns.astype(int).tolist())
