"""The pieces of a fit: patches of like residual, colours for 8-bit renderers, the non-crossing penalty, threads."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scenes import PAPER, random_scene, straight

from cubicsplat_cli.photo.geometric import LEAST_CROSSING, _handles, crossing_gradient, segments_of
from cubicsplat_cli.photo.seeding import LEAST_VARIANCE, _principal_axes, blob_points, find_blobs
from cubicsplat_cli.photo.state import BestCheckpoint, FitCurves, snapped
from cubicsplat_cli.scene.arrays import one_torch_thread
from cubicsplat_cli.settings import FitSettings, Mode


def _ellipse_picture(cx, cy, rx, ry):
    """A grey picture with a red ellipse, and the grey picture alone."""
    y, x = torch.meshgrid(torch.arange(80) + 0.5, torch.arange(100) + 0.5, indexing="ij")
    plain = torch.full((80, 100, 3), 0.5)
    target = plain.clone()
    target[((x - cx) / rx) ** 2 + ((y - cy) / ry) ** 2 <= 1] = torch.tensor([0.9, 0.1, 0.1])
    return plain, target


def test_a_blob_takes_place_size_direction_and_colour_of_its_patch():
    plain, target = _ellipse_picture(50, 40, 12, 5)
    seeds = torch.tensor([[46.5, 40.5]] * 40)
    centres, axes, colours = find_blobs(seeds, plain, target, 12.0, np.random.default_rng(1))
    centre = centres.median(0).values
    assert torch.allclose(centre, torch.tensor([50.0, 40.0]), atol=2.0)
    short, long = axes.norm(dim=1).median(0).values
    assert 3.0 < float(short) < 6.5
    assert 7.0 < float(long) < 14.0
    directions = axes[:, :, 1] / axes[:, :, 1].norm(dim=1, keepdim=True)
    assert float(directions[:, 0].abs().median()) > 0.95
    assert torch.allclose(colours.sigmoid().median(0).values, torch.tensor([0.9, 0.1, 0.1]), atol=0.05)


@given(st.lists(st.tuples(*[st.floats(-50, 50, width=32)] * 3), min_size=1, max_size=8))
def test_principal_axes_are_those_of_the_covariance(factors):
    root = torch.tensor([[[a, 0.0], [b, c]] for a, b, c in factors], dtype=torch.float64)
    covariance = root @ root.transpose(1, 2)
    axes = _principal_axes(covariance)
    widened = covariance + LEAST_VARIANCE * torch.eye(2)
    assert torch.allclose(axes @ axes.transpose(1, 2), widened, atol=1e-9, rtol=1e-9)
    assert (axes[:, :, 0] * axes[:, :, 1]).sum(1).abs().max() < 1e-9 * (1 + widened.abs().max())
    assert (axes[:, :, 0].norm(dim=1) <= axes[:, :, 1].norm(dim=1) + 1e-9).all()


@pytest.mark.parametrize("mode", list(Mode))
def test_blob_points_lie_around_the_patch(mode):
    plain, target = _ellipse_picture(50, 40, 12, 5)
    generator = np.random.default_rng(2)
    centres, axes, _ = find_blobs(torch.tensor([[50.5, 40.5]] * 5), plain, target, 8.0, generator)
    settings = FitSettings(mode=mode, segments=3)
    points = blob_points(centres, axes, settings, generator)
    assert points.shape == (5, 9 if mode is Mode.CLOSED else 10, 2)
    assert torch.allclose(points.mean(1), centres, atol=0.5)
    assert float((points - centres[:, None]).norm(dim=-1).max()) < 30.0


def test_blobs_of_a_perfect_picture_and_at_the_border_are_finite():
    plain, _ = _ellipse_picture(50, 40, 12, 5)
    seeds = torch.tensor([[0.5, 0.5], [99.5, 79.5], [50.5, 0.5]])
    for value in find_blobs(seeds, plain, plain, 6.0, np.random.default_rng(0)):
        assert torch.isfinite(value).all()


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=20))
def test_snapped_values_survive_truncation_to_8_bits(values):
    scene = random_scene(Mode.CLOSED, len(values), 2, background=PAPER)
    scene.colours = torch.tensor([[c, 1 - c, c * c] for c, _ in values])
    scene.opacities = torch.tensor([o for _, o in values])
    settled = snapped(scene)
    levels = (scene.opacities.double() * 255).round()
    # What cairo does: the opacity to 16 bits, then the high byte; the premultiplied colour likewise.
    written = (settled.opacities.double() * 1000).round() / 1000
    assert torch.equal((written * 65535 + 1e-6).floor().div(256).floor(), levels)
    ideal = scene.colours.double() * levels[:, None]
    kept = (settled.colours.double() * levels[:, None] + 1e-4).floor()
    assert float((kept - ideal).abs().max()) <= 1.0
    assert float((settled.colours * 255 - (settled.colours * 255).round()).abs().max()) < 1e-3


def test_snapped_colours_are_not_darker_on_average():
    generator = torch.Generator().manual_seed(0)
    scene = random_scene(Mode.CLOSED, 2000, 2, background=PAPER)
    scene.colours = torch.rand(2000, 3, generator=generator)
    scene.opacities = 0.1 + 0.9 * torch.rand(2000, generator=generator)
    levels = (scene.opacities.double() * 255).round()[:, None]
    plain = ((scene.colours.double() * 255).round() / 255 * levels).floor() - scene.colours.double() * levels
    settled = (snapped(scene).colours.double() * levels + 1e-4).floor() - scene.colours.double() * levels
    assert float(plain.mean()) < -0.4
    assert abs(float(settled.mean())) < 0.05


def crossing_penalty(points, mode, ring_ends=None):
    """What `crossing_gradient` is the gradient of, with a weight of 1."""
    index, _, after, real = segments_of(points, mode, ring_ends)
    first, last, side = _handles(points, index, after)
    product = first[..., 0] * last[..., 1] - first[..., 1] * last[..., 0]
    sine = product / (first.norm(dim=-1) * last.norm(dim=-1)).clip(LEAST_CROSSING)
    return ((side * sine).clip(0.0) * real).sum() / real.sum()


def test_crossing_penalty_knows_a_crossing_cubic():
    fair = torch.tensor([[[0.0, 0.0], [0.0, 10.0], [10.0, 10.0], [10.0, 0.0]]])
    crossed = torch.tensor([[[0.0, 0.0], [10.0, 10.0], [0.0, 10.0], [10.0, 3.0]]])
    assert float(crossing_penalty(fair, Mode.OPEN)) == 0.0
    assert float(crossing_penalty(crossed, Mode.OPEN)) > 0.5
    gradient = crossing_gradient(crossed, Mode.OPEN, 2.0)
    assert float(crossing_penalty(crossed - 0.5 * gradient, Mode.OPEN)) < float(crossing_penalty(crossed, Mode.OPEN))
    assert not crossing_gradient(fair, Mode.OPEN, 2.0).any()


def test_crossing_penalty_of_straight_rings_is_zero():
    square = straight([(0, 0), (10, 0), (10, 10), (0, 10)], closed=True)[None]
    assert float(crossing_penalty(square, Mode.CLOSED)) == pytest.approx(0.0, abs=1e-6)


def test_torch_threads_come_back():
    before = torch.get_num_threads()
    with pytest.raises(ZeroDivisionError), one_torch_thread():
        assert torch.get_num_threads() == 1
        raise ZeroDivisionError
    assert torch.get_num_threads() == before


@pytest.mark.parametrize("loss_of", [float, lambda value: torch.tensor(value, dtype=torch.float64)], ids=["cpu", "gpu"])
def test_the_best_curves_are_kept_as_they_were(loss_of):
    """Losses that are tensors, as on a GPU, are compared without being read."""
    best = BestCheckpoint()
    with pytest.raises(ValueError, match="no curves"):
        _ = best.curves
    shapes = ((2, 6, 2), (2, 3), (2,), (2,))
    curves = FitCurves(Mode.CLOSED, 9, 9, *(torch.zeros(shape) for shape in shapes))
    for i, loss in enumerate((5.0, 3.0, 4.0, float("nan"), 3.0, 2.0, 6.0)):
        for tensor in curves.arrays_by_name().values():
            tensor.fill_(i)
        best.consider(loss_of(loss), curves)
    assert best.loss == 2.0
    assert all(bool((t == 5).all()) for t in best.curves.arrays_by_name().values())
