"""New curves from the picture itself: ellipses over connected patches in which the fit errs in one way.

LIVE (Ma et al., CVPR 2022) starts its paths at connected components of the error; here the patch around a drawn pixel
is described by the moments of its residual, which needs no labelling and treats all pixels at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.photo.initial import colour_to_logits, random_ring
from cubicsplat_cli.scene.arrays import Array, contiguous, copied, like, namespace
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

    centres: Array
    axes: Array
    colour_logits: Array


def find_blobs(
    seeds: Array, image: Array, target: Array, sigma: float, generator: np.random.Generator,
    weights_of_pixels: Array | None = None,
) -> Blobs:  # fmt: skip
    """Patches around seeds (n, 2) px where image and target (H, W, C) differ as they do at the seed.

    A pixel counts by how much its residual points the way of the seed's, squared, times a Gaussian window of about
    `sigma` px, times its own weight (H, W). Colours are the target's mean over the patch.
    """
    xp, (height, width) = namespace(seeds), target.shape[:2]
    spread = np.exp(SIZE_SPREAD * generator.standard_normal(len(seeds)))
    windows = like(seeds, np.clip(sigma * spread, LEAST_SIGMA, 0.1 * min(width, height) + LEAST_SIGMA))
    steps = np.arange(-GRID, GRID + 1) * (GRID_REACH / GRID)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(1, -1, 2)
    places = seeds[:, None] + like(seeds, offsets) * windows[:, None, None]
    whole = xp.astype(xp.floor(places), xp.int64)
    x, y = whole[..., 0], whole[..., 1]
    on_canvas = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = xp.clip(x, 0, width - 1), xp.clip(y, 0, height - 1)
    residual, own = _blurred(target - image), xp.astype(seeds, xp.int64)
    likeness = _likeness(residual[y, x], residual[own[:, 1], own[:, 0]])
    window = on_canvas * like(seeds, np.exp(-0.5 * np.square(offsets).sum(axis=-1)))
    if weights_of_pixels is not None:
        window = window * (weights_of_pixels[y, x] + 1e-6)  # a seed drawn beside all that matters keeps its patch
    weights = window * likeness * likeness
    # A seed drawn beside an error, in its blur, has no residual of its own: then the window is the patch.
    weights = xp.where(xp.sum(weights, axis=1, keepdims=True) > 1e-3, weights, window)
    weights = weights / xp.sum(weights, axis=1, keepdims=True)
    centres = xp.sum(weights[..., None] * places, axis=1)
    away = places - centres[:, None]
    covariance = xp.permute_dims(weights[..., None] * away, (0, 2, 1)) @ away
    colours = xp.sum(weights[..., None] * target[y, x], axis=1)
    return Blobs(centres, AXES * _principal_axes(covariance), colour_to_logits(colours))


def blob_points(blobs: Blobs, settings: FitSettings, generator: np.random.Generator) -> Array:
    """Control points (n, K, 2): rings around the patches, or strokes along their longer axes."""
    centres, n = blobs.centres, len(blobs.centres)
    if settings.mode is Mode.CLOSED:
        ring = like(centres, random_ring(n, 3 * settings.segments, generator))
        return contiguous(centres[:, None] + ring @ namespace(centres).permute_dims(blobs.axes, (0, 2, 1)))
    k = 3 * settings.segments + 1
    along = like(centres, np.linspace(-1.0, 1.0, k))[None, :, None] * blobs.axes[:, None, :, 1]
    wobble = like(centres, STROKE_WOBBLE * generator.standard_normal((n, k, 2)))
    return contiguous(centres[:, None] + along + wobble)


def box_mean(planes: Array, size: int) -> Array:
    """Mean over the window of `size` x `size` px (odd) around each pixel of (..., H, W), of the pixels that exist.

    One axis after the other, by adding shifted copies: pooling, as torch has it, takes fifteen times as long.
    """
    xp, half = namespace(planes), size // 2
    for across in (True, False):
        length = planes.shape[-1 if across else -2]
        total = copied(planes)
        for shift in range(1, min(half, length - 1) + 1):
            rest = length - shift
            if across:
                total[..., :rest] += planes[..., shift:]
                total[..., shift:] += planes[..., :rest]
            else:
                total[..., :rest, :] += planes[..., shift:, :]
                total[..., shift:, :] += planes[..., :rest, :]
        index = xp.arange(length, device=planes.device)
        count = xp.astype(xp.clip(index + half, max=length - 1) - xp.clip(index - half, min=0) + 1, planes.dtype)
        total /= count if across else count[:, None]
        planes = total
    return planes


def _principal_axes(covariance: Array) -> Array:
    """Standard deviations along the principal axes of (n, 2, 2), times the axes, as columns; the shorter first.

    In closed form: a solver's start on a GPU takes longer than the whole reallocation.
    """
    xp = namespace(covariance)
    xx, xy, yy = covariance[:, 0, 0] + LEAST_VARIANCE, covariance[:, 0, 1], covariance[:, 1, 1] + LEAST_VARIANCE
    middle, half_range = 0.5 * (xx + yy), xp.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * xp.atan2(xy, 0.5 * (xx - yy))  # of the longer axis
    cos, sin = xp.cos(angle), xp.sin(angle)
    longer = xp.stack([cos, sin], axis=-1) * xp.sqrt(middle + half_range)[:, None]
    variance = xp.clip(middle - half_range, min=LEAST_VARIANCE)  # never less, but for rounding
    shorter = xp.stack([-sin, cos], axis=-1) * xp.sqrt(variance)[:, None]
    return xp.stack([shorter, longer], axis=-1)


def _blurred(residual: Array) -> Array:
    xp = namespace(residual)
    if residual.shape[-1] == 4:
        # Over black and over white, as the loss sees it: black on nothing differs in alpha alone.
        residual = xp.concat([residual[..., :3], residual[..., :3] - residual[..., 3:]], axis=-1)
    planes = contiguous(xp.permute_dims(residual, (2, 0, 1)))
    return xp.permute_dims(box_mean(planes, RESIDUAL_BLUR), (1, 2, 0))


def _likeness(residuals: Array, own: Array) -> Array:
    """Share of the seed's residual (n, 3) that each pixel's (n, p, 3) has along it, in [0, 1]."""
    xp = namespace(own)
    along = xp.sum(residuals * own[:, None], axis=-1)
    return xp.clip(along / xp.clip(xp.sum(own * own, axis=-1, keepdims=True), min=1e-8), 0.0, 1.0)
