"""Every engine against the reference: pictures, gradients, importance, training steps, and what it refuses.

The engines: the native one with each instruction set, the CUDA kernels on the emulator, and a GPU where there is one.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
import reference
import torch
from adan import ReferenceFit
from conftest import rest_slow
from engines import (
    CASE_NAMES,
    CASES,
    CUDA,
    DEGENERATE_CASES,
    ENGINES,
    FLIPPED,
    GRADIENT_TOLERANCE,
    PAINT,
    PICTURE_TOLERANCE,
    SETTINGS,
    WITH_SETTINGS,
    assert_degenerate_like,
    close,
    compared,
    outliers,
    packed,
    state_for,
    truth,
)
from scenes import (
    DEGENERATE,
    PAPER,
    circle,
    in_double,
    only,
    painted_scene,
    ragged_scene,
    random_scene,
    random_target,
    rectangle,
    reference_render,
    scene_of,
    slopes,
    straight,
)  # fmt: skip

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.engine import Rates, Training
from cubicsplat_cli.raster.settings import Penalty, RasterSettings
from cubicsplat_cli.settings import Mode

every_engine = pytest.mark.parametrize("engine", ENGINES, indirect=True)


@cache
def wanted(mode, background, settings):
    """One reference for all engines."""
    scene = random_scene(mode, 12, 3, 41, 35, background=background)
    target = random_target(scene)
    return scene, target, truth(scene, settings, target)


@pytest.mark.parametrize(("engine", "settings"), WITH_SETTINGS, indirect=["engine"])
@pytest.mark.parametrize(("mode", "background"), CASES, ids=CASE_NAMES)
def test_picture_and_gradients_match_the_reference(engine, mode, background, settings):
    scene, target, want = wanted(mode, background, settings)
    here = packed(scene, engine.device)
    assert outliers(engine.render(here, settings), want.image, PICTURE_TOLERANCE) <= FLIPPED
    loss, got = engine.gradients(here, settings, target=target.to(engine.device))
    assert loss == pytest.approx(want.loss, rel=1e-3)
    for name in compared(scene):
        scale = float(want.gradients[name].abs().max())
        assert scale > 1e-3, f"the test's scene has no gradient of {name}"
        assert outliers(got[name], want.gradients[name], GRADIENT_TOLERANCE * scale) <= 0.02, name


@cache
def degenerate_truth(name, settings):
    """One reference for all engines."""
    scene = dict(DEGENERATE)[name]
    return truth(scene, settings, random_target(scene), PAINT)


@pytest.mark.parametrize(("engine", "name", "scene", "settings"), DEGENERATE_CASES, indirect=["engine"])
def test_degenerate_scenes(engine, name, scene, settings):
    assert_degenerate_like(degenerate_truth(name, settings), engine, scene, settings)


SCENES = {
    name: random_scene(mode, 10, 3, 41, 35, 3, background=background)
    for name, (mode, background) in zip(CASE_NAMES, CASES, strict=True)
}
SCENES |= {f"ragged-{mode.value}": ragged_scene(mode, 8, 41, 35, 2, background=PAPER) for mode in Mode}
SCENES["gradients"] = painted_scene(Mode.CLOSED, 8, 41, 35, 2, background=PAPER)


@cache
def wanted_importance(name, kind):
    """One reference for all engines."""
    target = random_target(SCENES[name], 3)
    given = {"target": target.double(), "kind": kind}
    return target, reference.importance(in_double(SCENES[name]), SETTINGS[1], **given)


@every_engine
@pytest.mark.parametrize("kind", ["loo", "visibility"])
@pytest.mark.parametrize("name", SCENES)
def test_importance_matches_the_reference(engine, name, kind):
    target, want = wanted_importance(name, kind)
    here, target = packed(SCENES[name], engine.device), target.to(engine.device)
    _, got = engine.gradients(here, SETTINGS[1], target=target, importance=kind)
    assert float(want.abs().max()) > 1.0
    assert close(got["importance"], want, 2e-3)


@every_engine
@pytest.mark.parametrize("mode", list(Mode))
def test_leave_one_out_is_what_removing_a_curve_costs(engine, mode):
    scene = random_scene(mode, 6, 3, 33, 35, 5, background=PAPER, opacity=(0.2, 0.6))
    target = random_target(scene, 5).to(engine.device)
    loss, got = engine.gradients(packed(scene, engine.device), SETTINGS[2], target=target, importance="loo")
    for i in range(scene.curves):
        rest = packed(only(scene, [j for j in range(scene.curves) if j != i]), engine.device)
        without, _ = engine.gradients(rest, SETTINGS[2], target=target)
        assert float(got["importance"][i]) == pytest.approx(without - loss, abs=2e-3 * abs(loss))


@every_engine
@pytest.mark.parametrize(("mode", "background"), CASES, ids=CASE_NAMES)
def test_the_gradient_of_any_loss(engine, mode, background):
    """The squared error's gradient, given as any other loss would give its own, has the squared error's results."""
    scene = random_scene(mode, 10, 3, 41, 35, 8, background=background)
    here, target = packed(scene, engine.device), random_target(scene, 1).to(engine.device)
    for settings in (RasterSettings("relaxed", 1.5, 9), RasterSettings("exact", 1.5, 9)):
        error = engine.render(here, settings) - target
        gradient = 2.0 * error
        if background is None:  # mean of the squared errors over black and over white
            white = error[..., :3] - error[..., 3:]
            gradient = torch.cat((error[..., :3] + white, -white.sum(-1, keepdim=True)), -1)
        _, want = engine.gradients(here, settings, target=target)
        loss, got = engine.gradients(here, settings, gradient=gradient.contiguous())
        assert loss == 0.0
        for name, value in want.items():
            assert close(got[name], value, 1e-4), name


@every_engine
@pytest.mark.parametrize("importance", ["visibility", "loo"])
def test_a_gradient_and_a_target_together(engine, importance):
    """The gradient moves the parameters, the target gives loss and importance."""
    scene = random_scene(Mode.OPEN, 8, 3, 30, 26, 9, background=None)
    here, target, gradient = (
        packed(scene, engine.device), random_target(scene, 1).to(engine.device),
        random_target(scene, 2).to(engine.device),
    )  # fmt: skip
    loss, got = engine.gradients(here, SETTINGS[1], target=target, gradient=gradient, importance=importance)
    _, moved = engine.gradients(here, SETTINGS[1], gradient=gradient)
    judged_loss, judged = engine.gradients(here, SETTINGS[1], target=target, importance=importance)
    assert loss == pytest.approx(judged_loss, rel=1e-5)
    assert close(got.pop("importance"), judged["importance"], 1e-5)
    for name, value in got.items():
        assert close(value, moved[name], 1e-4), name


PENALTIES = [Penalty(), Penalty(0.5, 1.0, 0.1), Penalty(0.0, 40.0, 2e-3)]


@every_engine
@pytest.mark.parametrize(
    ("penalty", "mode", "background"),
    rest_slow(
        (PENALTIES[0], Mode.OPEN, PAPER),
        (PENALTIES[1], Mode.CLOSED, None),
        (PENALTIES[2], Mode.CLOSED, PAPER),
        *((penalty, *case) for penalty in PENALTIES for case in CASES),
        fast=3,
    ),
)
def test_weighted_penalties_have_the_gradients_and_importances_of_the_reference(engine, mode, background, penalty):
    loss, gradients, importances, (scene, target, weights) = weighted(mode, background, penalty)
    here, target, weights = packed(scene, engine.device), target.to(engine.device), weights.to(engine.device)
    for kind, want in importances.items():
        got_loss, got = engine.gradients(
            here, SETTINGS[1], target=target, weights=weights, penalty=penalty, importance=kind
        )
        assert got_loss == pytest.approx(loss, rel=2e-4)
        assert close(got["importance"], want, 2e-3), kind
    for name in compared(scene):
        assert close(got[name], gradients[name], GRADIENT_TOLERANCE, 0.02), name


@cache
def weighted(mode, background, penalty):
    """Loss, gradients and importances by the reference, and what they are of; a third of the pixels counts nothing."""
    scene = random_scene(mode, 12, 3, 41, 35, 6, background=background)
    target = random_target(scene, 6)
    weights = (3.0 * torch.rand(35, 41, generator=torch.Generator().manual_seed(1)) - 1.0).clamp(min=0.0)
    leaves = in_double(scene, requires_grad=True)
    image = reference.render(leaves, SETTINGS[1])
    loss = reference.image_loss(image, target.double(), weights, penalty)
    loss.backward()
    given = {"target": target.double(), "weights": weights, "penalty": penalty}
    importances = {
        kind: reference.importance(leaves, SETTINGS[1], **given, kind=kind) for kind in ("loo", "visibility")
    }
    gradients = {name: getattr(leaves, name).grad for name in compared(scene)}
    return float(loss.detach()), gradients, importances, (scene, target, weights)


@every_engine
def test_a_step_follows_weights_and_a_given_gradient(engine):
    """A step by a picture's gradient is one by the penalty that has it; what counts nothing pulls nothing."""
    start = untrained(Mode.CLOSED)
    target = random_target(random_scene(Mode.CLOSED, 1, 3, 21, 18, background=PAPER), 7).to(engine.device)
    weights = torch.zeros(18, 21, device=engine.device)
    weights[:, :10] = 2.0
    moved = []
    gradient = 2.0 * weights.unsqueeze(-1) * (engine.render(packed(start, engine.device), SETTINGS[1]) - target)
    for extra in ({"weights": weights}, {"gradient": gradient.contiguous()}):
        here = packed(start, engine.device)
        training = Training(target, state_for(here), RATES, **extra)
        loss = float(engine.step(here, SETTINGS[1], training))
        moved.append(here.points)
        assert loss == pytest.approx(
            float(
                engine.gradients(
                    packed(start, engine.device), SETTINGS[1], target=target, weights=extra.get("weights")
                )[0]
            ),
            rel=1e-5,
        )
    assert close(moved[0], moved[1].cpu(), 1e-4)
    still = packed(start, engine.device)
    training = Training(target, state_for(still), RATES, weights=torch.zeros_like(weights))
    assert float(engine.step(still, SETTINGS[1], training)) == 0.0
    assert torch.equal(still.points.cpu(), start.points)


