"""Whole fits of tiny pictures: what comes out, whatever the picture, and what goes wrong."""

from __future__ import annotations

import math
import operator
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import torch
from conftest import ctrl_c, smooth_pixels
from scenes import rectangle, scene_of

from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.photo.evaluator import psnr
from cubicsplat_cli.photo.initial import choose_background, curves_to_fit
from cubicsplat_cli.photo.inputs import FitResult
from cubicsplat_cli.photo.loop import FitLoop, fit
from cubicsplat_cli.photo.state import BestCheckpoint
from cubicsplat_cli.progress import Progress
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import Rates, Training
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import FitSettings, Mode

MODES = pytest.mark.parametrize("mode", ["closed", "open"])


def settings(**overrides) -> FitSettings:
    given = {"curves": 12, "steps": 60, "threads": 1} | overrides
    return FitSettings.from_preset(given.pop("preset", "draft"), **given)


def picture(width: int = 40, height: int = 28, *, alpha: bool = False) -> np.ndarray:
    """(H, W, 3), or premultiplied (H, W, 4), float32."""
    values = smooth_pixels(width, height, alpha=alpha).astype(np.float32) / 255
    if alpha:
        values[..., :3] *= values[..., 3:]
    return values


def loop(target: np.ndarray, **overrides) -> FitLoop:
    return FitLoop(torch.from_numpy(target), settings(**overrides))


def loss_of(scene: Scene, target: np.ndarray) -> float:
    """Sum of squared errors of the engine's exact picture; over black and over white, meaned, with transparency."""
    error = render_scene(scene, threads=1).astype(np.float64) - target
    if target.shape[2] == 3:
        return float((error**2).sum())
    return float(0.5 * (error[..., :3] ** 2 + (error[..., :3] - error[..., 3:]) ** 2).sum())


def tensors(scene: Scene) -> list[torch.Tensor]:
    return [scene.points, scene.colours, scene.opacities, scene.half_widths]


def same(first: FitResult, second: FitResult) -> bool:
    pairs = zip(tensors(first.scene), tensors(second.scene), strict=True)
    return all(a.shape == b.shape and bool((a == b).all()) for a, b in pairs)


# --- what a fit is worth -----------------------------------------------------------------------------------


@MODES
@pytest.mark.parametrize("alpha", [False, True])
def test_a_fit_improves_much_over_its_start_and_over_the_background_alone(mode, alpha):
    target = picture(alpha=alpha)
    fit_loop = loop(target, mode=mode, steps=120)
    start = fit_loop.evaluator.loss(fit_loop.state.curves)
    result = fit_loop.finish()
    nothing = float(((target - target.mean((0, 1))) ** 2).sum())
    assert loss_of(result.scene, target) < 0.35 * min(start, nothing)
    result.scene.validate()
    assert result.scene.mode is Mode(mode)
    assert result.scene.background is None if alpha else result.scene.background is not None


@MODES
def test_the_result_is_the_best_exact_picture_that_was_seen(mode):
    target = picture()
    fit_loop = loop(target, mode=mode)
    seen: list[float] = []

    class Noted(BestCheckpoint):
        def consider(self, loss: float, curves) -> None:
            seen.append(loss)
            super().consider(loss, curves)

    fit_loop.best = Noted()
    result = fit_loop.finish()
    assert len(seen) >= 0.15 * 60, "every step of the exact finish, and the end"
    assert fit_loop.best.loss == min(seen)
    kept = fit_loop.evaluator.loss(fit_loop.best.curves)
    # The steps of the finish flatten adaptively, this is the full polyline.
    assert kept == pytest.approx(min(seen), rel=2e-3)
    # Colours of 8 bits, and curves that only did harm left out.
    assert loss_of(result.scene, target) <= min(seen) * 1.02 + 1e-3


def test_the_best_state_is_kept_when_the_last_steps_spoil_it():
    target = picture()

    class WildAtTheEnd(CpuEngine):
        at_once = 1

        def step(self, scene, settings, training):
            if fit_loop.step >= 57:
                training.rates.points, training.rates.colours = 50.0, 5.0
            return super().step(scene, settings, training)

    fit_loop = FitLoop(target, settings(), opened=lambda *_, **__: WildAtTheEnd(1))
    result = fit_loop.finish()
    assert result.history[-1]["psnr_db"] < 0.9 * psnr(loss_of(result.scene, target), target.size)


