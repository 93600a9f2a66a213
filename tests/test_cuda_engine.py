"""The CUDA engine against the float64 reference and the CPU engine: the same tests on the emulator and on a GPU."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
import torch
from cuda_bodies import ENGINES, assert_like_cpu, close, open_cuda, packed, state_for
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
    truth,
)
from scenes import DEGENERATE, PAPER, as_arguments, in_double, random_scene, random_target

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster import reference
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import Rates
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import Mode


@pytest.fixture(scope="module", params=ENGINES)
def engine(request):
    engine = open_cuda(request.param)
    yield engine
    engine.close()


@cache
def wanted(mode, background, settings, seed):
    """One reference for all engines."""
    scene = random_scene(mode, 12, 3, 41, 35, seed, background=background)
    return scene, random_target(scene, seed), truth(scene, settings, random_target(scene, seed))


@pytest.mark.parametrize("settings", SETTINGS, ids=NAMES)
@pytest.mark.parametrize(("mode", "background"), CASES, ids=CASE_NAMES)
def test_picture_and_gradients_match_the_reference(engine, mode, background, settings):
    differing = {}
    for seed in range(2):
        scene, target, want = wanted(mode, background, settings, seed)
        here = packed(scene, engine.device)
        image = engine.render(here, settings).cpu()
        differing.setdefault("image", []).append(outliers(image, want.image, PICTURE_TOLERANCE))
        loss, got = engine.gradients(here, settings, target=target.to(engine.device))
        assert loss == pytest.approx(want.loss, rel=1e-3)
        for name in compared(scene):
            scale = float(want.gradients[name].abs().max())
            assert scale > 1e-3, f"the test's scene has no gradient of {name}"
            fraction = outliers(got[name].cpu(), want.gradients[name], GRADIENT_TOLERANCE * scale)
            differing.setdefault(name, []).append(fraction)
    for name, fractions in differing.items():
        assert sum(fractions) / len(fractions) <= (FLIPPED if name == "image" else 0.02), f"{name}: {fractions}"


@pytest.mark.parametrize("settings", SETTINGS, ids=NAMES)
@pytest.mark.parametrize(("name", "scene"), DEGENERATE, ids=[name for name, _ in DEGENERATE])
def test_degenerate_scenes(engine, name, scene, settings):
    cpu = CpuEngine(1)
    here, target = packed(scene, engine.device), random_target(scene)
    image = engine.render(here, settings).cpu()
    assert torch.isfinite(image).all()
    assert outliers(image, cpu.render(packed(scene), settings).double(), 2e-3) <= 0.02
    _, want = cpu.gradients(packed(scene), settings, target=target, importance="loo")
    _, got = engine.gradients(here, settings, target=target.to(engine.device), importance="loo")
    for key, value in got.items():
        assert torch.isfinite(value).all(), key
    for key in ("colours", "opacities"):
        scale = max(1.0, float(want[key].abs().max()))
        assert outliers(got[key].cpu(), want[key].double(), 0.02 * scale) == 0.0, key


@pytest.mark.parametrize("kind", ["loo", "visibility"])
@pytest.mark.parametrize(("mode", "background"), CASES, ids=CASE_NAMES)
def test_importance_matches_the_reference(engine, mode, background, kind):
    scene = random_scene(mode, 10, 3, 41, 35, 3, background=background)
    target = random_target(scene, 3)
    tensors, keywords = as_arguments(in_double(scene))
    settings = SETTINGS[1]
    want = reference.importance(*tensors, **keywords, settings=settings, target=target.double(), kind=kind)
    _, got = engine.gradients(packed(scene, engine.device), settings, target=target.to(engine.device), importance=kind)
    assert float(want.abs().max()) > 1.0
    assert close(got["importance"], want, 2e-3)


@pytest.mark.parametrize("coverage", ["relaxed", "exact"])
@pytest.mark.parametrize(("mode", "background"), CASES, ids=CASE_NAMES)
def test_the_gradient_of_any_loss(engine, mode, background, coverage):
    scene = random_scene(mode, 10, 3, 41, 35, 8, background=background)
    gradient = torch.randn(35, 41, scene.channels, generator=torch.Generator().manual_seed(1))
    settings = RasterSettings(coverage, 1.5, 9)
    loss, want = CpuEngine(1).gradients(packed(scene), settings, gradient=gradient)
    found, got = engine.gradients(packed(scene, engine.device), settings, gradient=gradient.to(engine.device))
    assert found == loss == 0.0
    for name, value in want.items():
        assert close(got[name], value, 3e-3, 0.02), name


@pytest.mark.parametrize("importance", ["visibility", "loo"])
def test_a_gradient_and_a_target_together(engine, importance):
    scene = random_scene(Mode.OPEN, 8, 3, 30, 26, 9, background=None)
    target, gradient = random_target(scene, 1), random_target(scene, 2)
    want = CpuEngine(1).gradients(packed(scene), SETTINGS[1], target=target, gradient=gradient, importance=importance)
    here, target, gradient = packed(scene, engine.device), target.to(engine.device), gradient.to(engine.device)
    got = engine.gradients(here, SETTINGS[1], target=target, gradient=gradient, importance=importance)
    assert got[0] == pytest.approx(want[0], rel=1e-3)
    for name, value in want[1].items():
        assert close(got[1][name], value, 3e-3, 0.02), name


@pytest.mark.parametrize("settings", SETTINGS[1:], ids=NAMES[1:])
@pytest.mark.parametrize("mode", list(Mode))
def test_steps_are_those_of_the_cpu_engine(engine, mode, settings):
    scene = packed(random_scene(mode, 20, 3, 45, 37, 2, background=PAPER))
    scene.colours, scene.opacities, scene.logits = 4 * scene.colours - 2, 4 * scene.opacities - 2, True
    target = random_target(random_scene(mode, 1, 3, 45, 37, background=PAPER), 7)
    rates = Rates(0.3, 0.05, 0.05, 0.02)
    cpu = CpuEngine(1)
    there = packed(scene)
    here, target_here = packed(scene, engine.device), target.to(engine.device)
    states = state_for(there), state_for(here)
    for i in range(6):
        # Only one step in three asks for the extras, from the same graph.
        extras = [{}, {}]
        if i % 3 == 2:
            for e, s in zip(extras, (there, here), strict=True):
                device = s.points.device
                e |= {"image": torch.zeros(37, 45, 3, device=device), "importance": torch.zeros(20, device=device)}
                e |= {"importance_kind": "loo", "background_gradient": torch.zeros(3, device=device)}
        changing = replace(settings, edge_width=settings.edge_width * 0.95**i)
        want = cpu.step(there, changing, target, states[0], rates, **extras[0])
        got = float(engine.step(here, changing, target_here, states[1], rates, **extras[1]))
        assert got == pytest.approx(want, rel=1e-3)
        for name in extras[0]:
            if name != "importance_kind":
                assert close(extras[1][name], extras[0][name], 2e-2, 0.05), name
    assert torch.equal(states[1].ages.cpu(), states[0].ages)
    for name in ("points", "colours", "opacities", "half_widths"):
        moved = getattr(there, name) - getattr(scene, name)
        assert name == "half_widths" or float(moved.abs().max()) > 1e-2
        # Adan divides small gradients by their own size: where one is nearly nothing, rounding decides its sign.
        assert close(getattr(here, name).cpu() - getattr(scene, name), moved, 0.05, 0.03), name


def test_steps_lower_the_loss(engine):
    scene = packed(random_scene(Mode.CLOSED, 30, 3, 48, 40, 2, background=PAPER), engine.device)
    target = random_target(random_scene(Mode.CLOSED, 1, 3, 48, 40, background=PAPER), 7).to(engine.device)
    scene.colours.zero_()
    scene.opacities.zero_()
    scene.logits = True
    state = state_for(scene)
    losses = [float(engine.step(scene, SETTINGS[1], target, state, Rates(0.5, 0.05, 0.05, 0.02))) for _ in range(60)]
    assert losses[-1] < 0.4 * losses[0]
    assert int(state.ages.min()) == 60
    assert engine.fault() is None


def test_learned_edges_and_a_further_gradient(engine):
    scene = packed(random_scene(Mode.OPEN, 8, 3, 40, 32, 4, background=PAPER, half_width=(2.0, 3.0)))
    scene.edge_widths = torch.linspace(1.2, 3.0, 8)
    target = random_target(random_scene(Mode.OPEN, 1, 3, 40, 32, background=PAPER), 3)
    assert_like_cpu(engine, scene, SETTINGS[1], target)
    there, here = packed(scene), packed(scene, engine.device)
    rates = Rates(0.3, 0.05, 0.05, 0.02, edge_widths=0.1)
    further = torch.linspace(-2, 2, scene.points.numel()).view_as(scene.points)
    states = state_for(there), state_for(here)
    for _ in range(3):
        CpuEngine(1).step(there, SETTINGS[1], target, states[0], rates, points_gradient=further)
        moved = further.to(engine.device)
        engine.step(here, SETTINGS[1], target.to(engine.device), states[1], rates, points_gradient=moved)
    assert float((there.edge_widths - scene.edge_widths).abs().max()) > 0.05
    for name in ("points", "edge_widths", "half_widths"):
        change = getattr(there, name) - getattr(scene, name)
        assert close(getattr(here, name).cpu() - getattr(scene, name), change, 0.05, 0.03), name


@pytest.mark.parametrize("samples", [3, 12, 64])
@pytest.mark.parametrize("mode", list(Mode))
def test_adaptive_sampling(engine, mode, samples):
    for segments in (1, 3):
        scene = random_scene(mode, 8, segments, 60, 50, 2, background=PAPER)
        settings = RasterSettings("exact", 1.0, samples, 0.05)
        assert_like_cpu(engine, packed(scene), settings, random_target(scene), 0.04)


def test_background_gradient_is_the_transmitted_gradient(engine):
    scene = random_scene(Mode.CLOSED, 5, 3, 30, 30, 6, background=PAPER)
    target = random_target(scene).to(engine.device)
    _, got = engine.gradients(packed(scene, engine.device), SETTINGS[1], target=target)
    for c in range(3):
        losses = []
        for sign in (1, -1):
            shifted = list(PAPER)
            shifted[c] += sign * 1e-2
            moved = packed(replace(scene, background=tuple(shifted)), engine.device)
            losses.append(engine.gradients(moved, SETTINGS[1], target=target)[0])
        assert float(got["background"][c]) == pytest.approx((losses[0] - losses[1]) / 2e-2, rel=1e-2)


def test_wrong_tensors_and_sizes_are_named(engine):
    scene = packed(random_scene(Mode.CLOSED, 3, 3, background=PAPER), engine.device)
    with pytest.raises(EngineError, match=r"target must be a contiguous .* of shape \(20, 24, 3\) on"):
        engine.gradients(scene, SETTINGS[0], target=torch.zeros(20, 24, 4, device=engine.device))
    with pytest.raises(EngineError, match="opacities must be"):
        engine.render(replace(scene, opacities=scene.opacities.double()), SETTINGS[0])
    with pytest.raises(EngineError, match="needs a target or an incoming gradient"):
        engine.gradients(scene, SETTINGS[0])
    with pytest.raises(EngineError, match="leave-one-out importance needs a target"):
        engine.gradients(scene, SETTINGS[0], gradient=torch.zeros(20, 24, 3, device=engine.device), importance="loo")
    long = packed(random_scene(Mode.CLOSED, 2, 43, background=PAPER), engine.device)
    with pytest.raises(EngineError, match="at most 42 segments and 4096 edges, not 43 and 258"):
        engine.render(long, SETTINGS[0])
    with pytest.raises(EngineError, match=r"no de Casteljau subdivision; use uniform samples, or the CPU"):
        engine.render(scene, RasterSettings("relaxed", 1.0, 12, 0.5, subdivide=True))


def test_a_curve_that_stops_being_finite_is_named(engine):
    fresh = type(engine)(driver=engine._driver)
    scene = packed(random_scene(Mode.CLOSED, 6, 3, background=PAPER), engine.device)
    target = random_target(random_scene(Mode.CLOSED, 1, 3, background=PAPER)).to(engine.device)
    state = state_for(scene)
    for i in range(4):
        if i == 2:
            scene.points[4, 1, 0] = float("nan")
        fresh.step(scene, SETTINGS[1], target, state, Rates(0.1, 0.1, 0.1, 0.0))
    assert fresh.fault() == (4, 2)
