"""MS-SSIM as a loss: the multi-scale structural similarity of Wang, Simoncelli and Bovik (2003), differentiable.

All that depends on the goal alone is computed once for a fit.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from cubicsplat_cli.record import record

SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # as published, from the finest scale on
TAPS, SIGMA = 11, 1.5
LIGHT, CONTRAST = 0.01**2, 0.03**2  # the constants of SSIM for values in [0, 1]
LEAST = 1e-4  # of a scale's similarity, whose power has no gradient at 0


@record
class _Scale:
    """The picture at one scale, (P, 1, h, w) for P planes: its local means and variances; weights, of sum 1."""

    planes: Tensor
    mean: Tensor
    variance: Tensor
    weights: Tensor | None


class MsSsim:
    """1 - MS-SSIM against a goal (H, W, 3), or (H, W, 4) premultiplied, which counts over black and over white.

    weights (H, W): of the pixels. Pictures with a side below 176 px have fewer scales, below 11 px a smaller window.
    """

    def __init__(self, goal: Tensor, weights: Tensor | None = None) -> None:
        planes = _planes(goal)
        least = min(goal.shape[:2])
        taps = min(TAPS, least - 1 + least % 2)
        place = torch.arange(taps, device=goal.device, dtype=goal.dtype) - (taps - 1) / 2
        window = torch.exp(-0.5 * (place / SIGMA) ** 2)
        self._window = (window / window.sum()).tolist()
        count = next(n for n in range(len(SCALE_WEIGHTS), 0, -1) if n == 1 or least >> (n - 1) >= taps)
        self._powers = [w / sum(SCALE_WEIGHTS[:count]) for w in SCALE_WEIGHTS[:count]]
        factors = None if weights is None else weights[None, None]
        self._scales = []
        for number in range(count):
            mean = self._blurred(planes)
            variance = self._blurred(planes * planes) - mean * mean
            local = None if factors is None else self._blurred(factors)
            shares = None if local is None else local / local.sum().clamp(min=1e-12)
            self._scales.append(_Scale(planes, mean, variance, shares))
            if number < count - 1:
                planes = avg_pool2d(planes, 2)
                factors = None if factors is None else avg_pool2d(factors, 2)

    def loss(self, image: Tensor) -> Tensor:
        """Return 1 - MS-SSIM of a picture of the goal's shape, differentiable; a scalar in [0, 1]."""
        planes, similarity = _planes(image), torch.ones((), device=image.device)
        last = len(self._scales) - 1
        for number, (goal, power) in enumerate(zip(self._scales, self._powers, strict=True)):
            mean = self._blurred(planes)
            variance = self._blurred(planes * planes) - mean * mean
            shared = self._blurred(planes * goal.planes) - mean * goal.mean
            alike = (2.0 * shared + CONTRAST) / (variance + goal.variance + CONTRAST)
            if number == last:
                alike = alike * (2.0 * mean * goal.mean + LIGHT) / (mean * mean + goal.mean * goal.mean + LIGHT)
            level = alike.mean() if goal.weights is None else (alike * goal.weights).sum() / len(planes)
            similarity = similarity * level.clamp(min=LEAST) ** power
            if number < last:
                planes = avg_pool2d(planes, 2)
        return 1.0 - similarity

    def _blurred(self, planes: Tensor) -> Tensor:
        return _Blur.apply(planes, self._window)


class _Blur(torch.autograd.Function):
    """Planes (..., H, W) through a symmetric window of n taps along both axes, (..., H - n + 1, W - n + 1).

    By shifted sums: torch's convolution of single planes takes ten times as long.
    """

    @staticmethod
    def forward(ctx: Any, planes: Tensor, window: list[float]) -> Tensor:
        ctx.window = window
        for axis in (-1, -2):
            length = planes.shape[axis] - len(window) + 1
            total = planes.narrow(axis, 0, length) * window[0]
            for i, weight in enumerate(window[1:], start=1):
                total.add_(planes.narrow(axis, i, length), alpha=weight)
            planes = total
        return planes

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        (gradient,), window = gradients, ctx.window
        for axis in (-2, -1):
            length = gradient.shape[axis]
            shape = list(gradient.shape)
            shape[axis] += len(window) - 1
            spread = gradient.new_zeros(shape)
            for i, weight in enumerate(window):
                spread.narrow(axis, i, length).add_(gradient, alpha=weight)
            gradient = spread
        return gradient, None


def _planes(picture: Tensor) -> Tensor:
    """Return (3, 1, H, W) of RGB, or (6, 1, H, W) of premultiplied RGBA over black and over white."""
    planes = picture.permute(2, 0, 1)[:, None]
    if planes.shape[0] == 3:
        return planes.contiguous()
    return torch.cat((planes[:3], planes[:3] + (1.0 - planes[3:])))
