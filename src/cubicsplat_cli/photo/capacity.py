"""Capacity reallocation: curves that matter least are removed and seeded anew where the error is high."""

from __future__ import annotations

import torch
from torch import Tensor

from cubicsplat_cli.photo.blobs import blob_points, find_blobs
from cubicsplat_cli.photo.guide import spread_of
from cubicsplat_cli.photo.initial import colours_at, control_points, draw_pixels, new_curves
from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.photo.smoothing import box_mean
from cubicsplat_cli.raster.engine import OptimiserState
from cubicsplat_cli.settings import FitSettings


def gini(importance: Tensor) -> float:
    """Gini coefficient (0: all equal, towards 1: few carry everything) of the positive parts of (N,) values."""
    values = importance.double().clamp(min=0).sort().values
    total = float(values.sum())
    n = values.numel()
    if n == 0 or total <= 0:
        return 0.0
    ranks = torch.arange(1, n + 1, dtype=torch.float64)
    return float((2 * ranks - n - 1) @ values) / (n * total)


def error_density(image: Tensor, target: Tensor, blur: int, power: float, weights: Tensor | None = None) -> Tensor:
    """Where new curves are wanted: the squared error, weighted, blurred by a box of `blur` px, to a power; (H, W)."""
    difference = image - target
    error = torch.zeros_like(difference[..., 0])
    for channel in difference.unbind(-1):  # torch's sum over an axis of three takes longer
        error.addcmul_(channel, channel)
    return box_mean(error if weights is None else error.mul_(weights), blur) ** power


def reallocate(
    parameters: Parameters,
    state: OptimiserState,
    importance: Tensor,
    image: Tensor,
    target: Tensor,
    fraction: float,
    settings: FitSettings,
    generator: torch.Generator,
    weights: Tensor | None = None,
) -> tuple[Parameters, OptimiserState, int]:
    """Replaces the least important `fraction` of the curves; new ones go to the front, their optimiser state is empty.

    All tensors are on one device, where the work is done; the random numbers are drawn on the CPU, to be the same for
    every device. weights (H, W): of the pixels. Returns the new parameters and state, and how many were
    replaced.
    """
    count = int(parameters.curves * fraction)
    if count == 0:
        return parameters, state, 0
    recipe = settings.recipe
    keep = importance.argsort()[count:].sort().values
    centres = draw_pixels(error_density(image, target, recipe.seed_blur, recipe.seed_power, weights), count, generator)
    height, width, _ = target.shape
    unit = recipe.unit(width, height, parameters.curves) * spread_of(weights) ** 0.5
    size = recipe.seed_size * unit
    if recipe.seeding == "blobs":
        blobs = find_blobs(centres, image, target, size, generator, weights)
        points, colour_logits = blob_points(blobs, settings, generator), blobs.colour_logits
    else:
        points, colour_logits = control_points(centres, size, settings, generator), colours_at(centres, target)
    fresh = new_curves(points, colour_logits, recipe.half_width_size * unit, settings)
    empty = OptimiserState.zeros(count, fresh.points.shape[1]).to(target.device)
    return fresh.joined(parameters.chosen(keep)), empty.joined(state.chosen(keep)), count