@pytest.mark.parametrize(
    "changes",
    [{}, {"mode": "open"}, {"shapes": "polygon", "shared_opacity": 0.6}, {"loss": "huber", "edges": "soft"},
     {"shapes": "ellipse"}, {"fill": "linear"}, {"crossing_penalty": 0.01}],
    ids=str,
)  # fmt: skip
def test_steps_in_a_row_are_those_one_by_one(changes):
    """Whatever the number of threads; the best of the exact finish included."""

    class Single(CpuEngine):
        at_once = 1

    calls = []

    class Counting(CpuEngine):
        def steps(self, *given):
            calls.append(super().steps(*given))
            return calls[-1]

    target, given = picture(), settings(steps=150, **changes)
    one = FitLoop(target, given, opened=lambda *_, **__: Single(1)).finish()
    many = FitLoop(target, given, opened=lambda *_, **__: Counting(3)).finish()
    assert one.steps == many.steps == 150
    assert same(one, many)
    drop = operator.itemgetter("step", "psnr_db", "replaced")
    assert list(map(drop, one.history)) == list(map(drop, many.history))
    by_hand = {"fill", "crossing_penalty"} & set(changes) or changes.get("shapes") == "ellipse"
    in_rows = sum(len(losses) for losses in calls if len(losses) > 1)
    assert in_rows == 0 if by_hand else in_rows > 75


def test_steps_in_a_row_end_where_a_value_ceases_to_be_finite_or_the_time_is_up():
    target = picture()
    state = FitLoop(target, settings()).state
    paces = np.tile(np.float32([1.0, 0.1, 0.1, 0.1, 0.1, 0.0]), (8, 1))
    training = Training(target, state.optimiser, Rates(0.1, 0.1, 0.1, 0.1))
    with closing(CpuEngine(1)) as engine:
        assert len(engine.steps(state.curves, RasterSettings(), training, paces, 10.0)) == 8
        assert len(engine.steps(state.curves, RasterSettings(), training, paces, 0.0)) == 1
        paces[3, 1] = math.nan
        assert len(engine.steps(state.curves, RasterSettings(), training, paces, 10.0)) == 4


def test_transparent_pictures_become_transparent_outside():
    target = picture(32, 32, alpha=True)
    image = render_scene(fit(target, settings(steps=150)).scene, threads=1)
    assert image.shape == (32, 32, 4)
    assert image[:3, :, 3].max() < 0.02, "nothing but the disc is there"
    assert image[14:18, 12:16, 3].min() > 0.95
    assert image[14:18, 12:16, 0].min() > 0.75, "and it is red"


def test_black_on_transparent_is_seen_although_its_premultiplied_colours_are_zero():
    """Over black nothing differs from an empty picture: only the alpha channel says where curves are wanted."""
    target = np.zeros((48, 48, 4), np.float32)
    target[6:20, 8:40, 3] = 1
    target[28:44, 24:34, 3] = 1
    for seed in (0, 1, 2):
        result = fit(target, settings(steps=200, curves=8, seed=seed))
        assert loss_of(result.scene, target) < 0.05 * float((target[..., 3] ** 2).sum()), seed


def test_background_none_of_an_opaque_picture_gives_four_channels_that_are_opaque():
    result = fit(picture(), settings(background="none", steps=100, curves=24))
    assert result.scene.background is None
    assert render_scene(result.scene, threads=1)[..., 3].mean() > 0.9


def test_backgrounds():
    target = torch.from_numpy(picture())
    mean = target.mean((0, 1))
    assert choose_background(target, settings()) == pytest.approx(tuple(mean.tolist()), abs=0.5 / 255)
    assert choose_background(target, settings(background="#ff8000")) == (1.0, 128 / 255, 0.0)
    assert choose_background(target, settings(background="#fff")) == (1.0, 1.0, 1.0)
    assert choose_background(torch.from_numpy(picture(alpha=True)), settings()) is None


@pytest.mark.parametrize(
    ("target", "curves", "least"),
    [
        (np.full((12, 17, 3), 0.25, np.float32), 5, 40),
        (np.full((12, 17, 4), 0.0, np.float32), 5, 20),
        (np.full((1, 1, 3), 0.7, np.float32), 4, 40),
        (np.full((1, 1, 4), 0.5, np.float32), 4, 12),
        (picture(37, 1), 6, 10),
        (picture(1, 29, alpha=True), 6, 10),
        (picture(4, 3), 100, 10),
    ],
    ids=["constant", "empty", "1x1", "1x1 alpha", "row", "column", "more curves than pixels"],
)
@MODES
def test_odd_pictures_are_fitted(target, curves, least, mode):
    result = fit(target, settings(curves=curves, mode=mode, steps=40))
    result.scene.validate()
    assert 1 <= result.scene.curves <= curves
    assert result.scene.curves + result.dropped == curves
    height, width = target.shape[:2]
    assert psnr(loss_of(result.scene, target), 3 * width * height) > least