STEPS = 3
RATES = Rates(0.3, 0.05, 0.05, 0.02, keep=(0.98, 0.92, 0.99), epsilon=1e-2)


def changing(settings, i):
    return replace(settings, edge_width=settings.edge_width * 0.95**i)


def untrained(mode):
    scene = packed(random_scene(mode, 5, 3, 21, 18, 2, background=PAPER))
    return replace(scene, colours=4 * scene.colours - 2, opacities=4 * scene.opacities - 2, logits=True)


@cache
def trained(mode, settings):
    """A few steps of the reference, one for all engines: the losses, and how it stands afterwards."""
    target = random_target(random_scene(mode, 1, 3, 21, 18, background=PAPER), 7)
    fit = ReferenceFit(untrained(mode), target, RATES)
    return target, [fit.step(changing(settings, i), i == STEPS - 1) for i in range(STEPS)], fit


@pytest.mark.parametrize(("engine", "settings"), WITH_SETTINGS, indirect=["engine"])
@pytest.mark.parametrize("mode", list(Mode))
def test_steps_are_those_of_the_reference(engine, mode, settings):
    """The last step asks for all extras; on a GPU it is a replay of the graph that the others run in."""
    target, losses, fit = trained(mode, settings)
    scene, here = untrained(mode), packed(untrained(mode), engine.device)
    state, target = state_for(here), target.to(engine.device)
    image, importance = torch.zeros(18, 21, 3, device=engine.device), torch.zeros(5, device=engine.device)
    for i in range(STEPS):
        asked = {"image": image, "out": {"importance": importance}, "importance": "loo"} if i == STEPS - 1 else {}
        loss = float(engine.step(here, changing(settings, i), Training(target, state, RATES, **asked)))
        assert loss == pytest.approx(losses[i], rel=2e-3)
    for name, value in (("image", image), ("importance", importance)):
        assert close(value, getattr(fit, name), 2e-2, 0.05), name
    assert state.ages.tolist() == [STEPS] * 5
    for name, value in fit.values.items():
        moved = value - getattr(scene, name)
        assert name == "half_widths" or float(moved.abs().max()) > 1e-2
        # Adan divides small gradients by their own size: where one is nearly nothing, rounding decides its sign.
        assert close(getattr(here, name).cpu().double() - getattr(scene, name), moved, 0.05, 0.03), name


