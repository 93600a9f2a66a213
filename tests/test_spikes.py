"""The penalties on joins that turn back and on slivers."""

from __future__ import annotations

import math
from contextlib import closing
from functools import partial

import numpy as np
import pytest
import torch
from test_fit import settings
from test_fit_pieces import crossing_penalty

from benchmarks.spikes import spikes_of
from cubicsplat_cli.photo.geometric import (
    EDGES,
    HELD,
    LEAST_ARM,
    OPPOSITE,
    SPIKE_TURN,
    THINNEST,
    Regulariser,
    crossing_gradient,
    sliver_gradient,
    spike_gradient,
)
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.raster.cpu import Blunting, CpuEngine, address_of
from cubicsplat_cli.raster.engine import EngineScene, OptimiserState, Rates, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import pack_rings
from cubicsplat_cli.settings import Mode

SIZE = (20, 20)  # px, of a canvas


def spikes(points: torch.Tensor) -> int:
    """Joins of rings (N, K, 2) that turn by more than 150 degrees."""
    arriving, leaving = points[:, ::3] - points.roll(1, 1)[:, ::3], points[:, 1::3] - points[:, ::3]
    cosine = (arriving * leaving).sum(-1) / (arriving.norm(dim=-1) * leaving.norm(dim=-1)).clamp(min=1e-9)
    return int((cosine < math.cos(math.radians(150))).sum())


@pytest.mark.parametrize("mode", list(Mode))
def test_following_the_gradient_opens_a_sharp_join_and_leaves_others(mode):
    along = torch.arange(6 if mode is Mode.CLOSED else 7).float()
    points = torch.stack((along, along * (6 - along)), -1)[None]
    points[0, 4] = points[0, 2] + torch.tensor([0.1, 0.2])  # back where it came from, at the join 3
    gradient = spike_gradient(points, mode, 2.0, SIZE)
    moved = set(gradient[0].abs().sum(-1).nonzero().flatten().tolist())
    assert {2, 3, 4} <= moved
    if mode is Mode.OPEN:
        assert moved == {2, 3, 4}

    def cosine(p):
        u, v = p[0, 3] - p[0, 2], p[0, 4] - p[0, 3]
        return float((u @ v) / (u.norm() * v.norm()))

    assert cosine(points - 0.01 * gradient) > cosine(points)
    assert not spike_gradient(torch.zeros(1, 6, 2), Mode.CLOSED, 1.0, SIZE).isnan().any()


def test_a_fit_with_the_penalty_has_fewer_spikes():
    small = np.random.default_rng(5).random((14, 20, 3), np.float32)
    target = small.repeat(4, 0).repeat(4, 1)
    plain, smooth = (fit(target, settings(curves=60, steps=150, spike_penalty=w)).scene.as_torch() for w in (0.0, 3.0))
    assert spikes(smooth.points) < 0.7 * spikes(plain.points)


