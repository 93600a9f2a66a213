"""Gradients: paints that change along a line or outwards from a middle, as SVG defines them.

A gradient gives every place a parameter t, 0 at the start of a line or at the focus of an ellipse, which most often is
its middle, and 1 at its end or on its rim. Its stops say the colour at some t; between two stops colour and opacity are
interpolated linearly in sRGB, not premultiplied; before the first and beyond the last they stay constant (SVG 1.1,
section 13.2, spread method "pad").
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

Rgba = tuple[int, int, int, int]  # sRGB and opacity, 8 bits each, not premultiplied


@dataclass(frozen=True)
class Stop:
    """offset: t in [0, 1]. colour: sRGB and opacity there."""

    offset: float
    colour: Rgba


@dataclass(frozen=True)
class LinearGradient:
    """From (x1, y1), t = 0, to (x2, y2), t = 1, in px. stops: one or more, their offsets ascending."""

    x1: float
    y1: float
    x2: float
    y2: float
    stops: tuple[Stop, ...]

    def frame(self) -> np.ndarray:
        """Return (2, 3), an affine map of px; t is the first coordinate of its result."""
        dx, dy = self.x2 - self.x1, self.y2 - self.y1
        square = max(dx * dx + dy * dy, 1e-18)
        along = np.array([dx, dy]) / square
        return np.array([[*along, -along @ (self.x1, self.y1)], [0.0, 0.0, 0.0]])

    def scaled(self, across: float, down: float) -> LinearGradient:
        """Return the gradient of a picture with its x times `across` and its y times `down`."""
        start, slope = (self.x1 * across, self.y1 * down), self.frame()[0, :2] / (across, down)
        step = slope / max(float(slope @ slope), 1e-18)
        return replace(self, x1=start[0], y1=start[1], x2=start[0] + float(step[0]), y2=start[1] + float(step[1]))


@dataclass(frozen=True)
class RadialGradient:
    """From the focus, t = 0, to an ellipse with the middle (cx, cy) and semi-axes rx and ry, t = 1, in px; angle: of
    the first axis in radians, clockwise as seen. stops: one or more, their offsets ascending. focus: (x, y) in px
    within the ellipse; None for its middle."""

    cx: float
    cy: float
    rx: float
    ry: float
    angle: float
    stops: tuple[Stop, ...]
    focus: tuple[float, float] | None = None

    def frame(self) -> np.ndarray:
        """Return (2, 3), an affine map of px that takes the ellipse to the unit circle; without a focus t is the length
        of its result."""
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        turn = np.array([[cos / self.rx, sin / self.rx], [-sin / self.ry, cos / self.ry]])
        return np.column_stack([turn, -turn @ (self.cx, self.cy)])

    def unit_focus(self) -> np.ndarray:
        """Return (2,): the focus in the unit circle, as `frame` maps it."""
        return np.zeros(2) if self.focus is None else self.frame() @ (*self.focus, 1.0)

    def matrix(self) -> np.ndarray:
        """Return (2, 3), an affine map that takes the unit circle to the ellipse, the inverse of the frame."""
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        return np.array([[cos * self.rx, -sin * self.ry, self.cx], [sin * self.rx, cos * self.ry, self.cy]])

    def scaled(self, across: float, down: float) -> RadialGradient:
        """Return the gradient of a picture with its x times `across` and its y times `down`."""
        focus = None if self.focus is None else (self.focus[0] * across, self.focus[1] * down)
        return radial_from(np.array([[across], [down]]) * self.matrix(), self.stops, focus)


Gradient = LinearGradient | RadialGradient


def radial_from(
    matrix: np.ndarray, stops: tuple[Stop, ...], focus: tuple[float, float] | None = None
) -> RadialGradient:
    """Return the gradient whose t = 1 is the image of the unit circle under an affine map (2, 3). focus: in px."""
    axes, lengths, _ = np.linalg.svd(matrix[:, :2])
    angle = math.atan2(axes[1, 0], axes[0, 0])
    if lengths[0] - lengths[1] < 1e-9 * lengths[0]:
        angle = 0.0
    angle = (angle + math.pi / 2.0) % math.pi - math.pi / 2.0
    cx, cy = matrix[:, 2].tolist()
    return RadialGradient(cx, cy, float(lengths[0]), float(lengths[1]), angle, stops, focus)


def parameter(gradient: Gradient, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return t at places x, y in px, not clipped."""
    (a, b, c), (d, e, f) = gradient.frame()
    first = a * x + b * y + c
    if not isinstance(gradient, RadialGradient):
        return first
    second = d * x + e * y + f
    if gradient.focus is None:
        return np.hypot(first, second)
    # The circle around (1 - t) focus with radius t holds the place (SVG 1.1, section 13.2.3).
    fx, fy = gradient.unit_focus()
    first, second, rest = first - fx, second - fy, 1.0 - fx * fx - fy * fy
    along = first * fx + second * fy
    return (along + np.sqrt(along * along + rest * (first * first + second * second))) / rest


def painted(gradient: Gradient, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (..., 4): premultiplied colours in [0, 1] of a gradient at places x, y in px."""
    t = parameter(gradient, x, y)
    offsets = [stop.offset for stop in gradient.stops]
    fills = np.array([stop.colour for stop in gradient.stops]) / 255.0
    colours = np.stack([np.interp(t, offsets, fills[:, k]) for k in range(4)], axis=-1)
    colours[..., :3] *= colours[..., 3:]
    return colours


def mean_fill(gradient: Gradient) -> Rgba:
    """Return about the colour of a gradient seen from far away: the mean of its stops."""
    fills = np.array([stop.colour for stop in gradient.stops], dtype=float)
    share = fills[:, 3:] / max(float(fills[:, 3].sum()), 1e-9)
    red, green, blue = (round(float(v)) for v in (fills[:, :3] * share).sum(axis=0))
    return red, green, blue, round(float(fills[:, 3].mean()))
