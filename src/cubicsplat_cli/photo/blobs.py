"""New curves from the picture itself: ellipses over connected patches in which the fit errs in one way.

LIVE (Ma et al., CVPR 2022) starts its paths at connected components of the error; here the patch around a drawn pixel
is described by the moments of its residual, which needs no labelling and treats all pixels at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from cubicsplat_cli.photo.initial import colour_to_logits, random_ring
from cubicsplat_cli.photo.smoothing import box_mean
from cubicsplat_cli.settings import FitSettings, Mode

RESIDUAL_BLUR = 5  # px; a single pixel's residual is noise
GRID = 12  # samples of a patch on each side of its centre
GRID_REACH = 2.0  # of the window's sigma
SIZE_SPREAD = 0.6  # of the logarithm of the window's sigma, so that all sizes are tried
LEAST_SIGMA = 1.5  # px
LEAST_VARIANCE = 0.5  # px^2, added: no patch is thinner than a pixel or so
# A uniform ellipse has semi-axes of 2 standard deviations; the window cuts patches off, hence a little less.
AXES = 1.6
STROKE_WOBBLE = 0.3  # px


@dataclass(frozen=True)
class Blobs:
    """n patches: centres (n, 2) px, semi-axes (n, 2, 2) px as columns, the shorter first, and colour logits (n, 3)."""

    centres: Tensor
    axes: Tensor
    colour_logits: Tensor


def find_blobs(
    seeds: Tensor, image: Tensor, target: Tensor, sigma: float, generator: torch.Generator,
    weights_of_pixels: Tensor | None = None,
) -> Blobs:  # fmt: skip
    """Patches around seeds (n, 2) px where image and target (H, W, C) differ as they do at the seed.

    A pixel counts by how much its residual points the way of the seed's, squared, times a Gaussian window of about
    `sigma` px, times its own weight (H, W). Colours are the target's mean over the patch.
    """
    height, width = target.shape[:2]
    spread = torch.exp(SIZE_SPREAD * torch.randn(len(seeds), generator=generator)).to(seeds.device)
    windows = (sigma * spread).clamp(LEAST_SIGMA, 0.1 * min(width, height) + LEAST_SIGMA)
    steps = torch.arange(-GRID, GRID + 1, device=seeds.device) * (GRID_REACH / GRID)
    offsets = torch.stack(torch.meshgrid(steps, steps, indexing="xy"), -1).reshape(1, -1, 2)
    places = seeds[:, None] + offsets * windows[:, None, None]
    x, y = places.floor().long().unbind(-1)
    on_canvas = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = x.clamp(0, width - 1), y.clamp(0, height - 1)
    residual = _blurred(target - image)
    likeness = _likeness(residual[y, x], residual[seeds[:, 1].long(), seeds[:, 0].long()])
    window = on_canvas * torch.exp(-0.5 * offsets.square().sum(-1))
    if weights_of_pixels is not None:
        window = window * (weights_of_pixels[y, x] + 1e-6)  # a seed drawn beside all that matters keeps its patch
    weights = window * likeness.square()
    # A seed drawn beside an error, in its blur, has no residual of its own: then the window is the patch.
    weights = torch.where(weights.sum(1, keepdim=True) > 1e-3, weights, window)
    weights = weights / weights.sum(1, keepdim=True)
    centres = (weights[..., None] * places).sum(1)
    away = places - centres[:, None]
    covariance = torch.einsum("np,npi,npj->nij", weights, away, away)
    colours = (weights[..., None] * target[y, x]).sum(1)
    return Blobs(centres, AXES * _principal_axes(covariance), colour_to_logits(colours))


def blob_points(blobs: Blobs, settings: FitSettings, generator: torch.Generator) -> Tensor:
    """Control points (n, K, 2): rings around the patches, or strokes along their longer axes."""
    n, device = len(blobs.centres), blobs.centres.device
    if settings.mode is Mode.CLOSED:
        ring = random_ring(n, 3 * settings.segments, generator).to(device)
        return (blobs.centres[:, None] + ring @ blobs.axes.transpose(1, 2)).contiguous()
    k = 3 * settings.segments + 1
    along = torch.linspace(-1, 1, k, device=device)[None, :, None] * blobs.axes[:, None, :, 1]
    wobble = STROKE_WOBBLE * torch.randn(n, k, 2, generator=generator).to(device)
    return (blobs.centres[:, None] + along + wobble).contiguous()


def _principal_axes(covariance: Tensor) -> Tensor:
    """Standard deviations along the principal axes of (n, 2, 2), times the axes, as columns; the shorter first.

    In closed form: a solver's start on a GPU takes longer than the whole reallocation.
    """
    xx, xy, yy = covariance[:, 0, 0] + LEAST_VARIANCE, covariance[:, 0, 1], covariance[:, 1, 1] + LEAST_VARIANCE
    middle, half_range = 0.5 * (xx + yy), torch.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * torch.atan2(xy, 0.5 * (xx - yy))  # of the longer axis
    longer = torch.stack([angle.cos(), angle.sin()], -1) * (middle + half_range).sqrt()[:, None]
    variance = (middle - half_range).clamp(min=LEAST_VARIANCE)  # never less, but for rounding
    shorter = torch.stack([-angle.sin(), angle.cos()], -1) * variance.sqrt()[:, None]
    return torch.stack([shorter, longer], -1)


def _blurred(residual: Tensor) -> Tensor:
    if residual.shape[-1] == 4:
        # Over black and over white, as the loss sees it: black on nothing differs in alpha alone.
        residual = torch.cat([residual[..., :3], residual[..., :3] - residual[..., 3:]], -1)
    return box_mean(residual.permute(2, 0, 1).contiguous(), RESIDUAL_BLUR).permute(1, 2, 0)


def _likeness(residuals: Tensor, own: Tensor) -> Tensor:
    """Share of the seed's residual (n, 3) that each pixel's (n, p, 3) has along it, in [0, 1]."""
    along = (residuals * own[:, None]).sum(-1)
    return (along / own.square().sum(-1, keepdim=True).clamp(min=1e-8)).clamp(0, 1)
