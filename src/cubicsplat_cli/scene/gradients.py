"""Gradient fills, in SVG's sense: colours that change along a line or outwards from a centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene.arrays import Array, CurveArrays, copied, is_array, kind_of, like, namespace
from cubicsplat_cli.scene.paint import Gradient, LinearGradient

FLAT, LINEAR, RADIAL = 0, 1, 2  # values of `Gradients.kinds`


@dataclass(eq=False)
class Gradients(CurveArrays):
    """The gradient fills of N curves, with room for S stops each.

    kinds: (N,) int32, `FLAT` (the curve has its one colour, and nothing else here is read), `LINEAR` or `RADIAL`.
    frames: (N, 2, 4): an affine map from px, as (x, y, 1), to the gradient's own plane, and in the last column a lean
        m. With u the result of the map, the place t on the way from the first stop to the last is the first coordinate
        of u (linear), or |u| + m . u (radial; see `RadialGradient.frame`). Frames (N, 2, 3) get the lean 0.
    counts: (N,) int32, stops in use, 1..S; those behind are padding, which nothing reads.
    offsets: (N, S), where on the way each stop is, in [0, 1], not falling along a row.
    stops: (N, S, 4), sRGB and opacity, in [0, 1].

    Colours between and beyond the stops are those of `scene.paint`. Of stops with one offset the last counts from there
    on. The curve's own opacity is a factor of the stops'. Gradients of a loss reach frames and stops, not the offsets.
    The arrays are of the kind of the scene's, the floats of their type.
    """

    kinds: Array
    frames: Array
    counts: Array
    offsets: Array
    stops: Array

    def __post_init__(self) -> None:
        if is_array(self.frames) and self.frames.shape[1:] == (2, 3):
            xp = namespace(self.frames)
            self.frames = xp.concat((self.frames, xp.zeros_like(self.frames[..., :1])), axis=-1)

    @property
    def most_stops(self) -> int:
        """S."""
        return int(self.stops.shape[1])

    def scaled(self, across: float, down: float) -> Gradients:
        """Return the same fills for curves whose x and y are multiplied by these factors."""
        return replace(self, frames=self.frames / like(self.frames, [across, down, 1.0, 1.0]))

    def seen_from(self, left: float, top: float) -> Gradients:
        """Return the same fills in coordinates relative to (left, top), px."""
        moved = copied(self.frames)
        moved[:, :, 2] += self.frames[:, :, :2] @ like(self.frames, [left, top])
        return replace(self, frames=moved)

    def validate(self) -> None:
        """Raise InputError, naming the variable and the curve, unless values are as the class says."""
        if not ((self.kinds >= FLAT) & (self.kinds <= RADIAL)).all():
            raise InputError(f"gradients.kinds must be {FLAT} (flat), {LINEAR} (linear) or {RADIAL} (radial)")
        xp = namespace(self.kinds)
        used = xp.arange(self.most_stops, device=self.kinds.device) < self.counts[:, None]
        # Written so that NaN fails as well.
        inside = (self.offsets >= 0.0) & (self.offsets <= 1.0)
        rising = xp.concat((xp.ones_like(inside[:, :1]), xp.diff(self.offsets, axis=1) >= 0.0), axis=1)
        within = xp.all((self.stops >= 0.0) & (self.stops <= 1.0), axis=2)
        leaning = (self.kinds == RADIAL) & (xp.sum(xp.square(self.frames[..., 3]), axis=1) >= 1.0)
        for wrong, what in (
            ((self.counts < 1) | (self.counts > self.most_stops), f"counts must lie between 1 and {self.most_stops}"),
            (~xp.all(xp.isfinite(self.frames), axis=(1, 2)), "frames must be finite"),
            (leaning, "frames must have a lean shorter than 1"),
            (xp.any(~(inside & rising) & used, axis=1), "offsets must rise from 0 to 1 along each row"),
            (xp.any(~within & used, axis=1), "stops must be between 0 and 1"),
        ):
            bad = xp.nonzero(wrong & (self.kinds != FLAT))[0]
            if len(bad):
                raise InputError(f"gradients.{what}, but those of curve {int(bad[0])} are not")

    def validate_form(self, points: Array) -> None:
        """Validate types, shapes and devices only, for a scene with these control points."""
        n = points.shape[0]
        if not is_array(self.stops) or self.stops.ndim != 3 or self.stops.shape[1] < 1:
            raise InputError(f"gradients.stops must be an array of shape ({n}, S, 4) with S >= 1")
        wanted = {
            "kinds": (n,), "frames": (n, 2, 4), "counts": (n,), "offsets": (n, self.most_stops),
            "stops": (n, self.most_stops, 4),
        }  # fmt: skip
        for name, shape in wanted.items():
            array = getattr(self, name)
            types = ("int32",) if name in ("kinds", "counts") else ("float32", "float64")
            fits = is_array(array) and array.dtype in [getattr(namespace(array), each) for each in types]
            if not fits or tuple(array.shape) != shape:
                raise InputError(f"gradients.{name} must be an array of {' or '.join(types)} and shape {shape}")
            if kind_of(array) != kind_of(points):
                advice = "use one kind and device for all, by as_numpy() or as_torch() of the scene"
                raise InputError(f"gradients.{name} is {kind_of(array)} but points {kind_of(points)}: {advice}")


def linear_frames(starts: Array, ends: Array) -> Array:
    """Return frames (N, 2, 4) of linear gradients from `starts` to `ends`, (N, 2) px; differentiable in both."""
    xp = namespace(starts)
    along = ends - starts
    slope = along / xp.clip(xp.sum(along * along, axis=1, keepdims=True), min=1e-12)
    shift = -xp.sum(slope * starts, axis=1, keepdims=True)
    row = xp.concat((slope, shift, xp.zeros_like(shift)), axis=1)
    return xp.stack((row, xp.zeros_like(row)), axis=1)


def ends_of(frames: Array, near: Array) -> tuple[Array, Array]:
    """Return starts and ends (N, 2) px of linear gradients with these frames, on lines through points `near` (N, 2)."""
    xp = namespace(frames)
    row = frames[:, 0]
    along = row[:, :2] / xp.sum(row[:, :2] * row[:, :2], axis=1, keepdims=True)
    starts = near - (xp.sum(row[:, :2] * near, axis=1, keepdims=True) + row[:, 2:3]) * along
    return starts, starts + along


def gradients_of(paints: Sequence[Gradient | None]) -> Gradients | None:
    """Return the gradients of a scene (numpy arrays) from those of its curves, in px; None if all are flat."""
    if not any(paints):
        return None
    n, room = len(paints), max(len(paint.stops) for paint in paints if paint)
    kinds, counts = np.zeros(n, np.int32), np.ones(n, np.int32)
    frames, offsets, stops = np.zeros((n, 2, 4)), np.zeros((n, room)), np.zeros((n, room, 4))
    for curve, paint in enumerate(paints):
        if paint is None:
            continue
        kinds[curve], counts[curve] = LINEAR if isinstance(paint, LinearGradient) else RADIAL, len(paint.stops)
        frames[curve] = paint.frame()
        offsets[curve, : len(paint.stops)] = [stop.offset for stop in paint.stops]
        stops[curve, : len(paint.stops)] = np.array([stop.colour for stop in paint.stops]) / 255.0
    return Gradients(kinds, frames.astype(np.float32), counts, offsets.astype(np.float32), stops.astype(np.float32))
