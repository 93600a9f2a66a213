"""The reference renderer: the definition of what every engine computes, in float64 and plain torch.

Written to be read and checked, not to be fast: one primitive at a time, of which `reference_coverage` has the coverage.
Forward values and derivatives (by autograd) are those the native engines are tested against. Shapes: N primitives; H, W
canvas; C channels.

Front-to-back compositing follows CubicSplat (ECCV 2026); the leave-one-out importance is ours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from reference_coverage import coverage, pixel_centres, polylines
from torch import Tensor

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.raster.settings import SQUARED, Penalty, RasterSettings, image_loss
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import Array, namespace
from cubicsplat_cli.scene.gradients import FLAT, LINEAR, Gradients

# Of the kernels' pixel.h, and so are those of the coverage. A pixel's alpha is kept below one so that the backward pass
# may divide by 1 - alpha; the transmittance at which a pixel stops lies just above 1 - MAX_ALPHA, so that one opaque
# curve ends the pixel in every precision.
MAX_ALPHA = 0.9995
MIN_TRANSMITTANCE = 5.1e-4
# Of the way between two stops: the second of nearer ones takes over at once.
LEAST_LENGTH = 1e-6


def paint_at(gradients: Gradients, curve: int, places: Array) -> Array:
    """Return colour and opacity (P, 4) of one curve that is not flat at places (P, 2) px; differentiable."""
    xp = namespace(places)
    frame = xp.astype(gradients.frames[curve], places.dtype)
    plane, lean = places @ frame[:, :2].T + frame[:, 2], frame[:, 3]
    if int(gradients.kinds[curve]) == LINEAR:
        t = plane[..., 0]
    else:
        # The square root has no derivative at 0.
        squared = xp.sum(plane * plane, axis=-1)
        t = xp.sqrt(xp.where(squared > 0.0, squared, 1.0)) * (squared > 0.0) + plane @ lean
    offsets, stops = (xp.astype(given[curve], places.dtype) for given in (gradients.offsets, gradients.stops))
    value = xp.broadcast_to(stops[0], (*t.shape, 4))
    for k in range(1, int(gradients.counts[curve])):
        length = offsets[k] - offsets[k - 1]
        if length > LEAST_LENGTH:
            ramp = xp.clip((t - offsets[k - 1]) / length, 0.0, 1.0)
        else:
            ramp = xp.astype(t >= offsets[k], places.dtype)
        value = value + ramp[..., None] * (stops[k] - stops[k - 1])
    return value


def alpha_of(covered: Tensor, opacity: Tensor) -> Tensor:
    """alpha = min(opacity * coverage, MAX_ALPHA), with a zero derivative where the limit holds."""
    return (opacity * covered).clamp(max=MAX_ALPHA)


class CompositingStep(NamedTuple):
    """One primitive on its way into the picture, at every pixel."""

    alpha: Tensor  # (H, W), zero where the pixel had stopped before this primitive
    transmittance: Tensor  # (H, W), before this primitive
    before: Tensor  # (H, W, C), colour accumulated before it
    after: Tensor  # (H, W, C), colour accumulated with it


def front_to_back(alphas: Tensor, colours: Tensor | Sequence[Tensor]) -> Iterator[CompositingStep]:
    """Composite alphas (N, H, W) of N colours (C,) or (H, W, C), front first: acc += T alpha c, T *= 1 - alpha.

    A primitive contributes to a pixel only while the transmittance before it is at least MIN_TRANSMITTANCE.
    """
    transmittance = torch.ones_like(alphas[0])
    accumulated = torch.zeros(*alphas.shape[1:], colours[0].shape[-1], dtype=alphas.dtype, device=alphas.device)
    for alpha, colour in zip(alphas, colours, strict=True):
        alpha = torch.where(transmittance >= MIN_TRANSMITTANCE, alpha, 0.0)
        after = accumulated + (transmittance * alpha).unsqueeze(-1) * colour
        yield CompositingStep(alpha, transmittance, accumulated, after)
        transmittance, accumulated = transmittance * (1.0 - alpha), after


def composite(alphas: Tensor, colours: Tensor | Sequence[Tensor], background: Tensor) -> Tensor:
    """The picture F = acc + T background: alphas (N, H, W), N colours (C,) or (H, W, C), background (C,)."""
    for layer in front_to_back(alphas, colours):
        last = layer
    transmittance = last.transmittance * (1.0 - last.alpha)
    return last.after + transmittance.unsqueeze(-1) * background


def channel_colours(colours: Tensor, background: tuple[float, float, float] | None) -> tuple[Tensor, Tensor]:
    """Colours (..., C), of (..., 3), and background (C,) of the picture's channels, float64.

    Over a background: RGB. Without one: premultiplied RGBA, where each primitive is (r, g, b, 1) and the
    background zero.
    """
    colours = colours.double()
    if background is not None:
        return colours, torch.tensor(background, dtype=torch.float64, device=colours.device)
    return torch.cat((colours, torch.ones_like(colours[..., :1])), dim=-1), colours.new_zeros(4)


def _painted(scene: Scene) -> list[Tensor]:
    """sRGB and opacity of every primitive: (4,), or (H, W, 4) of one with a gradient."""
    flat = torch.cat((scene.colours.double(), scene.opacities.double().unsqueeze(1)), dim=1)
    if scene.gradients is None:
        return list(flat)
    at = pixel_centres(scene.width, scene.height, scene.points.device)
    kinds = scene.gradients.kinds.tolist()
    return [
        own if kind == FLAT else paint_at(scene.gradients, n, at) * torch.cat((torch.ones_like(own[:3]), own[3:]))
        for n, (own, kind) in enumerate(zip(flat, kinds, strict=True))
    ]


def _layers(scene: Scene, settings: RasterSettings) -> tuple[Tensor, list[Tensor], Tensor]:
    """(N, H, W): the alpha of every primitive at every pixel; their colours and the background's, by channel."""
    paints = _painted(scene)
    alphas = [
        alpha_of(coverage(v, r, scene.mode, scene.width, scene.height, settings), paint[..., 3])
        for v, r, paint in zip(polylines(scene, settings.samples), scene.half_widths.double(), paints, strict=True)
    ]
    channels = [channel_colours(paint[..., :3], scene.background) for paint in paints]
    return torch.stack(alphas), [colour for colour, _ in channels], channels[0][1]


