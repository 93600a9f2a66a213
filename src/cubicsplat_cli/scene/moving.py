"""Moving scenes: curves of one topology whose numbers follow piecewise linear paths over the frames of a clip."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene.scene import Scene

# What moves on knots of its own: the shape without its offset (control points and half-width), the offset, the fill.
TRACKS = ("shapes", "offsets", "colours", "opacities")
# Decimals of a file: of opacities, where more would not show beside the error of a fit; of widths, at least.
OPACITY_DECIMALS, MIN_WIDTH_DECIMALS = 2, 2


@dataclass
class MovingScene:
    """N curves over F frames without a scene cut. All arrays are numpy's.

    base: topology (mode, ring_ends), canvas and background; its arrays are those of the first frame. Fills are flat.
    times: (F,) float64, seconds at which each frame begins, rising. end: when the last frame ends, s.
    points: (F, N, K, 2), colours: (F, N, 3), opacities: (F, N), half_widths: (F, N), float32, as in `Scene`.
    knots: (F, N) bool: the frames that are knots of curve n, the first and the last always. Between two knots all of
        the curve is linear in time; values of frames in between count for nothing until `interpolated` has set them.
    offsets: (F, N, 2) float32 px, or None: a translation that is part of `points` and may be written apart from them.
    track_knots: what needs fewer knots, by name of `TRACKS`: (F, N) bool, a subset of `knots` with the first and last
        frame. A track that is not named has all `knots`. "shapes" are `points` less `offsets`, and `half_widths`.
        Tracks are interpolated one by one, so whoever knows only `knots` and `points` gets the same curves.

    Nothing is checked at construction; `validate` does.
    """

    base: Scene
    times: np.ndarray
    end: float
    points: np.ndarray
    colours: np.ndarray
    opacities: np.ndarray
    half_widths: np.ndarray
    knots: np.ndarray
    offsets: np.ndarray | None = None
    track_knots: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """F, the number of frames."""
        return len(self.times)

    @property
    def curves(self) -> int:
        """N, the number of curves."""
        return int(self.points.shape[1])

    @property
    def duration(self) -> float:
        """Seconds from the beginning of the first frame to the end of the last."""
        return self.end - float(self.times[0])

    def knots_of(self, track: str) -> np.ndarray:
        """(F, N) bool: the knots of one of `TRACKS`."""
        return self.track_knots.get(track, self.knots)

    def shapes(self) -> np.ndarray:
        """(F, N, K, 2) px: the control points without the offsets."""
        return self.points if self.offsets is None else self.points - self.offsets[:, :, None]

    def at(self, frame: int) -> Scene:
        """The scene as a file plays it when this frame begins: knots exactly, all else on the lines between them."""
        scene, offsets = self.base, self.offsets
        shapes = between_knots(self.shapes(), self.knots_of("shapes"), self.times, frame)
        if offsets is not None:
            shapes = shapes + between_knots(offsets, self.knots_of("offsets"), self.times, frame)[:, None]
        return replace(
            scene,
            points=shapes.astype(np.float32),
            colours=between_knots(self.colours, self.knots_of("colours"), self.times, frame),
            opacities=between_knots(self.opacities, self.knots_of("opacities"), self.times, frame),
            half_widths=between_knots(self.half_widths, self.knots_of("shapes"), self.times, frame),
        )

    def validate(self) -> None:
        """Raise InputError, naming the variable and what it should be, unless every frame can be drawn."""
        self._validate_times()
        self._validate_shapes()
        for name, knots in (("knots", self.knots), *self.track_knots.items()):
            self._validate_knots(name, knots)
        if self.base.gradients is not None:
            raise InputError("curves of a moving scene must have flat fills")
        if self.offsets is not None and not np.isfinite(self.offsets).all():
            raise InputError("offsets must be finite")
        for frame in range(self.frames):
            self.at(frame).validate()

    def _validate_times(self) -> None:
        times = self.times
        if times.ndim != 1 or not len(times) or not np.isfinite(times).all():
            raise InputError("times must be finite seconds, one of each frame, of one frame at least")
        if (np.diff(times) <= 0.0).any() or not self.end > times[-1]:
            raise InputError("times must rise from frame to frame, and end must come after the last of them")

    def _validate_shapes(self) -> None:
        frames, curves = self.frames, self.base.curves
        wanted = {
            "points": (frames, *self.base.points.shape), "colours": (frames, curves, 3),
            "opacities": (frames, curves), "half_widths": (frames, curves),
        }  # fmt: skip
        if self.offsets is not None:
            wanted["offsets"] = (frames, curves, 2)
        for name, shape in wanted.items():
            array = getattr(self, name)
            if array.shape != shape or array.dtype != np.float32:
                raise InputError(f"{name} must be float32 of shape {shape}, not {array.dtype} {array.shape}")

    def _validate_knots(self, name: str, knots: np.ndarray) -> None:
        if name != "knots" and name not in TRACKS:
            raise InputError(f"track_knots has {name!r}, which is none of {', '.join(TRACKS)}")
        if knots.shape != (self.frames, self.base.curves) or knots.dtype != np.bool_:
            raise InputError(f"{name}: knots must be bool of shape {(self.frames, self.base.curves)}")
        if not (knots[0] & knots[-1]).all():
            raise InputError(f"{name}: the first and the last frame must be knots of every curve")
        if (knots & ~self.knots).any():
            raise InputError(f"{name}: every knot of a track must be one of `knots`")


@dataclass
class Clip:
    """A clip on a canvas of width x height px: moving scenes one after the other, with a scene cut between two.

    background: sRGB in [0, 1] behind everything, or None for a transparent canvas; that of every group.
    """

    width: int
    height: int
    background: tuple[float, float, float] | None
    groups: list[MovingScene]

    @property
    def frames(self) -> int:
        """The frames of all groups."""
        return sum(group.frames for group in self.groups)

    @property
    def duration(self) -> float:
        """Seconds from the beginning of the first frame to the end of the last."""
        return self.groups[-1].end - float(self.groups[0].times[0])

    def at(self, frame: int) -> Scene:
        """The scene of a frame, counted over all groups from 0."""
        for group in self.groups:
            if frame < group.frames:
                return group.at(frame)
            frame -= group.frames
        raise IndexError(f"the clip has {self.frames} frames")

    def validate(self) -> None:
        """Raise InputError unless every group can be drawn on this canvas, and begins when the one before ends."""
        if not self.groups:
            raise InputError("a clip needs at least 1 group of frames")
        for group in self.groups:
            base = group.base
            if (base.width, base.height, base.background) != (self.width, self.height, self.background):
                raise InputError("every group of a clip must have its canvas and its background")
            group.validate()
        for first, second in itertools.pairwise(self.groups):
            if first.end != second.times[0]:
                raise InputError("every group of a clip must begin when the one before it ends")


def between_knots(values: np.ndarray, knots: np.ndarray, times: np.ndarray, frame: int) -> np.ndarray:
    """(N, ...): of values (F, N, ...) those of a frame, on the line between the knots (F, N) bool around it in time."""
    before, after, share = lines_at(knots, times, frame)
    curves = np.arange(values.shape[1])
    first, last = values[before, curves], values[after, curves]
    share = share.reshape(-1, *[1] * (values.ndim - 2)).astype(values.dtype)
    return np.where(share > 0.0, first + share * (last - first), first)


def lines_at(knots: np.ndarray, times: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each curve the knot at or before a frame, the one at or after it, (N,) int64, and the share (N,) float64 of
    the second in the frame: 0 at the first of them.
    """
    before = frame - np.argmax(knots[frame::-1], axis=0)
    after = frame + np.argmax(knots[frame:], axis=0)
    span = times[after] - times[before]
    share = np.where(span > 0.0, (times[frame] - times[before]) / np.where(span > 0.0, span, 1.0), 0.0)
    return before, after, share
