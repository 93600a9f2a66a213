"""The steps of a fit: the engine's under the schedule, capacity reallocation in between, an exact finish at the end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.errors import DeviceError
from cubicsplat_cli.film import Film
from cubicsplat_cli.photo.best import Best
from cubicsplat_cli.photo.capacity import gini, in_front, reallocate, seeded, with_room_for_seeds
from cubicsplat_cli.photo.diary import Diary
from cubicsplat_cli.photo.faults import broken_down, check_finite
from cubicsplat_cli.photo.geometric import Regulariser
from cubicsplat_cli.photo.guide import UNGUIDED, Guide, spread_of
from cubicsplat_cli.photo.initial import first_curves
from cubicsplat_cli.photo.judge import Judge
from cubicsplat_cli.photo.objective import Objective
from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.photo.phases import raster_of, rates_of
from cubicsplat_cli.photo.resizing import Choose
from cubicsplat_cli.photo.result import FitResult
from cubicsplat_cli.photo.schedule import Phase, Schedule
from cubicsplat_cli.photo.snap import snapped
from cubicsplat_cli.photo.start import choose_background, keep_frozen, parameters_of, warmed
from cubicsplat_cli.photo.threads import one_torch_thread
from cubicsplat_cli.progress import Progress
from cubicsplat_cli.raster.engine import RATED, Engine, OptimiserState, Rates, SceneArrays, Training
from cubicsplat_cli.raster.engines import open_engine
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.scene.arrays import Array, as_numpy, copied, like, namespace
from cubicsplat_cli.settings import FitSettings

LOOK_EVERY = 16  # steps between two looks for values that are not finite on a GPU, since each look waits for it
AFTER_STEPS = 5  # what comes after the last step takes about as long as so many


@dataclass
class Trainer:
    """State of one fit.

    target: (H, W, C) float32. Its kind is that of all arrays on the CPU: numpy's, unless torch's are to be tried there.
    opened: gives the engine.
    """

    target: Array
    settings: FitSettings
    on_progress: Callable[[Progress], None] | None = None
    film: Film | None = None
    guide: Guide = UNGUIDED
    opened: Callable[..., Engine] = open_engine
    loss: float | Array = 0.0  # of the last step
    step: int = 0
    interrupted: bool = False
    stopped: bool = False  # before its last step
    rescued: str | None = None  # what the user should know of a GPU that failed
    kept_start: bool = False  # whether no step was better than the drawing to begin with

    def __post_init__(self) -> None:
        if self.target.shape[2] == 3 and self.settings.background == "none":
            xp = namespace(self.target)
            self.target = xp.concat([self.target, xp.ones_like(self.target[..., :1])], axis=-1)
        self.height, self.width, channels = (int(n) for n in self.target.shape)
        self.generator = np.random.default_rng(self.settings.seed)
        self.settings = self.settings.for_size(self.width, self.height)
        start = self.guide.start
        self.frozen = start.curves if start is not None and self.guide.frozen else 0
        if start is not None and not self.frozen:
            share = min(1.0, start.curves / self.settings.curves)
            self.settings = self.settings.with_(recipe=warmed(self.settings.recipe, share))
        self.recipe = self.settings.recipe
        weights = None if self.guide.weights is None else like(self.target, np.ascontiguousarray(self.guide.weights))
        self.unit = self.recipe.unit(self.width, self.height, self.settings.curves) * spread_of(weights) ** 0.5
        self.schedule = Schedule(self.recipe, self.settings.steps)
        self.engine: Engine = self.opened(
            self.settings.device, self.settings.threads, mode=self.settings.mode, channels=int(self.target.shape[2]),
            painted=self.settings.fill == "linear", subdivide=self.recipe.flatten == "de-casteljau",
            segments=max(self.settings.segments, 0 if start is None else start.segments),
            samples=max(self.settings.samples, self.settings.finish_samples),
        )  # fmt: skip
        self.host_weights = weights
        self._aim()
        self.background = choose_background(self.target, self.settings, weights)
        if start is not None and channels == 3 and self.settings.background == "auto" and start.background is not None:
            self.background = start.background
        xp = namespace(self.goal)
        self.image = xp.empty_like(self.goal)
        self.start_loss = math.inf  # of the drawing to begin with, where all of it is in the fit
        if start is None:
            discs = first_curves(self.target, self.settings, self.generator, self.unit, weights)
            self.parameters = discs.changed(self.engine.take)
        else:
            self.parameters = self._begun(start.as_kind_of(self.goal))
        self.state = OptimiserState.zeros_for(self.parameters.points)
        self.importance = xp.zeros_like(self.parameters.half_widths)
        # What the engine trains on, for the whole fit: the parameters' own arrays, which keep their places.
        self.curves = self._tensors(self.parameters)
        self.training = Training(
            self.goal, self.state, self._rates(self.schedule.phase(0.0)), importance_kind=self.recipe.importance,
            weights=self.weights, penalty=self.objective.judged_by,
        )  # fmt: skip
        self.still: Array | None = None  # (N,): the curves that are frozen
        if self.frozen:
            scale = xp.ones((self.parameters.curves, RATED), dtype=xp.float32, device=self.goal.device)
            scale[-self.frozen :] = 0.0
            self.training.rate_scale = scale
            self.still = scale[:, 0] == 0.0
        if not self.objective.pixelwise:
            self.training.image_gradient = xp.empty_like(self.image)
        if self.curves.gradients is not None:
            self.training.frames_gradient = xp.empty_like(self.curves.gradients.frames)
            self.training.stops_gradient = xp.empty_like(self.curves.gradients.stops)
        joins = self.parameters.curves * self.settings.segments
        self.regulariser = Regulariser(self.recipe, self.settings.mode, (self.width, self.height), joins)
        self.best = Best()  # of the exact finish
        # By the loss of the last step, before curves were replaced or added: new ones first make the picture worse.
        self.checkpoint = Best()
        self.saved: tuple[int, Parameters] | None = None  # what the host has of a GPU's fit, and of which step
        self.diary = Diary(self.on_progress)

    def _aim(self) -> None:
        """Brings what is aimed at to where the engine is."""
        self.goal = self.engine.take(self.target)
        self.weights = None if self.host_weights is None else self.engine.take(self.host_weights)
        self.objective = Objective(self.settings.loss, self.goal, self.weights)
        exact = RasterSettings("exact", 1.0, self.settings.finish_samples)
        self.judge = Judge(self.engine, self.objective, exact, self._tensors)

    def _begun(self, start: Scene) -> Parameters:
        """A drawing's curves, without those of least use where there are too many, behind new ones where too few."""
        parameters = parameters_of(start, self.settings, self.width, self.height)
        wanted = self.settings.curves
        if parameters.curves > wanted:
            xp, worth = namespace(self.goal), self.judge.worth(parameters)
            return with_room_for_seeds(parameters.chosen(xp.sort(xp.argsort(-worth)[:wanted])), self.settings)
        self.start_loss = self.judge.loss(parameters)
        if parameters.curves == wanted:
            return with_room_for_seeds(parameters.copy(), self.settings)
        image = self.judge.picture(parameters)
        fresh = seeded(
            wanted - parameters.curves, image, self.goal, self.settings, self.generator, self.unit, self.weights
        )
        return in_front(fresh, parameters)

    def run(self) -> FitResult:
        """All steps, or as many as there is time for."""
        if not self.stopped:
            self._advance_to(1.0)
        check_finite(self.engine, self.parameters, self.step, wait=True)
        candidates = [self.parameters]
        if self.best.empty and self.step < self.settings.steps and not self.checkpoint.empty:
            candidates.append(self.checkpoint.parameters)
        for candidate in candidates:
            self.best.consider(self.judge.loss(candidate), candidate)
        best = self.best.parameters
        self.parameters = self.judge.without_idle(best, self.frozen) if self.recipe.prune else best
        scene = self._finished()
        seconds = time.perf_counter() - self.diary.started
        return FitResult(
            scene, self.step, seconds, 1e3 * seconds / max(self.step, 1), self.diary.history, self.interrupted,
            self.engine.describe(), samples=self.settings.finish_samples, replaced=self.diary.replaced,
            dropped=best.curves - self.parameters.curves, settings=self.settings, notes=self._notes(),
        )  # fmt: skip

    def _finished(self) -> Scene:
        """The result: nothing worse than the drawing to begin with, and what was frozen of it as it was to the bit."""
        scene, start = snapped(self._scene()), self.guide.start
        if start is None:
            return scene
        sized = replace(scaled_scene(start.as_numpy(), self.width, self.height), background=self.background)
        if self.start_loss <= self.judge.loss(self.parameters):
            self.kept_start = True
            return sized
        if self.frozen:
            keep_frozen(scene, sized, self.frozen)
        return scene

    def relax(self, share: float = 1.0) -> bool:
        """The steps before the exact finish, or a share of them. Returns whether they ended as they should; if not,
        only `run` is left.
        """
        self._advance_to(share * self.schedule.finish_start)
        return not self.stopped

    def resized(self, choose: Choose) -> Trainer:
        """A fit that goes on from here with the curves that `choose` keeps, and new ones in front where it wants more.

        This one is at its end. Not for fits that began with a drawing.
        """
        chosen, wanted = choose(self._scene(), as_numpy(self.judge.worth(self.parameters)))
        keep = like(self.goal, np.sort(chosen), "int64")
        after = Trainer(self.target, self.settings.with_(curves=wanted), self.on_progress, self.film, self.guide)
        parameters, state, fresh = self.parameters.chosen(keep), self.state.chosen(keep), wanted - len(keep)
        if fresh > 0:
            image = self.judge.picture(self.parameters)
            seeds = seeded(fresh, image, self.goal, after.settings, self.generator, after.unit, self.weights)
            parameters = in_front(seeds, parameters)
            state = OptimiserState.zeros_for(parameters.points[:fresh]).joined(state)
        after._take(parameters, state)
        if fresh > 0 and self.step > 0:
            after.checkpoint.consider(self.loss, self.parameters)
        after.keep_course_of(self)
        return after

    def go_on_from(self, begun: Trainer) -> None:
        """Takes over a fit to a copy of the picture of another size, at the step that it has come to."""
        across, down = self.width / begun.width, self.height / begun.height
        self.parameters.overwrite(begun.parameters)
        self.parameters.resize(across, down)
        self.state.overwrite(begun.state)
        self.state.resize(across, down)
        self.keep_course_of(begun)

    def keep_course_of(self, begun: Trainer) -> None:
        """Goes on where another fit ends: with its ground, schedule, random numbers and history."""
        self.background, self.curves = begun.background, replace(self.curves, background=begun.background)
        self.generator, self.schedule, self.step = begun.generator, begun.schedule, begun.step
        self.diary = begun.diary
        self._save()
        begun.engine.close()

    def _advance_to(self, progress: float) -> None:
        try:
            with one_torch_thread(), self.engine.guarded():
                while self.progress() < progress:
                    self.advance()
        except KeyboardInterrupt:
            self.interrupted = self.stopped = True
        except DeviceError as error:
            self._rescue(error)
            self.stopped = True

    def _save(self) -> None:
        """Copies a GPU's parameters to the host, for when it fails. Waits for it."""
        if self.engine.runs_ahead:
            self.saved = (self.step, self.parameters.copy().as_kind_of(self.target))

    def _rescue(self, error: DeviceError) -> None:
        """After a GPU's failure: the last parameters that the host has, on the CPU; `error` where it has none."""
        if self.saved is None:
            raise error
        step, self.parameters = self.saved
        channels = int(self.target.shape[2])
        self.engine = open_engine("cpu", self.settings.threads, mode=self.settings.mode, channels=channels)
        self.best, self.checkpoint = Best(), Best()
        self._aim()
        unfinished = "" if self.schedule.phase(step / self.settings.steps).exact else ", without the exact finish"
        self.rescued = (
            f"{error}; the result is what the fit had come to by step {step} of {self.settings.steps}{unfinished}"
        )

    def progress(self) -> float:
        """Share of the steps done or, where that is more, of the time used up."""
        share = self.step / self.settings.steps
        if self.settings.time_limit is None:
            return share
        elapsed = time.perf_counter() - self.diary.started
        after = AFTER_STEPS * elapsed / max(self.step, 1)
        return max(share, elapsed / max(self.settings.time_limit - after, 1e-9)) if self.step else 0.0

    def advance(self) -> None:
        """One step, with the reallocation that the schedule may ask for after it."""
        if self._looks():
            check_finite(self.engine, self.parameters, self.step)
        progress = self.progress()
        phase = self.schedule.phase(progress)
        due = self.schedule.take_reallocation(progress)
        before = self.parameters.copy() if phase.exact else None
        training = self.training
        training.rates = self._rates(phase)
        training.points_gradient = self.regulariser.gradient(
            self.parameters.points, self.parameters.ring_ends, progress=progress, loss=self.loss
        )
        training.image, training.importance = (self.image, self.importance) if due else (None, None)
        if not self.objective.squared:
            training.image = self.image
        loss = self.loss = self._stepped(raster_of(phase, self.settings))
        if self.recipe.shared_opacity > 0.0:
            self.parameters.opacity_logits[...] = self.parameters.opacity_logits.mean()
        # A GPU's loss would have to be waited for; it is finite where the engine has found no fault.
        if isinstance(loss, float) and not math.isfinite(loss):
            raise broken_down(self.engine, f"the loss is {loss}", self.step)
        if before is not None:
            self.best.consider(loss, before)
        if due:
            self.checkpoint.consider(loss, self.parameters)
            self._reallocate(progress)
        if self.film is not None and self._looks() and self.film.due(level := self.judge.level(loss, self.image)):
            self.film.keep(level, self._scene())
        self.step += 1
        if self.diary.note(self.step, self.settings.steps, self.progress(), lambda: self.judge.level(loss, self.image)):
            self._save()  # the engine has just been waited for

    def _stepped(self, raster: RasterSettings) -> float | Array:
        """A step of the engine, and of the fills, which are no business of its; the loss before it."""
        fills, training = self.parameters.fills, self.training
        if fills is None:
            return self._drawn_step(raster)
        assert self.curves.gradients is not None
        assert training.frames_gradient is not None and training.stops_gradient is not None
        middles = self.parameters.middles()
        self.curves.gradients.overwrite(fills.gradients(middles))
        loss = self._drawn_step(raster)
        fills.learn(middles, training.frames_gradient, training.stops_gradient, training.rates, self.still)
        return loss

    def _drawn_step(self, raster: RasterSettings) -> float | Array:
        """A step of the engine."""
        training = self.training
        if training.image_gradient is None:
            return self.engine.step(self.curves, raster, training)
        loss, gradient = self.objective.gradient(self.engine.render(self.curves, raster))
        training.image_gradient[...] = gradient
        self.engine.step(self.curves, raster, training)
        return loss if self.engine.runs_ahead else float(loss)

    def _scene(self) -> Scene:
        """What the parameters are now."""
        return self.parameters.as_numpy().scene(
            self.settings.mode, self.width, self.height, self.background, opaque=self.recipe.opaque
        )

    def _tensors(self, parameters: Parameters) -> SceneArrays:
        soft = self.recipe.edges == "soft"
        return parameters.for_engine(self.settings.mode, self.width, self.height, self.background, soft=soft)

    def _rates(self, phase: Phase) -> Rates:
        return rates_of(phase, self.recipe, self.unit)

    def _reallocate(self, progress: float) -> None:
        importance = as_numpy(self.importance)
        self.diary.inequality = gini(importance)
        free = self.parameters.curves - self.frozen
        idle = (int((importance[:free] <= 0.0).sum()) + 0.5) / free  # will be rounded down to whole curves
        fraction = self.schedule.reallocation(progress, self.diary.inequality, idle)
        parameters, state, count = reallocate(
            self.parameters, self.state, self.importance, self.image, self.goal, fraction, self.settings,
            self.generator, self.weights, self.frozen,
        )  # fmt: skip
        self._take(parameters, state)
        self.diary.replaced += count

    def _take(self, parameters: Parameters, state: OptimiserState) -> None:
        """Goes on with other parameters, the new ones in front; where all share an opacity, with that of the others."""
        self.parameters.overwrite(parameters)
        self.state.overwrite(state)
        self.regulariser.forget()
        if self.recipe.shared_opacity > 0.0:
            self.parameters.opacity_logits[...] = copied(self.parameters.opacity_logits[-1:])

    def _notes(self) -> list[str]:
        notes = [self.rescued] if self.rescued else []
        if self.kept_start:
            notes.append("no step came nearer to the picture than the drawing that the fit began with, which it stays")
        if self.recipe.edges == "soft":
            notes.append(self.judge.of_soft_edges(self.parameters, self.settings.samples))
        return notes

    def _looks(self) -> bool:
        """Whether to look at this step's numbers: always where that costs nothing, now and then on a GPU."""
        return not self.engine.runs_ahead or self.step % LOOK_EVERY == 0
