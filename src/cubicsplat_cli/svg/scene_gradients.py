"""Gradients of a scene as a file holds them, in px, and back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.gradients import FLAT, LINEAR, Gradients, ends_of, paint_at
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, RadialGradient, Stop, mean_fill, radial_from

_OPAQUE = 255
_OFFSETS = 1000  # three decimals
# px: of a longer line or axis nothing is seen, and cairo's numbers end not far from it.
_LONGEST = 16_000.0
_DECIMALS = 7  # more than any file has


def gradient_decimals(precision: int) -> int:
    """Decimals of gradients' coordinates in px: where a colour changes is seen less than where a shape ends."""
    return max(0, precision - 1)


def paints_of(scene: Scene, precision: int) -> tuple[list[Gradient | None], np.ndarray, np.ndarray]:
    """The gradient of each curve in px, None where it is flat, and all colours (N, 3) and opacities (N,).

    Offsets have three decimals, fills 8 bits; coordinates are yet to be rounded. A curve's opacity goes into its stops,
    and comes back from them where they are alike; what nobody can tell from one colour becomes one. precision:
    decimals of the file's points.
    """
    scene = scene.as_numpy()
    given, colours, opacities = scene.gradients, scene.colours.astype(np.float64), scene.opacities.astype(np.float64)
    paints: list[Gradient | None] = [None] * scene.curves
    if given is None:
        return paints, colours, opacities
    given = given.floating(lambda t: t.astype(np.float64))
    step = 10.0 ** -gradient_decimals(precision)
    for curve in np.flatnonzero(given.kinds != FLAT).tolist():
        middle = np.concatenate(scene.rings(curve)).astype(np.float64).mean(axis=0)
        gradient = _in_px(given, curve, middle, step, float(opacities[curve]))
        paint = paint_at(given, curve, middle)
        alike = gradient is None or len({stop.colour[3] for stop in gradient.stops}) == 1
        # Not from the rounded fills: an opacity has three decimals.
        opacities[curve] = opacities[curve] * paint[3] if alike else 1.0
        colours[curve] = paint[:3]
        if gradient is None or len({stop.colour for stop in gradient.stops}) == 1:
            continue
        if alike:
            gradient = replace(gradient, stops=tuple(Stop(s.offset, (*s.colour[:3], _OPAQUE)) for s in gradient.stops))
        paints[curve] = gradient
        colours[curve] = np.array(mean_fill(gradient)[:3]) / _OPAQUE
    return paints, colours, opacities


def _in_px(given: Gradients, curve: int, middle: np.ndarray, step: float, opacity: float) -> Gradient | None:
    """step: of the coordinates in the file, px."""
    count = int(given.counts[curve])
    offsets = np.rint(given.offsets[curve, :count] * _OFFSETS) / _OFFSETS
    values = given.stops[curve, :count] * np.array([1.0, 1.0, 1.0, opacity])
    fills = np.rint(values * _OPAQUE).astype(int).tolist()
    stops = tuple(
        Stop(offset, (red, green, blue, alpha))
        for offset, (red, green, blue, alpha) in zip(offsets.tolist(), fills, strict=True)
    )
    frame = given.frames[curve]
    if int(given.kinds[curve]) == LINEAR:
        return _linear(frame, middle, step, stops)
    return _radial(frame, step, stops)


def _linear(frame: np.ndarray, middle: np.ndarray, step: float, stops: tuple[Stop, ...]) -> Gradient | None:
    if float(np.linalg.norm(frame[0, :2])) * _LONGEST < 1.0:
        return None
    start, end = (place[0] for place in ends_of(frame[None], middle[None]))
    # A line that is shorter than a step would have no direction.
    end = start + (end - start) * max(1.0, 1.01 * step / np.abs(end - start).max())
    if max(np.abs(start).max(), np.abs(end).max()) > _LONGEST:
        return None
    return LinearGradient(float(start[0]), float(start[1]), float(end[0]), float(end[1]), stops)


def _radial(frame: np.ndarray, step: float, stops: tuple[Stop, ...]) -> Gradient | None:
    if abs(float(np.linalg.det(frame[:, :2]))) * _LONGEST**2 < 1.0:
        return None
    inverse = np.linalg.inv(frame[:, :2])
    gradient = radial_from(np.column_stack([inverse, -inverse @ frame[:, 2]]), stops)
    if max(gradient.rx, abs(gradient.cx), abs(gradient.cy)) > _LONGEST or gradient.ry < step:
        return None
    return gradient


def as_written(gradient: Gradient, precision: int) -> Gradient:
    """A gradient as a file of this precision holds it, in px; see `gradient_element`."""
    steps = 10.0 ** gradient_decimals(precision)

    def rounded(value: float) -> float:
        return round(value * steps) / steps

    if isinstance(gradient, RadialGradient) and rounded(gradient.rx) != rounded(gradient.ry):
        return without_noise(radial_from(np.rint(gradient.matrix() * steps) / steps, gradient.stops))
    return without_noise(_with_lengths(gradient, rounded))


def without_noise(gradient: Gradient) -> Gradient:
    """A gradient read from a file, its coordinates without the noise of rounding."""
    plain = _with_lengths(gradient, lambda value: round(value, _DECIMALS))
    return replace(plain, angle=0.0) if isinstance(plain, RadialGradient) and plain.rx == plain.ry else plain


def _with_lengths(gradient: Gradient, change: Callable[[float], float]) -> Gradient:
    names = ("x1", "y1", "x2", "y2") if isinstance(gradient, LinearGradient) else ("cx", "cy", "rx", "ry")
    lengths: dict[str, Any] = {name: change(getattr(gradient, name)) for name in names}
    return replace(gradient, **lengths)