@every_engine
def test_steps_lower_the_loss(engine):
    scene = packed(random_scene(Mode.CLOSED, 12, 3, 20, 24, 2, background=PAPER), engine.device)
    target = random_target(random_scene(Mode.CLOSED, 1, 3, 20, 24, background=PAPER), 7).to(engine.device)
    scene.colours.zero_()
    scene.opacities.zero_()
    scene.logits = True
    state = state_for(scene)
    training = Training(target, state, Rates(0.5, 0.05, 0.05, 0.02))
    losses = [float(engine.step(scene, SETTINGS[1], training)) for _ in range(50)]
    assert losses[-1] < 0.4 * losses[0]
    assert int(state.ages.min()) == 50


@every_engine
@pytest.mark.parametrize("mode", list(Mode))
def test_a_learned_edge_width_has_the_gradient_of_finite_differences(engine, mode):
    scene = packed(random_scene(mode, 6, 3, 33, 40, 3, background=PAPER, half_width=(2.0, 3.0)), engine.device)
    widths = torch.linspace(1.5, 3.0, 6, device=engine.device)
    scene.edge_widths = widths.clone()
    target = random_target(random_scene(mode, 1, 3, 33, 40, 3, background=PAPER), 3).to(engine.device)
    _, got = engine.gradients(scene, SETTINGS[0], target=target)
    assert float(got["edge_widths"].abs().max()) > 0.1

    def loss(edge_widths: torch.Tensor) -> float:
        scene.edge_widths = edge_widths
        return engine.gradients(scene, SETTINGS[0], target=target)[0]

    for i, slope in slopes(loss, widths, 0.02).items():
        assert float(got["edge_widths"][i]) == pytest.approx(slope, rel=0.05, abs=0.02)


