"""The field of a soft shadow: what boxes become that are moved, made larger, blurred and let through.

A layer of a shadow darkens by s = alpha (G_sigma * M)(p - d), M the coverage of the box grown by `grown` px. That of a
box with sharp corners is the product of what its rows and its columns have, differences of error functions; what round
corners lack is an integral over their height, by Gauss and Legendre's rule, whose every node is such a product too.
Layers multiply what they let through: 1 - s = prod (1 - s_i), as several shadows of one card do in CSS (Backgrounds
and Borders, 6.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from cubicsplat_cli.artwork.robust import huber, huber_weights
from cubicsplat_cli.artwork.shadows.boxes import Box

OUTLYING = 4.0  # levels beyond which a pixel counts linearly
# Of a layer: dx, dy, px by which it is larger and rounder, log of sigma, and log-odds of alpha are what is fitted.
NUMBERS = 6
LEAST_SIGMA, MOST_SIGMA = 0.7, 40.0
ROUNDS, ENOUGH = 25, 1e-4
# Rounds after which a mean square in levels^2 beyond this is hopeless.
EARLY, HOPELESS = 7, 16.0
# Steps for differences, and the farthest that one round may go.
STEPS = np.array([0.02, 0.02, 0.02, 0.02, 0.005, 0.01])
FARTHEST = np.array([8.0, 8.0, 4.0, 4.0, 0.8, 1.2])
# What a layer costs for each px^2 by which it is rounder, in levels^2 a pixel: wide shadows say nothing of that.
ROUNDER = 1e-4
# Nodes along the arc of a corner: at least, for each sigma of its radius, and at most.
NODES, MORE_NODES, MOST_NODES = 10, 3.0, 160
BEYOND = 4.2  # sigmas from a box at which its shadow ends


_erfc = np.frompyfunc(math.erfc, 1, 1)


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
        return box.grown(self.grown, self.rounder).moved(self.dx, self.dy)


def layers_of(numbers: np.ndarray) -> tuple[BlurredBox, ...]:
    """The layers that numbers (6 k,) stand for."""
    out = []
    for dx, dy, grown, rounder, sigma, odds in numbers.reshape(-1, NUMBERS).tolist():
        bounded = float(np.clip(np.exp(sigma), LEAST_SIGMA, MOST_SIGMA))
        out.append(BlurredBox(dx, dy, grown, rounder, bounded, float(1.0 / (1.0 + np.exp(-odds)))))
    return tuple(out)


def ndtr(x: np.ndarray) -> np.ndarray:
    """The share of a normal distribution of deviation 1 that lies below x, of the same shape."""
    return 0.5 * _erfc(x * -(0.5**0.5)).astype(np.float64)


@cache
def _nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in -1..1 and weights (count,) of Gauss and Legendre's rule."""
    return np.polynomial.legendre.leggauss(count)


