"""The joint fit of all frames: gradients of frames move the knots around them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.motion.tracks import PAINTS, Tracks, gradients_of
from cubicsplat_cli.progress import nothing, work
from cubicsplat_cli.raster.engine import Engine
from cubicsplat_cli.raster.settings import RasterSettings

KEEP_MEAN, KEEP_SQUARE, EPSILON = 0.8, 0.95, 1e-12  # Adam's (Kingma and Ba, 2015)
RATE_END = 0.05  # of the first step size, at the end of the cosine decay


@dataclass(frozen=True)
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
        # Of each track, by the rows of its values as (F N, C): those, both means of Adam, and the number of steps.
        rows = {name: track.values.reshape(-1, track.values.shape[2]) for name, track in tracks.by_name.items()}
        self.state = {
            name: (values, np.zeros_like(values), np.zeros_like(values), np.zeros(len(values), np.int32))
            for name, values in rows.items()
        }
        self.gone = rows["opacities"] == 0.0

    def run(
        self, epochs: int, rates: KnotRates, generator: np.random.Generator, on_epoch: Callable[[float], None] = nothing
    ) -> None:  # fmt: skip
        """So many times every frame, with step sizes that decay. on_epoch: told the share of epochs that are done.

        Raises Stopped between two steps.
        """
        steps = epochs * len(self.frames)
        for epoch in range(epochs):
            on_epoch(epoch / epochs)
            for turn, frame in enumerate(generator.permutation(len(self.frames)).tolist()):
                work().at()
                along = (epoch * len(self.frames) + turn) / steps
                share = RATE_END + (1.0 - RATE_END) * 0.5 * (1.0 + math.cos(math.pi * along))
                self.step(frame, rates.scaled(share))

    def step(self, frame: int, rates: KnotRates) -> None:
        """One step by the gradient of a frame."""
        for name, (gradient, places) in self.gradients(frame)[1].items():
            self._move(name, gradient, places, rates.of(name))

    def gradients(self, frame: int) -> tuple[float, dict[str, tuple[np.ndarray, np.ndarray]]]:
        """The loss of a frame, and of each track its gradient by the values of knots, as `Lines.distributed`."""
        scene, seen = self.tracks.at(frame, self.lines, self.grid)
        loss, found = self.engine.gradients(scene, self.raster, target=self.frames[frame])
        return loss, {
            name: self.lines[name].distributed(gradient, frame, seen) for name, gradient in gradients_of(found).items()
        }

    def _move(self, name: str, gradient: np.ndarray, places: np.ndarray, rate: float) -> None:
        values, means, squares, ages = self.state[name]
        ages[places] += 1
        age = ages[places][:, None]
        mean = KEEP_MEAN * means[places] + (1.0 - KEEP_MEAN) * gradient
        square = KEEP_SQUARE * squares[places] + (1.0 - KEEP_SQUARE) * gradient * gradient
        means[places], squares[places] = mean, square
        scale = np.sqrt(square / (1.0 - KEEP_SQUARE**age)) + EPSILON
        moved = values[places] - rate * (mean / (1.0 - KEEP_MEAN**age)) / scale
        if name == "opacities":
            moved[self.gone[places]] = 0.0
        values[places] = moved.clip(0.0, 1.0) if name in PAINTS else moved