@pytest.mark.parametrize("mode", list(Mode))
def test_curves_of_several_lengths_and_rings_are_judged_each_by_itself(mode):
    """The gradients of both penalties are those of the rings as scenes of their own, and zero in the room between."""
    generator = torch.Generator().manual_seed(3)
    lengths = [[4], [3, 2], [1, 1]] if mode is Mode.CLOSED else [[4], [2], [1]]
    shared = 0 if mode is Mode.CLOSED else 1
    rings = [[10 + torch.randn(3 * n + shared, 2, generator=generator) for n in counts] for counts in lengths]
    points, ends = pack_rings(mode, rings)
    gradient = spike_gradient(points, mode, 2.0, SIZE, ends)
    every = torch.cat([spike_gradient(ring[None], mode, 2.0, SIZE)[0] for of_curve in rings for ring in of_curve])
    used = torch.arange(points.shape[1]) < 3 * ends[:, -1:] + shared
    assert torch.allclose(gradient[used], every)
    assert every.abs().max() > 0
    assert not gradient[~used].any()
    losses = [(ring.shape[0] // 3, crossing_penalty(ring[None], mode)) for of_curve in rings for ring in of_curve]
    mean = sum(count * loss for count, loss in losses) / sum(count for count, _ in losses)
    assert torch.allclose(crossing_penalty(points, mode, ends), mean)
    assert not crossing_gradient(points, mode, 1.0, ends)[~used].any()


def strip(thickness: float, length: float = 12.0) -> np.ndarray:
    """(1, 12, 2): a rectangle of four straight cubics."""
    corners = np.array([[3, 4], [3 + length, 4], [3 + length, 4 + thickness], [3, 4 + thickness]], np.float32)
    after = np.roll(corners, -1, axis=0)
    return np.stack([corners, (2 * corners + after) / 3, (corners + 2 * after) / 3], axis=1).reshape(1, 12, 2)


def test_following_the_gradient_widens_a_sliver_and_leaves_what_is_wider():
    assert not sliver_gradient(strip(0.6), 1.0, SIZE).any()
    points = strip(0.2)
    gradient = sliver_gradient(points, 3.0, SIZE)
    assert np.allclose(gradient, 3.0 * sliver_gradient(points, 1.0, SIZE))
    assert np.allclose(gradient.sum(axis=1), 0.0, atol=1e-4), "it moves nothing as a whole"
    for _ in range(200):
        points = points - 0.01 * sliver_gradient(points, 1.0, SIZE)
    top, bottom = points[0, 1:3, 1], points[0, 7:9, 1]
    assert (bottom - top > 0.34).all()
    assert not sliver_gradient(np.zeros((1, 6, 2), np.float32), 1.0, SIZE).any()


def joined(*corners: tuple[float, float]) -> np.ndarray:
    """(1, 3N, 2): a ring of straight cubics."""
    start = np.array(corners, np.float32)
    after = np.roll(start, -1, axis=0)
    return np.stack([start, (2 * start + after) / 3, (start + 2 * after) / 3], axis=1).reshape(1, -1, 2)


def blunted(
    points: np.ndarray,
    ends: np.ndarray | None = None,
    mode: Mode = Mode.CLOSED,
    turns: float = 1.0,
    slivers: float = 1.0,
) -> np.ndarray:
    """The gradient of both penalties with these weights as the engine finds it, in a step that moves nothing."""
    n, found = len(points), np.empty(points.shape, np.float32)
    white, one = np.ones((SIZE[1], SIZE[0], 3), np.float32), np.ones(n, np.float32)
    scene = EngineScene(mode, *SIZE, points.astype(np.float32), np.ones((n, 3), np.float32), one, one, (1, 1, 1), ends)
    blunting = Blunting(
        turns, slivers, 1.0, SPIKE_TURN, LEAST_ARM, THINNEST, OPPOSITE, EDGES, HELD, 0, address_of(found)
    )
    training = Training(white, OptimiserState.zeros_for(scene.points), Rates(0.0, 0.0, 0.0, 0.0), blunting=blunting)
    with closing(CpuEngine(2)) as engine:
        engine.step(scene, RasterSettings(), training)
        assert blunting.left == HELD - 1
    return found


@pytest.mark.parametrize("turned", [False, True])
def test_a_gap_and_what_lies_within_the_shape_are_no_slivers(turned):
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
        assert not blunted(points, of_points, turns=0.0).any()
    shown = strip(0.2)
    assert sliver_gradient(shown, 1.0, SIZE).any()
    assert sliver_gradient(backwards(shown), 1.0, SIZE).any(), "whichever way it runs"


def backwards(ring: np.ndarray) -> np.ndarray:
    """The same ring (1, 3N, 2), run through the other way."""
    return np.roll(ring[:, ::-1], 1, axis=1).copy()


def test_what_lies_beside_the_canvas_does_not_count():
    inside, beside = strip(0.2), strip(0.2) + np.array([0, 20], np.float32)
    for found in (partial(sliver_gradient, weight=1.0, size=SIZE), blunted):
        assert found(inside).any()
        assert not found(beside).any()
    tip = joined((3, 4), (15, 4.5), (3, 5))
    assert spike_gradient(tip, Mode.CLOSED, 1.0, SIZE).any()
    assert not spike_gradient(tip - np.array([16, 0], np.float32), Mode.CLOSED, 1.0, SIZE).any()


@pytest.mark.parametrize(("mode", "ragged"), [(Mode.CLOSED, False), (Mode.CLOSED, True), (Mode.OPEN, False)])
def test_the_library_and_arrays_of_any_kind_agree(mode, ragged):
    generator = np.random.default_rng(7)
    points = (generator.random((50, 12 + (mode is Mode.OPEN), 2)) * [5.0, 1.0]).astype(np.float32)
    ends = np.sort(generator.integers(1, 5, (50, 2)), axis=1).astype(np.int32) if ragged else None
    parts = [blunted(points, ends, mode, 1.0, 0.0), blunted(points, ends, mode, 0.0, 1.0)]
    there, ends_there = torch.from_numpy(points), None if ends is None else torch.from_numpy(ends)
    for kind, places in ((points, ends), (there, ends_there)):
        assert np.allclose(parts[0], spike_gradient(kind, mode, 1.0, SIZE, places), rtol=1e-3, atol=1e-4)
        if mode is Mode.CLOSED:
            assert np.allclose(parts[1], sliver_gradient(kind, 1.0, SIZE, places), atol=1e-4)
    assert np.abs(parts[0]).max() > 1.0
    assert np.allclose(blunted(points, ends, mode, 2.0, 0.5), 2.0 * parts[0] + 0.5 * parts[1], atol=1e-5)
    assert parts[1].any() == (mode is Mode.CLOSED)
    if ragged:
        assert not sum(parts)[np.arange(12) >= 3 * ends[:, -1:]].any()


def test_a_penalty_is_found_anew_now_and_then_and_where_the_curves_are_others():
    recipe = settings(spike_penalty=1.0).recipe
    regulariser = Regulariser(recipe, Mode.CLOSED, SIZE, 4)
    course = {"progress": 0.9, "loss": 2.0}
    thin, wide = (torch.from_numpy(strip(thickness)) for thickness in (0.2, 0.6))
    first = regulariser.gradient(thin, None, **course)
    assert first.any()
    for _ in range(HELD - 1):
        assert regulariser.gradient(wide, None, **course) is first
    assert not regulariser.gradient(wide, None, **course).any()
    regulariser.forget()
    assert regulariser.gradient(thin, None, **course).any()
    assert Regulariser(recipe, Mode.CLOSED, SIZE, 4).gradient(thin, None, progress=0.0, loss=2.0) is None


def test_a_fit_with_the_penalty_has_fewer_slivers():
    small = np.random.default_rng(6).random((14, 20, 3), np.float32)
    target = small.repeat(4, 0).repeat(4, 1)
    plain, smooth = (fit(target, settings(curves=60, steps=150, spike_penalty=w)).scene for w in (0.0, 1.0))
    assert spikes_of(smooth).slivers < 0.6 * spikes_of(plain).slivers
