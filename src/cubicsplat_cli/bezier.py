"""Cubic Bezier curves: Bernstein bases, the uniform polyline surrogate and its error bound, de Casteljau.

Flattening a curve is one product of a constant matrix with its control points, so it is linear,
differentiable and the same for every curve of a scene.
"""

from __future__ import annotations

import torch
from torch import Tensor

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.scene import points_from_segments, segments_from_points
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


def segment_points(points: Tensor, mode: Mode) -> Tensor:
    """The control points by segment: (N, K, 2) -> (N, M, 4, 2). Raises InputError on any other shape."""
    if points.ndim != 3 or points.shape[-1] != 2:
        raise InputError(f"points must have shape (N, K, 2), not {tuple(points.shape)}")
    segments = segments_from_points(mode, points.shape[1])
    return points[:, segment_indices(mode, segments).to(points.device)]


def second_derivative_bound(points: Tensor, mode: Mode) -> Tensor:
    """Upper bound of |B''(t)| on [0, 1] for each segment, in px.

    B'' runs in a straight line from 6 (P0 - 2 P1 + P2) to 6 (P1 - 2 P2 + P3), so the larger of their lengths
    is the exact maximum. points: (N, K, 2) px. Returns (N, M).
    """
    p0, p1, p2, p3 = segment_points(points, mode).unbind(2)
    return 6.0 * torch.maximum((p0 - 2.0 * p1 + p2).norm(dim=-1), (p1 - 2.0 * p2 + p3).norm(dim=-1))


def hausdorff_bound(points: Tensor, mode: Mode, samples: int) -> Tensor:
    """Upper bound D2 / (8 S^2) of the Hausdorff distance from each segment to its polyline of S edges, px.

    This is the error of linear interpolation over a parameter step of 1 / S. points: (N, K, 2) px. Returns
    (N, M). Raises UsageError when samples < 1.
    """
    if samples < 1:
        raise UsageError(f"samples must be at least 1, not {samples}")
    return second_derivative_bound(points, mode) / (8.0 * samples * samples)


def samples_for_tolerance(points: Tensor, mode: Mode, tolerance: float, minimum: int, maximum: int) -> Tensor:
    """The fewest samples per segment that keep each curve's polyline within `tolerance` px of it.

    points: (N, K, 2) px. Returns (N,) int64 in [minimum, maximum]; a curve that would need more gets
    `maximum`. Raises UsageError for a tolerance that is not positive or 1 <= minimum <= maximum not holding.
    """
    if not tolerance > 0.0:
        raise UsageError(f"tolerance must be above 0 px, not {tolerance}")
    if not 1 <= minimum <= maximum:
        raise UsageError(f"minimum and maximum must satisfy 1 <= minimum <= maximum, not {minimum}, {maximum}")
    largest = second_derivative_bound(points.detach().double(), mode).amax(dim=1)
    # Clamped before the cast to integers: a huge curve must not wrap around.
    return (largest / (8.0 * tolerance)).sqrt().ceil().clamp(minimum, maximum).long()


def de_casteljau_split(segment: Tensor, t: float) -> tuple[Tensor, Tensor]:
    """Split cubics at parameter t into two cubics that together trace the same curve.

    segment: (..., 4, D) control points; t in [0, 1]. Returns (left, right), each (..., 4, D), with
    left(s) = B(t s) and right(s) = B(t + (1 - t) s). Raises InputError for another shape, UsageError for t
    outside [0, 1].
    """
    if segment.ndim < 2 or segment.shape[-2] != 4:
        raise InputError(f"segment must have shape (..., 4, D), not {tuple(segment.shape)}")
    if not 0.0 <= t <= 1.0:
        raise UsageError(f"t must lie between 0 and 1, not {t}")
    level = segment
    left, right = [level[..., 0, :]], [level[..., -1, :]]
    while level.shape[-2] > 1:
        level = (1.0 - t) * level[..., :-1, :] + t * level[..., 1:, :]
        left.append(level[..., 0, :])
        right.append(level[..., -1, :])
    return torch.stack(left, dim=-2), torch.stack(right[::-1], dim=-2)
