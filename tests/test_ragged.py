"""Curves of different length and of several rings: holes, islands, padding; frozen curves; on every engine."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
import reference
import torch
from conftest import rest_slow
from engines import (
    ENGINES,
    EXACT,
    GRADIENT_TOLERANCE,
    PAINT,
    PICTURE_TOLERANCE,
    RELAXED,
    Truth,
    assert_degenerate_like,
    assert_drawn_and_differentiated,
    assert_same,
    close,
    compared,
    on_cpu_and_gpu,
    outliers,
    packed,
    state_for,
    truth,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scenes import (
    MODES,
    PAPER,
    TENSORS,
    circle,
    in_double,
    ragged_scene,
    random_scene,
    random_target,
    rectangle,
    reference_render,
    reverse_ring,
    scene_of,
    slopes,
    straight,
)
from torch import Tensor

from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.raster.engine import Engine, EngineScene, OptimiserState, Rates, Training
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.operator import render
from cubicsplat_cli.raster.settings import FLATNESS, RasterSettings
from cubicsplat_cli.scene import Scene, pack_rings
from cubicsplat_cli.settings import Mode

# Of a value in [0, 1]: random rings cross, and where outlines cross the engines cover by 16 lines a pixel row.
CROSSING_TOLERANCE = 5e-3


def compound(*curves: list[Tensor], width: int = 24, height: int = 20, opacity: float = 0.8) -> Scene:
    """Fills of the given rings over a background."""
    points, ring_ends = pack_rings(Mode.CLOSED, curves)
    scene = scene_of(Mode.CLOSED, [rectangle(0, 0, 1, 1)] * len(curves), width, height, background=PAPER)
    return replace(scene, points=points, ring_ends=ring_ends, opacities=torch.full((len(curves),), opacity))


def grid_of_dots(side: int) -> list[Tensor]:
    """side x side circles of four cubics that do not meet, 4 px apart."""
    return [circle(4.0 * x + 2.0, 4.0 * y + 2.0, 1.3) for y in range(side) for x in range(side)]


def padding(scene: Scene) -> Tensor:
    """(N, K) bool: the points behind each curve's last ring."""
    used = 3 * scene.ring_ends[:, -1:] + (scene.mode is Mode.OPEN)
    return torch.arange(scene.points_per_curve) >= used


DEGENERATE = {
    "hole-larger-than-the-ring": [rectangle(8, 8, 12, 12), reverse_ring(rectangle(3, 3, 18, 17))],
    "rings-that-cancel": [circle(12, 10, 6), reverse_ring(circle(12, 10, 6))],
    "the-same-ring-twice": [circle(12, 10, 6), circle(12, 10, 6)],
    "rings-that-touch": [rectangle(2, 2, 10, 10), rectangle(10, 2, 18, 10)],
    "one-segment": [torch.tensor([[3.0, 3.0], [30.0, 4.0], [4.0, 22.0]]), circle(12, 10, 3)],
    "a-point": [torch.full((3, 2), 5.25), circle(12, 10, 5)],
    "no-area": [straight([(2.25, 3.0), (20.0, 12.5)], closed=True), circle(12, 10, 5)],
    "one-ring-off-canvas": [circle(12, 10, 5), circle(-80, 10, 5)],
    "covers-all": [rectangle(-50, -50, 80, 80), reverse_ring(rectangle(5, 5, 9, 9))],
}


def test_rings_are_packed_and_given_back():
    rings = [[circle(5, 5, 4, 4), circle(5, 5, 2, 3)], [circle(9, 9, 3, 2)]]
    points, ring_ends = pack_rings(Mode.CLOSED, rings)
    assert points.shape == (2, 21, 2)
    assert ring_ends.tolist() == [[4, 7], [2, 2]]
    scene = compound(*rings)
    for curve in range(2):
        assert all(torch.equal(a, b) for a, b in zip(scene.rings(curve), rings[curve], strict=True))
    assert not points[1, 6:].any()
    assert (scene.curves, scene.segments, scene.points_per_curve) == (2, 7, 21)


