"""A gradient before it is one: a geometry, a ramp of colours along it, and where it is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.gradients.ramps import PRICE, STOP_PARAMETERS, Ramp
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Stop, radial_from

CLEAR = 8.0  # levels of opacity, below which a stop's own colour is not seen


@dataclass(frozen=True)
class Shade:
    """A gradient before it is one: frame (2, 3) as `Gradient.frame`, and the ramp over its t. radial: t is a length;
    parameters: how many numbers the geometry takes. open: whether the ramp goes on, for all that is seen, before its
    first and beyond its last stop."""

    frame: np.ndarray
    radial: bool
    ramp: Ramp
    parameters: int
    open: tuple[bool, bool] = (False, False)

    def t(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        first = self.frame[0, 0] * x + self.frame[0, 1] * y + self.frame[0, 2]
        if not self.radial:
            return first
        return np.hypot(first, self.frame[1, 0] * x + self.frame[1, 1] * y + self.frame[1, 2])

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(n, 4) premultiplied levels at places in px."""
        return self.ramp.at(self.t(x, y))

    def extended(self) -> Shade:
        """The shade with its ramp carried on, where it is open, by as much as it is long."""
        knots, colours = self.ramp.knots.copy(), self.ramp.colours.copy()
        length = knots[-1] - knots[0]
        for end, beside, step in ((0, 1, -length), (-1, -2, length)):
            if self.open[end]:
                colours[end] += step * (colours[end] - colours[beside]) / (knots[end] - knots[beside])
                knots[end] += step
        return Shade(self.frame, self.radial, Ramp(knots, colours), self.parameters, self.open)

    @property
    def price(self) -> float:
        """Nats."""
        return PRICE * (self.parameters + STOP_PARAMETERS * len(self.ramp.knots))


@dataclass(frozen=True)
class ShadedArea:
    """A gradient and where it is seen. mask: (H, W) bool. ground: the colour (4,) in levels of what it fades into
    without an edge, or None; rim: t where it does; inwards: whether the ramp lies below that t."""

    shade: Shade
    mask: np.ndarray
    ground: np.ndarray | None = None
    rim: float = 0.0
    inwards: bool = False


def gradient_of(shade: Shade) -> Gradient:
    """The gradient with 8-bit stops, t = 0 at the first of a linear one and t = 1 at the last."""
    knots = shade.ramp.knots
    first = knots[0] if not shade.radial else 0.0
    span = max(float(knots[-1] - first), 1e-9)
    stops = tuple(
        Stop(float(np.clip((knot - first) / span, 0.0, 1.0)), ink)
        for knot, ink in zip(knots.tolist(), _inks(shade.ramp.colours), strict=True)
    )
    if not shade.radial:
        slope = shade.frame[0, :2]
        square = float(slope @ slope)
        # The ends nearest to the area: the start on the line through the frame's own origin.
        start = slope * (first - shade.frame[0, 2]) / square
        end = start + slope * span / square
        return LinearGradient(float(start[0]), float(start[1]), float(end[0]), float(end[1]), stops)
    turn = np.linalg.inv(shade.frame[:, :2])
    return radial_from(np.column_stack([turn * span, -turn @ shade.frame[:, 2]]), stops)


def _inks(colours: np.ndarray) -> list[tuple[int, int, int, int]]:
    """8-bit inks of premultiplied colours (K, 4) in levels; a clear one has the colour of the stop beside it."""
    inks: list[tuple[int, int, int, int]] = []
    alpha = np.clip(colours[:, 3], 0.0, 255.0)
    visible = np.flatnonzero(alpha >= CLEAR)
    for i in range(len(colours)):
        own = i if alpha[i] >= CLEAR or not len(visible) else int(visible[np.abs(visible - i).argmin()])
        straight = np.clip(np.rint(colours[own, :3] * 255.0 / max(float(alpha[own]), 1e-9)), 0, 255)
        r, g, b = (int(v) for v in straight)
        inks.append((r, g, b, round(float(alpha[i]))))
    return inks
