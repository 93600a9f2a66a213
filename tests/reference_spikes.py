"""The penalties on spikes and slivers in float64 torch, curve by curve, with gradients by autograd: what the kernels'
formulas (raster/kernels/shared/spikes.h) are held against.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from cubicsplat_cli.photo.geometric import EDGES, LEAST_ARM, OPPOSITE, SPIKE_TURN, THINNEST
from cubicsplat_cli.settings import Mode


def spike_gradient(
    points: Tensor, mode: Mode, weight: float, size: tuple[int, int], ring_ends: Tensor | None = None
) -> Tensor:
    """Gradient (N, K, 2) of weight times the sum over all joins on the canvas of relu(t - SPIKE_TURN), t the turn in
    radians from the handle before the join to the one after it; at most weight / LEAST_ARM a point.
    """

    def turned_too_far(rings: list[Tensor]) -> Tensor:
        total = torch.zeros((), dtype=torch.float64)
        for ring in rings:
            last = (len(ring) - (mode is Mode.OPEN)) // 3
            for m in range(1 if mode is Mode.OPEN else 0, last):
                u, v = ring[3 * m] - ring[3 * m - 1], ring[3 * m + 1] - ring[3 * m]
                turn = torch.atan2(cross(u, v).abs() + 1e-6, u @ v)
                if shown(ring[3 * m], size) and turn > SPIKE_TURN:
                    total = total + turn
        return total

    found = gradient_of(turned_too_far, points, mode, ring_ends)
    longest = found.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    return weight * found * (1.0 / (LEAST_ARM * longest)).clamp(max=1.0)


def sliver_gradient(points: Tensor, weight: float, size: tuple[int, int], ring_ends: Tensor | None = None) -> Tensor:
    """Gradient (N, K, 2), for closed curves, of weight times the sum over all pairs of opposite edges of
    l relu(THINNEST - |d|): d the distance in px of the middle of the one, of length l, from the other, if its foot lies
    on that and the shape lies between them and not beyond either. The lengths, and the directions, count as given.
    """
    found = gradient_of(lambda rings: too_thin(rings, size), points, Mode.CLOSED, ring_ends)
    return weight * found


def too_thin(rings: list[Tensor], size: tuple[int, int]) -> Tensor:
    t = torch.arange(EDGES + 1, dtype=torch.float64) / EDGES
    basis = torch.stack(((1 - t) ** 3, 3 * (1 - t) ** 2 * t, 3 * (1 - t) * t * t, t**3), 1)
    starts, ends = [], []
    for ring in rings:
        for m in range(len(ring) // 3):
            vertices = basis @ ring[[3 * m, 3 * m + 1, 3 * m + 2, (3 * m + 3) % len(ring)]]
            starts.append(vertices[:-1])
            ends.append(vertices[1:])
    a, b = torch.cat(starts), torch.cat(ends)
    long = (b - a).norm(dim=1).clamp(min=1e-6).detach()
    along = ((b - a) / long[:, None]).detach()
    normals = torch.stack((-along[:, 1], along[:, 0]), 1)
    middles = 0.5 * (a + b)
    share = (((middles[:, None] - a) * along).sum(-1) / long).detach()
    # From the foot, which moves along with the edge.
    feet = a + share[..., None] * (b - a)
    distance = ((middles[:, None] - feet) * normals).sum(-1)
    left = windings(a.detach(), b.detach(), middles.detach())
    pairs = (along @ along.T < OPPOSITE) & (distance.abs() < THINNEST) & (distance != 0)
    pairs &= ((share - 0.5).abs() <= 0.5) & torch.stack([shown(p, size) for p in middles])[:, None]
    within = (distance > 0).long()
    pairs &= (left[:, None] == within) & (left == within)
    return (long[:, None] * (THINNEST - distance.abs()))[pairs].sum()


def windings(a: Tensor, b: Tensor, middles: Tensor) -> Tensor:
    """(V,): the winding number just left of the middle of each edge."""
    rising = (b[:, 1] > a[:, 1]).long()
    reached = (a[:, 1] <= middles[:, 1:]) != (b[:, 1] <= middles[:, 1:])
    reached &= ~torch.eye(len(a), dtype=torch.bool)
    side = cross(b - a, middles[:, None] - a)
    return (reached & (rising == 1) & (side > 0)).sum(1) - (reached & (rising == 0) & (side < 0)).sum(1) + rising


def gradient_of(
    penalty: Callable[[list[Tensor]], Tensor], points: Tensor, mode: Mode, ring_ends: Tensor | None
) -> Tensor:
    """(N, K, 2) of a penalty of the rings of a curve, each (K, 2), for every curve; zero in the room between."""
    moved = torch.as_tensor(points).double().requires_grad_()
    shared = 1 if mode is Mode.OPEN else 0
    total = 0.0 * moved.sum()
    for i, curve in enumerate(moved):
        ends = [(len(curve) - shared) // 3] if ring_ends is None else torch.as_tensor(ring_ends[i]).tolist()
        begins = [0, *ends[:-1]]
        rings = [curve[3 * b : 3 * e + shared] for b, e in zip(begins, ends, strict=True) if e > b]
        total = total + penalty(rings)
    return torch.autograd.grad(total, moved)[0]


def cross(u: Tensor, v: Tensor) -> Tensor:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def shown(point: Tensor, size: tuple[int, int]) -> Tensor:
    """True if a point lies on the canvas."""
    return (point >= 0).all() & (point <= torch.tensor(size)).all()
