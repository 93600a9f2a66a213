"""A fit from its picture to its result: takes its state through the schedule, replaces curves on the way, and keeps the
best; on request over a smaller copy, and with other numbers of curves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cubicsplat_cli.errors import DeviceError, EngineError, InputError
from cubicsplat_cli.photo.evaluator import Evaluator, Objective
from cubicsplat_cli.photo.initial import choose_background, curves_to_fit, keep_frozen, warmed
from cubicsplat_cli.photo.inputs import NO_INPUTS, FitInputs, FitResult, TrainingLog
from cubicsplat_cli.photo.seeding import Seeder
from cubicsplat_cli.photo.state import BestCheckpoint, FitCurves, FitState, snapped
from cubicsplat_cli.photo.stepper import Phase, Schedule, Stepper, gini
from cubicsplat_cli.progress import FrameRecorder, OnProgress
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import Engine
from cubicsplat_cli.raster.engines import open_engine
from cubicsplat_cli.scene import Scene, points_from_segments
from cubicsplat_cli.scene.arrays import Array, as_numpy, contiguous, like, namespace, one_torch_thread, with_channels
from cubicsplat_cli.settings import FitSettings

# Steps between two looks on a GPU for values that are not finite, and for the best curves of the exact finish: the one
# waits for it, the other takes the host as long as several steps.
LOOK_EVERY = 16
RUN_SECONDS = 0.05  # of steps in a row, after which Ctrl-C and time limits have their turn


class FitLoop:
    """Advances the state of one fit, on the engine that `opened` gives; between parts its number of curves may change.

    target: (H, W, C), of numpy, or of torch to try that on the CPU; all other arrays there are of its kind. Only
    fits that do not begin with a drawing come in parts. Other parameters, and errors, are those of `fit`.
    """

    def __init__(
        self,
        target: Array,
        settings: FitSettings,
        inputs: FitInputs = NO_INPUTS,
        on_progress: OnProgress | None = None,
        recorder: FrameRecorder | None = None,
        opened: Callable[..., Engine] = open_engine,
    ) -> None:
        target, start = _checked(target, inputs), inputs.start
        self.settings = settings.for_size(int(target.shape[1]), int(target.shape[0]))
        if start is not None and not inputs.frozen:  # smaller steps, since curves are in place already
            share = min(1.0, start.curves / self.settings.curves)
            self.settings = self.settings.with_(recipe=warmed(settings.recipe, share))
        # The picture and inputs of the exact finish, if it has others.
        self._finish: tuple[np.ndarray, FitInputs] | None = None
        if inputs.rough is not None and settings.recipe.finish > 0.0:
            self._finish = target, inputs
            target, inputs = _checked(*inputs.rough), inputs.rough[1]
        self.recorder, self.inputs = recorder, inputs
        self.generator = np.random.default_rng(self.settings.seed)
        self.schedule = Schedule(self.settings)
        self.engine = opened(
            settings.device, settings.threads, mode=settings.mode, painted=settings.fill == "linear",
            channels=4 if target.shape[2] == 4 or settings.background == "none" else 3,
            subdivide=settings.recipe.flatten == "de-casteljau",
            segments=max(settings.segments, 0 if start is None else start.segments),
            samples=max(settings.samples, settings.finish_samples),
        )  # fmt: skip
        if inputs.ground is not None:
            if self.engine.device != "cpu":
                raise EngineError("only the CPU's engine fits curves over a picture; use --device cpu")
            self.engine.ground, self.engine.metric = np.ascontiguousarray(inputs.ground, np.float32), inputs.metric
        self.step, self.stopped = 0, False  # stopped: before its last step
        self._look_at(target, inputs)
        self.start_loss = math.inf  # of the drawing to begin with, where all of it is in the fit
        self._go_on_with(FitState.unmoved(self._first_curves()))
        self.saved: tuple[int, FitCurves] | None = None  # a step of a GPU's fit, and its curves on the host
        self.log = TrainingLog(on_progress)

    def _look_at(self, target: Array, inputs: FitInputs) -> None:
        """Make the picture (H, W, C) and the pixels' weights the goal of the fit, on the engine's device."""
        self.target = target = with_channels(target, 4 if self.settings.background == "none" else 3)
        self.weights = None if inputs.weights is None else like(target, np.ascontiguousarray(inputs.weights))
        weights = None if self.weights is None else self.engine.take(self.weights)
        objective = Objective(self.settings.loss, self.engine.take(target), weights)
        self.evaluator = Evaluator(self.engine, objective, self.settings.finish_samples)

    def _first_curves(self) -> FitCurves:
        start, background = self.inputs.start, choose_background(self.target, self.settings, self.weights)
        if start is None:
            seeder = Seeder(self.settings, self.generator, background, self.target, self.weights)
            return seeder.first().changed(self.engine.take)
        if background is not None and self.settings.background == "auto" and start.background is not None:
            background = start.background
        height, width, _ = self.target.shape
        curves = curves_to_fit(start.as_kind_of(self.goal), self.settings, width, height, background)
        return self._resized_to_count(curves)

    def _resized_to_count(self, curves: FitCurves) -> FitCurves:
        """Return a drawing's curves without the least important if they are too many, or behind new ones if too few."""
        wanted, room = self.settings.curves, points_from_segments(self.settings.mode, self.settings.segments)
        if curves.curves > wanted:
            xp, (_, importance) = namespace(self.goal), self.evaluator.importance(curves)
            return curves.chosen(xp.sort(xp.argsort(-importance)[:wanted])).with_room_for(room)
        self.start_loss = self.evaluator.loss(curves)
        if curves.curves == wanted:
            return curves.copy().with_room_for(room)
        return curves.behind(self._seeds(wanted - curves.curves, curves))

    def _seeds(self, count: int, curves: FitCurves) -> FitCurves:
        """Return new curves at places where the exact picture of others is far from the goal."""
        return self._seeder(curves).seeds(count, self.evaluator.picture(curves))

    def _seeder(self, curves: FitCurves) -> Seeder:
        objective = self.evaluator.objective
        return Seeder(self.settings, self.generator, curves.background, objective.goal, objective.weights)

    def _go_on_with(self, state: FitState) -> None:
        """Make a state that no step has changed yet the fit's own; steps of earlier states still count."""
        self.state = state
        self.seeder = self._seeder(state.curves)
        self.stepper = Stepper(state, self.evaluator, self.schedule, self.seeder.unit, self.inputs.frozen_curves)
        self.best = BestCheckpoint()  # of the exact finish
        # By the loss of the last step, before curves were replaced or added: new ones first make the picture worse.
        self.checkpoint = BestCheckpoint()

    @property
    def goal(self) -> Array:
        """The picture, on the engine's device."""
        return self.evaluator.objective.goal

    @property
    def progress(self) -> float:
        """See `Schedule.progress`."""
        return self.schedule.progress(self.step, self.log.elapsed)

    def run_to(self, progress: float) -> bool:
        """Do the steps up to this progress. Return whether they did not fail; else only `finish` may follow."""
        if self.stopped:
            return False
        try:
            with one_torch_thread(), self.engine.guarded():
                while self.progress < progress:
                    self.advance(progress)
        except KeyboardInterrupt:
            self.interrupt()
        except DeviceError as error:
            self._rescue(error)
            self.stopped = True
        return not self.stopped

    def interrupt(self) -> None:
        """Do no further step, as after a Ctrl-C: only `finish` may follow."""
        self.log.interrupted = self.stopped = True

    def relax(self, share: float = 1.0) -> bool:
        """Do as `run_to` up to the exact finish, or a share of the way there."""
        return self.run_to(share * self.schedule.finish_start)

    def finish(self) -> FitResult:
        """Do the remaining steps, or as many as there is time for, and return the result."""
        if self._finish is not None and self.relax():
            self.go_over_to(*self._finish)
        self.run_to(1.0)
        self.stepper.check_finite(self.step, wait=True)
        candidates = [self.state.curves]
        if self.best.empty and self.step < self.settings.steps and not self.checkpoint.empty:
            candidates.append(self.checkpoint.curves)
        for candidate in candidates:
            self.best.consider(self.evaluator.loss(candidate), candidate)
        best = kept = self.best.curves
        if self.settings.recipe.prune:
            kept = self.evaluator.without_idle(best, self.inputs.frozen_curves)
        scene = self._finished(kept)
        if self.settings.recipe.edges == "soft":
            self.log.notes.append(self.evaluator.cost_of_crisp_edges(kept, self.settings.samples))
        seconds = self.log.elapsed
        return FitResult(
            scene, self.step, seconds, 1e3 * seconds / max(self.step, 1), self.log.history, self.log.interrupted,
            self.engine.describe(), samples=self.settings.finish_samples, replaced=self.log.replaced,
            dropped=best.curves - kept.curves, notes=self.log.notes,
        )  # fmt: skip

    def _finished(self, curves: FitCurves) -> Scene:
        """Return the result: not worse than the drawing to begin with, and with its frozen curves to the bit."""
        scene, start = snapped(self.scene(curves)), self.inputs.start
        if start is None:
            return scene
        sized = replace(start.as_numpy().scaled(scene.width, scene.height), background=scene.background)
        if self.start_loss <= self.evaluator.loss(curves):
            text = "no step came nearer to the picture than the drawing that the fit began with, which it stays"
            self.log.notes.append(text)
            return sized
        if self.inputs.frozen:
            keep_frozen(scene, sized, start.curves)
        return scene

    def scene(self, curves: FitCurves | None = None) -> Scene:
        """Return curves of the fit, by default its present ones, as they look."""
        return (curves or self.state.curves).scene(opaque=self.settings.recipe.opaque)

    def importance(self) -> np.ndarray:
        """Return the rise (N,) of the loss without each curve."""
        return as_numpy(self.evaluator.importance(self.state.curves)[1])

    def resize(self, kept: np.ndarray, count: int) -> None:
        """Go on with these curves, by number, and new ones in front, so many in all. Not for fits with a start."""
        before = self.state.curves
        state = self.state.chosen(like(self.goal, np.sort(kept), "int64"))
        self.settings = self.settings.with_(curves=count)
        fresh, loss = count - len(kept), self.stepper.loss
        if fresh > 0:
            state = state.with_seeds(self._seeds(fresh, before))
        if self.settings.recipe.shared_opacity > 0.0:
            state.share_opacity()
        self._go_on_with(state)
        if fresh > 0 and self.step > 0:
            self.checkpoint.consider(loss, before)
        self._save()

    def go_over_to(self, target: Array, inputs: FitInputs) -> None:
        """Go on with a copy of the picture of another size."""
        self.inputs = inputs
        self._look_at(target, inputs)
        height, width, _ = target.shape
        self.state.resize(width, height)
        self._go_on_with(self.state)
        self._save()

    def _save(self) -> None:
        """Copy a GPU's curves to the host, in case it fails. Waits for the GPU."""
        if self.engine.runs_ahead:
            self.saved = (self.step, self.state.curves.copy().as_kind_of(self.target))

    def _rescue(self, error: DeviceError) -> None:
        """Go on, after a GPU's failure, with the last curves on the host; raise `error` if there are none."""
        if self.saved is None:
            raise error
        step, curves = self.saved
        self.engine = CpuEngine(self.settings.threads)
        self._look_at(self.target, self.inputs)
        self._go_on_with(FitState.unmoved(curves))
        unfinished = "" if self.schedule.phase(step / self.settings.steps).exact else ", without the exact finish"
        result = f"what the fit had come to by step {step} of {self.settings.steps}{unfinished}"
        self.log.notes.append(f"{error}; the result is {result}")

    def advance(self, until: float = 0.0) -> None:
        """Do a step, and the reallocation due after it; or several steps with nothing between, up to a progress."""
        if self._looks():
            self.stepper.check_finite(self.step)
        progress = self.progress
        phases = self._phases(progress, until)
        if len(phases) > 1:
            best = self.best if phases[0].exact and not self.engine.runs_ahead else None
            self.step += self.stepper.steps(phases, progress, RUN_SECONDS, best)
            self.stepper.check_loss(self.step - 1)
        else:
            self._advance(phases[0], progress)
        if self.log.record(self.step, self.settings.steps, self.progress, self._psnr_db):
            self._save()  # the engine has just been waited for

    def _phases(self, progress: float, until: float) -> list[Phase]:
        """Return the phases of the next steps, up to one with another coverage or penalty, that reallocates, that comes
        after an entry of the log, or that begins after `until`.
        """
        schedule, elapsed, due = self.schedule, self.log.elapsed, self.stepper.regulariser.due
        phases = [first := schedule.phase(progress)]
        single = not self.stepper.runs or self.recorder is not None or schedule.reallocation_due(progress)
        ahead = self.engine.runs_ahead  # then the best curves are looked for between the calls
        if single or (first.exact and (self.best.empty or (ahead and self._looks()))):
            return phases
        while len(phases) < self.engine.at_once:
            then = schedule.progress(self.step + len(phases), elapsed)
            phase = schedule.phase(then)
            if phase.exact != first.exact or due(then) != due(progress) or schedule.reallocation_due(then):
                break
            if then >= until or self.log.due(then) or (ahead and (self.step + len(phases)) % LOOK_EVERY == 0):
                break
            phases.append(phase)
        return phases

    def _advance(self, phase: Phase, progress: float) -> None:
        due = self.schedule.take_reallocation(progress)
        before = self.state.curves.copy() if phase.exact else None
        loss = self.stepper.step(phase, progress, measured=due)
        self.stepper.check_loss(self.step)
        if before is not None:
            self.best.consider(loss, before)
        if due:
            self.checkpoint.consider(loss, self.state.curves)
            self.reallocate(progress)
        if self.recorder is not None and self._looks() and self.recorder.due(level := self._psnr_db()):
            self.recorder.keep(level, self.scene())
        self.step += 1

    def _psnr_db(self) -> float:
        """Return the PSNR of the picture before the last step."""
        self.engine.wait()
        return self.evaluator.psnr_db(self.stepper.loss, self.stepper.image)

    def reallocate(self, progress: float) -> None:
        """Replace the least important curves by new ones at places with a high error."""
        self.engine.wait()
        found = as_numpy(self.stepper.importance)
        self.log.inequality = gini(found)
        frozen = self.inputs.frozen_curves
        free = self.state.curves.curves - frozen
        idle = (int((found[:free] <= 0.0).sum()) + 0.5) / free  # will be rounded down to whole curves
        count = int(free * self.schedule.reallocation(progress, self.log.inequality, idle))
        state = self.state
        if count > 0:
            kept = state.without_least(self.stepper.importance, count, frozen)
            state = kept.with_seeds(self.seeder.seeds(count, self.stepper.image))
        self.stepper.replace(state)
        self.log.replaced += count

    def _looks(self) -> bool:
        """Return whether to look at this step's numbers: always on the CPU, where it costs nothing; rarely on a GPU."""
        return not self.engine.runs_ahead or self.step % LOOK_EVERY == 0


