"""New curves: small discs or short strokes with the picture's colour at their place."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from cubicsplat_cli.photo.fills import LinearFills, middles_of
from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.settings import FitSettings, Mode, Recipe

COLOUR_MARGIN = 0.02  # keeps the logits of black and white within reach of the optimiser
OPAQUE_LOGIT = 9.0  # an opacity of 0.99988


def new_curves(points: Tensor, colour_logits: Tensor, half_width: float, settings: FitSettings) -> Parameters:
    """Curves at control points (n, K, 2), with colour logits (n, 3), a half-width in px and the recipe's opacity."""
    recipe = settings.recipe

    def all_alike(value: float) -> Tensor:
        return torch.full((points.shape[0],), value, device=points.device)

    return Parameters(
        points.contiguous(),
        colour_logits.contiguous(),
        all_alike(first_opacity(recipe)),
        all_alike(half_width),
        all_alike(recipe.soft_edge),
        fills=LinearFills.flat(colour_logits, farthest(points)) if settings.fill == "linear" else None,
    )


def first_opacity(recipe: Recipe) -> float:
    """The logit of a new curve's opacity."""
    if recipe.opaque:
        return OPAQUE_LOGIT
    shared = recipe.shared_opacity
    return math.log(shared / (1.0 - shared)) if shared > 0.0 else recipe.opacity_logit


def farthest(points: Tensor, ring_ends: Tensor | None = None) -> Tensor:
    """(n, 2) px: of each curve's control points (n, K, 2) one farthest from their mean, seen from there."""
    away = points - middles_of(points, ring_ends).unsqueeze(1)
    if ring_ends is not None:
        away = away * (torch.arange(points.shape[1], device=points.device) < 3 * ring_ends[:, -1:]).unsqueeze(-1)
    index = away.square().sum(-1).argmax(1)
    return away[torch.arange(len(points), device=points.device), index]


def control_points(centres: Tensor, radius: float, settings: FitSettings, generator: torch.Generator) -> Tensor:
    """Control points (n, K, 2) of n new curves at `centres` (n, 2) px: circles of `radius` px, or bent strokes."""
    n = centres.shape[0]
    if settings.mode is Mode.CLOSED:
        return centres[:, None, :] + radius * random_ring(n, 3 * settings.segments, generator).to(centres.device)
    k = 3 * settings.segments + 1
    angle = torch.rand(n, 1, generator=generator) * 2 * math.pi
    direction = torch.stack([angle.cos(), angle.sin()], -1)
    along = torch.linspace(-1.5, 1.5, k)[None, :, None] * direction
    wobble = 0.15 * torch.randn(n, k, 2, generator=generator)
    return centres[:, None, :] + radius * (along + wobble).to(centres.device)


def random_ring(n: int, k: int, generator: torch.Generator) -> Tensor:
    """(n, k, 2): k points evenly on the unit circle, turned by a random angle for each of the n; on the CPU."""
    turn = torch.rand(n, 1, generator=generator) * 2 * math.pi
    angle = torch.arange(k) / k * 2 * math.pi + turn
    return torch.stack([angle.cos(), angle.sin()], -1)


def colours_at(centres: Tensor, target: Tensor) -> Tensor:
    """Logits (n, 3) of the target's colour (H, W, C) at the centres; straight colour where it is premultiplied."""
    height, width, _ = target.shape
    x = centres[:, 0].long().clamp(0, width - 1)
    y = centres[:, 1].long().clamp(0, height - 1)
    return colour_to_logits(target[y, x])


def colour_to_logits(colours: Tensor) -> Tensor:
    """Logits (n, 3) of colours (n, 3), or of the straight colours of premultiplied (n, 4)."""
    if colours.shape[-1] == 4:
        colours = colours[:, :3] / colours[:, 3:].clamp(min=1e-3)
    return torch.logit(colours.clamp(COLOUR_MARGIN, 1 - COLOUR_MARGIN))


def random_centres(count: int, target: Tensor, generator: torch.Generator, weights: Tensor | None = None) -> Tensor:
    """Random places (n, 2) px, by the pixels' weights; where there is transparency, only where there is something."""
    height, width, channels = target.shape
    if channels == 4 or weights is not None:
        there = target[..., 3].clamp(min=1e-6) if channels == 4 else torch.ones_like(target[..., 0])
        return draw_pixels(there if weights is None else there * weights, count, generator)
    return torch.rand(count, 2, generator=generator) * torch.tensor([width, height], dtype=torch.float32)


def draw_pixels(density: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Centres (count, 2) of pixels drawn, with replacement, in proportion to a density (H, W) >= 0."""
    total = density.reshape(-1).cumsum(0, dtype=torch.float64)
    share = torch.rand(count, dtype=torch.float64, generator=generator).to(density.device)
    last = density.numel() - 1
    pixel = torch.searchsorted(total, share * total[-1], right=True).clamp(max=last)
    # Without any density all are alike; decided without a look at the value, which would wait for a GPU.
    pixel = torch.where(total[-1] > 0, pixel, (share * density.numel()).long().clamp(max=last))
    width = density.shape[1]
    return torch.stack([pixel % width, pixel // width], -1).float() + 0.5
