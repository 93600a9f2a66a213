"""The steps of a fit: their schedule, and single steps.

The schedule holds the edge width, step sizes, reallocations and the exact finish, nearly all functions of the progress
in [0, 1]: the share of the steps or, under a time limit, of the time. A step is the engine's, with penalties on shapes,
gradient fills and losses that the engine does not know.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.photo.evaluator import Evaluator
from cubicsplat_cli.photo.fills import Shapes
from cubicsplat_cli.photo.geometric import Regulariser
from cubicsplat_cli.photo.state import BestCheckpoint, FitState
from cubicsplat_cli.raster.engine import RATED, Rates, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import Array, as_numpy, namespace
from cubicsplat_cli.settings import FitSettings

# The published course of the step sizes: (from this share of the steps on, factor).
PUBLISHED_RATES = ((0.0, 1.0), (0.5, 0.5), (0.6, 0.2), (0.9, 0.1))
FLATNESS = 0.5  # px, of de Casteljau subdivision
FINISH_TOLERANCE = 0.1  # px: cairo's own, so that the file is drawn no finer than it was fitted
AFTER_STEPS = 5  # the work after the last step takes about as long as so many steps


@record
class Phase:
    """The settings of a step. rate: a factor of all step sizes; edge_width: px; exact: area coverage going forward."""

    rate: float
    edge_width: float
    exact: bool


class Schedule:
    """The course of a fit with these settings."""

    def __init__(self, settings: FitSettings) -> None:
        self.settings, self.recipe = settings, settings.recipe
        # Long fits gain from more reallocations, but each needs more steps for its new curves to fall into place.
        density = self.recipe.reallocation_density if self.recipe.prune else 0.0
        self.reallocations = round(density * math.sqrt(settings.steps))
        self._done = 0
        self.finish_start = 1.0 - self.recipe.finish
        self.reallocations_end = self.recipe.reallocate_until * self.finish_start

    def progress(self, step: int, elapsed: float) -> float:
        """Return the share of the steps done or, if that is more, of the time used up; elapsed: seconds."""
        share, limit = step / self.settings.steps, self.settings.time_limit
        if limit is None or step == 0:
            return share
        return max(share, elapsed / max(limit - AFTER_STEPS * elapsed / step, 1e-9))

    def phase(self, progress: float) -> Phase:
        """Return the settings at a progress in [0, 1], or a little beyond if the clock overtook the last step."""
        recipe = self.recipe
        if recipe.finish > 0.0 and progress >= self.finish_start:
            along = (progress - self.finish_start) / recipe.finish
            return Phase(recipe.finish_rate * _fall(along, recipe.finish_rate_end), recipe.finish_edge_width, True)
        along = progress / self.finish_start
        anneal = min(1.0, along / recipe.anneal) if recipe.anneal > 0 else 1.0
        width = recipe.edge_start * (recipe.edge_end / recipe.edge_start) ** anneal
        if recipe.rate_course == "cosine":
            return Phase(_fall(along, recipe.rate_end), width, False)
        return Phase([factor for start, factor in PUBLISHED_RATES if along >= start][-1], width, False)

    def raster(self, phase: Phase) -> RasterSettings:
        """Return the settings of drawing in this phase."""
        coverage = "exact" if phase.exact else "relaxed"
        if self.recipe.flatten == "de-casteljau":
            return RasterSettings(coverage, phase.edge_width, 64, FLATNESS, subdivide=True)
        samples = self.settings.finish_samples if phase.exact else self.settings.samples
        tolerance = FINISH_TOLERANCE if phase.exact and self.recipe.tolerance > 0.0 else self.recipe.tolerance
        return RasterSettings(coverage, phase.edge_width, samples, tolerance)

    def rates(self, phase: Phase, unit: float) -> Rates:
        """Return the step sizes of this phase; unit: of the recipe's lengths, px."""
        recipe = self.recipe
        return Rates(
            points=phase.rate * recipe.rate_points * unit,
            colours=phase.rate * recipe.rate_colours,
            opacities=0.0 if recipe.opaque else phase.rate * recipe.rate_opacities,
            half_widths=phase.rate * recipe.rate_half_widths * unit,
            edge_widths=phase.rate * recipe.rate_edge_widths,
            keep=(recipe.keep_mean, recipe.keep_change, recipe.keep_square),
            epsilon=recipe.epsilon,
        )

    def reallocation(self, progress: float, inequality: float = 0.0, idle: float = 0.0) -> float:
        """Return the fraction of the curves to replace at this progress.

        inequality: `gini` of their importance, which decides by the published rule. idle: the fraction of curves
        without which the picture is no worse; the usual rule replaces at least these.
        """
        recipe = self.recipe
        if recipe.prune_rule == "gini":
            return recipe.prune_fraction * min(1.0, max(0.0, (inequality - recipe.gini_threshold) / 0.5))
        return max(idle, recipe.prune_fraction * (1.0 - progress / self.reallocations_end))

    def reallocation_due(self, progress: float) -> bool:
        """Return whether the next of the evenly spaced reallocations is due."""
        share = (self._done + 1) / (self.reallocations + 1)
        return share * self.reallocations_end <= progress < self.reallocations_end

    def take_reallocation(self, progress: float) -> bool:
        """Return whether the next reallocation is due, and count it as done."""
        due = self.reallocation_due(progress)
        self._done += due
        return due


