"""`--fill linear`: two colours a curve, and a gradient between them that learns with all else."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from adan import Adan
from cli_runs import strict_json
from conftest import rest_slow
from PIL import Image
from test_fit import loop, picture, settings
from test_gradients import one

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.photo.fills import ENDS_RATE, LinearFills, middles_of
from cubicsplat_cli.photo.initial import new_curves
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.photo.seeding import Seeder
from cubicsplat_cli.photo.state import FitState
from cubicsplat_cli.raster.engine import Rates
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.gradients import FLAT, LINEAR, RADIAL, ends_of, linear_frames
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.scene_reader import read_svg
from cubicsplat_cli.svg.scene_writer import write_svg

RATES = Rates(0.3, 0.05, 0.05, 0.0, keep=(0.9, 0.95, 0.99), epsilon=0.5)


def slopes(width: int = 48, height: int = 32) -> np.ndarray:
    """(H, W, 3): four fields, each with a ramp of its own, which few flat curves cannot show."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    ramps = [x / width, y / height, 1.0 - x / width, (x + y) / (width + height)]
    field = 2 * (y >= height / 2).astype(int) + (x >= width / 2)
    values = np.choose(field, ramps)
    return np.stack((values, 0.8 * values[::-1], 0.5 + 0.4 * values), -1).astype(np.float32)


def final(target: np.ndarray, scene: Scene) -> float:
    """dB of a scene's exact picture."""
    return float(-10 * np.log10(np.square(render_scene(scene, threads=1) - target).mean()))


def random_fills(n: int = 5) -> tuple[LinearFills, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    fills = LinearFills.flat(torch.randn(n, 3, generator=generator), 4.0 + torch.rand(n, 2, generator=generator))
    fills.stop_logits += torch.randn(n, 2, 3, generator=generator)
    return fills, 20.0 * torch.rand(n, 2, generator=generator)


def test_a_step_is_adans_on_the_derivatives_of_ends_and_colours():
    fills, middles = random_fills()
    leaves = {"ends": fills.ends.double(), "stop_logits": fills.stop_logits.double()}
    adans = {"ends": Adan(ENDS_RATE * RATES.points, RATES), "stop_logits": Adan(RATES.colours, RATES)}
    generator = torch.Generator().manual_seed(4)
    for _ in range(3):
        frames, stops = torch.randn(5, 2, 4, generator=generator), torch.randn(5, 2, 4, generator=generator)
        fills.learn(middles, frames, stops, RATES, None)
        leaves = {name: leaf.detach().requires_grad_() for name, leaf in leaves.items()}
        starts, ends = (middles.double().unsqueeze(1) + leaves["ends"]).unbind(1)
        objective = (linear_frames(starts, ends) * frames)[:, 0].sum()
        objective = objective + (leaves["stop_logits"].sigmoid() * stops[..., :3]).sum()
        objective.backward()
        leaves = {name: leaf.detach() - adans[name].step(leaf.grad) for name, leaf in leaves.items()}
    for name, want in leaves.items():
        assert torch.allclose(getattr(fills, name).double(), want, atol=2e-4), name
    assert fills.ages.tolist() == [3] * 5


def test_frozen_fills_keep_every_bit():
    fills, middles = random_fills()
    before, still = fills.copy(), torch.tensor([True, False, True, False, False])
    fills.learn(middles, torch.randn(5, 2, 3), torch.randn(5, 2, 4), RATES, still)
    assert torch.equal(fills.ends[still], before.ends[still])
    assert torch.equal(fills.stop_logits[still], before.stop_logits[still])
    assert (fills.ends[~still] != before.ends[~still]).all()


def test_ends_do_not_fall_together():
    fills, middles = random_fills()
    fills.ends *= 1e-3
    fills.learn(middles, torch.zeros(5, 2, 3), torch.zeros(5, 2, 4), RATES, None)
    assert torch.allclose((fills.ends[:, 1] - fills.ends[:, 0]).norm(dim=1), torch.ones(5), atol=1e-4)


def test_the_ends_move_with_the_curve_and_padding_does_not_move_them():
    given = settings(fill="linear")
    points = 10.0 * torch.rand(3, 12, 2)
    curves = new_curves(points, torch.zeros(3, 3), 0.0, given, (9, 9))
    moved = replace(curves, points=points + torch.tensor([5.0, -2.0]))
    starts, ends = ends_of(curves.for_engine().gradients.frames, curves.middles())
    for want, got in zip((starts, ends), ends_of(moved.for_engine().gradients.frames, moved.middles()), strict=True):
        assert torch.allclose(want + torch.tensor([5.0, -2.0]), got, atol=1e-3)
    assert torch.allclose(
        curves.with_room(21, 2).for_engine().gradients.frames, curves.for_engine().gradients.frames, atol=1e-5
    )
    assert torch.allclose(middles_of(points, None), points.mean(1))


@pytest.mark.parametrize(("mode", "alpha"), rest_slow((Mode.CLOSED, True), *product(Mode, (False, True))))
def test_gradients_show_slopes_that_flat_curves_do_not(mode, alpha):
    target = slopes()
    if alpha:
        target = np.concatenate((target, np.ones_like(target[..., :1])), -1)
    gains = []
    for seed in range(4):
        flat, linear = (
            fit(target, settings(mode=mode, steps=150, curves=6, fill=fill, seed=seed)).scene
            for fill in ("flat", "linear")
        )
        assert flat.gradients is None
        assert linear.gradients.kinds.tolist() == [LINEAR] * linear.curves
        gains.append(final(target, linear) - final(target, flat))
    assert np.mean(gains) > 0.5


def test_curves_are_replaced_together_with_their_fills():
    given = settings(fill="linear", curves=10)
    target = torch.from_numpy(slopes())
    curves = new_curves(20.0 * torch.rand(10, 12, 2), torch.randn(10, 3), 0.0, given, (36, 24))
    curves.fills.ages += torch.arange(1, 11, dtype=torch.int32)
    seeds = Seeder(given, np.random.default_rng(0), None, target).seeds(3, torch.zeros_like(target))
    after = FitState.unmoved(curves).without_least(torch.arange(10.0), 3).with_seeds(seeds).curves
    assert after.fills.ages.tolist() == [0, 0, 0, 4, 5, 6, 7, 8, 9, 10]
    assert torch.equal(after.fills.stop_logits[:3, 0], after.colours[:3])
    assert after.behind(curves).fills.ends.shape == (20, 2, 2)


@pytest.mark.parametrize("threads", [2, 3])
def test_the_result_does_not_depend_on_the_threads(threads):
    results = [fit(slopes(), settings(fill="linear", threads=count)).scene.gradients for count in (1, threads)]
    assert np.array_equal(results[0].stops, results[1].stops)
    assert np.array_equal(results[0].frames, results[1].frames)


def test_a_fit_that_goes_over_to_a_finer_copy_takes_its_fills_along():
    fit_loop = loop(slopes(24, 16), fill="linear")
    fit_loop.relax()
    curves = fit_loop.state.curves
    want = ends_of(curves.for_engine().gradients.frames, curves.middles())
    fit_loop.go_over_to(torch.from_numpy(slopes()), FitInputs())
    got = ends_of(curves.for_engine().gradients.frames, curves.middles())
    for small, large in zip(want, got, strict=True):
        assert torch.allclose(2.0 * small, large, atol=1e-2)


def test_the_file_of_a_fit_is_where_the_next_one_begins():
    target = slopes()
    first = read_svg(write_svg(fit(target, settings(fill="linear", steps=100)).scene))
    refined = fit(target, settings(fill="linear", steps=40), inputs=FitInputs(start=first)).scene
    assert final(target, refined) >= final(target, first) - 1e-4
    with pytest.raises(InputError, match="the drawing to begin with has gradients; use --fill linear"):
        fit(target, settings(), inputs=FitInputs(start=first))


def test_a_flat_drawing_is_refined_to_gradients():
    target = slopes()
    first = fit(target, settings(steps=100)).scene
    refined = fit(target, settings(fill="linear", steps=150), inputs=FitInputs(start=first)).scene
    assert final(target, refined) > final(target, first) + 0.5


@pytest.mark.parametrize(
    "change", [{"kinds": torch.tensor([RADIAL], dtype=torch.int32)}, {"stops": torch.full((1, 2, 4), 0.5)}]
)
def test_gradients_of_another_kind_cannot_be_begun_with(change):
    frame = [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]]
    fill = replace(one(LINEAR, frame, [0.0, 1.0], [[0.2, 0.4, 0.6, 1.0], [0.8, 0.4, 0.6, 1.0]]), **change)
    start = fit(slopes(), settings(curves=1)).scene
    with pytest.raises(InputError, match="gradients other than those of --fill linear"):
        fit(slopes(), settings(fill="linear"), inputs=FitInputs(start=replace(start, gradients=fill)))


