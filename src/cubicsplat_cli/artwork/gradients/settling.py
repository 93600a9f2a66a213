"""The numbers of a gradient's geometry and the places of its stops that are nearest to an area's pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.gradients.ramps import Ramp, best_colours, hats, trimmed
from cubicsplat_cli.artwork.gradients.shade import Shade

ROUNDS, ENOUGH = 12, 1e-3
OUTLYING = 2.0  # levels, beyond which a pixel hardly counts


def settled(shade: Shade, x: np.ndarray, y: np.ndarray, values: np.ndarray) -> Shade:
    """The shade with its geometry and the places of its inner stops at their best, by Gauss-Newton steps in which the
    colours always are (variable projection, with differences for derivatives)."""
    pixels = _Pixels(x, y, values)
    at = shade.at(x, y)
    weights = _trust(at - values)
    value, damping = _value(at - values), 1e-3
    for _ in range(ROUNDS):
        steps = _steps(shade, x, y)
        columns = [
            (pixels.moved(shade, np.where(np.arange(len(steps)) == k, step, 0.0), weights)[1] - at).ravel() / step
            for k, step in enumerate(steps)
        ]
        jacobian = np.stack(columns, axis=1)
        heavy = (np.repeat(weights, 4)[:, None] * jacobian).T
        gram, gradient = heavy @ jacobian, heavy @ (at - values).ravel()
        gained = 0.0
        while damping < 1e6:
            step = np.linalg.solve(gram + damping * np.diag(np.diag(gram) + 1e-12), -gradient)
            trial, there = pixels.moved(shade, step, weights)
            following = _value(there - values)
            if following < value:
                gained = value - following
                shade, at, value, damping = trial, there, following, damping / 5.0
                weights = _trust(at - values)
                break
            damping *= 5.0
        if gained < ENOUGH * value:
            break
    return Shade(shade.frame, shade.radial, trimmed(shade.ramp), shade.parameters)


def _trust(residuals: np.ndarray) -> np.ndarray:
    """(n,) the weights by which outliers count less."""
    return np.minimum(1.0, OUTLYING**2 / np.maximum((residuals * residuals).sum(axis=1), 1e-9))


def _value(residuals: np.ndarray) -> float:
    """What residuals (n, 4) cost: squares, beyond OUTLYING by their logarithm."""
    square, far = (residuals * residuals).sum(axis=1), OUTLYING**2
    return float(np.where(square < far, square, far * (1.0 + np.log(np.maximum(square, 1e-9) / far))).sum())


def _steps(shade: Shade, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Small steps of what is free of a shade: numbers of its frame, and the places of its stops."""
    reach = max(float(np.ptp(x)), float(np.ptp(y)), 1.0)
    span = max(float(shade.ramp.knots[-1] - shade.ramp.knots[0]), 1e-9)
    middle, shape = [1e-4 * reach] * 2, [1e-3] * 2
    geometry = {2: [1e-3], 3: middle, 5: middle + shape}[shade.parameters]
    return np.array([*geometry, *[1e-3 * span] * len(shade.ramp.knots)])


@dataclass(frozen=True)
class _Pixels:
    """What a shade is fitted to."""

    x: np.ndarray
    y: np.ndarray
    values: np.ndarray

    def moved(self, shade: Shade, step: np.ndarray, weights: np.ndarray) -> tuple[Shade, np.ndarray]:
        """The shade after a step, its colours the best there, and its colours (n, 4) at the pixels."""
        count = len(step) - len(shade.ramp.knots)
        frame = _stepped(shade, step[:count], self.x, self.y)
        knots = np.sort(shade.ramp.knots + step[count:])
        knots[1:] = np.maximum(knots[1:], knots[:-1] + 1e-6 * (knots[-1] - knots[0]) + 1e-12)
        moved = Shade(frame, shade.radial, Ramp(knots, shade.ramp.colours), shade.parameters)
        basis = hats(moved.t(self.x, self.y), knots)
        colours = best_colours(basis, self.values, weights)
        return Shade(frame, shade.radial, Ramp(knots, colours), shade.parameters), basis @ colours


def _stepped(shade: Shade, step: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The frame after a step: of a direction its turn about the middle, of an ellipse its middle and its shape."""
    frame = shade.frame
    middle = np.array([float(x.mean()), float(y.mean())])
    if shade.parameters == 2:
        cos, sin = math.cos(float(step[0])), math.sin(float(step[0]))
        along = np.array([cos * frame[0, 0] - sin * frame[0, 1], sin * frame[0, 0] + cos * frame[0, 1]])
        shift = frame[0, :2] @ middle + frame[0, 2] - along @ middle
        return np.array([[*along, shift], [0.0, 0.0, 0.0]])
    turn = frame[:, :2]
    centre = np.linalg.solve(turn, -frame[:, 2]) + step[:2]
    if shade.parameters == 5:
        # A symmetric change: stretched along x and at 45 degrees; its scale is the ramp's.
        change = np.array([[1.0 + step[2], step[3]], [step[3], 1.0 - step[2]]])
        turn = turn @ change
    return np.column_stack([turn, -turn @ centre])
