"""What new curves look like: small discs or short strokes with the picture's colour at their place."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.photo.fills import LinearFills, middles_of
from cubicsplat_cli.photo.state import Background, FitCurves
from cubicsplat_cli.scene.arrays import Array, contiguous, like, logit, namespace
from cubicsplat_cli.settings import FitSettings, Mode, Recipe

COLOUR_MARGIN = 0.02  # keeps the logits of black and white within reach of the optimiser
ABOUT_FARTHEST = 0.999  # of the squared distance
OPAQUE_LOGIT = 9.0  # an opacity of 0.99988


def new_curves(
    points: Array, colours: Array, half_width: float, settings: FitSettings, size: tuple[int, int],
    background: Background = None,
) -> FitCurves:  # fmt: skip
    """Curves with control points (n, K, 2), colours (n, 3) as logits, a half-width in px and the recipe's opacity.

    size: width and height of the canvas, px.
    """
    recipe, xp = settings.recipe, namespace(points)

    def all_alike(value: float) -> Array:
        return xp.full((points.shape[0],), value, dtype=points.dtype, device=points.device)

    return FitCurves(
        settings.mode, *size, contiguous(points), contiguous(colours), all_alike(first_opacity(recipe)),
        all_alike(half_width), background,
        edge_widths=all_alike(recipe.soft_edge) if recipe.edges == "soft" else None,
        fills=LinearFills.flat(colours, farthest(points)) if settings.fill == "linear" else None,
    )  # fmt: skip


def first_opacity(recipe: Recipe) -> float:
    """The logit of a new curve's opacity."""
    if recipe.opaque:
        return OPAQUE_LOGIT
    shared = recipe.shared_opacity
    return math.log(shared / (1.0 - shared)) if shared > 0.0 else recipe.opacity_logit


def farthest(points: Array, ring_ends: Array | None = None) -> Array:
    """(n, 2) px: of each curve's control points (n, K, 2) the first that is about farthest from their mean, seen from
    there. Not the very farthest: on a circle rounding would choose it.
    """
    xp, (n, k, _), device = namespace(points), points.shape, points.device
    away = points - middles_of(points, ring_ends)[:, None]
    if ring_ends is not None:
        away = away * (xp.arange(k, device=device) < 3 * ring_ends[:, -1:])[..., None]
    squared = xp.sum(away * away, axis=-1)
    about = squared >= ABOUT_FARTHEST * xp.max(squared, axis=1, keepdims=True)
    index = xp.argmax(xp.astype(about, xp.float32), axis=1)
    return away[xp.arange(n, device=device), index]


def control_points(centres: Array, radius: float, settings: FitSettings, generator: np.random.Generator) -> Array:
    """Control points (n, K, 2) of n new curves at `centres` (n, 2) px: circles of `radius` px, or bent strokes."""
    n = centres.shape[0]
    if settings.mode is Mode.CLOSED:
        return centres[:, None, :] + like(centres, radius * random_ring(n, 3 * settings.segments, generator))
    k = 3 * settings.segments + 1
    angle = generator.random((n, 1)) * 2 * math.pi
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    along = np.linspace(-1.5, 1.5, k)[None, :, None] * direction
    wobble = 0.15 * generator.standard_normal((n, k, 2))
    return centres[:, None, :] + like(centres, radius * (along + wobble))


def random_ring(n: int, k: int, generator: np.random.Generator) -> np.ndarray:
    """(n, k, 2): k points evenly on the unit circle, turned by a random angle for each of the n."""
    turn = generator.random((n, 1)) * 2 * math.pi
    angle = np.arange(k) / k * 2 * math.pi + turn
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def colours_at(centres: Array, target: Array) -> Array:
    """Logits (n, 3) of the target's colour (H, W, C) at the centres; straight colour where it is premultiplied."""
    xp, (height, width, _) = namespace(centres), target.shape
    x = xp.astype(xp.clip(centres[:, 0], 0.0, width - 1.0), xp.int64)
    y = xp.astype(xp.clip(centres[:, 1], 0.0, height - 1.0), xp.int64)
    return colour_to_logits(target[y, x])


def colour_to_logits(colours: Array) -> Array:
    """Logits (n, 3) of colours (n, 3), or of the straight colours of premultiplied (n, 4)."""
    xp = namespace(colours)
    if colours.shape[-1] == 4:
        colours = colours[:, :3] / xp.clip(colours[:, 3:], min=1e-3)
    return logit(xp.clip(colours, COLOUR_MARGIN, 1.0 - COLOUR_MARGIN))
