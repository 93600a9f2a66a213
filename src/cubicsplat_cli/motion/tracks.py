"""Tracks: the numbers of curves over the frames of a group, on knots of their own, their gradients, and the joint fit
of all frames, in which the gradients of frames move the knots around them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.progress import nothing, work
from cubicsplat_cli.raster.cpu import CpuEngine, FrameSteps, NativeTrack
from cubicsplat_cli.raster.engine import EngineScene
from cubicsplat_cli.raster.native import address_of, floats, native
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import width_decimals

# What moves on knots of its own: the shape without its offset (control points and half-width), the offset, the fill.
TRACKS = ("shapes", "offsets", "colours", "opacities")
OPACITY_DECIMALS = 2  # of a file: more would not show beside the error of a fit
PAINTS = ("colours", "opacities")  # the tracks whose values lie in [0, 1]
EVERY = slice(None)
KEEP_MEAN, KEEP_SQUARE, EPSILON = 0.8, 0.95, 1e-12  # Adam's (Kingma and Ba, 2015)
AT_ONCE = 8  # steps between two looks whether to stop
RATE_END = 0.05  # of the first step size, at the end of the cosine decay


@dataclass(eq=False)
class KnotTrack:
    """One of `TRACKS`, linear in time between knots. values: (F, N, C) float32, of which only the rows of knots count.
    knots: (F, N) bool, the first and the last frame always.

    still: (N,) bool: the curves whose values never change; they are those of the first frame.
    """

    values: np.ndarray
    knots: np.ndarray
    still: np.ndarray

    @property
    def count(self) -> int:
        """The knots of all curves that are not still."""
        return int(self.knots[:, ~self.still].sum())

    def lines(self, times: np.ndarray) -> Lines:
        """Return the knots around each frame."""
        numbers, last = np.arange(len(times))[:, None], len(times) - 1
        before = np.maximum.accumulate(np.where(self.knots, numbers, 0), axis=0)
        after = np.minimum.accumulate(np.where(self.knots, numbers, last)[::-1], axis=0)[::-1]
        span = times[after] - times[before]
        share = (times[:, None] - times[before]) / np.where(span > 0.0, span, 1.0)
        before[:, self.still], after[:, self.still], share[:, self.still] = 0, 0, 0.0
        return Lines(np.ascontiguousarray(before), np.ascontiguousarray(after), share.astype(np.float32))


@record
class Lines:
    """(F, N): of each frame and curve the knots before and after it, int64, and the share of the latter, float32."""

    before: np.ndarray
    after: np.ndarray
    share: np.ndarray

    def at(self, values: np.ndarray, frame: int, curves: np.ndarray | slice = EVERY) -> np.ndarray:
        """(n, C): the values (F, N, C) of knots, at a frame between them, of some curves (n,)."""
        count = self.before.shape[1]
        numbers = np.arange(count)[curves]
        before, after = (knots[frame, curves] * count + numbers for knots in (self.before, self.after))
        share = np.ascontiguousarray(self.share[frame, curves])
        found = np.empty((len(before), values.shape[2]), np.float32)
        native("clip", "cs_between_knots", *found.shape, values, before, after, share, found, result=None)
        return found


@dataclass(eq=False)
class Tracks:
    """All numbers of N curves over F frames without a scene cut. scene: canvas and topology. times: (F,) s, rising, at
    which each frame begins. end: of the last frame, s.

    by_name: of each of `TRACKS` its `KnotTrack`: shapes (2 K coordinates in px, and the half-width), offsets (2, px),
    colours (3), opacities (1). Control points are shape plus offset.
    """

    scene: Scene
    times: np.ndarray
    end: float
    by_name: dict[str, KnotTrack]

    @classmethod
    def on_every_frame(cls, scenes: list[Scene], times: np.ndarray, end: float) -> Tracks:
        """Tracks through scenes, one of each frame, with a knot at every one; offsets are 0."""
        frames, curves = len(scenes), scenes[0].curves
        points = np.stack([scene.points for scene in scenes]).reshape(frames, curves, -1)
        widths = np.stack([scene.half_widths for scene in scenes])[..., None]
        values = {
            "shapes": np.concatenate([points, widths], axis=2),
            "offsets": np.zeros((frames, curves, 2)),
            "colours": np.stack([scene.colours for scene in scenes]),
            "opacities": np.stack([scene.opacities for scene in scenes])[..., None],
        }
        by_name = {
            name: KnotTrack(floats(each), np.ones((frames, curves), bool), np.zeros(curves, bool))
            for name, each in values.items()
        }
        return cls(scenes[0], times, end, by_name)

    @property
    def frames(self) -> int:
        """F, the number of frames."""
        return len(self.times)

    def lines(self) -> dict[str, Lines]:
        """Of each track; good for as long as knots and still curves stay the same."""
        return {name: track.lines(self.times) for name, track in self.by_name.items()}

    def at(self, frame: int, lines: dict[str, Lines]) -> tuple[EngineScene, np.ndarray]:
        """Return the scene of a frame, as the engine draws it, and which curves (n,) it has: those with an opacity."""
        opacities = lines["opacities"].at(self.by_name["opacities"].values, frame)
        seen = np.flatnonzero(opacities[:, 0] > 0.0)
        found = {name: lines[name].at(track.values, frame, seen) for name, track in self.by_name.items()}
        return engine_scene(self.scene, found), seen

    def on_grid(self, grid: dict[str, np.ndarray]) -> Tracks:
        """The same with the values of knots as a file has them."""
        by_name = {
            name: replace(track, values=(np.rint(track.values / grid[name]) * grid[name]).astype(np.float32))
            for name, track in self.by_name.items()
        }
        return replace(self, by_name=by_name)


def grid_of(points: int, precision: int) -> dict[str, np.ndarray]:
    """Of each track the steps (C,) of its values in a file with `precision` decimals, for so many control points."""
    coordinates, width = 10.0**-precision, 0.5 * 10.0 ** -width_decimals(precision)
    return {
        "shapes": np.array([coordinates] * (2 * points) + [width]), "offsets": np.full(2, coordinates),
        "colours": np.full(3, 1.0 / 255.0), "opacities": np.full(1, 10.0**-OPACITY_DECIMALS),
    }  # fmt: skip


def engine_scene(scene: Scene, values: dict[str, np.ndarray]) -> EngineScene:
    """A scene on another's canvas with these numbers of its curves, (N, C) of each track."""
    shapes = values["shapes"]
    points = shapes[:, :-1].reshape(len(shapes), -1, 2) + values["offsets"][:, None]
    return EngineScene(
        scene.mode, scene.width, scene.height, floats(points), floats(values["colours"]),
        floats(values["opacities"][:, 0]), floats(shapes[:, -1]), scene.background, scene.ring_ends,
    )  # fmt: skip


