"""Optional regularisers: the non-crossing penalty of LIVE (an ablation: it costs quality, see docs/ablations.md), and
one on thorns, joins at which an outline turns back on itself, which show when a file is enlarged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from cubicsplat_cli.scene import segments_from_points
from cubicsplat_cli.settings import Mode

THORN_TURN = math.radians(140.0)  # less than what is called a thorn, 150 degrees, so that those end below
LEAST_ARM = 0.3  # px: shorter handles are pulled no more than such


def crossing_penalty(points: Tensor, mode: Mode, ring_ends: Tensor | None = None) -> Tensor:
    """Mean over all cubics of the Xing loss of points (N, K, 2): 0 where no cubic's handles cross, at most 1.

    For a cubic A B C D let D1 = [AB x BC > 0] and D2 = AB x CD / (|AB| |CD|), the sine between the handles. A cubic
    whose handles turn the other way at its end crosses itself or nearly so: the loss is relu(-D2) where D1, else
    relu(D2). ring_ends: as in `Scene`. Source: LIVE (Ma et al., "Towards Layer-wise Image Vectorization", CVPR 2022),
    section on the Xing loss.
    """
    found = _segments(points, mode, ring_ends)
    onward = found.index + 1
    if mode is Mode.CLOSED:
        onward = torch.where(onward >= found.end, found.start, onward)
    a, b, c = (_taken(points, 3 * found.index + k) for k in range(3))
    first, middle, last = b - a, c - b, _taken(points, 3 * onward) - c
    turns_left = _cross(first, middle) > 0
    lengths = (first.norm(dim=-1) * last.norm(dim=-1)).clamp(min=1e-6)
    sine = _cross(first, last) / lengths
    return torch.where(turns_left, (-sine).relu(), sine.relu())[found.real].mean()


def crossing_gradient(points: Tensor, mode: Mode, weight: float, ring_ends: Tensor | None = None) -> Tensor:
    """Gradient of weight * crossing_penalty with respect to the points, (N, K, 2)."""
    leaf = points.detach().clone().requires_grad_()
    (gradient,) = torch.autograd.grad(weight * crossing_penalty(leaf, mode, ring_ends), leaf)
    return gradient.contiguous()


def thorn_gradient(points: Tensor, mode: Mode, weight: float, ring_ends: Tensor | None = None) -> Tensor:
    """Gradient (N, K, 2) of weight times the sum over all joins of relu(t - `THORN_TURN`), t the turn in radians from
    the handle before the join to the one after it; at most weight / `LEAST_ARM` a point. ring_ends: as in `Scene`.
    """
    leaf = points.detach().clone().requires_grad_()
    found = _segments(leaf, mode, ring_ends)
    before, joined = 3 * found.index - 1, found.real
    if mode is Mode.CLOSED:
        before = torch.where(found.index == found.start, 3 * found.end - 1, before)
    else:
        before, joined = before.clamp(min=0), joined & (found.index > 0)
    joins = _taken(leaf, 3 * found.index)
    arriving, leaving = joins - _taken(leaf, before), _taken(leaf, 3 * found.index + 1) - joins
    turn = torch.atan2(_cross(arriving, leaving).abs() + 1e-6, (arriving * leaving).sum(-1))
    (gradient,) = torch.autograd.grad((turn - THORN_TURN).relu()[joined].sum(), leaf)
    # The angle at a handle of no length may change at any rate.
    size = gradient.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    return (weight * gradient * (1.0 / (LEAST_ARM * size)).clamp(max=1.0)).contiguous()


@dataclass(frozen=True)
class _Segments:
    """Of each segment, (N, M) or, where curves do not differ, (1, M): its number, those of the first one of its ring
    and of the one behind the last; whether it is one, and not room that a shorter curve leaves.
    """

    index: Tensor
    start: Tensor
    end: Tensor
    real: Tensor


def _segments(points: Tensor, mode: Mode, ring_ends: Tensor | None) -> _Segments:
    count = segments_from_points(mode, points.shape[1])
    ends = torch.tensor([[count]], device=points.device) if ring_ends is None else ring_ends.long()
    index = torch.arange(count, device=points.device).expand(len(ends), -1)
    ring = (index[:, :, None] >= ends[:, None, :]).sum(-1).clamp(max=ends.shape[1] - 1)
    starts = torch.cat((torch.zeros_like(ends[:, :1]), ends), dim=1)
    real = (index < ends[:, -1:]).expand(len(points), -1)
    return _Segments(index, starts.gather(1, ring), ends.gather(1, ring), real)


def _taken(points: Tensor, index: Tensor) -> Tensor:
    """Of points (N, K, 2) those at (N or 1, M) places of each curve: (N, M, 2)."""
    return points.gather(1, index.expand(len(points), -1)[..., None].expand(-1, -1, 2))


def _cross(u: Tensor, v: Tensor) -> Tensor:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