def _tables(box: Box, sigma: float, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(h, k) and (w, k): the blurred coverage of a box at rows y (h,) and columns x (w,) is the one times the other."""
    across = ndtr((x - box.left) / sigma) - ndtr((x - box.right) / sigma)
    down = ndtr((y - box.top) / sigma) - ndtr((y - box.bottom) / sigma)
    if min(box.rx, box.ry) <= 0.0:
        return down[:, None], across[:, None]
    count = min(NODES + int(MORE_NODES * box.ry / sigma), MOST_NODES)
    at, weight = _nodes(count)
    turn = 0.25 * math.pi * (at + 1.0)
    inset, height = box.rx * (1.0 - np.cos(turn)), box.ry * np.sin(turn)
    weight = weight * 0.25 * math.pi * box.ry * np.cos(turn)
    missing = ndtr((x - box.left)[:, None] / sigma) - ndtr((x[:, None] - box.left - inset) / sigma)
    missing += ndtr((x[:, None] - box.right + inset) / sigma) - ndtr((x - box.right)[:, None] / sigma)
    # At the same distance from both ends the same is missing.
    density = np.zeros((len(y), count))
    for end in (box.top + box.ry - height, box.bottom - box.ry + height):
        density += np.exp(-0.5 * ((y[:, None] - end) / sigma) ** 2)
    density *= -weight / (sigma * math.sqrt(2.0 * math.pi))
    return np.column_stack([down, density]), np.column_stack([across, missing])


def blurred_box(box: Box, sigma: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(h, w) coverage of a box, blurred by sigma px, at rows y (h,) and columns x (w,), px."""
    rows, columns = _tables(box, sigma, x, y)
    return np.asarray(np.clip(rows @ columns.T, 0.0, 1.0))


def shaded(box: Box, layers: Sequence[BlurredBox], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(h, w) how much the layers of a box darken at rows y (h,) and columns x (w,), px; 0..1."""
    left = np.ones((len(y), len(x)))
    for layer in layers:
        left *= 1.0 - layer.alpha * blurred_box(layer.of(box), layer.sigma, x, y)
    return 1.0 - left


@dataclass(frozen=True)
class ShadowSamples:
    """What is seen of the shadows of some boxes that have the same layers.

    rows, columns: (n,) of pixels; seen: (n,) how much each is darkened; through: (n,) light that other shadows leave
    it; open: for each box (n,) bool, whether its shadow falls on the pixel; scale: levels of a whole shade.
    """

    boxes: tuple[Box, ...]
    rows: np.ndarray
    columns: np.ndarray
    seen: np.ndarray
    through: np.ndarray
    open: tuple[np.ndarray, ...]
    scale: float

    @cached_property
    def _places(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """The rows and columns that there are, and which of them each pixel has."""
        return tuple(np.unique(at, return_inverse=True) for at in (self.rows, self.columns))

    def every(self, few: int) -> ShadowSamples:
        """The same of every so many pixels."""
        rows, columns, seen, through = (v[::few] for v in (self.rows, self.columns, self.seen, self.through))
        return ShadowSamples(self.boxes, rows, columns, seen, through, tuple(v[::few] for v in self.open), self.scale)

    def light(self, layer: BlurredBox) -> np.ndarray:
        """(n,) the share of light that a layer leaves each pixel."""
        (ys, row), (xs, column) = self._places
        out = np.ones(len(self.seen))
        for box, open_ in zip(self.boxes, self.open, strict=True):
            rows, columns = _tables(layer.of(box), layer.sigma, xs + 0.5, ys + 0.5)
            own = np.flatnonzero(open_)
            field = np.einsum("nk,nk->n", rows[row[own]], columns[column[own]])
            out[own] *= 1.0 - layer.alpha * np.clip(field, 0.0, 1.0)
        return out

    def off(self, layers: Sequence[BlurredBox]) -> np.ndarray:
        """(n,) levels by which each pixel is darker than seen."""
        return self._off([self.light(layer) for layer in layers])

    def _off(self, lights: list[np.ndarray]) -> np.ndarray:
        return np.asarray(self.scale * (1.0 - np.prod([self.through, *lights], axis=0) - self.seen))

    def settled(self, layers: Sequence[BlurredBox]) -> tuple[tuple[BlurredBox, ...], float]:
        """The layers that come nearest to what is seen, by Levenberg-Marquardt steps, and the mean square in
        levels^2."""
        numbers = np.concatenate([layer.numbers() for layer in layers])
        lights = [self.light(layer) for layer in layers_of(numbers)]
        residual, damping = self._off(lights), 1e-2
        value = self._loss(residual, numbers)
        own = np.arange(3, len(numbers), NUMBERS)
        farthest = np.tile(FARTHEST, len(layers))
        for turn in range(ROUNDS):
            if turn == EARLY and value > HOPELESS * len(residual):
                break
            jacobian = self._jacobian(numbers, lights, residual)
            weights = huber_weights(np.abs(residual), OUTLYING)
            gram = (jacobian * weights[:, None]).T @ jacobian
            slope = (jacobian * weights[:, None]).T @ residual
            gram[own, own] += ROUNDER * len(residual)
            slope[own] += ROUNDER * len(residual) * numbers[own]
            gained = 0.0
            while damping < 1e6:
                step = np.linalg.solve(gram + damping * np.diag(np.diag(gram) + 1e-9), -slope)
                trial = numbers + np.clip(step, -farthest, farthest)
                trial_lights = [self.light(layer) for layer in layers_of(trial)]
                following = self._off(trial_lights)
                loss = self._loss(following, trial)
                if loss < value:
                    gained = value - loss
                    numbers, lights, residual, value, damping = trial, trial_lights, following, loss, damping / 4.0
                    break
                damping *= 4.0
            if gained < ENOUGH * value:
                break
        return layers_of(numbers), float(value / max(len(residual), 1))

    def _loss(self, residual: np.ndarray, numbers: np.ndarray) -> float:
        rounder = float((numbers[3::NUMBERS] ** 2).sum())
        return float(huber(np.abs(residual), OUTLYING).sum()) + ROUNDER * len(residual) * rounder

    def _jacobian(self, numbers: np.ndarray, lights: list[np.ndarray], residual: np.ndarray) -> np.ndarray:
        """(n, 6 k) by what a pixel's residual changes with each number."""
        out = np.empty((len(residual), len(numbers)))
        for k in range(len(numbers)):
            own, part = divmod(k, NUMBERS)
            changed = numbers[own * NUMBERS : (own + 1) * NUMBERS].copy()
            changed[part] += STEPS[part]
            (layer,) = layers_of(changed)
            out[:, k] = (self._off([*lights[:own], self.light(layer), *lights[own + 1 :]]) - residual) / STEPS[part]
        return out


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
