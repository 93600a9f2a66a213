"""Optional regularisers: the non-crossing penalty of LIVE (an ablation: it costs quality, see docs/ablations.md), and
one on thorns, joins at which an outline turns back on itself, which show when a file is enlarged.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from cubicsplat_cli.bezier import segment_points
from cubicsplat_cli.settings import Mode

THORN_TURN = math.radians(140.0)  # less than what is called a thorn, 150 degrees, so that those end below


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


def thorn_gradient(points: Tensor, mode: Mode, weight: float) -> Tensor:
    """Gradient (N, K, 2) of weight times the sum over all joins of relu(c - cos t), t the turn from the handle before
    the join to the one after it, c the cosine of `THORN_TURN`.
    """
    leaf = points.detach().clone().requires_grad_()
    if mode is Mode.CLOSED:
        joins, before, after = leaf[:, ::3], leaf.roll(1, 1)[:, ::3], leaf[:, 1::3]
    else:
        joins, before, after = leaf[:, 3:-1:3], leaf[:, 2:-2:3], leaf[:, 4::3]
    arriving, leaving = joins - before, after - joins
    lengths = (arriving.norm(dim=-1) * leaving.norm(dim=-1)).clamp(min=1e-3)
    penalty = (math.cos(THORN_TURN) - (arriving * leaving).sum(-1) / lengths).relu().sum()
    (gradient,) = torch.autograd.grad(weight * penalty, leaf)
    return gradient.contiguous()


def _cross(u: Tensor, v: Tensor) -> Tensor:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
