"""The scene: the parameters of N cubic Bezier shapes on a canvas, which fit, raster and svg exchange."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.settings import Mode


def segments_from_points(mode: Mode, points_per_curve: int) -> int:
    """Number M of cubic segments of a curve with K control points: K = 3M (closed) or 3M + 1 (open).

    Raises InputError when no whole number of segments, at least one, has that many control points.
    """
    shared = 0 if mode is Mode.CLOSED else 1
    segments, rest = divmod(points_per_curve - shared, 3)
    if segments < 1 or rest:
        wanted = "3M" if mode is Mode.CLOSED else "3M + 1"
        raise InputError(
            f"{mode.value} curves need {wanted} control points for M >= 1 segments, not {points_per_curve}"
        )
    return segments


def points_from_segments(mode: Mode, segments: int) -> int:
    """Number K of control points of a curve with M cubic segments; the inverse of `segments_from_points`."""
    if segments < 1:
        raise InputError(f"a curve needs at least 1 segment, not {segments}")
    return 3 * segments if mode is Mode.CLOSED else 3 * segments + 1


@dataclass
class Scene:
    """N primitives, front to back (index 0 is the front-most), on a canvas of `width` x `height` pixels.

    mode: every primitive is of this kind.
    points: (N, K, 2) control points in px, x to the right and y down; pixel (row i, column j) has its centre
    at
        (j + 0.5, i + 0.5). K = 3M closed: segment m runs through points 3m, 3m+1, 3m+2, (3m+3) mod K.
        K = 3M + 1 open: segment m runs through points 3m .. 3m+3. Any finite value, on or off the canvas.
    colours: (N, 3) sRGB in [0, 1].
    opacities: (N,) in [0, 1].
    half_widths: (N,) half the stroke width in px, >= 0; all zero when closed.
    background: sRGB in [0, 1] behind everything, or None for a transparent canvas (then a render has 4
    channels).

    The tensors are float32, share one device, and are detached unless the caller wants gradients. Nothing is
    checked at construction; `validate` does.
    """

    mode: Mode
    width: int
    height: int
    points: Tensor
    colours: Tensor
    opacities: Tensor
    half_widths: Tensor
    background: tuple[float, float, float] | None = None

    @property
    def curves(self) -> int:
        """N, the number of primitives."""
        return self.points.shape[0]

    @property
    def points_per_curve(self) -> int:
        """K, the number of control points of each primitive."""
        return self.points.shape[1]

    @property
    def segments(self) -> int:
        """M, the number of cubic segments of each primitive."""
        return segments_from_points(self.mode, self.points_per_curve)

    @property
    def channels(self) -> int:
        """Channels of a render: 3 (RGB) over a background, 4 (premultiplied RGBA) without one."""
        return 4 if self.background is None else 3

    def validate(self) -> None:
        """Raise InputError, naming the variable and what it should be, unless the scene can be rendered."""
        if not isinstance(self.mode, Mode):
            raise InputError(f"mode must be Mode.CLOSED or Mode.OPEN, not {self.mode!r}")
        for name, size in (("width", self.width), ("height", self.height)):
            if isinstance(size, bool) or not isinstance(size, int) or size < 1:
                raise InputError(f"{name} must be a whole number of pixels, at least 1, not {size!r}")
        self._validate_shapes()
        _check_range("points", self.points)
        _check_range("colours", self.colours, 0.0, 1.0)
        _check_range("opacities", self.opacities, 0.0, 1.0)
        _check_range("half_widths", self.half_widths, 0.0, 0.0 if self.mode is Mode.CLOSED else None)
        if self.background is not None:
            _check_background(self.background)

    def _validate_shapes(self) -> None:
        tensors = {
            "points": self.points,
            "colours": self.colours,
            "opacities": self.opacities,
            "half_widths": self.half_widths,
        }
        for name, tensor in tensors.items():
            if not isinstance(tensor, Tensor):
                raise InputError(f"{name} must be a torch.Tensor, not {type(tensor).__name__}")
            if tensor.dtype not in (torch.float32, torch.float64):
                raise InputError(f"{name} must be float32 or float64, not {tensor.dtype}")
            if tensor.device != self.points.device:
                raise InputError(
                    f"{name} is on {tensor.device} but points on {self.points.device}: use one device for all"
                )
        if self.points.ndim != 3 or self.points.shape[-1] != 2 or self.curves < 1:
            raise InputError(f"points must have shape (N, K, 2) with N >= 1 curves, not {tuple(self.points.shape)}")
        segments_from_points(self.mode, self.points_per_curve)
        for name, wanted in (
            ("colours", (self.curves, 3)),
            ("opacities", (self.curves,)),
            ("half_widths", (self.curves,)),
        ):
            shape = tuple(tensors[name].shape)
            if shape != wanted:
                raise InputError(f"{name} must have shape {wanted} for {self.curves} curves, not {shape}")


def _check_range(name: str, tensor: Tensor, low: float | None = None, high: float | None = None) -> None:
    values = tensor.detach()
    bad = ~torch.isfinite(values)
    if bad.any():
        raise InputError(f"{name} must be finite, but curve {_first_curve(bad)} holds NaN or infinity")
    if low is not None:
        bad = values < low
    if high is not None:
        bad = bad | (values > high)
    if bad.any():
        wanted = "0 for closed curves" if low == high else f"at least {low:g}"
        if high is not None and low != high:
            wanted = f"between {low:g} and {high:g}"
        raise InputError(f"{name} must be {wanted}, but curve {_first_curve(bad)} is outside")


def _first_curve(bad: Tensor) -> int:
    return int(bad.nonzero()[0, 0])


def _check_background(background: tuple[float, float, float]) -> None:
    if not isinstance(background, tuple) or len(background) != 3:
        raise InputError(f"background must be None or a tuple of three numbers, not {background!r}")
    # Written so that NaN fails as well.
    if not all(isinstance(c, (int, float)) and math.isfinite(c) and 0.0 <= c <= 1.0 for c in background):
        raise InputError(f"background must hold sRGB values between 0 and 1, not {background!r}")