def test_a_shape_of_a_hundred_thousand_edges_is_drawn_and_fitted_like_its_rings(engine):
    dots, raster = grid_of_dots(40), RasterSettings("exact", 1.0, 16)  # 1600 rings of 64 edges
    whole = compound(dots, width=160, height=160)
    apart = compound(*([dot] for dot in dots), width=160, height=160)
    apart = replace(apart, colours=whole.colours.repeat(len(dots), 1))
    assert close(engine.render(packed(whole), raster), engine.render(packed(apart), raster), 1e-6)
    goal = random_target(whole)
    _, one = engine.gradients(packed(whole), raster, target=goal, importance="loo")
    _, many = engine.gradients(packed(apart), raster, target=goal, importance="loo")
    assert close(one["points"].reshape(many["points"].shape), many["points"], 1e-6)
    assert float(one["importance"]) == pytest.approx(float(many["importance"].sum()), rel=1e-4)


def test_a_finished_picture_keeps_to_its_curves_with_fewer_edges(engine):
    scene, fine = compound(grid_of_dots(9), width=36, height=36), RasterSettings("exact", 1.0, 64)
    want = engine.render(packed(scene), fine).numpy()
    edges = engine.counts()["edges"]
    assert 0.0 < np.abs(render_scene(scene, samples=64, threads=1) - want).max() < FLATNESS
    engine.render(packed(scene), replace(fine, tolerance=FLATNESS))
    assert engine.counts()["edges"] < edges / 10


def test_equal_curves_of_one_ring_need_no_table():
    curves = list(random_scene(Mode.OPEN, 3, 2).points)
    points, ring_ends = pack_rings(Mode.OPEN, [[c] for c in curves])
    assert ring_ends is None
    assert torch.equal(points, torch.stack(curves))


@pytest.mark.parametrize(
    ("mode", "curves", "words"),
    [
        (Mode.CLOSED, [], "at least 1 curve"),
        (Mode.CLOSED, [[circle(5, 5, 4)], []], "curve 1 has 0 rings"),
        (Mode.OPEN, [[torch.zeros(4, 2), torch.zeros(4, 2)]], "curve 0 has 2 rings"),
        (Mode.CLOSED, [[torch.zeros(4, 2)]], "need 3M"),
    ],
)
def test_rings_that_cannot_be_packed(mode, curves, words):
    with pytest.raises(InputError, match=words):
        pack_rings(mode, curves)


@pytest.mark.parametrize(
    ("mode", "table", "words"),
    [
        (Mode.CLOSED, torch.tensor([[1], [2]]), "int32"),
        (Mode.CLOSED, torch.tensor([[1, 2]], dtype=torch.int32), r"shape \(N, R\) for 2 curves"),
        (Mode.OPEN, torch.tensor([[1, 2], [1, 2]], dtype=torch.int32), r"shape \(N, 1\)"),
        (Mode.CLOSED, torch.tensor([[1, 2], [0, 2]], dtype=torch.int32), "curve 1 has .0, 2."),
        (Mode.CLOSED, torch.tensor([[2, 1], [1, 2]], dtype=torch.int32), "curve 0 has .2, 1."),
        (Mode.CLOSED, torch.tensor([[1, 2], [1, 4]], dtype=torch.int32), "at most 3 segments, but curve 1"),
    ],
)
def test_wrong_tables_are_named(mode, table, words):
    scene = replace(random_scene(mode, 2, 3), ring_ends=table)
    with pytest.raises(InputError, match=words):
        scene.validate()


@pytest.mark.parametrize("mode", rest_slow(*MODES))
def test_reference_gradients_match_finite_differences(mode):
    scene = in_double(ragged_scene(mode, 4, 13, 11, 3, background=PAPER), requires_grad=True)
    target = random_target(scene).double()

    def loss(points: Tensor) -> Tensor:
        return reference.image_loss(reference_render(replace(scene, points=points), edge_width=2.0, samples=4), target)

    (gradient,) = torch.autograd.grad(loss(scene.points), scene.points)
    assert not gradient[padding(scene)].any()
    assert int((gradient != 0.0).sum()) > 40
    for index, slope in slopes(loss, scene.points, 1e-6, every=5).items():
        assert float(gradient.view(-1)[index]) == pytest.approx(slope, rel=1e-4, abs=1e-5)


