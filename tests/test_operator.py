"""The engines as a torch operator: autograd with any loss, and torch's own checks of the operator."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
import reference
import torch
from conftest import rest_slow
from engines import compared, outliers, packed
from scenes import PAPER, TENSORS, in_double, random_scene, random_target

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.operator import render, render_op
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import Mode


def _loss(image, target):
    """Neither squared nor pixelwise: absolute differences of neighbouring pixels too."""
    error = image - target
    return error.abs().sqrt().sum() + (error[1:] - error[:-1]).abs().sum()


@pytest.mark.parametrize("background", [PAPER, None])
@pytest.mark.parametrize("mode", list(Mode))
def test_gradients_of_any_loss(mode, background):
    scene = random_scene(mode, 8, 3, 33, 29, 1, background=background)
    target = random_target(scene) * 0.5 + 2.0  # away from the kinks of the loss
    settings = RasterSettings("relaxed", 2.0, 8)
    grads = []
    for leaves, draw in (
        (in_double(scene, True), reference.render),
        (replace(scene, **{name: getattr(scene, name).clone().requires_grad_() for name in TENSORS}), render),
    ):
        _loss(draw(leaves, settings), target).backward()
        grads.append([getattr(leaves, name) for name in TENSORS])
    for name, want, got in zip(TENSORS, *grads, strict=True):
        if name not in compared(scene):
            continue
        scale = float(want.grad.abs().max())
        assert scale > 1e-2
        assert outliers(got.grad, want.grad, 5e-3 * scale) <= 0.02, name


REGISTERED = ("test_schema", "test_autograd_registration", "test_faketensor")
RING_ENDS = torch.tensor([[1], [2], [2]], dtype=torch.int32)


@pytest.mark.parametrize(
    ("asked", "ring_ends"), rest_slow(*product((REGISTERED, ("test_aot_dispatch_dynamic",)), (RING_ENDS, None)))
)
def test_torch_accepts_the_operator(asked, ring_ends):
    scene = random_scene(Mode.OPEN, 3, 2, 20, 18, background=PAPER)
    tensors = [getattr(scene, name).clone().requires_grad_() for name in TENSORS]
    arguments = (*tensors, *[None] * 5, ring_ends, [0, 20, 18], list(PAPER), [0, 8, 0], [1.5, 0.0])
    results = torch.library.opcheck(render_op, arguments, test_utils=asked)
    assert set(results.values()) == {"SUCCESS"}


def test_a_non_finite_point_is_named():
    scene = random_scene(Mode.CLOSED, 3, 2, background=PAPER)
    scene.points[1, 2, 0] = float("nan")
    with pytest.raises(InputError, match="points"):
        render(scene)


def test_every_setting_reaches_the_engine():
    scene = random_scene(Mode.CLOSED, 6, 3, 60, 50, 2, background=PAPER)
    engine = CpuEngine(1)
    for settings in (
        RasterSettings("exact", 2.0, 16),
        RasterSettings("relaxed", 2.0, 64, 0.5, subdivide=True),
        RasterSettings("relaxed", 3.0, 48, 0.3),
    ):
        assert torch.equal(render(scene, settings), engine.render(packed(scene), settings))
    assert torch.equal(render(scene), engine.render(packed(scene), RasterSettings()))


def test_doubles_get_double_gradients():
    scene = in_double(random_scene(Mode.CLOSED, 3, 2, background=PAPER), requires_grad=True)
    render(scene).sum().backward()
    assert scene.points.grad.dtype == torch.float64
    assert scene.points.grad.any()
