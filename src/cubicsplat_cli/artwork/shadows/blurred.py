"""The field of a soft shadow: what a silhouette becomes that is moved, made larger, blurred and let through.

A layer of a shadow darkens by s = alpha (G_sigma * M)(p - d), M the coverage of the silhouette grown by `grown` px. The
Fourier transform of a moved and blurred field is that of the field times exp(-i k.d - sigma^2 k^2 / 2). Layers multiply
what they let through: 1 - s = prod (1 - s_i), as several shadows of one card do in CSS (Backgrounds and Borders, 6.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from cubicsplat_cli.artwork.robust import huber, huber_weights

OUTLYING = 4.0  # levels beyond which a pixel counts linearly
# Of a layer: dx, dy, px by which it is larger, log of sigma, and log-odds of alpha are what is fitted.
NUMBERS = 5
LEAST_SIGMA, MOST_SIGMA = 0.7, 40.0
MARGIN = 96
ROUNDS, ENOUGH = 25, 1e-4
# Rounds after which a mean square in levels^2 beyond this is hopeless.
EARLY, HOPELESS = 7, 16.0
# Steps for differences, and the farthest that one round may go.
STEPS = np.array([0.02, 0.02, 0.02, 0.005, 0.01])
FARTHEST = np.array([8.0, 8.0, 4.0, 0.8, 1.2])


@dataclass(frozen=True)
class Layer:
    """One blurred copy of a silhouette. dx, dy: px by which it is moved; grown: px by which it is larger on all sides;
    sigma: px of its blur; alpha: of its middle, 0..1."""

    dx: float
    dy: float
    grown: float
    sigma: float
    alpha: float

    def scaled(self, factor: float) -> Layer:
        """The layer of a picture that is so many times as large."""
        return Layer(self.dx * factor, self.dy * factor, self.grown * factor, self.sigma * factor, self.alpha)

    def numbers(self) -> np.ndarray:
        alpha = min(max(self.alpha, 1e-3), 1.0 - 1e-3)
        return np.array([self.dx, self.dy, self.grown, np.log(self.sigma), np.log(alpha / (1.0 - alpha))])


def layers_of(numbers: np.ndarray) -> tuple[Layer, ...]:
    """The layers that numbers (5 k,) stand for."""
    out = []
    for dx, dy, grown, sigma, odds in numbers.reshape(-1, NUMBERS).tolist():
        bounded = float(np.clip(np.exp(sigma), LEAST_SIGMA, MOST_SIGMA))
        out.append(Layer(dx, dy, grown, bounded, float(1.0 / (1.0 + np.exp(-odds)))))
    return tuple(out)


class Silhouette:
    """What casts a shadow, in a window of the picture. own: (h, w) bool; what touches the border goes on beyond it.
    margin: px around the window, so that what wraps around is far away."""

    def __init__(self, own: np.ndarray, margin: int = MARGIN) -> None:
        self.shape = own.shape
        rows, columns = (fft.next_fast_len(n + 2 * margin, real=True) for n in own.shape)
        pad = [(margin, size - n - margin) for size, n in zip((rows, columns), own.shape, strict=True)]
        self._inner = (slice(margin, margin + own.shape[0]), slice(margin, margin + own.shape[1]))
        wide = np.pad(own, pad, mode="edge")
        # Of pixels the outlines run half a px outside their middles.
        inside, outside = ndimage.distance_transform_edt(wide), ndimage.distance_transform_edt(~wide)
        self._distance = np.where(wide, inside - 0.5, 0.5 - outside)
        self._ky = 2.0 * np.pi * fft.fftfreq(rows)[:, None]
        self._kx = 2.0 * np.pi * fft.rfftfreq(columns)[None]
        self._known: dict[float, np.ndarray] = {}

    def coverage(self, grown: float) -> np.ndarray:
        """(h, w) share of each pixel of the window that the grown silhouette covers."""
        return np.clip(0.5 + self._distance[self._inner] + grown, 0.0, 1.0)

    def _spectrum(self, grown: float) -> np.ndarray:
        if grown not in self._known:
            if len(self._known) > 8:
                self._known.pop(next(iter(self._known)))
            self._known[grown] = fft.rfft2(np.clip(0.5 + self._distance + grown, 0.0, 1.0))
        return self._known[grown]

    def shaded(self, layers: Sequence[Layer]) -> np.ndarray:
        """(h, w) how much the layers darken each pixel of the window, 0..1."""
        left = np.ones(self.shape)
        for layer in layers:
            moved = np.exp(-1j * (self._ky * layer.dy + self._kx * layer.dx))
            soft = np.exp(-0.5 * layer.sigma**2 * (self._ky**2 + self._kx**2))
            field = fft.irfft2(self._spectrum(layer.grown) * moved * soft, s=(len(self._ky), self._distance.shape[1]))
            left *= 1.0 - layer.alpha * np.clip(field[self._inner], 0.0, 1.0)
        return 1.0 - left


def moved(coverage: np.ndarray, layer: Layer) -> np.ndarray:
    """A coverage (h, w) moved as a layer is, without its blur."""
    return np.asarray(ndimage.shift(coverage, (layer.dy, layer.dx), order=1, mode="nearest"))


def settled(
    silhouette: Silhouette, layers: Sequence[Layer], index: np.ndarray, seen: np.ndarray, scale: float
) -> tuple[tuple[Layer, ...], float]:
    """The layers that come nearest to what is seen, by Levenberg-Marquardt steps, and the mean square in levels^2.

    index: (n,) pixels of the window in raster order; seen: (n,) how much each is darkened; scale: levels of a whole.
    """

    def off(numbers: np.ndarray) -> np.ndarray:
        return scale * (silhouette.shaded(layers_of(numbers)).ravel()[index] - seen)

    numbers = np.concatenate([layer.numbers() for layer in layers])
    steps, farthest = np.tile(STEPS, len(layers)), np.tile(FARTHEST, len(layers))
    residual, damping = off(numbers), 1e-2
    value = float(huber(np.abs(residual), OUTLYING).sum())
    for turn in range(ROUNDS):
        if turn == EARLY and value > HOPELESS * len(seen):
            break
        units = np.diag(steps)
        jacobian = np.stack([off(numbers + unit) - residual for unit in units], axis=1) / steps
        weights = huber_weights(np.abs(residual), OUTLYING)
        gram = (jacobian * weights[:, None]).T @ jacobian
        slope = (jacobian * weights[:, None]).T @ residual
        gained = 0.0
        while damping < 1e6:
            step = np.linalg.solve(gram + damping * np.diag(np.diag(gram) + 1e-9), -slope)
            step = np.clip(step, -farthest, farthest)
            trial = off(numbers + step)
            following = float(huber(np.abs(trial), OUTLYING).sum())
            if following < value:
                gained = value - following
                numbers, residual, value, damping = numbers + step, trial, following, damping / 4.0
                break
            damping *= 4.0
        if gained < ENOUGH * value:
            break
    return layers_of(numbers), float(value / len(seen))
