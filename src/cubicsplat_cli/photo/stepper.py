"""One training step: the engine's, with what it leaves to others: penalties on shapes, gradient fills, other losses."""

from __future__ import annotations

import math
from dataclasses import replace

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.photo.evaluator import Evaluator
from cubicsplat_cli.photo.fills import Shapes
from cubicsplat_cli.photo.geometric import Regulariser
from cubicsplat_cli.photo.schedule import Phase, Schedule
from cubicsplat_cli.photo.state import FitState
from cubicsplat_cli.raster.engine import RATED, Rates, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene.arrays import Array, namespace


class Stepper:
    """Moves the curves of a state, in place, towards the goal of the evaluator.

    The engine trains on the state's own arrays for as long as the stepper is used. unit: of the recipe's lengths, px.
    frozen: how many of the last curves stay as they are. image, importance: of the last step that was to fill them.
    loss: before the last step, 0 before the first.
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
            goal, state.optimiser, Rates(0.0, 0.0, 0.0, 0.0), importance_kind=recipe.importance,
            weights=self.objective.weights, penalty=self.objective.judged_by,
            image_gradient=None if self.objective.pixelwise else xp.empty_like(goal),
        )  # fmt: skip
        if self.scene.gradients is not None:
            self.training.frames_gradient = xp.empty_like(self.scene.gradients.frames)
            self.training.stops_gradient = xp.empty_like(self.scene.gradients.stops)
        if curves.restricted is not None:
            self.training.of_points = xp.empty_like(curves.points)
        self.still: Array | None = None  # (N,): the curves that are frozen
        if frozen:
            scale = xp.ones((curves.curves, RATED), dtype=xp.float32, device=goal.device)
            scale[-frozen:] = 0.0
            self.training.rate_scale = scale
            self.still = scale[:, 0] == 0.0
        joins = curves.curves * schedule.settings.segments
        self.regulariser = Regulariser(recipe, curves.mode, (curves.width, curves.height), joins)

    def step(self, phase: Phase, progress: float, *, measured: bool) -> float | Array:
        """One step of this phase; returns the loss before it. measured: also fills image and importance.

        The fills of gradients are updated by their derivatives of before the step.
        """
        curves, training = self.state.curves, self.training
        training.rates = self.schedule.rates(phase, self.unit)
        if curves.restricted is None or not curves.restricted.has_axes:  # those have no spikes and cannot cross
            training.points_gradient = self.regulariser.gradient(
                curves.points, curves.ring_ends, progress=progress, loss=self.loss
            )
        training.importance = self.importance if measured else None
        training.image = self.image if measured or not self.objective.squared else None
        raster = self.schedule.raster(phase)
        if curves.restricted is not None:
            self._step_shapes(curves.restricted, raster)
        elif curves.fills is None:
            self.loss = self._engine_step(raster)
        else:
            assert self.scene.gradients is not None
            middles = curves.middles()
            self.scene.gradients.overwrite(curves.fills.gradients(middles))
            self.loss = self._engine_step(raster)
            curves.fills.learn(
                middles, training.frames_gradient, training.stops_gradient, training.rates, self.still
            )  # fmt: skip
        if self.schedule.recipe.shared_opacity > 0.0:
            curves.opacities[...] = curves.opacities.mean()
        return self.loss

    def _step_shapes(self, shapes: Shapes, raster: RasterSettings) -> None:
        """The same for restricted shapes: the engine moves all but the points, and says how these would move."""
        training, rates, further = self.training, self.training.rates, self.training.points_gradient
        training.rates, training.points_gradient = replace(rates, points=0.0), None
        self.loss = self._engine_step(raster)
        of_points = training.of_points
        shapes.learn(of_points if further is None else of_points + further, rates)
        self.state.curves.points[...] = shapes.points()

    def _engine_step(self, raster: RasterSettings) -> float | Array:
        training = self.training
        if training.image_gradient is None:
            return self.engine.step(self.scene, raster, training)
        loss, gradient = self.objective.gradient(self.engine.render(self.scene, raster))
        training.image_gradient[...] = gradient
        self.engine.step(self.scene, raster, training)
        return loss if self.engine.runs_ahead else float(loss)

    def replace(self, state: FitState) -> None:
        """Goes on with as many other curves, whose values are copied to where the engine's arrays are."""
        self.state.overwrite(state)
        if self.schedule.recipe.shared_opacity > 0.0:
            self.state.share_opacity()
        self.regulariser.forget()

    def check_finite(self, step: int, *, wait: bool = False) -> None:
        """Before a step: within it one bad curve spoils every curve that it shares a pixel with. Raises EngineError.

        A GPU's engine looks by itself; without `wait` this is what it found some steps ago.
        """
        if fault := self.engine.fault(wait):
            raise self._broken_down(f"curve {fault[0]} has a non-finite value", step)
        if not self.engine.runs_ahead and (found := self.state.curves.first_non_finite()):
            raise self._broken_down(f"curve {found[0]} has a non-finite value in {found[1]}", step)

    def check_loss(self, step: int) -> None:
        """After a step. Raises EngineError where its loss is not finite; a GPU's engine looks by itself."""
        if isinstance(self.loss, float) and not math.isfinite(self.loss):
            raise self._broken_down(f"the loss is {self.loss}", step)

    def _broken_down(self, where: str, step: int) -> EngineError:
        """The error, with the curve and step that the engine has noted, if it has: that may be some steps ago."""
        if fault := self.engine.fault():
            where, step = f"curve {fault[0]} has a non-finite value", fault[1]
        return EngineError(f"the fit broke down at step {step}: {where}; lower the step sizes or change --seed")