def track_gradients(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Of each track, (N, C): an engine's gradients by a frame's points, colours, opacities and half-widths."""
    points = found["points"]
    return {
        "shapes": np.concatenate([points.reshape(len(points), -1), found["half_widths"][:, None]], axis=1),
        "offsets": points.sum(axis=1),
        "colours": found["colours"],
        "opacities": found["opacities"][:, None],
    }


class JointFit:
    """Fits the knots of tracks, in place, to frames (H, W, C).

    Frames are alike, and most knots have several: a step by one frame is as good as one by all, and there are as many
    more of them. Curves have no opacity from then on where they have none at a knot.
    grid: the steps of all values, where they are to be good after rounding: frames are drawn as rounded, and the
    gradient there moves the values behind (a straight-through estimator).
    """

    def __init__(
        self, tracks: Tracks, frames: list[np.ndarray], engine: CpuEngine, raster: RasterSettings,
        grid: dict[str, np.ndarray] | None = None,
    ) -> None:  # fmt: skip
        self.tracks, self.frames, self.engine, self.raster, self.grid = tracks, frames, engine, raster, grid
        self.lines = tracks.lines()
        # Of each track Adam's means and squares, of all values, and its number of steps, of each knot.
        self.moments = {
            name: (np.zeros_like(track.values), np.zeros_like(track.values), np.zeros(track.knots.shape, np.int32))
            for name, track in tracks.by_name.items()
        }
        self.held = tracks.by_name["opacities"].values == 0.0
        self.canvas, _ = tracks.at(0, self.lines)
        pictures = [self.canvas.addresses("cpu", {"target": frame})["target"] for frame in frames]
        self.targets = np.array(pictures, np.uintp)
        self.native = (NativeTrack * len(TRACKS))(*(self._native(name) for name in TRACKS))

    def _native(self, name: str) -> NativeTrack:
        track, lines, steps = self.tracks.by_name[name], self.lines[name], (self.grid or {}).get(name)
        return NativeTrack(
            track.values.shape[2], address_of(lines.before), address_of(lines.after), address_of(lines.share),
            None if steps is None else address_of(steps), address_of(self.held) if name == "opacities" else None,
            name in PAINTS, address_of(track.values), *map(address_of, self.moments[name]),
        )  # fmt: skip

    def run(
        self, epochs: int, rates: tuple[float, float], generator: np.random.Generator, finish: RasterSettings,
        finish_share: float, on_epoch: Callable[[float], None] = nothing,
    ) -> None:  # fmt: skip
        """So many times every frame, with step sizes that decay, and in the last share of the epochs with other
        settings of coverage: exact ones take twice the time. rates: as of `step`. on_epoch: told the share of epochs
        that are done. Raises Stopped between two steps.
        """
        steps = epochs * len(self.frames)
        for epoch in range(epochs):
            on_epoch(epoch / epochs)
            if epoch >= (1.0 - finish_share) * epochs:
                self.raster = finish
            order = generator.permutation(len(self.frames))
            along = (epoch * len(order) + np.arange(len(order))) / steps
            shares = RATE_END + (1.0 - RATE_END) * 0.5 * (1.0 + np.cos(math.pi * along))
            for begin in range(0, len(order), AT_ONCE):
                work().at()
                part = slice(begin, begin + AT_ONCE)
                self.step(order[part], shares[part, None] * rates)

    def step(self, frames: np.ndarray, rates: np.ndarray) -> None:
        """Steps by the gradients of frames (n,), one after the other.

        rates: (n, 2), step sizes of Adam: px of shapes and offsets, and of colours and opacities, in their range.
        """
        given = np.ascontiguousarray(frames, np.int64), self.targets[frames], np.ascontiguousarray(rates, np.float64)
        steps = FrameSteps(
            self.tracks.by_name["shapes"].knots.shape[1], self.native, len(frames), *map(address_of, given), KEEP_MEAN,
            KEEP_SQUARE, EPSILON,
        )  # fmt: skip
        self.engine.step_frames(self.canvas, self.raster, steps)
