"""The joint fit of all frames: gradients of frames move the knots around them."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.motion.tracks import PAINTS, Tracks, gradients_of
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.engine import Engine
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.records import dataclass

KEEP_MEAN, KEEP_SQUARE, EPSILON = 0.9, 0.95, 1e-12  # Adam's (Kingma and Ba, 2015)
STRIDE = 8  # frames of a step lie so far apart: most knots then have one of them near
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

    grid: the steps of all values, where they are to be good after rounding: frames are drawn as rounded, and the
    gradient there moves the values behind (a straight-through estimator).
    """

    def __init__(
        self, tracks: Tracks, frames: list[np.ndarray], engine: Engine, raster: RasterSettings,
        grid: dict[str, np.ndarray] | None = None,
    ) -> None:  # fmt: skip
        self.tracks, self.frames, self.engine, self.raster, self.grid = tracks, frames, engine, raster, grid
        self.lines = tracks.lines()
        values = {name: track.values for name, track in tracks.by_name.items()}
        self.means = {name: np.zeros_like(value) for name, value in values.items()}
        self.squares = {name: np.zeros_like(value) for name, value in values.items()}
        self.ages = {name: np.zeros(value.shape[:2], np.int32) for name, value in values.items()}
        self.losses = np.full(len(frames), math.inf)

    def run(self, epochs: int, rates: KnotRates, generator: np.random.Generator) -> None:
        """So many times every frame, with step sizes that decay. Raises Stopped between two steps."""
        stride = min(STRIDE, len(self.frames))
        for epoch in range(epochs):
            share = RATE_END + (1.0 - RATE_END) * 0.5 * (1.0 + math.cos(math.pi * epoch / epochs))
            for phase in generator.permutation(stride).tolist():
                work().at()
                self.step(range(phase, len(self.frames), stride), rates.scaled(share))

    def step(self, chosen: range, rates: KnotRates) -> None:
        """One step by the gradients of some frames."""
        sums, touched = self.gradients(chosen)
        for name, gradient in sums.items():
            self._move(name, gradient, touched[name], rates.of(name))

    def gradients(self, chosen: range) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Of each track the gradient (F, N, C) of the loss of some frames by the values of knots, and the (F, N) knots
        that have one.
        """
        tracks = self.tracks if self.grid is None else self.tracks.on_grid(self.grid)
        sums = {name: np.zeros_like(track.values) for name, track in tracks.by_name.items()}
        touched = {name: np.zeros(track.knots.shape, bool) for name, track in tracks.by_name.items()}
        every = np.arange(tracks.by_name["shapes"].knots.shape[1])
        for frame in chosen:
            scene = tracks.at(frame, self.lines)
            self.losses[frame], found = self.engine.gradients(scene, self.raster, target=self.frames[frame])
            for name, gradient in gradients_of(found).items():
                lines = self.lines[name]
                lines.distribute(gradient, frame, sums[name])
                touched[name][lines.before[frame], every] = True
                touched[name][lines.after[frame], every] = True
        return sums, touched

    def _move(self, name: str, sums: np.ndarray, touched: np.ndarray, rate: float) -> None:
        gradient = sums[touched]
        self.ages[name][touched] += 1
        age = self.ages[name][touched][:, None]
        mean = KEEP_MEAN * self.means[name][touched] + (1.0 - KEEP_MEAN) * gradient
        square = KEEP_SQUARE * self.squares[name][touched] + (1.0 - KEEP_SQUARE) * gradient * gradient
        self.means[name][touched], self.squares[name][touched] = mean, square
        scale = np.sqrt(square / (1.0 - KEEP_SQUARE**age)) + EPSILON
        values = self.tracks.by_name[name].values
        moved = values[touched] - rate * (mean / (1.0 - KEEP_MEAN**age)) / scale
        values[touched] = moved.clip(0.0, 1.0) if name in PAINTS else moved
