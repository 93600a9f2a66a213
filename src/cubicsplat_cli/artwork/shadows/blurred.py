"""Soft shadows of boxes: moved, made larger, blurred and let through, and fitted to what is seen of them.

A layer of a shadow darkens by s = alpha (G_sigma * M)(p - d), M the coverage of the box grown by `grown` px. Layers
multiply what they let through: 1 - s = prod (1 - s_i), as several shadows of one card do in CSS (Backgrounds and
Borders, 6.1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.shadows.boxes import Box
from cubicsplat_cli.raster.shadows import ShadedPixels, shadow_box, shadow_window
from cubicsplat_cli.records import dataclass

BEYOND = 4.2  # sigmas from a box at which its shadow ends


@dataclass(frozen=True)
class BlurredBox:
    """One blurred copy of a box. dx, dy: px by which it is moved; grown: px by which it is larger on all sides;
    rounder: px by which its corners have a larger radius; sigma: px of its blur; alpha: of its middle, 0..1."""

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
        """The box, moved and grown."""
        return Box(*shadow_box(box.numbers(), self.numbers()).tolist())


def _layers_of(numbers: np.ndarray) -> tuple[BlurredBox, ...]:
    """The layers that numbers (k, 6) stand for."""
    return tuple(
        BlurredBox(dx, dy, grown, rounder, float(np.exp(sigma)), float(1.0 / (1.0 + np.exp(-odds))))
        for dx, dy, grown, rounder, sigma, odds in numbers.tolist()
    )


def _numbers_of(layers: Sequence[BlurredBox]) -> np.ndarray:
    return np.stack([layer.numbers() for layer in layers])


def shaded(box: Box, layers: Sequence[BlurredBox], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(h, w) how much the layers of a box darken at rows y (h,) and columns x (w,), px; 0..1."""
    return 1.0 - shadow_window(box.numbers(), _numbers_of(layers), x, y)


@dataclass(frozen=True)
class ShadowSamples:
    """Samples of the shadows of some boxes that have the same layers.

    pixels: some; seen: (n,) how much each is darkened; through: (n,) light that other shadows leave it; scale: levels
    of a whole shade.
    """

    pixels: ShadedPixels
    seen: np.ndarray
    through: np.ndarray
    scale: float

    def every(self, few: int) -> ShadowSamples:
        """The same of every so many pixels."""
        own = self.pixels
        some = ShadedPixels(own.boxes, own.rows[::few], own.columns[::few], own.open[:, ::few])
        return ShadowSamples(some, self.seen[::few], self.through[::few], self.scale)

    def light(self, layers: Sequence[BlurredBox]) -> np.ndarray:
        """(n,) the share of light that layers leave each pixel."""
        return self.pixels.light(_numbers_of(layers))

    def off(self, layers: Sequence[BlurredBox]) -> np.ndarray:
        """(n,) levels by which each pixel is darker than seen."""
        return np.asarray(self.scale * (1.0 - self.through * self.light(layers) - self.seen))

    def nearest(self, layers: Sequence[BlurredBox]) -> tuple[tuple[BlurredBox, ...], float]:
        """The layers that come nearest to what is seen, and the mean square in levels^2."""
        numbers, left = self.pixels.fitted(_numbers_of(layers), self.seen, self.through, self.scale)
        return _layers_of(numbers), left


def reached(box: Box, layers: Sequence[BlurredBox], shape: tuple[int, int]) -> tuple[slice, slice]:
    """The rows and columns of a picture (H, W) that the shadow of a box may reach."""
    ends = []
    for layer in layers:
        own, reach = layer.of(box), BEYOND * layer.sigma
        ends.append((own.top - reach, own.bottom + reach, own.left - reach, own.right + reach))
    top, bottom, left, right = np.array(ends).T
    rows = slice(int(np.clip(top.min(), 0, shape[0])), int(np.clip(np.ceil(bottom.max()), 0, shape[0])))
    columns = slice(int(np.clip(left.min(), 0, shape[1])), int(np.clip(np.ceil(right.max()), 0, shape[1])))
    return rows, columns
