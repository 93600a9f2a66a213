"""The fit: steps of the engine under the schedule, capacity reallocation in between, an exact finish at the end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import EngineError, InputError
from ..raster.cpu import CpuEngine, OptimiserState, Rates
from ..raster.engines import open_engine
from ..raster.settings import RasterSettings
from ..scene import Scene
from .capacity import gini, reallocate
from .initial import colour_logits, control_points, random_centres
from .parameters import Background, Parameters
from .presets import FitSettings, parse_background
from .schedule import Phase, Schedule

REPORT_SECONDS = 0.1
HISTORY_ENTRIES = 50


@dataclass(frozen=True)
class Progress:
    """Where a fit stands. psnr_db: of the engine's own picture. replaced: curves re-seeded so far."""

    step: int
    steps: int
    psnr_db: float
    ms_per_step: float
    replaced: int
    seconds_left: float


@dataclass
class FitResult:
    """The best scene of a fit, and how it came about. samples: edges per cubic of the exact finish (S*)."""

    scene: Scene
    steps: int
    fit_s: float
    ms_per_step: float
    history: list[dict[str, float]]
    interrupted: bool
    device: dict[str, Any]
    samples: int
    replaced: int
    settings: FitSettings


def psnr(loss: float, values: int) -> float:
    """dB of a sum of squared errors over so many values in [0, 1]; at most 100."""
    return min(100.0, 10.0 * math.log10(values / max(loss, 1e-300)))


def fit(
    target: np.ndarray, settings: FitSettings, on_progress: Callable[[Progress], None] | None = None
) -> FitResult:
    """Fits a scene to a picture (H, W, 3), or (H, W, 4) premultiplied RGBA, float32 in [0, 1].

    An interrupt (Ctrl-C) ends the fit early with the best scene so far. Raises InputError for a picture of another
    form, EngineError where the engine cannot run or meets a value that is not finite.
    """
    if target.ndim != 3 or target.shape[2] not in (3, 4) or 0 in target.shape:
        raise InputError(f"the picture must have shape (height, width, 3 or 4), not {target.shape}")
    if not np.isfinite(target).all():
        raise InputError("the picture has values that are not finite")
    trainer = Trainer(torch.from_numpy(np.ascontiguousarray(target, dtype=np.float32)), settings, on_progress)
    return trainer.run()


def choose_background(target: Tensor, settings: FitSettings) -> Background:
    """The colour behind the curves: the picture's mean, the given one, or none for a picture with transparency."""
    if target.shape[2] == 4:
        return None
    given = parse_background(settings.background)
    if given is not None:
        return given
    mean = [round(float(v) * 255) / 255 for v in target.mean((0, 1))]
    return mean[0], mean[1], mean[2]


