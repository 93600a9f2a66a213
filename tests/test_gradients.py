"""Gradient fills: what is one, the reference's derivatives, and every engine against the reference."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import reference
import reference_coverage
import torch
from conftest import rest_slow
from engines import (
    CUDA,
    ENGINES,
    EXACT,
    GRADIENT_TOLERANCE,
    PICTURE_TOLERANCE,
    RELAXED,
    assert_drawn_and_differentiated,
    assert_same,
    close,
    compared,
    on_cpu_and_gpu,
    outliers,
    packed,
    state_for,
    with_cases,
)
from reference import paint_at
from scenes import (
    MODES,
    PAPER,
    TENSORS,
    in_double,
    painted_scene,
    random_gradients,
    random_scene,
    random_target,
    rectangle,
    reference_render,
    scene_of,
    slopes,
)
from torch import Tensor

from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.raster.engine import Rates, Training
from cubicsplat_cli.raster.operator import render, render_op
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.gradients import (
    FLAT,
    LINEAR,
    RADIAL,
    Gradients,
    ends_of,
    gradients_of,
    linear_frames,
)
from cubicsplat_cli.scene.paint import RadialGradient, Stop, parameter, radial_of_frame
from cubicsplat_cli.settings import Mode


def one(kind: int, frame: list[list[float]], offsets: list[float], stops: list[list[float]]) -> Gradients:
    """Of one curve."""
    return Gradients(
        torch.tensor([kind], dtype=torch.int32), torch.tensor([frame]), torch.tensor([len(stops)], dtype=torch.int32),
        torch.tensor([offsets]), torch.tensor([stops]),
    )  # fmt: skip


RAMP = [[0.0, 0.2, 1.0, 1.0], [1.0, 0.4, 0.0, 0.5]]


def test_a_linear_gradient_by_hand():
    given = one(LINEAR, [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]], [0.2, 0.7], RAMP)
    places = torch.tensor([[-5.0, 3.0], [2.0, 3.0], [4.5, 9.0], [7.0, 0.0], [50.0, 0.0]], dtype=torch.float64)
    want = [RAMP[0], RAMP[0], [0.5, 0.3, 0.5, 0.75], RAMP[1], RAMP[1]]
    assert torch.allclose(paint_at(given, 0, places), torch.tensor(want, dtype=torch.float64), atol=1e-6)


def test_a_radial_gradient_by_hand():
    given = one(RADIAL, [[0.25, 0.0, -1.0], [0.0, 0.5, -1.0]], [0.0, 1.0], RAMP)
    places = torch.tensor([[4.0, 2.0], [6.0, 2.0], [4.0, 3.0], [0.0, 2.0]], dtype=torch.float64)
    middle = [0.5, 0.3, 0.5, 0.75]
    want = torch.tensor([RAMP[0], middle, middle, RAMP[1]], dtype=torch.float64)
    assert torch.allclose(paint_at(given, 0, places), want, atol=1e-6)


@pytest.mark.parametrize("focus", [None, (38.0, 23.0), (-6.0, 8.0)])
def test_a_focal_gradient_is_circles_that_grow_from_the_focus_to_the_rim(focus):
    """SVG 2, section 14.2.3, draws the circles of a canvas: at each t the one around (1 - t) focus + t centre with the
    radius t r (HTML, section 4.12.5.1.10, for a first circle of radius 0). An affine map makes ellipses of them."""
    given = RadialGradient(10.0, 12.0, 40.0, 20.0, 0.4, (Stop(0.0, (0, 0, 0, 255)), Stop(1.0, (255, 0, 0, 255))), focus)
    start = np.array(focus or (given.cx, given.cy))
    t, turn = np.meshgrid(np.linspace(0.0, 0.99, 12), np.linspace(0.0, 6.0, 9))
    rim = given.matrix() @ np.stack((np.cos(turn), np.sin(turn), np.ones_like(turn))).reshape(3, -1)
    places = ((1.0 - t.ravel()) * start[:, None] + t.ravel() * rim).T
    assert np.allclose(parameter(given.frame(), True, *places.T), t.ravel(), atol=1e-12)
    (found,) = gradients_of([given]).frames.astype(float)
    assert radial_of_frame(found, 1.0, given.stops).focus == (None if focus is None else pytest.approx(focus, abs=1e-4))
    drawn = paint_at(gradients_of([given]), 0, places)[:, 0]
    assert np.allclose(drawn, t.ravel(), atol=1e-5)


def test_frames_without_a_lean_have_none():
    given = one(RADIAL, [[0.25, 0.0, -1.0], [0.0, 0.5, -1.0]], [0.0, 1.0], RAMP)
    assert given.frames.tolist() == [[[0.25, 0.0, -1.0, 0.0], [0.0, 0.5, -1.0, 0.0]]]


def test_of_stops_with_one_offset_the_last_counts_from_there_on():
    stops = [[0.0] * 4, [0.3] * 4, [1.0] * 4]
    given = one(LINEAR, [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]], [0.5, 0.5, 0.5], stops)
    places = torch.tensor([[4.9, 0.0], [5.1, 0.0]], dtype=torch.float64)
    assert paint_at(given, 0, places)[:, 0].tolist() == [0.0, 1.0]


def test_frames_have_the_ends_that_they_were_made_of():
    generator = torch.Generator().manual_seed(0)
    starts, ends = (20.0 * torch.rand(5, 2, generator=generator, dtype=torch.float64) for _ in range(2))
    frames = linear_frames(starts, ends)
    for t, places in enumerate((starts, ends)):
        assert torch.allclose((frames[:, 0, :2] * places).sum(1) + frames[:, 0, 2], torch.full((5,), float(t)).double())
    again = ends_of(frames, starts)
    assert torch.allclose(again[0], starts)
    assert torch.allclose(again[1], ends)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kinds": torch.tensor([0, 1, 3], dtype=torch.int32)}, "kinds must be 0 .flat., 1"),
        ({"kinds": torch.tensor([0, 1, 2])}, r"kinds must be an array of int32 and shape \(3,\)"),
        (
            {"counts": torch.tensor([0, 1, 9], dtype=torch.int32)},
            "counts must lie between 1 and 4, but those of curve 2",
        ),
        ({"frames": torch.zeros(3, 2)}, r"frames must be an array of float32 or float64 and shape \(3, 2, 4\)"),
        ({"frames": torch.full((3, 2, 3), float("nan"))}, "frames must be finite, but those of curve 1"),
        (
            {"frames": torch.tensor([[[0.1, 0.0, 0.0, 0.8], [0.0, 0.1, 0.0, 0.6]]] * 3)},
            "frames must have a lean shorter than 1, but those of curve 2",
        ),
        ({"offsets": torch.tensor([[0.0, 0.5, 0.4, 1.0]] * 3)}, "offsets must rise from 0 to 1"),
        ({"stops": torch.full((3, 4, 4), 1.5)}, "stops must be between 0 and 1"),
        ({"stops": None}, r"stops must be an array of shape \(3, S, 4\)"),
    ],
)
def test_wrong_gradients_are_named(change, words):
    scene = painted_scene(Mode.CLOSED, 3)
    four = torch.full((3,), 4, dtype=torch.int32)
    bad = replace(scene, gradients=replace(scene.gradients, **{"counts": four, **change}))
    with pytest.raises(InputError, match=words):
        bad.validate()


def test_what_nothing_reads_may_be_anything():
    scene = painted_scene(Mode.CLOSED, 3)
    given = scene.gradients.copy()
    given.stops[0] = float("nan")  # flat
    given.counts[1] = 2
    given.stops[1, 2:] = 7.0
    given.offsets[1, 2:] = -1.0
    other = replace(scene, gradients=given)
    other.validate()
    few = scene.gradients.copy()
    few.counts[1] = 2
    assert torch.equal(reference_render(other), reference_render(replace(scene, gradients=few)))


@pytest.mark.parametrize("mode", MODES)
def test_a_scaled_scene_has_the_same_gradients(mode):
    scene = painted_scene(mode, 6, 20, 18)
    larger = scene.scaled(40, 36)
    at = reference_coverage.pixel_centres(20, 18)
    for curve in (1, 2, 4, 5):
        assert torch.allclose(
            paint_at(scene.gradients, curve, at), paint_at(larger.gradients, curve, 2.0 * at), atol=1e-5
        )


@pytest.mark.parametrize("coverage", ["relaxed", "exact"])
@pytest.mark.parametrize("background", [PAPER, None])
def test_equal_stops_are_a_flat_fill(coverage, background):
    scene = painted_scene(Mode.CLOSED, background=background)
    alike = torch.cat((scene.colours, torch.ones(9, 1)), 1).unsqueeze(1).expand(9, 4, 4)
    same = replace(scene, gradients=replace(scene.gradients, stops=alike.contiguous()))
    want = reference_render(replace(scene, gradients=None), coverage)
    assert torch.allclose(reference_render(same, coverage), want, atol=1e-6)


def in_double_painted(scene: Scene) -> Scene:
    """Float64 leaves, the gradients' frames and stops too."""
    given = scene.gradients.changed(lambda t: t.detach().double() if t.is_floating_point() else t)
    given.frames.requires_grad_()
    given.stops.requires_grad_()
    return replace(in_double(scene, requires_grad=True), gradients=given)


