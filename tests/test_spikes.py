"""The penalties on joins that turn back and on slivers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from engines import CUDA, ENGINES, open_kind, packed
from reference_spikes import sliver_gradient, spike_gradient
from scenes import straight
from test_fit import settings
from test_fit_pieces import crossing_penalty

from benchmarks.spikes import spikes_of
from cubicsplat_cli.photo.geometric import HELD, SLIVERS, SPIKES_FROM, TURNS, Regulariser, crossing_gradient
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.raster.engine import Engine, EngineScene, OptimiserState, Rates, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import pack_rings
from cubicsplat_cli.settings import Mode

SIZE = (20, 20)  # px, of a canvas


def spikes(points: torch.Tensor) -> int:
    """Joins of rings (N, K, 2) that turn by more than 150 degrees."""
    arriving, leaving = points[:, ::3] - points.roll(1, 1)[:, ::3], points[:, 1::3] - points[:, ::3]
    cosine = (arriving * leaving).sum(-1) / (arriving.norm(dim=-1) * leaving.norm(dim=-1)).clamp(min=1e-9)
    return int((cosine < math.cos(math.radians(150))).sum())


@pytest.fixture(scope="module", params=[ENGINES[0], *CUDA])
def engine(request):
    engine = open_kind(request.param)
    yield engine
    engine.close()


def blunted(
    engine: Engine,
    points: np.ndarray,
    ends: np.ndarray | None = None,
    mode: Mode = Mode.CLOSED,
    turns: float = 1.0,
    slivers: float = 1.0,
) -> torch.Tensor:
    """(N, K, 2): the gradient of both penalties with these weights, in a step that moves nothing."""
    points, n, device = torch.as_tensor(points).float().contiguous(), len(points), engine.device
    ends = None if ends is None else torch.as_tensor(ends).int().contiguous()
    white, one = torch.ones(SIZE[1], SIZE[0], 3, device=device), torch.ones(n)
    scene = packed(EngineScene(mode, *SIZE, points, torch.ones(n, 3), one, one, (1, 1, 1), ends), device)
    loss = torch.ones((), device=device) if engine.runs_ahead else 1.0
    regulariser = Regulariser(settings(spike_penalty=1.0).recipe, mode, SIZE, 1)
    blunting = regulariser.blunting(scene.points, progress=1.0, loss=loss)
    blunting.turns, blunting.slivers = turns, slivers
    training = Training(white, OptimiserState.zeros_for(scene.points), Rates(0.0, 0.0, 0.0, 0.0), blunting=blunting)
    engine.step(scene, RasterSettings(), training)
    assert blunting.left == HELD - 1
    return regulariser.spikes.to("cpu", copy=True)


@pytest.mark.parametrize("mode", list(Mode))
def test_following_the_gradient_opens_a_sharp_join_and_leaves_others(engine, mode):
    along = torch.arange(6 if mode is Mode.CLOSED else 7).float()
    points = torch.stack((along, along * (6 - along)), -1)[None]
    points[0, 4] = points[0, 2] + torch.tensor([0.1, 0.2])  # back where it came from, at the join 3
    gradient = blunted(engine, points, None, mode, 2.0, 0.0)
    moved = set(gradient[0].abs().sum(-1).nonzero().flatten().tolist())
    assert {2, 3, 4} <= moved
    if mode is Mode.OPEN:
        assert moved == {2, 3, 4}

    def cosine(p):
        u, v = p[0, 3] - p[0, 2], p[0, 4] - p[0, 3]
        return float((u @ v) / (u.norm() * v.norm()))

    assert cosine(points - 0.01 * gradient) > cosine(points)
    assert not blunted(engine, torch.zeros(1, 6, 2), None, Mode.CLOSED, 1.0, 0.0).isnan().any()


def test_a_fit_with_the_penalty_has_fewer_spikes():
    small = np.random.default_rng(5).random((14, 20, 3), np.float32)
    target = small.repeat(4, 0).repeat(4, 1)
    plain, smooth = (fit(target, settings(curves=60, steps=150, spike_penalty=w)).scene.as_torch() for w in (0.0, 3.0))
    assert spikes(smooth.points) < 0.7 * spikes(plain.points)


@pytest.mark.parametrize("mode", list(Mode))
def test_curves_of_several_lengths_and_rings_are_judged_each_by_itself(engine, mode):
    """The gradients of both penalties are those of the rings as scenes of their own, and zero in the room between."""
    generator = torch.Generator().manual_seed(3)
    lengths = [[4], [3, 2], [1, 1]] if mode is Mode.CLOSED else [[4], [2], [1]]
    shared = 0 if mode is Mode.CLOSED else 1
    rings = [[10 + torch.randn(3 * n + shared, 2, generator=generator) for n in counts] for counts in lengths]
    points, ends = pack_rings(mode, rings)
    gradient = blunted(engine, points, ends, mode, 2.0, 0.0)
    every = torch.cat([blunted(engine, r[None], None, mode, 2.0, 0.0)[0] for of_curve in rings for r in of_curve])
    used = torch.arange(points.shape[1]) < 3 * ends[:, -1:] + shared
    assert torch.allclose(gradient[used], every)
    assert every.abs().max() > 0
    assert not gradient[~used].any()
    losses = [(ring.shape[0] // 3, crossing_penalty(ring[None], mode)) for of_curve in rings for ring in of_curve]
    mean = sum(count * loss for count, loss in losses) / sum(count for count, _ in losses)
    assert torch.allclose(crossing_penalty(points, mode, ends), mean)
    assert not crossing_gradient(points, mode, 1.0, ends)[~used].any()


def joined(*corners: tuple[float, float]) -> np.ndarray:
    """(1, 3N, 2): a ring of straight cubics."""
    return straight(corners, closed=True).numpy()[None]


def strip(thickness: float) -> np.ndarray:
    """(1, 12, 2): a rectangle 12 px long."""
    return joined((3, 4), (15, 4), (15, 4 + thickness), (3, 4 + thickness))


def test_following_the_gradient_widens_a_sliver_and_leaves_what_is_wider(engine):
    assert not blunted(engine, strip(0.6)).any()
    points = torch.from_numpy(strip(0.2))
    gradient = blunted(engine, points, slivers=3.0)
    assert torch.allclose(gradient, 3.0 * blunted(engine, points), atol=1e-5)
    assert gradient.sum(1).abs().max() < 1e-4, "it moves nothing as a whole"
    for _ in range(30):
        points = points - 0.03 * blunted(engine, points)
    top, bottom = points[0, 1:3, 1], points[0, 7:9, 1]
    assert (bottom - top > 0.34).all()
    assert not blunted(engine, np.zeros((1, 6, 2))).any()


@pytest.mark.parametrize("turned", [False, True])
def test_a_gap_and_what_lies_within_the_shape_are_no_slivers(engine, turned):
    """A U whose arms stand 0.2 px apart; and a square with a strip 0.2 px wide in it, as a hole or hidden."""
    u = joined((3, 3), (15, 3), (15, 9), (9.1, 9), (9.1, 5), (8.9, 5), (8.9, 9), (3, 9))
    square = joined((1, 1), (19, 1), (19, 19), (1, 19))
    hidden, hole = (np.concatenate((square, ring), axis=1) for ring in (strip(0.2), backwards(strip(0.2))))
    ends = np.array([[4, 8]], np.int32)
    for points, of_points in ((u, None), (hidden, ends), (hole, ends)):
        if turned:
            rings = np.split(points, 1 if of_points is None else 2, axis=1)
            points = np.concatenate([backwards(ring) for ring in rings], axis=1)
        assert not sliver_gradient(points, 1.0, SIZE, of_points).any()
        assert not blunted(engine, points, of_points, turns=0.0).any()
    shown = strip(0.2)
    assert blunted(engine, shown).any()
    assert blunted(engine, backwards(shown)).any(), "whichever way it runs"


def backwards(ring: np.ndarray) -> np.ndarray:
    """The same ring (1, 3N, 2), run through the other way."""
    return np.roll(ring[:, ::-1], 1, axis=1).copy()


def test_what_lies_beside_the_canvas_does_not_count(engine):
    inside, beside = strip(0.2), strip(0.2) + np.array([0, 20], np.float32)
    assert blunted(engine, inside).any()
    assert not blunted(engine, beside).any()
    tip = joined((3, 4), (15, 4.5), (3, 5))
    assert blunted(engine, tip, slivers=0.0).any()
    assert not blunted(engine, tip - np.array([16, 0], np.float32), slivers=0.0).any()


@pytest.mark.parametrize(("mode", "ragged"), [(Mode.CLOSED, False), (Mode.CLOSED, True), (Mode.OPEN, False)])
def test_the_engines_find_the_gradient_of_the_reference(engine, mode, ragged):
    generator = np.random.default_rng(7)
    points = (generator.random((50, 12 + (mode is Mode.OPEN), 2)) * [5.0, 1.0]).astype(np.float32)
    ends = np.sort(generator.integers(1, 5, (50, 2)), axis=1).astype(np.int32) if ragged else None
    turns = blunted(engine, points, ends, mode, 1.0, 0.0)
    slivers = blunted(engine, points, ends, mode, 0.0, 1.0)
    assert torch.allclose(turns.double(), spike_gradient(points, mode, 1.0, SIZE, ends), rtol=1e-3, atol=1e-4)
    assert turns.abs().max() > 1.0
    if mode is Mode.CLOSED:
        assert torch.allclose(slivers.double(), sliver_gradient(points, 1.0, SIZE, ends), atol=1e-4)
    assert slivers.any() == (mode is Mode.CLOSED)
    assert torch.allclose(blunted(engine, points, ends, mode, 2.0, 0.5), 2.0 * turns + 0.5 * slivers, atol=1e-5)
    if ragged:
        assert not (turns + slivers)[torch.arange(12) >= 3 * torch.from_numpy(ends)[:, -1:]].any()


def test_a_gradient_is_good_for_some_steps_and_found_anew_where_the_curves_are_others(engine):
    """It is added to the picture's: a thin strip, aslant and of the picture's own colour, grows."""
    aslant = torch.tensor([[1.0, 0.1], [0.0, 1.0]])
    thin, wide = (torch.from_numpy(strip(thickness)) @ aslant for thickness in (0.2, 0.6))
    regulariser = Regulariser(settings(spike_penalty=1.0).recipe, Mode.CLOSED, SIZE, 4)
    assert regulariser.blunting(thin, progress=SPIKES_FROM, loss=2.0) is None
    device = engine.device
    loss = torch.full((), 2.0, device=device) if engine.runs_ahead else 2.0
    white, one = torch.ones(SIZE[1], SIZE[0], 3, device=device), torch.ones(1)
    scene = packed(EngineScene(Mode.CLOSED, *SIZE, thin, torch.ones(1, 3), one, one, (1, 1, 1)), device)
    points = scene.points
    training = Training(white, OptimiserState.zeros_for(points), Rates(0.0, 0.0, 0.0, 0.0))

    def step() -> torch.Tensor:
        training.blunting = regulariser.blunting(points, progress=0.9, loss=loss)
        engine.step(scene, RasterSettings(), training)
        return regulariser.spikes.to("cpu", copy=True)

    first = step()
    expected = 2.0 * TURNS / 4 * spike_gradient(thin, Mode.CLOSED, 1.0, SIZE)
    expected += 2.0 * SLIVERS / (SIZE[0] * SIZE[1]) * sliver_gradient(thin, 1.0, SIZE)
    assert first.any()
    assert torch.allclose(first.double(), expected, atol=1e-5)
    points.copy_(wide)
    for _ in range(HELD - 1):
        assert torch.equal(step(), first)
    assert not step().any()
    points.copy_(thin)
    regulariser.forget()
    assert torch.allclose(step(), first)
    training.rates = Rates(0.1, 0.0, 0.0, 0.0)
    step()
    assert (points[0, [8, 7], 1] - points[0, [1, 2], 1] > 0.21).all()


def test_a_fit_with_the_penalty_has_fewer_slivers():
    small = np.random.default_rng(6).random((14, 20, 3), np.float32)
    target = small.repeat(4, 0).repeat(4, 1)
    plain, smooth = (fit(target, settings(curves=60, steps=150, spike_penalty=w)).scene for w in (0.0, 1.0))
    assert spikes_of(smooth).slivers < 0.6 * spikes_of(plain).slivers
