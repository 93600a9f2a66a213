"""Gradients: paints that change along a line or outwards from a middle, as SVG defines them.

A gradient gives every place a parameter t, 0 at the start of a line or at the focus of an ellipse, which most often is
its middle, and 1 at its end or on its rim. Its stops say the colour at some t; between two stops colour and opacity are
interpolated linearly in sRGB, not premultiplied; before the first and beyond the last they stay constant (SVG 1.1,
section 13.2, spread method "pad").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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
        """Return (2, 4): an affine map of px, and a column of zeros; t is the first coordinate of the map's result."""
        dx, dy = self.x2 - self.x1, self.y2 - self.y1
        along = np.array([dx, dy]) / max(dx * dx + dy * dy, 1e-18)
        return np.array([[*along, -along @ (self.x1, self.y1), 0.0], [0.0] * 4])

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
        """Return (2, 4): an affine map u of px that takes the focus to 0, and the focus m in the unit circle, to which
        an affine map q takes the ellipse; t = |u| + m . u.

        By SVG 1.1, section 13.2.3, the circle around (1 - t) m with radius t holds the place: |q - m + t m| = t. The
        positive solution is t = (m . w + sqrt((m . w)^2 + (1 - m . m) w . w)) / (1 - m . m), with w = q - m. The root
        is (1 - m . m) |u| for u = `_focal(m)` w, and m . w is (1 - m . m) m . u.
        """
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        turn = np.array([[cos / self.rx, sin / self.rx], [-sin / self.ry, cos / self.ry]])
        middle = turn @ (self.cx, self.cy)
        focus = np.zeros(2) if self.focus is None else turn @ self.focus - middle
        change = _focal(focus)
        return np.column_stack([change @ turn, -change @ (middle + focus), focus])

    def matrix(self) -> np.ndarray:
        """Return (2, 3), an affine map that takes the unit circle to the ellipse, the inverse of the frame."""
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        return np.array([[cos * self.rx, -sin * self.ry, self.cx], [sin * self.rx, cos * self.ry, self.cy]])

    def scaled(self, across: float, down: float) -> RadialGradient:
        """Return the gradient of a picture with its x times `across` and its y times `down`."""
        focus = None if self.focus is None else (self.focus[0] * across, self.focus[1] * down)
        return radial_from(np.array([[across], [down]]) * self.matrix(), self.stops, focus)


Gradient = LinearGradient | RadialGradient
Paint = Rgba | Gradient


def colours_in(paint: Paint) -> list[Rgba]:
    """Return the colours of a gradient's stops, or a fill alone."""
    return [paint] if isinstance(paint, tuple) else [stop.colour for stop in paint.stops]


def is_opaque(paint: Paint) -> bool:
    """True if nothing shines through a paint."""
    return all(colour[3] == 255 for colour in colours_in(paint))


def _focal(focus: np.ndarray) -> np.ndarray:
    """Return (2, 2): the map of the unit circle's plane by which `RadialGradient.frame` differs from that of the same
    gradient without a focus (2,), which lies within the circle."""
    rest = max(1.0 - float(focus @ focus), 1e-6)  # rounding may take a focus to the rim, where t has no bound
    root = math.sqrt(rest)
    return (root * np.eye(2) + np.outer(focus, focus) / (1.0 + root)) / rest


def radial_of_frame(frame: np.ndarray, span: float, stops: tuple[Stop, ...]) -> RadialGradient:
    """Return the gradient with t = 1 where the frame (2, 4) of `RadialGradient.frame` has t = span."""
    turn, lean = np.linalg.inv(frame[:, :2]), frame[:, 3]
    focus = -turn @ frame[:, 2]
    axes = turn @ _focal(lean) * span
    place = (float(focus[0]), float(focus[1])) if lean.any() else None
    return radial_from(np.column_stack([axes, focus - axes @ lean]), stops, place)


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


def parameter(frame: np.ndarray, radial: bool, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return t at places x, y in px, not clipped, of a gradient with a frame (2, 4)."""
    (a, b, c, along), (d, e, f, across) = frame
    first = a * x + b * y + c
    if not radial:
        return first
    second = d * x + e * y + f
    return np.hypot(first, second) + along * first + across * second


def painted(gradient: Gradient, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (..., 4): premultiplied colours in [0, 1] of a gradient at places x, y in px."""
    t = parameter(gradient.frame(), isinstance(gradient, RadialGradient), x, y)
    offsets = [stop.offset for stop in gradient.stops]
    fills = np.array([stop.colour for stop in gradient.stops]) / 255.0
    colours = np.stack([np.interp(t, offsets, fills[:, k]) for k in range(4)], axis=-1)
    colours[..., :3] *= colours[..., 3:]
    return colours


def laid_over(colours: Sequence[np.ndarray], opaque: float = 1.0) -> np.ndarray:
    """Return premultiplied colours (..., 4), one or more, each over the one before, with alpha up to `opaque`."""
    out = colours[0]
    for above in colours[1:]:
        out = above + (1.0 - above[..., 3:] / opaque) * out
    return out


def mean_fill(gradient: Gradient) -> Rgba:
    """Return about the colour of a gradient seen from far away: the mean of its stops."""
    fills = np.array([stop.colour for stop in gradient.stops], dtype=float)
    share = fills[:, 3:] / max(float(fills[:, 3].sum()), 1e-9)
    red, green, blue = (round(float(v)) for v in (fills[:, :3] * share).sum(axis=0))
    return red, green, blue, round(float(fills[:, 3].mean()))