@MODES
def test_where_no_curve_is_of_use_one_is_left(mode):
    """A scene has at least one; the others of an empty picture could only be seen as what they are: mistakes."""
    target = np.zeros((16, 16, 4), np.float32)
    result = fit(target, settings(mode=mode, steps=40))
    assert (result.scene.curves, result.dropped) == (1, 11)


def test_specks_beside_the_silhouette_go_and_one_of_two_curves_that_hide_each_other_stays():
    """Each of the twins is of no use while the other is there; without both there would be no picture."""
    speck, twin = rectangle(3, 3, 3.6, 3.4), rectangle(10, 8, 30, 22)
    scene = scene_of(Mode.CLOSED, [speck, twin, twin, speck + 1.0], 40, 28)
    scene = replace(scene, colours=torch.full((4, 3), 0.5), opacities=torch.ones(4)).as_numpy()
    target = np.zeros((28, 40, 4), np.float32)
    target[8:22, 10:30] = (0.5, 0.5, 0.5, 1.0)
    fit_loop = loop(target, segments=4)
    begun = curves_to_fit(scene, fit_loop.settings, 40, 28, None).as_torch()
    kept = fit_loop.evaluator.without_idle(begun, 0)
    assert kept.curves == 1
    assert torch.equal(kept.points[0], twin)
    assert fit_loop.evaluator.loss(kept) < fit_loop.evaluator.loss(begun)
    assert torch.equal(fit_loop.evaluator.without_idle(begun, 2).points[-2:], begun.points[-2:]), "these are frozen"


