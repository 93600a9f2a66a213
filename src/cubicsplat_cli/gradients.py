"""Gradient fills, in SVG's sense: colours that change along a line or outwards from a centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from cubicsplat_cli.curvetensors import CurveTensors
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.paint import Gradient, LinearGradient

if TYPE_CHECKING:
    from collections.abc import Callable

FLAT, LINEAR, RADIAL = 0, 1, 2  # values of `Gradients.kinds`
# Of the way between two stops: where they are nearer, the second takes over at once.
LEAST_LENGTH = 1e-6


@dataclass
class Gradients(CurveTensors):
    """How N curves are filled where one colour is not enough, with room for S stops each.

    kinds: (N,) int32, `FLAT` (the curve has its one colour, and nothing else here is read), `LINEAR` or `RADIAL`.
    frames: (N, 2, 3), an affine map from px, as (x, y, 1), to the gradient's own plane. The place t on the way from the
        first stop to the last is the first coordinate there (linear), or the distance from the origin (radial).
    counts: (N,) int32, stops in use, 1..S; those behind are padding, which nothing reads.
    offsets: (N, S), where on the way each stop is, in [0, 1], not falling along a row.
    stops: (N, S, 4), sRGB and opacity, in [0, 1].

    Between two stops colour and opacity change linearly, the colour not premultiplied, as in SVG; before the first and
    behind the last they stay ("pad"). Of stops with one offset the last counts from there on. The curve's own opacity
    is a factor of the stops'. Gradients of a loss reach frames and stops, not the offsets. Floats are of the type of
    the scene's tensors and on their device.
    """

    kinds: Tensor
    frames: Tensor
    counts: Tensor
    offsets: Tensor
    stops: Tensor

    @property
    def most_stops(self) -> int:
        """S."""
        return int(self.stops.shape[1])

    def floating(self, change: Callable[[Tensor], Tensor]) -> Gradients:
        """The three tensors of floats changed alike, the others as they are."""
        return replace(self, **{name: change(getattr(self, name)) for name in ("frames", "offsets", "stops")})

    def scaled(self, across: float, down: float) -> Gradients:
        """The same fills of curves whose x and y are multiplied by these factors."""
        return replace(self, frames=self.frames / self.frames.new_tensor([across, down, 1.0]))

    def seen_from(self, left: float, top: float) -> Gradients:
        """The same fills where px count from (left, top)."""
        moved = self.frames.clone()
        moved[:, :, 2] += self.frames[:, :, :2] @ self.frames.new_tensor([left, top])
        return replace(self, frames=moved)

    def validate(self) -> None:
        """Raise InputError, naming the variable and the curve, unless values are as the class says."""
        if not ((self.kinds >= FLAT) & (self.kinds <= RADIAL)).all():
            raise InputError(f"gradients.kinds must be {FLAT} (flat), {LINEAR} (linear) or {RADIAL} (radial)")
        used = torch.arange(self.most_stops, device=self.kinds.device) < self.counts.unsqueeze(1)
        painted = self.kinds != FLAT
        counted = (self.counts >= 1) & (self.counts <= self.most_stops)
        self._refuse(~counted & painted, f"counts must lie between 1 and {self.most_stops}")
        self._refuse(~torch.isfinite(self.frames).flatten(1).all(1) & painted, "frames must be finite")
        # Written so that NaN fails as well.
        inside = (self.offsets >= 0.0) & (self.offsets <= 1.0)
        rising = torch.cat((torch.ones_like(inside[:, :1]), self.offsets.diff(dim=1) >= 0.0), dim=1)
        self._refuse(((~inside | ~rising) & used).any(1) & painted, "offsets must rise from 0 to 1 along each row")
        within = ((self.stops >= 0.0) & (self.stops <= 1.0)).all(2)
        self._refuse((~within & used).any(1) & painted, "stops must be between 0 and 1")

    @staticmethod
    def _refuse(bad: Tensor, what: str) -> None:
        if bad.any():
            raise InputError(f"gradients.{what}, but those of curve {int(bad.nonzero()[0, 0])} are not")

    def validate_form(self, points: Tensor) -> None:
        """`validate` of types, shapes and devices only, for a scene with these control points."""
        n = points.shape[0]
        if not isinstance(self.stops, Tensor) or self.stops.ndim != 3 or self.stops.shape[1] < 1:
            raise InputError(f"gradients.stops must be a torch.Tensor of shape ({n}, S, 4) with S >= 1")
        wanted = {
            "kinds": (n,), "frames": (n, 2, 3), "counts": (n,), "offsets": (n, self.most_stops),
            "stops": (n, self.most_stops, 4),
        }  # fmt: skip
        for name, shape in wanted.items():
            tensor = getattr(self, name)
            types = (torch.int32,) if name in ("kinds", "counts") else (torch.float32, torch.float64)
            if not isinstance(tensor, Tensor) or tensor.dtype not in types or tuple(tensor.shape) != shape:
                kind = " or ".join(str(each).removeprefix("torch.") for each in types)
                raise InputError(f"gradients.{name} must be a {kind} torch.Tensor of shape {shape}")
            if tensor.device != points.device:
                raise InputError(f"gradients.{name} is on {tensor.device} but points on {points.device}")


def linear_frames(starts: Tensor, ends: Tensor) -> Tensor:
    """Frames (N, 2, 3) of linear gradients from `starts` to `ends`, (N, 2) px; differentiable in both."""
    along = ends - starts
    slope = along / along.square().sum(1, keepdim=True).clamp(min=1e-12)
    row = torch.cat((slope, -(slope * starts).sum(1, keepdim=True)), dim=1)
    return torch.stack((row, torch.zeros_like(row)), dim=1)


def ends_of(frames: Tensor, near: Tensor) -> tuple[Tensor, Tensor]:
    """Starts and ends (N, 2) px of linear gradients with these frames, on the line through the points `near` (N, 2)."""
    row = frames[:, 0]
    along = row[:, :2] / row[:, :2].square().sum(1, keepdim=True)
    starts = near - ((row[:, :2] * near).sum(1, keepdim=True) + row[:, 2:]) * along
    return starts, starts + along


def paint_at(gradients: Gradients, curve: int, places: Tensor) -> Tensor:
    """Colour and opacity (P, 4) of one curve, which is not flat, at places (P, 2) px; differentiable."""
    frame = gradients.frames[curve].to(places.dtype)
    plane = places @ frame[:, :2].T + frame[:, 2]
    if int(gradients.kinds[curve]) == LINEAR:
        t = plane[..., 0]
    else:
        # The square root has no derivative at 0.
        squared = plane.square().sum(-1)
        t = torch.where(squared > 0.0, squared, 1.0).sqrt() * (squared > 0.0)
    count = int(gradients.counts[curve])
    offsets, stops = gradients.offsets[curve].to(places.dtype), gradients.stops[curve].to(places.dtype)
    value = stops[0].expand(*t.shape, 4)
    for k in range(1, count):
        length = offsets[k] - offsets[k - 1]
        ramp = (
            ((t - offsets[k - 1]) / length).clamp(0.0, 1.0) if length > LEAST_LENGTH else (t >= offsets[k]).to(t.dtype)
        )
        value = value + ramp.unsqueeze(-1) * (stops[k] - stops[k - 1])
    return value


def gradients_of(paints: Sequence[Gradient | None]) -> Gradients | None:
    """The gradients of a scene (float32 CPU tensors) from those of its curves, in px; None where all are flat."""
    if not any(paints):
        return None
    n, room = len(paints), max(len(paint.stops) for paint in paints if paint)
    kinds, counts = torch.zeros(n, dtype=torch.int32), torch.ones(n, dtype=torch.int32)
    frames, offsets, stops = np.zeros((n, 2, 3)), np.zeros((n, room)), np.zeros((n, room, 4))
    for curve, paint in enumerate(paints):
        if paint is None:
            continue
        kinds[curve], counts[curve] = LINEAR if isinstance(paint, LinearGradient) else RADIAL, len(paint.stops)
        frames[curve] = paint.frame()
        offsets[curve, : len(paint.stops)] = [stop.offset for stop in paint.stops]
        stops[curve, : len(paint.stops)] = np.array([stop.ink for stop in paint.stops]) / 255.0
    as_tensors = [torch.from_numpy(each.astype(np.float32)) for each in (frames, offsets, stops)]
    return Gradients(kinds, as_tensors[0], counts, as_tensors[1], as_tensors[2])