@pytest.mark.parametrize("fill", ["flat", "linear"])
def test_frozen_curves_keep_their_fills(fill):
    target = slopes()
    first = fit(target, settings(fill=fill)).scene
    given = settings(fill="linear", curves=first.curves + 8)
    found = fit(target, given, inputs=FitInputs(start=first, frozen=True)).scene
    assert found.curves > first.curves
    kept = found.gradients.chosen(slice(-first.curves, None))
    if fill == "flat":
        assert kept.kinds.tolist() == [FLAT] * first.curves
    else:
        for name, tensor in first.gradients.arrays_by_name().items():
            assert np.array_equal(kept.arrays_by_name()[name], tensor), name


def test_another_fill_is_a_usage_error():
    with pytest.raises(UsageError, match="must be flat or linear, not 'radial'"):
        settings(fill="radial")


def test_the_real_command_writes_gradients(tmp_path, run_cli):
    Image.fromarray((255 * picture()).round().astype(np.uint8)).save(tmp_path / "p.png")
    options = ("--preset", "draft", "--steps", 40, "--curves", 8, "--threads", 1, "--fill", "linear", "--json", "-q")
    result = run_cli("vectorize", tmp_path / "p.png", "-o", tmp_path / "p.svg", *options)
    text = (tmp_path / "p.svg").read_text()
    assert text.count("<linearGradient") > 1
    assert read_svg(text).gradients is not None
    report = strict_json(result.stdout)
    assert report["style"] == "photo"
    assert report["settings"]["fill"] == "linear"
    assert report["quality"]["agreement_db"] > 40.0
