"""Capacity reallocation: curves that matter least are removed and seeded anew where the error is high."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.photo.blobs import blob_points, find_blobs
from cubicsplat_cli.photo.guide import spread_of
from cubicsplat_cli.photo.initial import colours_at, control_points, draw_pixels, new_curves
from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.photo.smoothing import box_mean
from cubicsplat_cli.raster.engine import OptimiserState
from cubicsplat_cli.scene.arrays import Array, as_numpy, namespace
from cubicsplat_cli.settings import FitSettings, Mode


def gini(importance: Array) -> float:
    """Gini coefficient (0: all equal, towards 1: few carry everything) of the positive parts of (N,) values."""
    values = np.sort(np.maximum(as_numpy(importance).astype(np.float64), 0.0))
    total = float(values.sum())
    n = len(values)
    if n == 0 or total <= 0:
        return 0.0
    ranks = np.arange(1, n + 1)
    return float((2 * ranks - n - 1) @ values) / (n * total)


def error_density(image: Array, target: Array, blur: int, power: float, weights: Array | None = None) -> Array:
    """Where new curves are wanted: the squared error, weighted, blurred by a box of `blur` px, to a power; (H, W)."""
    difference = image - target
    difference *= difference
    error = sum(difference[..., channel] for channel in range(target.shape[2]))  # a sum over an axis takes longer
    return box_mean(error if weights is None else error * weights, blur) ** power


def seeded(
    count: int,
    image: Array,
    target: Array,
    settings: FitSettings,
    generator: np.random.Generator,
    unit: float,
    weights: Array | None = None,
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


def with_room_for_seeds(parameters: Parameters, settings: FitSettings) -> Parameters:
    """The curves with room for as many points each as new curves have; the same object where there is enough."""
    needed = 3 * settings.segments + (settings.mode is Mode.OPEN)
    if parameters.points.shape[1] >= needed:
        return parameters
    return parameters.with_room(needed, 1 if parameters.ring_ends is None else int(parameters.ring_ends.shape[1]))


def reallocate(
    parameters: Parameters,
    state: OptimiserState,
    importance: Array,
    image: Array,
    target: Array,
    fraction: float,
    settings: FitSettings,
    generator: np.random.Generator,
    weights: Array | None = None,
    frozen: int = 0,
) -> tuple[Parameters, OptimiserState, int]:
    """Replaces the least important `fraction` of the curves; new ones go to the front, their optimiser state is empty.

    All arrays are in one place, where the work is done; the random numbers are drawn on the host, to be the same for
    every device. weights (H, W): of the pixels. frozen: how many of the last curves stay. Returns the new parameters
    and state, and how many were replaced.
    """
    free = parameters.curves - frozen
    count = int(free * fraction)
    if count == 0:
        return parameters, state, 0
    xp = namespace(importance)
    order = xp.sort(xp.argsort(importance[:free])[count:])
    keep = xp.concat((order, xp.arange(free, parameters.curves, device=order.device)))
    height, width, _ = target.shape
    unit = settings.recipe.unit(width, height, parameters.curves) * spread_of(weights) ** 0.5
    fresh = seeded(count, image, target, settings, generator, unit, weights)
    after = in_front(fresh, parameters.chosen(keep))
    empty = OptimiserState.zeros_for(after.points[:count])
    return after, empty.joined(state.chosen(keep)), count