@on_cpu_and_gpu
@pytest.mark.parametrize("coverage", ["relaxed", "exact"])
def test_a_hole_is_a_ring_that_runs_the_other_way(engine, coverage):
    ring, inner = rectangle(2, 2, 18, 18), rectangle(6, 6, 14, 14)
    scene = compound([ring, reverse_ring(inner)], [ring, inner], [ring], opacity=1.0)
    for curve, inside in ((0, 0.0), (1, 1.0)):
        one = replace(
            scene,
            background=None,
            **{name: getattr(scene, name)[curve : curve + 1] for name in (*TENSORS, "ring_ends")},
        )
        for picture in (
            engine.render(packed(one, engine.device), RasterSettings(coverage, 1.0, 4)).cpu().double(),
            reference_render(one, coverage, samples=4),
        ):
            assert float(picture[10, 10, 3]) == pytest.approx(inside, abs=1e-3)
            assert float(picture[4, 10, 3]) == pytest.approx(1.0, abs=1e-3)


def widened(scene: Scene) -> Scene:
    """The same scene with padding that nothing must read."""
    rows, columns = scene.curves, 2 if scene.mode is Mode.CLOSED else 1
    wide = torch.cat((scene.points, torch.full((rows, 6, 2), 12.5)), dim=1)
    padded = replace(scene, points=wide, ring_ends=torch.full((rows, columns), scene.segments, dtype=torch.int32))
    padded.validate()
    return padded


@on_cpu_and_gpu
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("subdivide", rest_slow(True, False))
def test_padding_changes_nothing(engine, mode, subdivide):
    if subdivide and engine.name == "cuda":
        pytest.skip("the CPU's alone")
    scene = random_scene(mode, 9, 3, 40, 30, 2, background=PAPER)
    target = random_target(scene).to(engine.device)
    raster = RasterSettings("relaxed", 1.5, 16, 0.02 if subdivide else 0.0, subdivide)
    here, padded = packed(scene, engine.device), packed(widened(scene), engine.device)
    assert torch.equal(engine.render(here, raster), engine.render(padded, raster))
    _, want = engine.gradients(here, raster, target=target, importance="loo")
    _, got = engine.gradients(padded, raster, target=target, importance="loo")
    count = scene.points_per_curve
    assert not got["points"][:, count:].any()
    got["points"] = got["points"][:, :count]
    assert_same(engine, got, want)


def check_against_reference(
    engine: Engine, scene: Scene, raster: RasterSettings, flipped: float, want: Truth | None = None
) -> None:
    """Picture and gradients, less the fraction of values that rounding may put on another side of an edge.

    want: the reference's, where it is known.
    """
    scene.validate()
    target = random_target(scene)
    want = want or truth(scene, raster, target)
    here = packed(scene, engine.device)
    sampled = raster.coverage == "exact" and scene.mode is Mode.CLOSED
    tolerance = CROSSING_TOLERANCE if sampled else PICTURE_TOLERANCE
    assert outliers(engine.render(here, raster), want.image, tolerance) <= flipped
    _, got = engine.gradients(here, raster, target=target.to(engine.device))
    if scene.ring_ends is not None:
        assert not got["points"].cpu()[padding(scene)].any()
    tolerance = 5 * GRADIENT_TOLERANCE
    for name in compared(scene):
        assert torch.isfinite(got[name]).all()
        scale = max(1.0, float(want.gradients[name].abs().max()))
        assert outliers(got[name], want.gradients[name], tolerance * scale) <= 5 * flipped, name


@cache
def wanted(mode, background, seed, raster):
    """One reference for all engines."""
    scene = ragged_scene(mode, 8, 33, 27, seed, background=background)
    return scene, raster, 0.01, truth(scene, raster, random_target(scene))


@pytest.mark.parametrize("engine", ENGINES, indirect=True)
@pytest.mark.parametrize(
    ("mode", "background"), rest_slow(*zip(MODES, (PAPER, None), strict=True), *product(MODES, (PAPER, None)), fast=2)
)
def test_the_engine_matches_the_reference(engine, mode, background):
    for seed, raster in enumerate((RELAXED, EXACT)):
        check_against_reference(engine, *wanted(mode, background, seed, raster))