@pytest.mark.parametrize("background", rest_slow((None,), (PAPER,)))
def test_reference_gradients_match_finite_differences(background):
    scene = in_double_painted(painted_scene(Mode.CLOSED, 6, 13, 11, 3, background=background, opacity=(0.3, 0.8)))
    target = random_target(scene).double()

    def loss(**changed: Tensor) -> Tensor:
        fills = replace(scene.gradients, **changed)
        return reference.image_loss(reference_render(replace(scene, gradients=fills), edge_width=2.0), target)

    leaves = {name: getattr(scene.gradients, name) for name in ("frames", "stops")}
    found = dict(zip(leaves, torch.autograd.grad(loss(), list(leaves.values())), strict=True))
    assert not found["stops"][0].any()  # flat
    for name, leaf in leaves.items():
        assert int((found[name].abs() > 1e-3).sum()) >= 9, name
        for index, slope in slopes(lambda moved, name=name: loss(**{name: moved}), leaf, 1e-7, every=3).items():
            assert float(found[name].view(-1)[index]) == pytest.approx(slope, rel=2e-3, abs=2e-3), (name, index)


@cache
def wanted(mode, background, raster):
    """A scene, and its picture, loss and gradients by the reference: one for all engines."""
    scene = painted_scene(mode, 9, seed=4 + (raster is EXACT), background=background)
    scene.validate()
    leaves = in_double_painted(scene)
    image = reference.render(leaves, raster)
    loss = reference.image_loss(image, random_target(scene).double())
    loss.backward()
    found = {name: getattr(leaves, name).grad for name in compared(scene)}
    return scene, image.detach(), float(loss.detach()), found | {
        "frames": leaves.gradients.frames.grad, "stops": leaves.gradients.stops.grad
    }  # fmt: skip