def render(scene: Scene, settings: RasterSettings) -> Tensor:
    """Render a scene, differentiably in its four tensors and in the gradients' frames and stops.

    Returns (H, W, C) float64 in [0, 1]: RGB over a background, premultiplied RGBA when background is None. Raises
    InputError as `Scene.validate` does.
    """
    scene.validate()
    return composite(*_layers(scene, settings))


def importance(
    scene: Scene,
    settings: RasterSettings,
    *,
    target: Tensor | None = None,
    kind: str = "loo",
    weights: Tensor | None = None,
    penalty: Penalty = SQUARED,
) -> Tensor:
    """The importance of each primitive, (N,) float64; no gradient.

    weights (H, W): factors of the pixels. "visibility": sum over the pixels of T alpha, px^2. "loo" (leave one out):
    how much `image_loss` against target (H, W, C) would rise without the primitive; negative when it does harm. The
    picture without it is acc_before + (F - acc_after) / (1 - alpha), which is exact except where a pixel stopped
    early: what lies behind the primitive that stopped it was never composited, and counts as background.

    Raises InputError as `Scene.validate` and `image_loss` do, UsageError for another kind or no target.
    """
    if kind not in ("loo", "visibility"):
        raise UsageError(f"importance must be 'loo' or 'visibility', not {kind!r}")
    if kind == "loo" and target is None:
        raise UsageError("leave-one-out importance needs a target picture")
    scene.validate()
    with torch.no_grad():
        alphas, channels, behind = _layers(scene, settings)
        if kind == "visibility" or target is None:
            factor = 1.0 if weights is None else weights.to(alphas.dtype)
            return torch.stack([(factor * x.transmittance * x.alpha).sum() for x in front_to_back(alphas, channels)])
        image = composite(alphas, channels, behind)
        loss = image_loss(image, target, weights, penalty)
        without = (
            x.before + (image - x.after) / (1.0 - x.alpha).unsqueeze(-1) for x in front_to_back(alphas, channels)
        )
        return torch.stack([image_loss(picture, target, weights, penalty) - loss for picture in without])