def gini(importance: Array) -> float:
    """Return the Gini coefficient (0: all equal, towards 1: few carry all) of the positive parts of (N,) values."""
    values = np.sort(np.maximum(as_numpy(importance).astype(np.float64), 0.0))
    n, total = len(values), float(values.sum())
    return float((2 * np.arange(1, n + 1) - n - 1) @ values) / (n * total) if total > 0 else 0.0


def _fall(along: float, end: float) -> float:
    """Return a cosine that falls from 1 at 0 to `end` at 1."""
    return end + (1.0 - end) * 0.5 * (1.0 + math.cos(math.pi * min(max(along, 0.0), 1.0)))


class Stepper:
    """Moves the curves of a state, in place, towards the goal of the evaluator.

    The engine trains on the state's own arrays as long as the stepper is used. unit: of the recipe's lengths, px.
    frozen: the number of curves, the last ones, that stay as they are. image, importance: of the last step that filled
    them. loss: before the last step, 0 before the first. runs: true if there is nothing to do between two steps.
    """

    def __init__(self, state: FitState, evaluator: Evaluator, schedule: Schedule, unit: float, frozen: int) -> None:
        self.state, self.schedule, self.unit = state, schedule, unit
        self.engine, self.objective = evaluator.engine, evaluator.objective
        curves, goal, recipe = state.curves, self.objective.goal, schedule.recipe
        xp = namespace(goal)
        self.scene = curves.for_engine()
        self.image, self.importance = xp.empty_like(goal), xp.zeros_like(curves.half_widths)
        self.loss: float | Array = 0.0
        self.training = Training(
            goal, state.optimiser, Rates(0.0, 0.0, 0.0, 0.0), weights=self.objective.weights,
            penalty=self.objective.judged_by, gradient=None if self.objective.pixelwise else xp.empty_like(goal),
        )  # fmt: skip
        if self.scene.gradients is not None:
            names = ("frames", "stops")
            self.training.out |= {name: xp.empty_like(getattr(self.scene.gradients, name)) for name in names}
        if curves.restricted is not None:
            self.training.out["points"] = xp.empty_like(curves.points)
        self.still: Array | None = None  # (N,): the curves that are frozen
        if frozen:
            scale = xp.ones((curves.curves, RATED), dtype=xp.float32, device=goal.device)
            scale[-frozen:] = 0.0
            self.training.rate_scale = scale
            self.still = scale[:, 0] == 0.0
        joins = curves.curves * schedule.settings.segments
        self.regulariser = Regulariser(recipe, curves.mode, (curves.width, curves.height), joins)
        shapes, self._by_engine = curves.restricted, isinstance(curves.points, np.ndarray)
        if self._by_engine:
            self.training.shared_opacity = recipe.shared_opacity > 0.0
            if shapes is not None and not shapes.has_axes:
                self.training.tied = shapes.values, shapes.moments, shapes.ages, shapes.map()
        alone = self._by_engine or (self.engine.runs_ahead and recipe.shared_opacity == 0.0)
        moves_all = curves.fills is None and (shapes is None or self.training.tied is not None)
        self.runs = alone and moves_all and self.objective.pixelwise and recipe.crossing_penalty == 0.0

    def step(self, phase: Phase, progress: float, *, measured: bool) -> float | Array:
        """Do a step of this phase; return the loss before it. measured: also fill image and importance.

        Gradient fills are updated by their derivatives from before the step.
        """
        curves, training = self.state.curves, self.training
        self._prepare(phase, progress, measured=measured)
        raster = self.schedule.raster(phase)
        if curves.restricted is not None and training.tied is None:
            self._step_shapes(curves.restricted, raster)
        elif curves.fills is None:
            self.loss = self._engine_step(raster)
        else:
            assert self.scene.gradients is not None
            middles = curves.middles()
            self.scene.gradients.overwrite(curves.fills.gradients(middles))
            self.loss = self._engine_step(raster)
            curves.fills.learn(middles, training.out["frames"], training.out["stops"], training.rates, self.still)
        if self.schedule.recipe.shared_opacity > 0.0 and not self._by_engine:
            curves.opacities[...] = curves.opacities.mean()
        return self.loss

    def steps(self, phases: list[Phase], progress: float, seconds: float, best: BestCheckpoint | None) -> int:
        """Do several steps in a row, if it `runs`: of phases with the same coverage and penalties, from this progress
        on. best: is kept up to date. Return the number of steps done within so many seconds.
        """
        self._prepare(phases[0], progress, measured=False)
        paces = [(phase.edge_width, *self.schedule.rates(phase, self.unit).sizes) for phase in phases]
        raster, sizes = self.schedule.raster(phases[0]), np.array(paces, np.float32)
        losses = self.engine.steps(self.scene, raster, self.training, sizes, seconds, best)
        self.loss = losses[-1] if self.engine.runs_ahead else float(losses[-1])
        return len(losses)

    def _prepare(self, phase: Phase, progress: float, *, measured: bool) -> None:
        curves, training = self.state.curves, self.training
        training.rates = self.schedule.rates(phase, self.unit)
        if curves.restricted is None or not curves.restricted.has_axes:  # those have no spikes and cannot cross
            training.points_gradient = self.regulariser.crossing_gradient(curves.points, curves.ring_ends)
            training.blunting = self.regulariser.blunting(curves.points, progress=progress, loss=self.loss)
        training.importance = self.schedule.recipe.importance if measured else None
        training.out["importance"] = self.importance if measured else None
        training.image = self.image if measured or not self.objective.squared else None

    def _step_shapes(self, shapes: Shapes, raster: RasterSettings) -> None:
        """Do a step of restricted shapes: the engine moves all but the points, and gives the gradient of these."""
        training, rates, further = self.training, self.training.rates, self.training.points_gradient
        training.rates, training.points_gradient = replace(rates, points=0.0), None
        self.loss = self._engine_step(raster)
        of_points = training.out["points"]
        shapes.learn(of_points if further is None else of_points + further, rates)
        self.state.curves.points[...] = shapes.points()

    def _engine_step(self, raster: RasterSettings) -> float | Array:
        training = self.training
        if training.gradient is None:
            return self.engine.step(self.scene, raster, training)
        loss, gradient = self.objective.gradient(self.engine.render(self.scene, raster))
        training.gradient[...] = gradient
        self.engine.step(self.scene, raster, training)
        return loss if self.engine.runs_ahead else float(loss)

    def replace(self, state: FitState) -> None:
        """Go on with as many other curves, copied into the arrays that the engine has."""
        self.state.overwrite(state)
        if self.schedule.recipe.shared_opacity > 0.0:
            self.state.share_opacity()
        self.regulariser.forget()

    def check_finite(self, step: int, *, wait: bool = False) -> None:
        """Raise EngineError if a value is not finite: a step would spoil all curves that share a pixel with this one.

        A GPU's engine looks by itself; without `wait` its state of some steps ago counts.
        """
        if fault := self.engine.fault(wait):
            raise self._broken_down(f"curve {fault[0]} has a non-finite value", step)
        if not self.engine.runs_ahead and (found := self.state.curves.first_non_finite()):
            raise self._broken_down(f"curve {found[0]} has a non-finite value in {found[1]}", step)

    def check_loss(self, step: int) -> None:
        """Raise EngineError if the loss of the step is not finite; a GPU's engine looks by itself."""
        if isinstance(self.loss, float) and not math.isfinite(self.loss):
            raise self._broken_down(f"the loss is {self.loss}", step)

    def _broken_down(self, where: str, step: int) -> EngineError:
        """Return the error, with the curve and step that the engine has noted, perhaps some steps ago, if it has."""
        if fault := self.engine.fault():
            where, step = f"curve {fault[0]} has a non-finite value", fault[1]
        return EngineError(f"the fit broke down at step {step}: {where}; lower the step sizes or change --seed")