def fit(
    target: np.ndarray,
    settings: FitSettings,
    on_progress: OnProgress | None = None,
    recorder: FrameRecorder | None = None,
    inputs: FitInputs = NO_INPUTS,
) -> FitResult:
    """Fit a scene to a picture (H, W, 3), or (H, W, 4) premultiplied RGBA, float32 in [0, 1].

    recorder: keeps scenes on the way. inputs: further inputs of the fit.

    An interrupt (Ctrl-C) ends the fit early with the best scene so far. Raises InputError for a picture of another
    form, EngineError if the engine cannot run or meets a value that is not finite. If a GPU fails on the way, the
    result is the state that the fit had come to, with a note.
    """
    return FitLoop(target, settings, inputs, on_progress, recorder).finish()


def _checked(target: Array, inputs: FitInputs) -> Array:
    """Return the picture as the engines take it. Raises InputError if it, or its weights, cannot be fitted."""
    xp = namespace(target)
    if target.ndim != 3 or target.shape[2] not in (3, 4) or 0 in target.shape:
        raise InputError(f"the picture must have shape (height, width, 3 or 4), not {target.shape}")
    if not xp.isfinite(target).all():
        raise InputError("the picture has values that are not finite")
    weights = inputs.weights
    if weights is not None and (
        weights.shape != target.shape[:2] or not np.isfinite(weights).all() or weights.min() < 0 or not weights.any()
    ):
        raise InputError(f"weights must be at least 0, not all 0, and of shape {target.shape[:2]}")
    return contiguous(xp.astype(target, xp.float32, copy=False))
