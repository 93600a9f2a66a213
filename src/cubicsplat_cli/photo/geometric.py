"""The non-crossing penalty of LIVE, an optional regulariser (an ablation: it costs quality, see docs/ablations.md)."""

from __future__ import annotations

import torch
from torch import Tensor

from cubicsplat_cli.bezier import segment_points
from cubicsplat_cli.settings import Mode


def crossing_penalty(points: Tensor, mode: Mode) -> Tensor:
    """Mean over all cubics of the Xing loss of points (N, K, 2): 0 where no cubic's handles cross, at most 1.

    For a cubic A B C D let D1 = [AB x BC > 0] and D2 = AB x CD / (|AB| |CD|), the sine between the handles. A cubic
    whose handles turn the other way at its end crosses itself or nearly so: the loss is relu(-D2) where D1, else
    relu(D2). Source: LIVE (Ma et al., "Towards Layer-wise Image Vectorization", CVPR 2022), section on the Xing loss.
    """
    a, b, c, d = segment_points(points, mode).unbind(2)
    first, middle, last = b - a, c - b, d - c
    turns_left = _cross(first, middle) > 0
    lengths = (first.norm(dim=-1) * last.norm(dim=-1)).clamp(min=1e-6)
    sine = _cross(first, last) / lengths
    return torch.where(turns_left, (-sine).relu(), sine.relu()).mean()


def crossing_gradient(points: Tensor, mode: Mode, weight: float) -> Tensor:
    """Gradient of weight * crossing_penalty with respect to the points, (N, K, 2)."""
    leaf = points.detach().clone().requires_grad_()
    (gradient,) = torch.autograd.grad(weight * crossing_penalty(leaf, mode), leaf)
    return gradient.contiguous()


def _cross(u: Tensor, v: Tensor) -> Tensor:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
