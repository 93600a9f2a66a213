"""The joint fit of all frames: gradients of frames move the knots around them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from cubicsplat_cli.motion.tracks import PAINTS, Tracks, track_gradients
from cubicsplat_cli.progress import nothing, work
from cubicsplat_cli.raster.cpu import native
from cubicsplat_cli.raster.engine import Engine
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.record import record

KEEP_MEAN, KEEP_SQUARE, EPSILON = 0.8, 0.95, 1e-12  # Adam's (Kingma and Ba, 2015)
RATE_END = 0.05  # of the first step size, at the end of the cosine decay


@record
class KnotRates:
    """Step sizes of Adam. points: px, of shapes and offsets. paints: of colours and opacities, in their range."""

    points: float
    paints: float

    def scaled(self, share: float) -> KnotRates:
        """So many times as long steps."""
        return KnotRates(share * self.points, share * self.paints)

    def of(self, track: str) -> float:
        """That of a track."""
        return self.paints if track in PAINTS else self.points


class JointFit:
    """Fits the knots of tracks, in place, to frames (H, W, C).

    Frames are alike, and most knots have several: a step by one frame is as good as one by all, and there are as many
    more of them. Curves have no opacity from then on where they have none at a knot.
    grid: the steps of all values, where they are to be good after rounding: frames are drawn as rounded, and the
    gradient there moves the values behind (a straight-through estimator).
    """

    def __init__(
        self, tracks: Tracks, frames: list[np.ndarray], engine: Engine, raster: RasterSettings,
        grid: dict[str, np.ndarray] | None = None,
    ) -> None:  # fmt: skip
        self.tracks, self.frames, self.engine, self.raster, self.grid = tracks, frames, engine, raster, grid
        self.lines = tracks.lines()
        # Of each track Adam's means and squares, of all values, and its number of steps, of each knot.
        self.moments = {
            name: (np.zeros_like(track.values), np.zeros_like(track.values), np.zeros(track.knots.shape, np.int32))
            for name, track in tracks.by_name.items()
        }
        self.held = {"opacities": tracks.by_name["opacities"].values == 0.0}

    def run(
        self, epochs: int, rates: KnotRates, generator: np.random.Generator, finish: RasterSettings,
        finish_share: float, on_epoch: Callable[[float], None] = nothing,
    ) -> None:  # fmt: skip
        """So many times every frame, with step sizes that decay, and in the last share of the epochs with other
        settings of coverage: exact ones take twice the time. on_epoch: told the share of epochs that are done.

        Raises Stopped between two steps.
        """
        steps = epochs * len(self.frames)
        for epoch in range(epochs):
            on_epoch(epoch / epochs)
            if epoch >= (1.0 - finish_share) * epochs:
                self.raster = finish
            for turn, frame in enumerate(generator.permutation(len(self.frames)).tolist()):
                work().at()
                along = (epoch * len(self.frames) + turn) / steps
                share = RATE_END + (1.0 - RATE_END) * 0.5 * (1.0 + math.cos(math.pi * along))
                self.step(frame, rates.scaled(share))

    def step(self, frame: int, rates: KnotRates) -> None:
        """One step by the gradient of a frame."""
        scene, seen = self.tracks.at(frame, self.lines, self.grid)
        _, found = self.engine.gradients(scene, self.raster, target=self.frames[frame])
        for name, gradient in track_gradients(found).items():
            self.move(name, gradient, frame, seen, rates.of(name))

    def move(self, name: str, gradient: np.ndarray, frame: int, curves: np.ndarray, rate: float) -> None:
        """One step of the knots of a track by the gradient (n, C) of a frame's values of some curves (n,)."""
        native(
            "clip", "cs_step_knots", *gradient.shape, np.ascontiguousarray(gradient),
            *self.lines[name].rows(frame, curves), self.held.get(name), name in PAINTS, rate, KEEP_MEAN, KEEP_SQUARE,
            EPSILON, self.tracks.by_name[name].values, *self.moments[name], result=None,
        )  # fmt: skip