@every_engine
def test_equal_edge_widths_are_the_common_one(engine):
    scene = packed(random_scene(Mode.CLOSED, 6, 3, background=PAPER), engine.device)
    common = engine.render(scene, RasterSettings("relaxed", 2.5, 8))
    scene.edge_widths = torch.full((6,), 2.5, device=engine.device)
    assert torch.equal(common, engine.render(scene, RasterSettings("relaxed", 1.0, 8)))


@every_engine
def test_edge_widths_are_learned_and_a_further_gradient_moves_the_points(engine):
    scene = packed(random_scene(Mode.OPEN, 3, 2, background=PAPER), engine.device)
    scene.edge_widths = torch.full((3,), 2.0, device=engine.device)
    before, state = packed(scene, engine.device), state_for(scene)
    target = engine.render(scene, SETTINGS[1])  # no error: the picture asks for nothing
    further = torch.zeros_like(scene.points)
    further[1, 2, 0] = 5.0
    rates = Rates(0.5, 0.0, 0.0, 0.0, edge_widths=0.1)
    engine.step(scene, SETTINGS[1], Training(target, state, rates, points_gradient=further))
    moved = (scene.points - before.points).cpu()
    assert float(moved[1, 2, 0]) == pytest.approx(-0.5, rel=1e-2)
    moved[1, 2, 0] = 0.0
    assert float(moved.abs().max()) < 1e-3
    scene.points.copy_(before.points)
    _, out = engine.gradients(scene, SETTINGS[1], target=1.0 - target)
    engine.step(scene, SETTINGS[1], Training(1.0 - target, state_for(scene), rates))
    change = scene.edge_widths - before.edge_widths
    assert torch.equal(change.sign(), -out["edge_widths"].sign())
    assert float(change.abs().max()) == pytest.approx(0.1, rel=0.1)


