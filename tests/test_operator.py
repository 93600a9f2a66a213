"""The engines as a torch operator: autograd with any loss, and torch's own checks of the operator."""

from __future__ import annotations

import pytest
import torch
from engines import compared, outliers
from scenes import PAPER, as_arguments, in_double, random_scene, random_target

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.raster import RasterSettings, reference, render
from cubicsplat_cli.raster.operator import render_op
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
    for leaves, renderer in ((in_double(scene, True), reference.render), (scene, render)):
        tensors, keywords = as_arguments(leaves)
        if renderer is render:
            tensors = tuple(t.clone().requires_grad_() for t in tensors)
        _loss(renderer(*tensors, **keywords, settings=settings), target).backward()
        grads.append(tensors)
    for name, want, got in zip(("points", "colours", "opacities", "half_widths"), *grads, strict=True):
        if name not in compared(scene):
            continue
        scale = float(want.grad.abs().max())
        assert scale > 1e-2
        assert outliers(got.grad, want.grad, 5e-3 * scale) <= 0.02, name


def test_torch_accepts_the_operator():
    scene = random_scene(Mode.OPEN, 3, 2, 20, 18, background=PAPER)
    tensors = [getattr(scene, n).clone().requires_grad_() for n in ("points", "colours", "opacities", "half_widths")]
    results = torch.library.opcheck(render_op, (*tensors, False, 20, 18, list(PAPER), False, 1.5, 8, 0.0))
    assert set(results.values()) == {"SUCCESS"}


def test_a_non_finite_point_is_named():
    scene = random_scene(Mode.CLOSED, 3, 2, background=PAPER)
    scene.points[1, 2, 0] = float("nan")
    tensors, keywords = as_arguments(scene)
    with pytest.raises(InputError, match="points"):
        render(*tensors, **keywords, settings=RasterSettings())