@on_cpu_and_gpu
@given(data=st.data())
# An engine keeps nothing from one scene to the next.
@settings(derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_engine_matches_the_reference_on_any_rings(engine, data):
    seed = data.draw(st.integers(0, 2**20))
    counts = data.draw(st.lists(st.lists(st.integers(1, 4), min_size=1, max_size=4), min_size=1, max_size=4))
    shapes = [
        [random_scene(Mode.CLOSED, 1, m, 24, 20, seed + 17 * i + r).points[0] for r, m in enumerate(of_curve)]
        for i, of_curve in enumerate(counts)
    ]
    scene = compound(*shapes)
    check_against_reference(engine, scene, data.draw(st.sampled_from([RELAXED, EXACT])), 0.02)


@on_cpu_and_gpu
@pytest.mark.parametrize("raster", [RELAXED, EXACT], ids=["relaxed", "exact"])
@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_rings(engine, name, raster):
    scene = compound(DEGENERATE[name], [circle(15.3, 12.2, 5.5)])
    assert_degenerate_like(truth(scene, raster, random_target(scene), PAINT), engine, scene, raster)


@pytest.mark.parametrize("mode", MODES)
def test_subdivision(engine, mode):
    scene = ragged_scene(mode, 8, 60, 50, 2, background=PAPER)
    target = random_target(scene)
    fine, subdivided = RasterSettings("relaxed", 2.0, 64), RasterSettings("relaxed", 2.0, 64, 0.02, subdivide=True)
    difference = (engine.render(packed(scene), fine) - engine.render(packed(scene), subdivided)).abs()
    assert 0.0 < float(difference.max()) < 0.02
    want = engine.gradients(packed(scene), fine, target=target)[1]
    got = engine.gradients(packed(scene), subdivided, target=target)[1]
    for name in compared(scene):
        assert outliers(got[name], want[name], 0.02 * float(want[name].abs().max())) <= 0.05, name


@pytest.mark.parametrize("mode", MODES)
def test_each_curve_gets_as_many_edges_as_its_flatness_needs(engine, mode):
    scene = ragged_scene(mode, 8, 120, 90, 4, background=PAPER)
    fine = engine.render(packed(scene), RasterSettings("relaxed", 1.0, 64))
    all_edges = engine.counts()["edges"]
    picture = engine.render(packed(scene), RasterSettings("relaxed", 1.0, 64, 0.02))
    assert float((picture - fine).abs().max()) < 0.05
    assert engine.counts()["edges"] < all_edges


def untrained(scene: Scene, engine: Engine) -> tuple[EngineScene, OptimiserState]:
    """The scene's tensors as logits, to train in place, with a fresh optimiser."""
    logits = replace(scene, colours=scene.colours * 2 - 1, opacities=scene.opacities * 2)
    parameters = packed(logits, engine.device)
    parameters.logits = True
    parameters.edge_widths = torch.full((scene.curves,), 2.0, device=engine.device)
    return parameters, state_for(parameters)


@on_cpu_and_gpu
@pytest.mark.parametrize("mode", rest_slow(*Mode))
def test_steps_lower_the_loss_and_leave_the_padding(engine, mode):
    scene = ragged_scene(mode, 10, 20, 20, 2, background=PAPER)
    unused = padding(scene)
    scene.points[unused] = 7.0
    parameters, state = untrained(scene, engine)
    target = random_target(scene, 7).to(engine.device)
    training = Training(target, state, Rates(0.3, 0.05, 0.05, 0.02, keep=(0.98, 0.92, 0.99), epsilon=1e-2))
    losses = [float(engine.step(parameters, RELAXED, training)) for _ in range(40)]
    assert losses[-1] < 0.6 * losses[0]
    training.points_gradient = torch.ones_like(parameters.points)
    engine.step(parameters, RELAXED, training)
    assert (parameters.points.cpu()[unused] == 7.0).all()


@on_cpu_and_gpu
@pytest.mark.parametrize("mode", MODES)
def test_frozen_parameters_keep_every_bit(engine, mode):
    """Each curve has another of the five groups frozen, and the sixth all of them."""
    scene = ragged_scene(mode, 6, 40, 32, 1, background=PAPER)
    scene.colours[:] = 25.0  # beyond the logits' limits: writing would bring it back
    parameters, state = untrained(scene, engine)
    before = parameters.copy()
    scale = torch.cat((1.0 - torch.eye(5), torch.zeros(1, 5))).to(engine.device)
    target = random_target(scene).to(engine.device)
    training = Training(target, state, Rates(0.3, 0.05, 0.05, 0.02, 0.02), rate_scale=scale)
    for _ in range(3):
        engine.step(parameters, RELAXED, training)
    groups = (*TENSORS, "edge_widths")
    moved = {name: (getattr(parameters, name) != getattr(before, name)).view(6, -1).any(1).tolist() for name in groups}
    if mode is Mode.CLOSED:
        assert moved.pop("half_widths") == [False] * 6
    for group, name in enumerate(groups):
        if name in moved:
            assert moved[name] == [curve not in (group, 5) for curve in range(6)], name
    assert not state.moments[5].any()
    assert state.ages.tolist() == [3] * 6


@on_cpu_and_gpu
def test_a_rate_of_zero_freezes_as_well(engine):
    scene = ragged_scene(Mode.OPEN, 4, background=PAPER)
    parameters, state = untrained(scene, engine)
    before = parameters.half_widths.clone()
    target = random_target(scene).to(engine.device)
    engine.step(parameters, RELAXED, Training(target, state, Rates(0.3, 0.05, 0.05, 0.0)))
    assert torch.equal(parameters.half_widths, before)


@on_cpu_and_gpu
def test_a_scaled_rate_is_that_rate(engine):
    """Powers of two, so that no rounding differs; but on a GPU atomics add in any order."""
    scene = ragged_scene(Mode.OPEN, 6, 40, 32, 1, background=PAPER)
    target = random_target(scene).to(engine.device)
    scale = torch.tensor([[0.5, 0.25, 1.0, 0.125, 1.0]], device=engine.device).expand(6, 5).contiguous()
    results = []
    for rates, factors in ((Rates(0.25, 0.125, 0.5, 0.0625, 0.5), None), (Rates(0.5, 0.5, 0.5, 0.5, 0.5), scale)):
        parameters, state = untrained(scene, engine)
        for _ in range(3):
            engine.step(parameters, RELAXED, Training(target, state, rates, rate_scale=factors))
        results.append(parameters)
    for name in (*TENSORS, "edge_widths"):
        got, want = (getattr(result, name) for result in results)
        assert close(got, want, 1e-3, 0.02) if str(engine.device).startswith("cuda") else torch.equal(got, want), name


def test_wrong_tables_and_factors_do_not_reach_the_engine(engine):
    scene = packed(ragged_scene(Mode.CLOSED, 4, background=PAPER))
    good = scene.ring_ends
    for bad in ([0, 1, 1], [2, 1, 3], [1, 2, 99]):
        scene.ring_ends = good.clone()
        scene.ring_ends[2] = torch.tensor(bad, dtype=torch.int32)
        with pytest.raises(EngineError, match="ring_ends must rise"):
            engine.render(scene, RELAXED)
    scene.ring_ends = good.long()
    with pytest.raises(EngineError, match=r"ring_ends must be contiguous on the CPU, int32"):
        engine.render(scene, RELAXED)
    scene.ring_ends = good
    with pytest.raises(EngineError, match=r"rate_scale must be .* of shape \(4, 5\)"):
        engine.step(
            scene, RELAXED, Training(torch.zeros(20, 24, 3), OptimiserState.zeros_for(scene.points),
            Rates(0.1, 0.1, 0.1, 0.1), rate_scale=torch.ones(4)),
        )  # fmt: skip


@pytest.mark.parametrize("mode", MODES)
def test_the_operator_and_render_scene_draw_rings(engine, mode):
    scene = ragged_scene(mode, 6, background=PAPER)
    points = scene.points.clone().requires_grad_()
    assert_drawn_and_differentiated(engine, scene, {"points": points}, render(replace(scene, points=points), EXACT))