@every_engine
def test_exact_fills_are_areas_where_the_outline_is_simple(engine):
    turned = straight([(1.3, 14.2), (17.9, 1.6), (30.2, 19.7), (9.1, 27.3)], closed=True)
    for i, points in enumerate([turned, circle(14.3, 13.1, 11.7), rectangle(3.27, 4.61, 25.13, 17.02)]):
        scene = scene_of(Mode.CLOSED, [points], 33, 29, background=PAPER, opacity=1.0)
        want = reference_render(scene, "exact", samples=16)
        picture = engine.render(packed(scene, engine.device), RasterSettings("exact", 1.0, 16))
        assert float((picture.cpu() - want).abs().max()) <= 1e-4, i


@every_engine
@pytest.mark.parametrize("mode", list(Mode))
def test_adaptive_sampling_stays_within_the_tolerance(engine, mode):
    for segments in (1, 3):
        scene = packed(random_scene(mode, 6, segments, 60, 50, 4, background=PAPER, scale=0.2), engine.device)
        fine, want = (engine.render(scene, RasterSettings("exact", 1.0, n)) for n in (64, 3))
        assert float((want - fine).abs().max()) > 0.05, "the test's scene needs no more than three edges"
        picture = engine.render(scene, RasterSettings("exact", 1.0, 48, 0.02))
        assert float((picture - fine).abs().max()) < 0.05


@every_engine
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


@every_engine
def test_wrong_tensors_are_named(engine):
    scene = packed(random_scene(Mode.CLOSED, 3, 3, background=PAPER), engine.device)
    with pytest.raises(EngineError, match=r"target must be (a )?contiguous .* of shape \(20, 24, 3\)"):
        engine.gradients(scene, SETTINGS[0], target=torch.zeros(20, 24, 4, device=engine.device))
    with pytest.raises(EngineError, match="opacities must be"):
        engine.render(replace(scene, opacities=scene.opacities.double()), SETTINGS[0])
    with pytest.raises(EngineError, match="needs a target or an incoming gradient"):
        engine.gradients(scene, SETTINGS[0])
    with pytest.raises(EngineError, match="leave-one-out importance needs a target"):
        engine.gradients(scene, SETTINGS[0], gradient=torch.zeros(20, 24, 3, device=engine.device), importance="loo")


cuda_alone = pytest.mark.parametrize("engine", CUDA, indirect=True)


@cuda_alone
def test_what_cuda_cannot_draw_is_named(engine):
    long = packed(random_scene(Mode.CLOSED, 2, 43, background=PAPER), engine.device)
    with pytest.raises(EngineError, match="at most 42 segments and 4096 edges, not 43 and 258"):
        engine.render(long, SETTINGS[0])
    scene = packed(random_scene(Mode.CLOSED, 3, 3, background=PAPER), engine.device)
    with pytest.raises(EngineError, match=r"no de Casteljau subdivision; use uniform samples, or the CPU"):
        engine.render(scene, RasterSettings("relaxed", 1.0, 12, 0.5, subdivide=True))


@cuda_alone
def test_a_curve_that_stops_being_finite_is_named(engine):
    fresh = type(engine)(driver=engine._driver)
    scene = packed(random_scene(Mode.CLOSED, 6, 3, background=PAPER), engine.device)
    target = random_target(random_scene(Mode.CLOSED, 1, 3, background=PAPER)).to(engine.device)
    state = state_for(scene)
    assert fresh.fault() is None
    for i in range(4):
        if i == 2:
            scene.points[4, 1, 0] = float("nan")
        fresh.step(scene, SETTINGS[1], Training(target, state, Rates(0.1, 0.1, 0.1, 0.0)))
    assert fresh.fault() == (4, 2)
