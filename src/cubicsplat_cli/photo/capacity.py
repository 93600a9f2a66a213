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


def seeded(
    count: int,
    image: Tensor,
    target: Tensor,
    settings: FitSettings,
    generator: torch.Generator,
    unit: float,
    weights: Tensor | None = None,
) -> Parameters:
    """New curves where the picture (H, W, C) is far from the target, weighted; unit: of the recipe's lengths, px."""
    recipe = settings.recipe
    centres = draw_pixels(error_density(image, target, recipe.seed_blur, recipe.seed_power, weights), count, generator)
    size = recipe.seed_size * unit
    if recipe.seeding == "blobs":
        blobs = find_blobs(centres, image, target, size, generator, weights)
        points, colour_logits = blob_points(blobs, settings, generator), blobs.colour_logits
    else:
        points, colour_logits = control_points(centres, size, settings, generator), colours_at(centres, target)
    return new_curves(points, colour_logits, recipe.half_width_size * unit, settings)


def in_front(fresh: Parameters, rest: Parameters) -> Parameters:
    """New curves before others, which may have more points, or several rings."""
    points, rest_points = int(fresh.points.shape[1]), int(rest.points.shape[1])
    if rest.ring_ends is None and points == rest_points:
        return fresh.joined(rest)
    room, rings = max(points, rest_points), 1 if rest.ring_ends is None else int(rest.ring_ends.shape[1])
    return fresh.with_room(room, rings).joined(rest.with_room(room, rings))


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
    frozen: int = 0,
) -> tuple[Parameters, OptimiserState, int]:
    """Replaces the least important `fraction` of the curves; new ones go to the front, their optimiser state is empty.

    All tensors are on one device, where the work is done; the random numbers are drawn on the CPU, to be the same for
    every device. weights (H, W): of the pixels. frozen: how many of the last curves stay. Returns the new parameters
    and state, and how many were replaced.
    """
    free = parameters.curves - frozen
    count = int(free * fraction)
    if count == 0:
        return parameters, state, 0
    order = importance[:free].argsort()[count:].sort().values
    keep = torch.cat((order, torch.arange(free, parameters.curves, device=order.device)))
    height, width, _ = target.shape
    unit = settings.recipe.unit(width, height, parameters.curves) * spread_of(weights) ** 0.5
    fresh = seeded(count, image, target, settings, generator, unit, weights)
    after = in_front(fresh, parameters.chosen(keep))
    empty = OptimiserState.zeros(count, after.points.shape[1]).to(target.device)
    return after, empty.joined(state.chosen(keep)), count