@pytest.mark.parametrize("shape", [(5, 5), (5, 5, 2), (0, 5, 3), (5, 0, 3), (5, 5, 5)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(InputError, match="shape"):
        fit(np.zeros(shape, np.float32), settings())


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_pictures_that_are_not_finite_are_refused(value):
    target = picture()
    target[3, 4, 1] = value
    with pytest.raises(InputError, match="finite"):
        fit(target, settings())


# --- the same again ----------------------------------------------------------------------------------------


@MODES
def test_same_seed_same_result_whatever_the_number_of_threads(mode):
    target = picture(60, 40)
    one = fit(target, settings(mode=mode, curves=20))
    assert same(one, fit(target, settings(mode=mode, curves=20)))
    assert same(one, fit(target, settings(mode=mode, curves=20, threads=3)))
    assert not same(one, fit(target, settings(mode=mode, curves=20, seed=1)))


def test_the_callers_random_state_and_threads_are_left_alone():
    torch.manual_seed(5)
    threads, state = torch.get_num_threads(), torch.get_rng_state()
    fit(picture(), settings(steps=20))
    assert torch.get_num_threads() == threads
    assert (torch.get_rng_state() == state).all()


# --- what a fit tells --------------------------------------------------------------------------------------


def test_progress_history_and_figures():
    told: list[Progress] = []
    result = fit(picture(), settings(steps=80), told.append)
    assert told[-1].step == told[-1].steps == 80
    assert told[-1].seconds_left == 0
    assert told[-1].replaced == result.replaced > 0
    assert [p.step for p in told] == sorted({p.step for p in told})
    steps = [entry["step"] for entry in result.history]
    assert steps == sorted(set(steps))
    assert 20 <= len(steps) <= 51
    assert (steps[-1], result.steps) == (80, 80)
    assert result.history[-1]["psnr_db"] > result.history[0]["psnr_db"] + 3
    assert result.history[-1]["psnr_db"] == pytest.approx(psnr(loss_of(result.scene, picture()), 40 * 28 * 3), abs=0.5)
    assert result.ms_per_step == pytest.approx(1e3 * result.fit_s / 80, rel=1e-6)
    assert result.device["name"] == "cpu"
    assert (result.interrupted, result.samples) == (False, 48)
    assert result.notes == []


def test_psnr_by_hand():
    assert psnr(0.03, 300) == pytest.approx(40.0)
    assert psnr(0.0, 300) == 100.0


def test_soft_edges_come_with_a_warning():
    result = fit(picture(), settings(edges="soft", finish=0.0, steps=30))
    assert "SVG" in result.notes[0]


def test_a_time_limit_ends_a_long_fit_with_a_whole_schedule():
    result = fit(picture(), settings(steps=1_000_000, time_limit=0.8))
    # Wide bounds: the machine may be busy with other things.
    assert 0.6 < result.fit_s < 60
    assert 2 < result.steps < 100_000
    assert not result.interrupted
    assert result.replaced > 0
    assert psnr(loss_of(result.scene, picture()), 40 * 28 * 3) > 15, "of ten steps even"


# --- the ablations run -------------------------------------------------------------------------------------


@MODES
@pytest.mark.parametrize(
    "changes",
    [
        {"prune": False}, {"importance": "visibility"}, {"crossing_penalty": 0.01}, {"flatten": "de-casteljau"},
        {"edges": "soft", "finish": 0.0}, {"opaque": True}, {"samples": 8, "tolerance": 0.0},
    ],
    ids=str,
)  # fmt: skip
def test_every_ablation_fits_and_does_what_it_says(mode, changes):
    target = picture()
    result = fit(target, settings(mode=mode, steps=50, **changes))
    assert psnr(loss_of(result.scene, target), 40 * 28 * 3) > 11
    if "prune" in changes:
        assert (result.replaced, result.dropped, result.scene.curves) == (0, 0, 12)
    if "opaque" in changes:
        assert (result.scene.opacities == 1).all()
    else:
        assert result.scene.opacities.std() > 0


@MODES
def test_the_published_preset_runs_and_gets_better(mode):
    target = picture()
    short, long = (fit(target, settings(preset="paper", mode=mode, steps=steps)) for steps in (1, 150))
    assert loss_of(long.scene, target) < 0.9 * loss_of(short.scene, target)


# --- what goes wrong ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [0, 1, 30, 58])
def test_an_interrupt_returns_the_best_so_far(at):
    target = picture()

    class Interrupted(CpuEngine):
        at_once = 1

        def step(self, scene, settings, training):
            if fit_loop.step == at:
                raise KeyboardInterrupt
            return super().step(scene, settings, training)

    fit_loop = FitLoop(target, settings(), opened=lambda *_, **__: Interrupted(1))
    result = fit_loop.finish()
    assert result.interrupted
    assert result.steps == at
    result.scene.validate()
    if at == 58:
        assert psnr(loss_of(result.scene, target), 40 * 28 * 3) > 18


def test_curves_that_do_nothing_are_replaced_however_late():
    """At the last replacements the schedule asks for next to none."""
    counts = []

    class Watched(FitLoop):
        def reallocate(self, progress: float) -> None:
            self.stepper.importance[:3], self.stepper.importance[3:] = 0.0, 1.0
            before = self.log.replaced
            super().reallocate(progress)
            counts.append(self.log.replaced - before)

    Watched(picture(), settings()).finish()
    assert counts[0] > 3
    assert counts[-1] == 3


def test_an_interrupt_right_after_curves_were_replaced_returns_what_was_before():
    """New curves first make the picture worse."""
    target, levels = picture(), []

    class Interrupted(FitLoop):
        def reallocate(self, progress: float) -> None:
            levels.append(psnr(self.evaluator.loss(self.state.curves), target.size))
            super().reallocate(progress)
            if self.step >= 20:
                levels.append(psnr(self.evaluator.loss(self.state.curves), target.size))
                raise KeyboardInterrupt

    result = Interrupted(target, settings()).finish()
    *_, before, after = levels
    assert after < before - 0.5
    assert psnr(loss_of(result.scene, target), target.size) > before - 0.05  # colours of 8 bits


def test_an_interrupt_out_of_the_progress_callback_does_the_same():
    result = fit(picture(), settings(steps=100_000), ctrl_c)
    assert result.interrupted
    assert 0 < result.steps < 100_000


@MODES
@pytest.mark.parametrize("name", ["points", "colours", "opacities"])
@pytest.mark.parametrize("step", [5, 55])
def test_values_that_are_not_finite_are_named_with_curve_and_step(mode, name, step):
    fit_loop = loop(picture(), mode=mode)
    while fit_loop.step < step:
        fit_loop.advance()
    getattr(fit_loop.state.curves, name)[7].view(-1)[0] = math.nan
    with pytest.raises(EngineError, match=rf"step {step}\b.*curve 7\b.*{name}"):
        fit_loop.advance()


def test_a_loss_that_is_not_finite_is_told_even_where_no_parameter_is_to_blame():
    class Infinite(CpuEngine):
        def step(self, scene, settings, training):
            return math.inf

    fit_loop = FitLoop(picture(), settings(), opened=lambda *_, **__: Infinite(1))
    with pytest.raises(EngineError, match=r"step 0.*loss is inf"):
        fit_loop.advance()


def test_a_device_that_is_not_there_is_an_error_and_no_fallback():
    if torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(EngineError, match=r"(?i)cuda"):
        fit(picture(), settings(device="cuda"))