@pytest.mark.parametrize(("engine", "mode", "background"), with_cases(ENGINES), indirect=["engine"])
def test_the_engine_matches_the_reference(engine, mode, background):
    for raster in (RELAXED, EXACT):
        scene, image, loss, gradients = wanted(mode, background, raster)
        here = packed(scene, engine.device)
        tolerance = 5e-3 if raster is EXACT else PICTURE_TOLERANCE
        assert outliers(engine.render(here, raster), image, tolerance) <= 0.01
        found, got = engine.gradients(here, raster, target=random_target(scene).to(engine.device))
        assert found == pytest.approx(loss, rel=2e-3)
        for name, want in gradients.items():
            scale = max(1.0, float(want.abs().max()))
            assert outliers(got[name], want, 5 * GRADIENT_TOLERANCE * scale) <= 0.02, (name, raster.coverage)
        assert float(gradients["frames"].abs().max()) > 1.0
        assert int((gradients["frames"][..., 3].abs() > 0.1).sum()) >= 2  # of radial ones


@pytest.mark.parametrize(("engine", "mode", "background"), with_cases([ENGINES[0], *CUDA]), indirect=["engine"])
def test_flat_kinds_are_drawn_as_without_gradients(engine, mode, background):
    """To the bit: the way through the gradients changes nothing else."""
    scene = random_scene(mode, 20, 3, 50, 40, 2, background=background)
    given = replace(random_gradients(scene), kinds=torch.full((20,), FLAT, dtype=torch.int32))
    target = random_target(scene).to(engine.device)
    plain, flat = (packed(s, engine.device) for s in (scene, replace(scene, gradients=given)))
    for raster in (RELAXED, EXACT):
        assert torch.equal(engine.render(plain, raster), engine.render(flat, raster))
        _, want = engine.gradients(plain, raster, target=target, importance="loo")
        _, got = engine.gradients(flat, raster, target=target, importance="loo")
        assert not got["frames"].any()
        assert not got["stops"].any()
        assert_same(engine, got, want)


