"""Cubic Bezier curves: Bernstein bases and the uniform polyline surrogate.

Flattening a curve is one product of a constant matrix with its control points, so it is linear,
differentiable and the same for every curve of a scene.
"""

from __future__ import annotations

import torch
from torch import Tensor

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.scene.scene import points_from_segments
from cubicsplat_cli.settings import Mode


def bernstein(t: Tensor) -> Tensor:
    """The four cubic Bernstein polynomials at parameters t.

    t: (S,) floating point, usually in [0, 1]. Returns (S, 4) of the same type; rows sum to 1.
    """
    u = 1.0 - t
    return torch.stack((u * u * u, 3.0 * u * u * t, 3.0 * u * t * t, t * t * t), dim=-1)


def segment_indices(mode: Mode, segments: int) -> Tensor:
    """(M, 4) int64: the control points of each segment; a closed curve's last segment ends at its point 0."""
    count = points_from_segments(mode, segments)
    return (3 * torch.arange(segments).unsqueeze(1) + torch.arange(4)) % count


def polyline_basis(mode: Mode, segments: int, samples: int) -> Tensor:
    """The matrix that flattens a curve: vertices = basis @ points.

    Vertex m * S + s is segment m at t = s / S. Returns (V, K) float64 on the CPU, with V = M * S for a closed
    curve (whose last edge returns to vertex 0) and M * S + 1 for an open one. Raises UsageError when
    samples < 1.
    """
    if samples < 1:
        raise UsageError(f"samples must be at least 1, not {samples}")
    indices = segment_indices(mode, segments)
    weights = bernstein(torch.arange(samples, dtype=torch.float64) / samples)
    basis = torch.zeros(segments, samples, points_from_segments(mode, segments), dtype=torch.float64)
    # Added, not assigned: the single segment of a closed curve with M = 1 uses its point 0 twice.
    basis.scatter_add_(2, indices.unsqueeze(1).expand(-1, samples, -1), weights.unsqueeze(0).expand(segments, -1, -1))
    basis = basis.flatten(0, 1)
    if mode is Mode.OPEN:
        end = torch.zeros(1, basis.shape[1], dtype=torch.float64)
        end[0, -1] = 1.0
        basis = torch.cat((basis, end))
    return basis
