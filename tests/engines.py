"""Comparing an engine with the reference, the same way for every engine and every test."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from scenes import PAPER, TENSORS, as_arguments, in_double
from torch import Tensor

from cubicsplat_cli.raster import reference
from cubicsplat_cli.raster.draw import scene_tensors
from cubicsplat_cli.raster.engine import SceneTensors
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode

PICTURE_TOLERANCE = 2e-4  # of a value in [0, 1], away from edges that rounding can put on the other side of a centre
GRADIENT_TOLERANCE = 2e-3  # of the largest gradient of its kind
FLIPPED = 0.004  # fraction of values that may differ more: signs and nearest edges that rounding decides
# What every engine is compared in.
SETTINGS = [
    RasterSettings("relaxed", 4.0, 6),
    RasterSettings("relaxed", 1.0, 12),
    RasterSettings("exact", 1.0, 24),
]
NAMES = [f"{s.coverage}-{s.edge_width:g}" for s in SETTINGS]
CASES = [(mode, background) for mode in Mode for background in (PAPER, None)]
CASE_NAMES = [f"{mode.value}-{'rgb' if background else 'rgba'}" for mode, background in CASES]


@dataclass
class Truth:
    """What the float64 reference says of a scene: picture, loss, gradients and importance."""

    image: Tensor
    loss: float
    gradients: dict[str, Tensor]


def truth(scene: Scene, settings: RasterSettings, target: Tensor) -> Truth:
    """Reference picture and the gradients of the squared error against `target`."""
    leaves = in_double(scene, requires_grad=True)
    tensors, keywords = as_arguments(leaves)
    image = reference.render(*tensors, **keywords, settings=settings)
    loss = reference.image_loss(image, target.double())
    loss.backward()
    given = {name: getattr(leaves, name) for name in TENSORS}
    gradients = {name: torch.zeros_like(t) if t.grad is None else t.grad for name, t in given.items()}
    return Truth(image.detach(), float(loss.detach()), gradients)


def packed(scene: Scene) -> SceneTensors:
    return scene_tensors(scene)


def outliers(got: Tensor, want: Tensor, tolerance: float) -> float:
    """Fraction of the values that differ by more than the tolerance."""
    if want.numel() == 0:
        return 0.0
    return float(((got.double() - want).abs() > tolerance).double().mean())


def compared(scene: Scene) -> list[str]:
    """Parameters whose gradients are compared: half-widths only where there are strokes."""
    return [name for name in TENSORS if name != "half_widths" or scene.mode is Mode.OPEN]