@on_cpu_and_gpu
def test_a_step_gives_the_gradients_of_frames_and_stops(engine):
    scene = painted_scene(Mode.CLOSED, background=PAPER)
    target = random_target(scene).to(engine.device)
    here = packed(replace(scene, colours=scene.colours.logit(), opacities=scene.opacities.logit()), engine.device)
    here.logits = True
    _, want = engine.gradients(here, RELAXED, target=target)
    before, state = here.copy(), state_for(here)
    training = Training(
        target, state, Rates(0.3, 0.05, 0.05, 0.0),
        out={"frames": torch.zeros(9, 2, 4, device=engine.device), "stops": torch.zeros(9, 4, 4, device=engine.device)},
    )  # fmt: skip
    loss = float(engine.step(here, RELAXED, training))
    assert close(training.out["frames"], want["frames"], 1e-5)
    assert close(training.out["stops"], want["stops"], 1e-5)
    assert torch.equal(here.gradients.stops, before.gradients.stops)
    assert not torch.equal(here.points, before.points)
    assert float(engine.step(here, RELAXED, training)) < loss


@pytest.mark.parametrize("mode", MODES)
def test_the_operator_and_render_scene_draw_gradients(engine, mode):
    scene = painted_scene(mode, background=PAPER)
    points = scene.points.clone().requires_grad_()
    given = scene.gradients.copy()
    given.frames.requires_grad_()
    given.stops.requires_grad_()
    picture = render(replace(scene, points=points, gradients=given), EXACT)
    leaves = {"points": points, "frames": given.frames, "stops": given.stops}
    assert_drawn_and_differentiated(engine, scene, leaves, picture)


def test_the_operator_needs_no_gradient_of_the_fills():
    scene = painted_scene(Mode.CLOSED, background=PAPER)
    colours = scene.colours.clone().requires_grad_()
    render(replace(scene, colours=colours), RELAXED).sum().backward()
    assert colours.grad[::3].any()  # the flat ones
    assert not colours.grad[1::3].any()


@pytest.mark.slow  # test_operator.py has the operator without them
def test_torch_accepts_the_operator_with_gradients():
    scene = painted_scene(Mode.CLOSED, 3, 20, 18, background=PAPER)
    tensors = [getattr(scene, name).clone().requires_grad_() for name in TENSORS]
    given = scene.gradients
    fills = [given.frames.clone().requires_grad_(), given.stops.clone().requires_grad_(), given.offsets]
    canvas = ([1, 20, 18], list(PAPER), [0, 8, 0], [1.5, 0.0])
    results = torch.library.opcheck(render_op, (*tensors, *fills, given.kinds, given.counts, None, *canvas))
    assert set(results.values()) == {"SUCCESS"}


def test_wrong_tables_do_not_reach_the_engine(engine):
    scene = packed(painted_scene(Mode.CLOSED, 6))
    for name, value in (("kinds", 5), ("counts", 99), ("counts", 0)):
        bad = packed(scene)
        getattr(bad.gradients, name)[1] = value
        with pytest.raises(EngineError, match="gradients need a kind from 0 to 2"):
            engine.render(bad, RELAXED)
    scene.gradients.offsets = scene.gradients.offsets.double()
    with pytest.raises(EngineError, match=r"gradients.offsets must be contiguous on the CPU, float32"):
        engine.render(scene, RELAXED)


def test_a_place_at_the_centre_of_a_radial_gradient_has_finite_gradients(engine):
    scene = scene_of(Mode.CLOSED, [rectangle(1, 1, 9, 9)], 10, 10, background=PAPER)
    scene = replace(scene, gradients=one(RADIAL, [[0.125, 0.0, -0.5625], [0.0, 0.125, -0.5625]], [0.0, 1.0], RAMP))
    target = random_target(scene)
    _, got = engine.gradients(packed(scene), RELAXED, target=target)
    leaves = in_double_painted(scene)
    reference.image_loss(reference.render(leaves, RELAXED), target.double()).backward()
    assert close(got["frames"], leaves.gradients.frames.grad, 1e-3)
    for name in (*TENSORS, "frames", "stops"):
        assert torch.isfinite(got[name]).all(), name
