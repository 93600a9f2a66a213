"""The fit: steps of the engine under the schedule, capacity reallocation in between, an exact finish at the end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cubicsplat_cli.errors import DeviceError, EngineError, InputError
from cubicsplat_cli.film import Film
from cubicsplat_cli.photo.best import Best
from cubicsplat_cli.photo.capacity import gini, in_front, reallocate, seeded
from cubicsplat_cli.photo.geometric import crossing_gradient, thorn_gradient
from cubicsplat_cli.photo.guide import UNGUIDED, Guide, spread_of
from cubicsplat_cli.photo.initial import colours_at, control_points, new_curves, random_centres
from cubicsplat_cli.photo.objective import Objective
from cubicsplat_cli.photo.parameters import Background, Parameters
from cubicsplat_cli.photo.resizing import Choose, Resizing
from cubicsplat_cli.photo.schedule import Phase, Schedule
from cubicsplat_cli.photo.snap import snapped
from cubicsplat_cli.photo.start import keep_fills, parameters_of, warmed
from cubicsplat_cli.photo.threads import one_torch_thread
from cubicsplat_cli.progress import Progress
from cubicsplat_cli.raster.engine import RATED, Engine, OptimiserState, Rates, SceneTensors, Training
from cubicsplat_cli.raster.engines import open_engine
from cubicsplat_cli.raster.reference import image_loss
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.settings import FitSettings

REPORT_SECONDS = 0.1
HISTORY_ENTRIES = 50
LOOK_EVERY = 16  # steps between two looks for values that are not finite on a GPU, since each look waits for it
FLATNESS = 0.5  # px, of de Casteljau subdivision
AFTER_STEPS = 3  # what comes after the last step takes about as long as so many
FINISH_TOLERANCE = 0.1  # px: cairo's own, so that the file is drawn no finer than it was fitted
THORNS_FROM = 0.5  # of the fit: earlier they are on their way to something
CHANNELS_COMPARED = 3  # PSNR counts colour channels, over black and white alike


@dataclass
class FitResult:
    """The best scene of a fit, and how it came about.

    samples: edges per cubic of the exact finish (S*). replaced, dropped: curves re-seeded during the fit, and left out
    at its end since the picture is better, or no worse, without them. notes: what the user should know.
    """

    scene: Scene
    steps: int
    fit_s: float
    ms_per_step: float
    history: list[dict[str, float]]
    interrupted: bool
    device: dict[str, Any]
    samples: int
    replaced: int
    dropped: int
    settings: FitSettings
    notes: list[str]


def psnr(loss: float, values: int) -> float:
    """dB of a sum of squared errors over so many values in [0, 1]; at most 100."""
    return min(100.0, 10.0 * math.log10(values / max(loss, 1e-300)))


def fit(
    target: np.ndarray,
    settings: FitSettings,
    on_progress: Callable[[Progress], None] | None = None,
    film: Film | None = None,
    guide: Guide = UNGUIDED,
    rough: tuple[np.ndarray, Guide] | None = None,
    resizings: Sequence[Resizing] = (),
) -> FitResult:
    """Fits a scene to a picture (H, W, 3), or (H, W, 4) premultiplied RGBA, float32 in [0, 1].

    film: keeps scenes on the way. guide: what else the fit is told. rough: a smaller copy of the picture, on which all
    but the exact finish is done, and what a fit to it is told; only for fits that do not begin with a drawing.
    resizings: when on the way the number of curves changes, in order; for such fits as well.

    An interrupt (Ctrl-C) ends the fit early with the best scene so far. Raises InputError for a picture of another
    form, EngineError where the engine cannot run or meets a value that is not finite. A GPU that fails on the way
    leaves the state that the fit had come to, with a note.
    """
    picture = _checked(target, guide)
    settings = settings.for_size(target.shape[1], target.shape[0])
    smaller = rough is not None and settings.recipe.finish > 0.0
    if rough is not None and smaller:
        trainer = Trainer(_checked(*rough), settings, on_progress, film, rough[1])
    else:
        trainer = Trainer(picture, settings, on_progress, film, guide)
    for resizing in resizings:
        if not trainer.relax(resizing.at):
            return trainer.run()
        trainer = trainer.resized(resizing.choose)
    if smaller:
        if not trainer.relax():
            return trainer.run()
        whole = Trainer(picture, trainer.settings, on_progress, film, guide)
        whole.go_on_from(trainer)
        return whole.run()
    return trainer.run()


def _checked(target: np.ndarray, guide: Guide) -> Tensor:
    """The picture as a tensor. Raises InputError where it, or its weights, cannot be fitted."""
    if target.ndim != 3 or target.shape[2] not in (3, 4) or 0 in target.shape:
        raise InputError(f"the picture must have shape (height, width, 3 or 4), not {target.shape}")
    if not np.isfinite(target).all():
        raise InputError("the picture has values that are not finite")
    weights = guide.weights
    if weights is not None and (
        weights.shape != target.shape[:2] or not np.isfinite(weights).all() or weights.min() < 0 or not weights.any()
    ):
        raise InputError(f"weights must be at least 0, not all 0, and of shape {target.shape[:2]}")
    return torch.from_numpy(np.ascontiguousarray(target, dtype=np.float32))


def choose_background(target: Tensor, settings: FitSettings, weights: Tensor | None = None) -> Background:
    """The colour behind the curves: the picture's (weighted) mean, the given one, or none for a picture with
    transparency.
    """
    if target.shape[2] == 4:
        return None
    given = settings.background_colour
    if given is not None:
        return given
    middle = target.mean((0, 1)) if weights is None else (target * weights.unsqueeze(-1)).sum((0, 1)) / weights.sum()
    mean = [round(float(v) * 255) / 255 for v in middle]
    return mean[0], mean[1], mean[2]


@dataclass
class Trainer:
    """State of one fit."""

    target: Tensor
    settings: FitSettings
    on_progress: Callable[[Progress], None] | None = None
    film: Film | None = None
    guide: Guide = UNGUIDED
    history: list[dict[str, float]] = field(default_factory=list)
    replaced: int = 0
    inequality: float | None = None
    loss: float | Tensor = 0.0  # of the last step
    step: int = 0
    interrupted: bool = False
    stopped: bool = False  # before its last step
    rescued: str | None = None  # what the user should know of a GPU that failed
    kept_start: bool = False  # whether no step was better than the drawing to begin with

    def __post_init__(self) -> None:
        if self.target.shape[2] == 3 and self.settings.background == "none":
            self.target = torch.cat([self.target, torch.ones_like(self.target[..., :1])], -1)
        self.height, self.width, channels = (int(n) for n in self.target.shape)
        self.values = self.height * self.width * CHANNELS_COMPARED
        self.generator = torch.Generator().manual_seed(self.settings.seed)
        self.settings = self.settings.for_size(self.width, self.height)
        start = self.guide.start
        self.frozen = start.curves if start is not None and self.guide.frozen else 0
        if start is not None and not self.frozen:
            share = min(1.0, start.curves / self.settings.curves)
            self.settings = self.settings.with_(recipe=warmed(self.settings.recipe, share))
        self.recipe = self.settings.recipe
        weights = None if self.guide.weights is None else torch.from_numpy(np.ascontiguousarray(self.guide.weights))
        self.unit = self.recipe.unit(self.width, self.height, self.settings.curves) * spread_of(weights) ** 0.5
        self.schedule = Schedule(self.recipe, self.settings.steps)
        self.engine: Engine = open_engine(
            self.settings.device,
            self.settings.threads,
            mode=self.settings.mode,
            channels=int(self.target.shape[2]),
            painted=self.settings.fill == "linear",
            subdivide=self.recipe.flatten == "de-casteljau",
        )
        device = self.engine.device
        self.goal = self.target.to(device)  # the target where the engine is
        self.weights = None if weights is None else weights.to(device)
        self.objective = Objective(self.settings.loss, self.goal, self.weights)
        self.background = choose_background(self.target, self.settings, weights)
        if start is not None and channels == 3 and self.settings.background == "auto" and start.background is not None:
            self.background = start.background
        self.image = torch.empty(self.height, self.width, channels, device=device)
        self.start_loss = math.inf  # of the drawing to begin with, where all of it is in the fit
        self.parameters = (self._discs(weights) if start is None else self._begun(start)).to(device)
        self.state = OptimiserState.zeros(*self.parameters.points.shape[:2]).to(device)
        self.importance = torch.zeros(self.parameters.curves, device=device)
        # What the engine trains on, for the whole fit: the parameters' own tensors, which keep their places.
        self.curves = self._tensors(self.parameters)
        self.training = Training(
            self.goal, self.state, self._rates(self.schedule.phase(0.0)), importance_kind=self.recipe.importance,
            weights=self.weights, penalty=self.objective.judged_by,
        )  # fmt: skip
        self.still: Tensor | None = None  # (N,): the curves that are frozen
        if self.frozen:
            scale = torch.ones(self.parameters.curves, RATED, device=device)
            scale[-self.frozen :] = 0.0
            self.training.rate_scale = scale
            self.still = scale[:, 0] == 0.0
        if not self.objective.pixelwise:
            self.training.image_gradient = torch.empty_like(self.image)
        if self.curves.gradients is not None:
            self.training.frames_gradient = torch.empty_like(self.curves.gradients.frames)
            self.training.stops_gradient = torch.empty_like(self.curves.gradients.stops)
        self.best = Best()
        self.saved: tuple[int, Parameters] | None = None  # what the host has of a GPU's fit, and of which step
        self.started = self.reported = time.perf_counter()

    def _discs(self, weights: Tensor | None) -> Parameters:
        """The usual start."""
        centres = random_centres(self.settings.curves, self.target, self.generator, weights)
        radius, half_width = self.recipe.start_size * self.unit, self.recipe.half_width_size * self.unit
        points = control_points(centres, radius, self.settings, self.generator)
        return new_curves(points, colours_at(centres, self.target), half_width, self.settings)

    def _begun(self, start: Scene) -> Parameters:
        """A drawing's curves, without those of least use where there are too many, behind new ones where too few."""
        parameters = parameters_of(start, self.settings, self.width, self.height).to(self.engine.device)
        wanted = self.settings.curves
        if parameters.curves > wanted:
            keep = self._worth(parameters).argsort(descending=True)[:wanted].sort().values
            return parameters.chosen(keep)
        self.start_loss = self._exact_loss(parameters)
        if parameters.curves == wanted:
            return parameters.copy()
        image = self.engine.render(self._tensors(parameters), self._exact())
        fresh = seeded(
            wanted - parameters.curves, image, self.goal, self.settings, self.generator, self.unit, self.weights
        )
        return in_front(fresh, parameters)

    def run(self) -> FitResult:
        """All steps, or as many as there is time for."""
        if not self.stopped:
            self._advance_to(1.0)
        self._check_finite(wait=True)
        self.best.consider(self._exact_loss(self.parameters), self.parameters)
        dropped = self._drop_invisible()
        scene = self._finished()
        seconds = time.perf_counter() - self.started
        return FitResult(
            scene=scene,
            steps=self.step,
            fit_s=seconds,
            ms_per_step=1e3 * seconds / max(self.step, 1),
            history=self.history,
            interrupted=self.interrupted,
            device=self.engine.describe(),
            samples=self.settings.finish_samples,
            replaced=self.replaced,
            dropped=dropped,
            settings=self.settings,
            notes=self._notes(),
        )

    def _finished(self) -> Scene:
        """The result: nothing worse than the drawing to begin with, and what was frozen of it as it was to the bit."""
        scene, start = snapped(self._scene()), self.guide.start
        if start is None:
            return scene
        sized = replace(scaled_scene(start, self.width, self.height), background=self.background)
        if self.start_loss <= self._exact_loss(self.parameters):
            self.kept_start = True
            return sized
        if self.frozen:
            for name in ("points", "colours", "opacities", "half_widths"):
                values = getattr(sized, name)
                kept = getattr(scene, name)[-self.frozen :]
                (kept[:, : values.shape[1]] if values.ndim == 3 else kept).copy_(values)
            if scene.gradients is not None:
                keep_fills(scene.gradients, sized.gradients, self.frozen)
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
        keep, wanted = choose(self._scene(), self._worth(self.parameters).cpu())
        keep = keep.to(self.engine.device).sort().values
        after = Trainer(self.target, self.settings.with_(curves=wanted), self.on_progress, self.film, self.guide)
        parameters, state, fresh = self.parameters.chosen(keep), self.state.chosen(keep), wanted - len(keep)
        if fresh > 0:
            image = self.engine.render(self._tensors(self.parameters), self._exact())
            seeds = seeded(fresh, image, self.goal, after.settings, self.generator, after.unit, self.weights)
            parameters = in_front(seeds, parameters)
            state = OptimiserState.zeros(fresh, parameters.points.shape[1]).to(self.engine.device).joined(state)
        after._take(parameters, state)
        after.keep_course_of(self)
        return after

    def go_on_from(self, begun: Trainer) -> None:
        """Takes over a fit to a copy of the picture of another size, at the step that it has come to."""
        across, down = self.width / begun.width, self.height / begun.height
        scale, pixels = math.sqrt(across * down), across * down
        self.parameters.overwrite(begun.parameters)
        self.parameters.points.mul_(self.parameters.points.new_tensor([across, down]))
        self.parameters.half_widths.mul_(scale)
        if self.parameters.fills is not None:
            self.parameters.fills.resize(across, down)
        self.state.overwrite(begun.state)
        # The loss is a sum over the pixels: gradients of lengths grow with the scale, those of paints with the pixels.
        growth = torch.full_like(self.state.moments[0, :, 0], pixels)
        growth[: 2 * self.parameters.points.shape[1]] = scale
        growth[-1] = scale  # the half-width
        self.state.moments.mul_(torch.stack([growth, growth, growth.square(), growth], -1))
        self.keep_course_of(begun)

    def keep_course_of(self, begun: Trainer) -> None:
        """Goes on where another fit ends: with its ground, schedule, random numbers and history."""
        self.background, self.curves = begun.background, replace(self.curves, background=begun.background)
        self.generator, self.schedule, self.step = begun.generator, begun.schedule, begun.step
        self.history, self.replaced, self.inequality = begun.history, begun.replaced, begun.inequality
        self.started, self.reported = begun.started, begun.reported
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
        if self.engine.name == "cuda":
            self.saved = (self.step, self.parameters.copy().to("cpu"))

    def _rescue(self, error: DeviceError) -> None:
        """After a GPU's failure: the last parameters that the host has, on the CPU; `error` where it has none."""
        if self.saved is None:
            raise error
        step, self.parameters = self.saved
        channels = int(self.target.shape[2])
        self.engine = open_engine("cpu", self.settings.threads, mode=self.settings.mode, channels=channels)
        self.goal, self.best = self.target, Best()
        self.weights = None if self.weights is None else self.weights.cpu()
        self.objective = Objective(self.settings.loss, self.goal, self.weights)
        unfinished = "" if self.schedule.phase(step / self.settings.steps).exact else ", without the exact finish"
        self.rescued = (
            f"{error}; the result is what the fit had come to by step {step} of {self.settings.steps}{unfinished}"
        )

    def progress(self) -> float:
        """Share of the steps done or, where that is more, of the time used up."""
        share = self.step / self.settings.steps
        if self.settings.time_limit is None:
            return share
        elapsed = time.perf_counter() - self.started
        after = AFTER_STEPS * elapsed / max(self.step, 1)
        return max(share, elapsed / max(self.settings.time_limit - after, 1e-9)) if self.step else 0.0

    def advance(self) -> None:
        """One step, with the reallocation that the schedule may ask for after it."""
        if self._looks():
            self._check_finite()
        progress = self.progress()
        phase = self.schedule.phase(progress)
        due = self.schedule.take_reallocation(progress)
        before = self.parameters.copy() if phase.exact else None
        training = self.training
        training.rates, training.points_gradient = self._rates(phase), self._regulariser(progress)
        training.image, training.importance = (self.image, self.importance) if due else (None, None)
        if not self.objective.squared:
            training.image = self.image
        loss = self._stepped(self.raster(phase))
        if self.recipe.shared_opacity > 0.0:
            self.parameters.opacity_logits.fill_(self.parameters.opacity_logits.mean())
        # A GPU's loss would have to be waited for; it is finite where the engine has found no fault.
        if isinstance(loss, float) and not math.isfinite(loss):
            self._broke_down(f"the loss is {loss}")
        self.loss = loss
        if before is not None:
            self.best.consider(loss, before)
        if due:
            self._reallocate(progress)
        if self.film is not None and self._looks():
            self._put_on_film(self.film, self._level(loss))
        self.step += 1
        self._report(loss)

    def _stepped(self, raster: RasterSettings) -> float | Tensor:
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

    def _drawn_step(self, raster: RasterSettings) -> float | Tensor:
        """A step of the engine."""
        training = self.training
        if training.image_gradient is None:
            return self.engine.step(self.curves, raster, training)
        loss, gradient = self.objective.gradient(self.engine.render(self.curves, raster))
        training.image_gradient.copy_(gradient)
        self.engine.step(self.curves, raster, training)
        return float(loss) if self.engine.device.type == "cpu" else loss

    def _scene(self) -> Scene:
        """What the parameters are now."""
        return self.parameters.to("cpu").scene(
            self.settings.mode, self.width, self.height, self.background, opaque=self.recipe.opaque
        )

    def _put_on_film(self, film: Film, level: float) -> None:
        if film.due(level):
            film.keep(level, self._scene())

    def _tensors(self, parameters: Parameters) -> SceneTensors:
        soft = self.recipe.edges == "soft"
        return parameters.for_engine(self.settings.mode, self.width, self.height, self.background, soft=soft)

    def raster(self, phase: Phase) -> RasterSettings:
        """How a step of this phase is drawn."""
        coverage = "exact" if phase.exact else "relaxed"
        samples = self.settings.finish_samples if phase.exact else self.settings.samples
        if self.recipe.flatten == "de-casteljau":
            return RasterSettings(coverage, phase.edge_width, 64, FLATNESS, subdivide=True)
        tolerance = FINISH_TOLERANCE if phase.exact and self.recipe.tolerance > 0.0 else self.recipe.tolerance
        return RasterSettings(coverage, phase.edge_width, samples, tolerance)

    def _rates(self, phase: Phase) -> Rates:
        recipe = self.recipe
        return Rates(
            points=phase.rate * recipe.rate_points * self.unit,
            colours=phase.rate * recipe.rate_colours,
            opacities=0.0 if recipe.opaque else phase.rate * recipe.rate_opacities,
            half_widths=phase.rate * recipe.rate_half_widths * self.unit,
            edge_widths=phase.rate * recipe.rate_edge_widths,
            keep=(recipe.keep_mean, recipe.keep_change, recipe.keep_square),
            epsilon=recipe.epsilon,
        )

    def _regulariser(self, progress: float) -> Tensor | None:
        """The gradient of what the recipe penalises beside the picture's error."""
        recipe, points, mode = self.recipe, self.parameters.points, self.settings.mode
        rings = self.parameters.ring_ends
        found = None
        if recipe.geometric_reg > 0.0:
            found = crossing_gradient(points, mode, recipe.geometric_reg * self.width * self.height, rings)
        if recipe.thorn_reg > 0.0 and progress > THORNS_FROM:
            # In shares of what a join has of the loss: what suits one picture then suits all.
            joins = self.parameters.curves * self.settings.segments
            blunting = thorn_gradient(points, mode, recipe.thorn_reg, rings) * (self.loss / joins)
            found = blunting if found is None else found + blunting
        return found

    def _reallocate(self, progress: float) -> None:
        self.inequality = gini(self.importance.cpu())
        fraction = self.schedule.reallocation(progress, self.inequality)
        parameters, state, count = reallocate(
            self.parameters, self.state, self.importance, self.image, self.goal, fraction, self.settings,
            self.generator, self.weights, self.frozen,
        )  # fmt: skip
        self._take(parameters, state)
        self.replaced += count

    def _take(self, parameters: Parameters, state: OptimiserState) -> None:
        """Goes on with other parameters, the new ones in front; where all share an opacity, with that of the others."""
        self.parameters.overwrite(parameters)
        self.state.overwrite(state)
        if self.recipe.shared_opacity > 0.0:
            self.parameters.opacity_logits.fill_(self.parameters.opacity_logits[-1].clone())

    def _exact(self) -> RasterSettings:
        return RasterSettings("exact", 1.0, self.settings.finish_samples)

    def _exact_loss(self, parameters: Parameters) -> float:
        if not self.objective.pixelwise:
            return float(self.objective.of(self.engine.render(self._tensors(parameters), self._exact())))
        return self.engine.gradients(
            self._tensors(parameters), self._exact(), target=self.goal, weights=self.weights,
            penalty=self.objective.penalty,
        )[0]  # fmt: skip

    def _worth(self, parameters: Parameters) -> Tensor:
        """(N,): how much the loss of the exact picture would rise without each curve."""
        return self.engine.gradients(
            self._tensors(parameters), self._exact(), target=self.goal, weights=self.weights,
            penalty=self.objective.judged_by, importance="loo",
        )[1]["importance"]  # fmt: skip

    def _level(self, loss: float | Tensor) -> float:
        """dB of the last step's picture, whose loss is known."""
        if self.objective.squared:
            return psnr(float(loss), self.values)
        return psnr(float(image_loss(self.image, self.goal, self.weights)), self.values)

    def _drop_invisible(self) -> int:
        """Takes the best parameters, less the curves whose leave-one-out importance is not positive."""
        loss, parameters = self.best.loss, self.best.parameters
        worth = self._worth(parameters)
        keep = worth > 0
        # A scene has at least one curve.
        keep[worth.argmax()] = True
        if self.frozen:
            keep[-self.frozen :] = True
        if not self.recipe.prune or bool(keep.all()):
            self.parameters = parameters
            return 0
        rest = parameters.chosen(keep)
        # Two curves may each be of no use only while the other is there: so all are dropped only if that is better.
        self.parameters = rest if self._exact_loss(rest) <= loss else parameters
        return parameters.curves - self.parameters.curves

    def _notes(self) -> list[str]:
        notes = [self.rescued] if self.rescued else []
        if self.kept_start:
            notes.append("no step came nearer to the picture than the drawing that the fit began with, which it stays")
        if self.recipe.edges != "soft":
            return notes
        relaxed = RasterSettings("relaxed", 1.0, self.settings.samples)
        soft, crisp = (
            self.engine.gradients(self._tensors(self.parameters), raster, target=self.goal)[0]
            for raster in (relaxed, self._exact())
        )
        return [
            *notes,
            f"no SVG can show soft edges: with them the fit has {psnr(soft, self.values):.2f} dB, "
            f"with the file's crisp edges {psnr(crisp, self.values):.2f} dB",
        ]

    def _looks(self) -> bool:
        """Whether to look at this step's numbers: always where that costs nothing, now and then on a GPU."""
        return self.engine.device.type == "cpu" or self.step % LOOK_EVERY == 0

    def _check_finite(self, wait: bool = False) -> None:
        """Before a step: within it one bad curve spoils every curve that it shares a pixel with.

        A GPU's engine looks by itself; without `wait` this is what it found some steps ago.
        """
        if fault := self.engine.fault(wait):
            self._broke_down(f"curve {fault[0]} has a non-finite value")
        if self.engine.device.type == "cpu" and (found := self.parameters.first_non_finite()):
            self._broke_down(f"curve {found[0]} has a non-finite value in {found[1]}")

    def _broke_down(self, where: str) -> None:
        step = self.step
        if fault := self.engine.fault():
            # It may have happened some steps ago: the engine has noted where and when.
            where, step = f"curve {fault[0]} has a non-finite value", fault[1]
        raise EngineError(f"the fit broke down at step {step}: {where}; lower the step sizes or change --seed")

    def _report(self, loss: float | Tensor) -> None:
        now = time.perf_counter()
        progress = self.progress()
        if progress * HISTORY_ENTRIES >= len(self.history) + 1 or progress >= 1.0:
            level, seconds = round(self._level(loss), 3), round(now - self.started, 3)
            entry = {"step": self.step, "psnr_db": level, "seconds": seconds, "replaced": self.replaced}
            self.history.append(entry if self.inequality is None else {**entry, "gini": round(self.inequality, 4)})
            self._save()  # the engine has just been waited for
        if self.on_progress and (now - self.reported >= REPORT_SECONDS or progress >= 1.0):
            self.reported = now
            elapsed = now - self.started
            left = elapsed / max(progress, 1e-9) * max(0.0, 1.0 - progress)
            level, per_step = self._level(loss), 1e3 * elapsed / self.step
            self.on_progress(
                Progress(min(progress, 1.0), self.step, self.settings.steps, level, per_step, self.replaced, left)
            )