@dataclass
class Trainer:
    """State of one fit."""

    target: Tensor
    settings: FitSettings
    on_progress: Callable[[Progress], None] | None = None
    history: list[dict[str, float]] = field(default_factory=list)
    replaced: int = 0
    step: int = 0

    def __post_init__(self) -> None:
        self.height, self.width, self.channels = (int(n) for n in self.target.shape)
        self.size = math.sqrt(self.width * self.height)
        self.generator = torch.Generator().manual_seed(self.settings.seed)
        self.schedule = Schedule(self.settings.recipe, self.settings.steps)
        self.engine: CpuEngine = open_engine(self.settings.device, self.settings.threads)
        if self.channels == 3 and self.settings.background == "none":
            self.target = torch.cat([self.target, torch.ones(self.height, self.width, 1)], -1)
            self.channels = 4
        self.background = choose_background(self.target, self.settings)
        self.image = torch.empty_like(self.target)
        self.values = self.height * self.width * 3
        self.parameters = self._start()
        self.state = OptimiserState.zeros(self.settings.curves, int(self.parameters.points.shape[1]))
        self.best: tuple[float, Parameters] | None = None
        self.started = self.reported = time.perf_counter()

    def _start(self) -> Parameters:
        recipe, n = self.settings.recipe, self.settings.curves
        centres = random_centres(n, self.target, self.generator)
        radius = recipe.start_radius_size * self.size
        return Parameters(
            control_points(centres, radius, self.settings, self.generator).contiguous(),
            colour_logits(centres, self.target),
            torch.full((n,), recipe.opacity_logit),
            torch.full((n,), recipe.half_width),
        )

    def run(self) -> FitResult:
        interrupted = False
        try:
            while self.step < self.settings.steps:
                self._one_step()
        except KeyboardInterrupt:
            interrupted = True
        self._consider(self._exact_loss(), self.parameters)
        seconds = time.perf_counter() - self.started
        assert_best = self.best[1] if self.best else self.parameters
        self.parameters = assert_best
        scene = self.parameters.scene(self.settings.mode, self.width, self.height, self.background)
        return FitResult(
            scene, self.step, seconds, 1e3 * seconds / max(self.step, 1), self.history, interrupted,
            self.engine.describe(), self.settings.finish_samples, self.replaced, self.settings,
        )  # fmt: skip

    def _raster(self, phase: Phase) -> RasterSettings:
        tolerance = self.settings.recipe.tolerance
        if phase.exact:
            return RasterSettings("exact", phase.edge_width, self.settings.finish_samples, tolerance / 4)
        return RasterSettings("relaxed", phase.edge_width, self.settings.samples, tolerance)

    def _rates(self, phase: Phase) -> Rates:
        recipe = self.settings.recipe
        return Rates(
            points=phase.rate * recipe.rate_points_size * self.size,
            colours=phase.rate * recipe.rate_colours,
            opacities=phase.rate * recipe.rate_opacities,
            half_widths=phase.rate * recipe.rate_half_widths_size * self.size,
        )

    def _tensors(self):
        return self.parameters.tensors(self.settings.mode, self.width, self.height, self.background)

    def _one_step(self) -> None:
        phase = self.schedule.phase(self.step)
        fraction = self.schedule.reallocation(self.step)
        before = self.parameters.copy() if phase.exact else None
        importance = torch.zeros(self.parameters.curves) if fraction > 0 else None
        loss = self.engine.step(
            self._tensors(), self._raster(phase), self.target, self.state, self._rates(phase),
            image=self.image if fraction > 0 else None, importance=importance,
            importance_kind=self.settings.recipe.importance,
        )  # fmt: skip
        if not math.isfinite(loss):
            self._name_non_finite(loss)
        if before is not None:
            self._consider(loss, before)
        if importance is not None:
            self._reallocate(importance, fraction)
        self.step += 1
        self._report(loss)

    def _reallocate(self, importance: Tensor, fraction: float) -> None:
        if gini(importance) < self.settings.recipe.gini_threshold:
            return
        self.parameters, self.state, count = reallocate(
            self.parameters, self.state, importance, self.image, self.target, fraction, self.settings, self.generator
        )
        self.replaced += count

    def _consider(self, loss: float, parameters: Parameters) -> None:
        """Keeps the parameters if their exact picture is the best so far."""
        if self.best is None or loss < self.best[0]:
            self.best = (loss, parameters.copy())

    def _exact_loss(self) -> float:
        raster = RasterSettings("exact", 1.0, self.settings.finish_samples)
        loss, _ = self.engine.gradients(self._tensors(), raster, target=self.target)
        return loss

    def _name_non_finite(self, loss: float) -> None:
        found = self.parameters.first_non_finite()
        where = f"curve {found[0]} has a non-finite value in {found[1]}" if found else f"the loss is {loss}"
        raise EngineError(f"the fit broke down at step {self.step}: {where}; lower the step sizes or change --seed")

    def _report(self, loss: float) -> None:
        now = time.perf_counter()
        last = self.step == self.settings.steps
        if self.step % max(1, self.settings.steps // HISTORY_ENTRIES) == 0 or last:
            level, seconds = round(psnr(loss, self.values), 3), round(now - self.started, 3)
            self.history.append({"step": self.step, "psnr_db": level, "seconds": seconds})
        if self.on_progress and (now - self.reported >= REPORT_SECONDS or last):
            self.reported = now
            per_step = (now - self.started) / self.step
            self.on_progress(
                Progress(
                    self.step, self.settings.steps, psnr(loss, self.values), 1e3 * per_step, self.replaced,
                    per_step * (self.settings.steps - self.step),
                )
            )
