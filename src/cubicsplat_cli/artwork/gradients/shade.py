"""A gradient before it is one: a geometry, a ramp of colours along it, and where it is seen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.parts import Patch
from cubicsplat_cli.raster.shades import Pixels, best_colours, colours_at, colours_off
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Stop, radial_from

CLOSE = 2.0  # levels that a gradient may be off a pixel that it explains
CLEAR = 8.0  # levels of opacity, below which a stop's own colour is not seen
# Levels: what rounding to 8 bits and the arithmetic of drawing programs leave.
SIGMA = 0.4
# Neighbouring pixels are off together, so each counts for less; and one that no ramp explains for so much at most.
SHARE, MOST_CHI = 0.2, 36.0
PRICE = 4.0  # nats a parameter
STOP_PARAMETERS = 4  # a place and a colour, most often opaque
EVEN = 1.0  # levels by which neighbouring stops at the ends may differ to be one, since ramps go on as they end


@record
class Ramp:
    """knots: (K,) ascending t; colours: (K, 4) levels there."""

    knots: np.ndarray
    colours: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """(n, 4) the colours at t (n,)."""
        return np.stack([np.interp(t, self.knots, self.colours[:, k]) for k in range(4)], axis=-1)

    def trimmed(self) -> Ramp:
        """The ramp without end stops that repeat their neighbours."""
        first, last = 0, len(self.knots) - 1
        gaps = np.abs(np.diff(self.colours, axis=0)).max(axis=1)
        while last - first > 1 and gaps[first] <= EVEN:
            first += 1
        while last - first > 1 and gaps[last - 1] <= EVEN:
            last -= 1
        return Ramp(self.knots[first : last + 1], self.colours[first : last + 1])


def alike(first: Ramp, second: Ramp) -> float:
    """The distance, in levels, of the colours of one ramp from those of the other, the shorter of both ways."""
    ways = []
    for a, b in ((first, second), (second, first)):
        here, there = (r.at(np.linspace(r.knots[0], r.knots[-1], n)) for r, n in ((a, 9), (b, 65)))
        gaps = np.abs(here[:, None] - there[None]).max(axis=2).min(axis=1)
        ways.append(float(np.median(gaps)))
    return min(ways)


@record
class Shade:
    """A gradient before it is one: frame (2, 4) as of `raster.shades`, and the ramp over its t. radial: t is a length;
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
        second = self.frame[1, 0] * x + self.frame[1, 1] * y + self.frame[1, 2]
        return np.hypot(first, second) + self.frame[0, 3] * first + self.frame[1, 3] * second

    def slope(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(2, n) how t changes per px at places in px."""
        turn, lean = self.frame[:, :2], self.frame[:, 3:]
        if not self.radial:
            return turn[:1].T + np.zeros(len(x))
        u = self.frame[:, :3] @ np.stack([x, y, np.ones(len(x))])
        return turn.T @ (u / np.maximum(np.hypot(*u), 1e-9) + lean)

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(n, 4) premultiplied levels at places in px."""
        return colours_at(self.frame, self.radial, self.ramp.knots, self.ramp.colours, x, y)

    def off(self, pixels: Pixels) -> np.ndarray:
        """(n,) levels by which the worst channel of pixels is off."""
        return largest(np.abs(self._residuals(pixels)))

    def explains(self, pixels: Pixels) -> np.ndarray:
        """(n,) bool."""
        return self.off(pixels) <= CLOSE

    def misfit(self, pixels: Pixels) -> float:
        """Half of chi^2, in nats, of pixels."""
        residuals = self._residuals(pixels)
        chi = np.einsum("nk,nk->n", residuals, residuals) / (SIGMA * SIGMA)
        return 0.5 * SHARE * float(np.minimum(chi, MOST_CHI).sum())

    def _residuals(self, pixels: Pixels) -> np.ndarray:
        return colours_off(self.frame, self.radial, self.ramp.knots, self.ramp.colours, pixels)

    def stopped(self, knots: np.ndarray, pixels: Pixels) -> Shade:
        """The shade with stops at these knots, in the colours nearest to pixels."""
        return replace(self, ramp=Ramp(knots, best_colours(self.frame, self.radial, knots, pixels)))

    def extended(self) -> Shade:
        """The shade with its ramp carried on, where it is open, by as much as it is long."""
        knots, colours = self.ramp.knots.copy(), self.ramp.colours.copy()
        length = knots[-1] - knots[0]
        for end, beside, step in ((0, 1, -length), (-1, -2, length)):
            if self.open[end]:
                colours[end] += step * (colours[end] - colours[beside]) / (knots[end] - knots[beside])
                knots[end] += step
        return Shade(self.frame, self.radial, Ramp(knots, colours), self.parameters, self.open)

    def times(self, factor: float) -> Shade:
        """The shade of pixels whose colours are so many times as much."""
        return replace(self, ramp=Ramp(self.ramp.knots, self.ramp.colours * factor))

    @property
    def price(self) -> float:
        """Nats."""
        return PRICE * (self.parameters + STOP_PARAMETERS * len(self.ramp.knots))


@record
class ShadedArea:
    """A gradient and where it is seen. ground: the colour (4,) in levels of what it fades into without an edge, or
    None; rim: t where it does; inwards: whether the ramp lies below that t."""

    shade: Shade
    patch: Patch
    ground: np.ndarray | None = None
    rim: float = 0.0
    inwards: bool = False


def gradient_of(shade: Shade) -> Gradient:
    """The gradient with 8-bit stops, t = 0 at the first of a linear one and t = 1 at the last."""
    knots = shade.ramp.knots
    first = knots[0] if not shade.radial else 0.0
    span = max(float(knots[-1] - first), 1e-9)
    stops = tuple(
        Stop(float(np.clip((knot - first) / span, 0.0, 1.0)), fill)
        for knot, fill in zip(knots.tolist(), _fills(shade.ramp.colours), strict=True)
    )
    if not shade.radial:
        slope = shade.frame[0, :2]
        square = float(slope @ slope)
        # The ends nearest to the area: the start on the line through the frame's own origin.
        start = slope * (first - shade.frame[0, 2]) / square
        end = start + slope * span / square
        return LinearGradient(float(start[0]), float(start[1]), float(end[0]), float(end[1]), stops)
    turn, lean = np.linalg.inv(shade.frame[:, :2]), shade.frame[:, 3]
    origin, square = -turn @ shade.frame[:, 2], float(lean @ lean)
    if square == 0.0:
        return radial_from(np.column_stack([turn * span, origin]), stops)
    # t = span is an ellipse with the focus 0 and the eccentricity |lean|, longer by its root along that.
    rest = 1.0 - square
    along = np.outer(lean, lean) / square
    axes = span / rest * (along + math.sqrt(rest) * (np.eye(2) - along))
    focus = float(origin[0]), float(origin[1])
    return radial_from(np.column_stack([turn @ axes, origin - turn @ lean * (span / rest)]), stops, focus)


def _fills(colours: np.ndarray) -> list[tuple[int, int, int, int]]:
    """8-bit fills of premultiplied colours (K, 4) in levels; a clear one has the colour of the stop beside it."""
    fills: list[tuple[int, int, int, int]] = []
    alpha = np.clip(colours[:, 3], 0.0, 255.0)
    visible = np.flatnonzero(alpha >= CLEAR)
    for i in range(len(colours)):
        own = i if alpha[i] >= CLEAR or not len(visible) else int(visible[np.abs(visible - i).argmin()])
        straight = np.clip(np.rint(colours[own, :3] * 255.0 / max(float(alpha[own]), 1e-9)), 0, 255)
        r, g, b = (int(v) for v in straight)
        fills.append((r, g, b, round(float(alpha[i]))))
    return fills
