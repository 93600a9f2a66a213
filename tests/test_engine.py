"""The native engine against the reference: pictures, gradients, importance; every instruction set; any thread count."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
import torch
from engines import (
    CASE_NAMES,
    CASES,
    FLIPPED,
    GRADIENT_TOLERANCE,
    NAMES,
    PICTURE_TOLERANCE,
    SETTINGS,
    compared,
    outliers,
    packed,
    truth,
)
from scenes import DEGENERATE, PAPER, as_arguments, in_double, only, random_scene, random_target

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster import reference
from cubicsplat_cli.raster.cpu import CpuEngine, instruction_sets
from cubicsplat_cli.raster.engine import OptimiserState, Rates
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import Mode


@pytest.fixture(scope="module", params=instruction_sets())
def engine(request):
    engine = CpuEngine(2, request.param)
    yield engine
    engine.close()


@pytest.mark.parametrize("settings", SETTINGS, ids=NAMES)
@pytest.mark.parametrize(("mode", "background"), CASES, ids=CASE_NAMES)
def test_picture_and_gradients_match_the_reference(engine, mode, background, settings):
    differing = {}
    for seed in range(4):
        scene = random_scene(mode, 12, 3, 41, 35, seed, background=background)
        target = random_target(scene, seed)
        want = truth(scene, settings, target)
        image = engine.render(packed(scene), settings)
        differing.setdefault("image", []).append(outliers(image, want.image, PICTURE_TOLERANCE))
        loss, got = engine.gradients(packed(scene), settings, target=target)
        assert loss == pytest.approx(want.loss, rel=1e-3)
        for name in compared(scene):
            scale = float(want.gradients[name].abs().max())
            assert scale > 1e-3, f"the test's scene has no gradient of {name}"
            differing.setdefault(name, []).append(outliers(got[name], want.gradients[name], GRADIENT_TOLERANCE * scale))
    for name, fractions in differing.items():
        assert sum(fractions) / len(fractions) <= (FLIPPED if name == "image" else 0.02), f"{name}: {fractions}"


@cache
def degenerate_truth(name, settings):
    """One reference for all instruction sets."""
    scene = dict(DEGENERATE)[name]
    return truth(scene, settings, random_target(scene))


@pytest.mark.parametrize("settings", SETTINGS, ids=NAMES)
@pytest.mark.parametrize(("name", "scene"), DEGENERATE, ids=[name for name, _ in DEGENERATE])
def test_degenerate_scenes(engine, name, scene, settings):
    target = random_target(scene)
    want = degenerate_truth(name, settings)
    image = engine.render(packed(scene), settings)
    assert torch.isfinite(image).all()
    assert outliers(image, want.image, 2e-3) <= 0.02
    _, got = engine.gradients(packed(scene), settings, target=target, importance="loo")
    for key, value in got.items():
        assert torch.isfinite(value).all(), key
    for key in ("colours", "opacities"):
        scale = max(1.0, float(want.gradients[key].abs().max()))
        assert outliers(got[key], want.gradients[key], 0.02 * scale) == 0.0, key


@pytest.mark.parametrize("kind", ["loo", "visibility"])
@pytest.mark.parametrize(("mode", "background"), CASES, ids=CASE_NAMES)
def test_importance_matches_the_reference(engine, mode, background, kind):
    scene = random_scene(mode, 10, 3, 41, 35, 3, background=background)
    target = random_target(scene, 3)
    tensors, keywords = as_arguments(in_double(scene))
    settings = SETTINGS[1]
    want = reference.importance(*tensors, **keywords, settings=settings, target=target.double(), kind=kind)
    _, got = engine.gradients(packed(scene), settings, target=target, importance=kind)
    assert float(want.abs().max()) > 1.0
    assert torch.allclose(got["importance"].double(), want, rtol=2e-3, atol=2e-3 * float(want.abs().max()))


@pytest.mark.parametrize("mode", list(Mode))
def test_leave_one_out_is_what_removing_a_curve_costs(mode):
    engine = CpuEngine(1)
    scene = random_scene(mode, 8, 3, 40, 40, 5, background=PAPER, opacity=(0.2, 0.6))
    target = random_target(scene, 5)
    settings = SETTINGS[2]
    loss, got = engine.gradients(packed(scene), settings, target=target, importance="loo")
    for i in range(scene.curves):
        rest = only(scene, [j for j in range(scene.curves) if j != i])
        without, _ = engine.gradients(packed(rest), settings, target=target)
        assert float(got["importance"][i]) == pytest.approx(without - loss, abs=2e-3 * abs(loss))


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("coverage", ["relaxed", "exact"])
def test_results_do_not_depend_on_threads(mode, coverage):
    scene = random_scene(mode, 60, 3, 150, 90, 1, background=PAPER)
    target = random_target(scene)
    results = []
    for threads in (1, 2, 5):
        engine = CpuEngine(threads)
        parameters = packed(replace(scene, colours=scene.colours * 4 - 2, opacities=scene.opacities * 4 - 2))
        parameters.logits = True
        for name in ("points", "colours", "opacities", "half_widths"):
            setattr(parameters, name, getattr(parameters, name).clone())
        state = OptimiserState.zeros(scene.curves, scene.points_per_curve)
        importance = torch.zeros(scene.curves)
        for _ in range(5):
            loss = engine.step(
                parameters, RasterSettings(coverage, 1.0, 8), target, state, Rates(0.5, 0.05, 0.05, 0.1),
                importance=importance, importance_kind="loo",
            )  # fmt: skip
        results.append((loss, parameters.points, parameters.colours, parameters.half_widths, importance))
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            assert a == b if isinstance(a, float) else torch.equal(a, b)


@pytest.mark.parametrize("mode", list(Mode))
def test_steps_lower_the_loss(mode):
    engine = CpuEngine(2)
    scene = random_scene(mode, 30, 3, 64, 64, 2, background=PAPER)
    target = random_target(scene, 7)
    parameters = packed(scene)
    parameters.colours, parameters.opacities, parameters.logits = torch.zeros(30, 3), torch.zeros(30), True
    state = OptimiserState.zeros(30, scene.points_per_curve)
    rates = Rates(0.5, 0.05, 0.05, 0.02)
    losses = [engine.step(parameters, SETTINGS[1], target, state, rates) for _ in range(80)]
    assert losses[-1] < 0.3 * losses[0]
    assert int(state.ages.min()) == 80


def test_adaptive_sampling_stays_within_the_tolerance():
    engine = CpuEngine(1)
    scene = random_scene(Mode.CLOSED, 10, 4, 120, 90, 4, background=PAPER, scale=0.1)
    fine = engine.render(packed(scene), RasterSettings("exact", 1.0, 64))
    edges = {}
    for tolerance in (0.0, 0.02):
        picture = engine.render(packed(scene), RasterSettings("exact", 1.0, 48, tolerance))
        edges[tolerance] = engine.counts()["edges"]
        assert float((picture - fine).abs().max()) < 0.05
    assert edges[0.02] < edges[0.0]


def test_background_gradient_is_the_transmitted_gradient():
    engine = CpuEngine(1)
    scene = random_scene(Mode.CLOSED, 5, 3, 30, 30, 6, background=PAPER)
    target = random_target(scene)
    _, got = engine.gradients(packed(scene), SETTINGS[1], target=target)
    step = 1e-2
    for c in range(3):
        losses = []
        for sign in (1, -1):
            shifted = list(PAPER)
            shifted[c] += sign * step
            moved = replace(scene, background=tuple(shifted))
            losses.append(engine.gradients(packed(moved), SETTINGS[1], target=target)[0])
        assert float(got["background"][c]) == pytest.approx((losses[0] - losses[1]) / (2 * step), rel=1e-2)


@pytest.mark.parametrize("mode", list(Mode))
def test_a_learned_edge_width_has_the_gradient_of_finite_differences(mode):
    engine = CpuEngine(1)
    scene = packed(random_scene(mode, 6, 3, 48, 40, 3, background=PAPER, half_width=(2.0, 3.0)))
    scene.edge_widths = torch.linspace(1.5, 3.0, 6)
    target = random_target(random_scene(mode, 6, 3, 48, 40, 3, background=PAPER), 3)
    _, got = engine.gradients(scene, SETTINGS[0], target=target)
    assert float(got["edge_widths"].abs().max()) > 0.1
    step = 0.02
    for i in range(6):
        losses = []
        for sign in (1, -1):
            scene.edge_widths = torch.linspace(1.5, 3.0, 6)
            scene.edge_widths[i] += sign * step
            losses.append(engine.gradients(scene, SETTINGS[0], target=target)[0])
        slope = (losses[0] - losses[1]) / (2 * step)
        assert float(got["edge_widths"][i]) == pytest.approx(slope, rel=0.05, abs=0.02)


def test_equal_edge_widths_are_the_common_one():
    engine = CpuEngine(1)
    scene = packed(random_scene(Mode.CLOSED, 6, 3, background=PAPER))
    common = engine.render(scene, RasterSettings("relaxed", 2.5, 8))
    scene.edge_widths = torch.full((6,), 2.5)
    assert torch.equal(common, engine.render(scene, RasterSettings("relaxed", 1.0, 8)))


@pytest.mark.parametrize("mode", list(Mode))
def test_subdivision_draws_the_same_curves_with_the_same_gradients(mode):
    engine = CpuEngine(1)
    scene = random_scene(mode, 8, 3, 60, 50, 2, background=PAPER)
    target = random_target(scene)
    fine, subdivided = RasterSettings("relaxed", 2.0, 64), RasterSettings("relaxed", 2.0, 64, 0.02, subdivide=True)
    difference = (engine.render(packed(scene), fine) - engine.render(packed(scene), subdivided)).abs()
    assert 0.0 < float(difference.max()) < 0.02
    want = engine.gradients(packed(scene), fine, target=target)[1]
    got = engine.gradients(packed(scene), subdivided, target=target)[1]
    for name in compared(scene):
        assert outliers(got[name], want[name], 0.02 * float(want[name].abs().max())) <= 0.05, name


def test_a_further_gradient_moves_the_points():
    engine = CpuEngine(1)
    scene = random_scene(Mode.CLOSED, 3, 2, background=PAPER)
    target = engine.render(packed(scene), SETTINGS[1])  # no error: the picture asks for nothing
    parameters = packed(scene)
    parameters.points = parameters.points.clone()
    further = torch.zeros_like(parameters.points)
    further[1, 2, 0] = 5.0
    state = OptimiserState.zeros(3, scene.points_per_curve)
    engine.step(parameters, SETTINGS[1], target, state, Rates(0.5, 0.0, 0.0, 0.0), points_gradient=further)
    moved = parameters.points - scene.points
    assert float(moved[1, 2, 0]) == pytest.approx(-0.5, rel=1e-2)
    moved[1, 2, 0] = 0.0
    assert float(moved.abs().max()) < 1e-3


def test_wrong_tensors_are_named():
    engine = CpuEngine(1)
    scene = packed(random_scene(Mode.CLOSED, 3, 3, background=PAPER))
    with pytest.raises(EngineError, match=r"target must be a contiguous .* CPU tensor of shape \(20, 24, 3\)"):
        engine.gradients(scene, SETTINGS[0], target=torch.zeros(20, 24, 4))
    with pytest.raises(EngineError, match="needs a target or an incoming gradient"):
        engine.gradients(scene, SETTINGS[0])
    with pytest.raises(EngineError, match="instruction set mmx"):
        CpuEngine(1, "mmx")
