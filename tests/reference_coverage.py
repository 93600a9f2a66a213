"""The coverage of pixels by one curve, as the reference renderer defines it: relaxed, and exact with its derivative.

One curve at a time, every pixel against every edge, in float64 and plain torch. Shapes: H, W canvas; P any pixel shape;
V vertices and E edges of one curve's polyline. A curve of several rings has a sequence of polylines (V, 2) where one of
a single ring has its one.

The relaxation (uniform polyline surrogate, signed distance with a sign that is constant in the backward pass, stroke
coverage as a difference of two edges) follows CubicSplat (ECCV 2026). The exact coverage with the relaxed derivative is
ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene, segments_from_points
from cubicsplat_cli.scene.scene import points_from_segments
from cubicsplat_cli.settings import Mode

# Exact coverage of strokes: sub-samples per axis of a pixel.
EXACT_SUBSAMPLES = 4
# Half of the relaxed edge's support, in edge widths (the smoothstep of slope 1/w has support 1.5 w).
HALF_SUPPORT = 0.75
# Squared edge length below which an edge counts as this long when a point is projected onto it, px^2.
MIN_EDGE_SQUARED = 1e-12
# Distance below which the direction to the nearest point is lost to rounding, px.
ON_OUTLINE = 1e-6

# The vertices of a curve: (V, 2), or one such tensor for each of its rings.
Polyline = Tensor | Sequence[Tensor]


def flatten(points: Tensor, mode: Mode, samples: int) -> Tensor:
    """The polyline of every curve: points (N, K, 2) px -> vertices (N, V, 2) px, float64."""
    segments = segments_from_points(mode, points.shape[1])
    return polyline_basis(mode, segments, samples).to(points.device) @ points.double()


def pixel_centres(width: int, height: int, device: torch.device | str = "cpu") -> Tensor:
    """(H, W, 2) float64: the centre (j + 0.5, i + 0.5) of every pixel (row i, column j), px."""
    return _grid(width, height, 1, device)


def _grid(width: int, height: int, per_pixel: int, device: torch.device | str) -> Tensor:
    """(H n, W n, 2): the centres of the cells of a grid with n x n cells in each pixel, n = per_pixel."""
    x = (torch.arange(width * per_pixel, dtype=torch.float64, device=device) + 0.5) / per_pixel
    y = (torch.arange(height * per_pixel, dtype=torch.float64, device=device) + 0.5) / per_pixel
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)


def polylines(scene: Scene, samples: int) -> list[Polyline]:
    """The polyline of every curve of a scene, by rings where the scene has any; px, float64."""
    if scene.ring_ends is None:
        return list(flatten(scene.points, scene.mode, samples))
    return [
        [flatten(ring.unsqueeze(0), scene.mode, samples)[0] for ring in scene.rings(curve)]
        for curve in range(scene.curves)
    ]


def edges(vertices: Polyline, mode: Mode) -> tuple[Tensor, Tensor]:
    """Start and end (E, 2) of the edges of a polyline (V, 2): E = V closed (back to vertex 0), V - 1 open."""
    if not isinstance(vertices, Tensor):
        starts, ends = zip(*(edges(ring, mode) for ring in vertices), strict=True)
        return torch.cat(starts), torch.cat(ends)
    if mode is Mode.CLOSED:
        return vertices, vertices.roll(-1, dims=0)
    return vertices[:-1], vertices[1:]


class Nearest(NamedTuple):
    """The point of a polyline that is nearest to each pixel."""

    distance: Tensor  # (P), px, detached
    offset: Tensor  # (P, 2), px, nearest point minus pixel; differentiable, with t held constant
    along: Tensor  # (P, 2), the vector from start to end of the nearest edge, detached


def nearest(vertices: Polyline, at: Tensor, mode: Mode) -> Nearest:
    """The nearest point c = (1 - t) a + t b of the polyline (V, 2) to each of the points `at` (P, 2), px.

    Of edges equally near the first one counts. t needs no derivative (envelope theorem), so it is
    held constant.
    """
    a, b = edges(vertices, mode)
    with torch.no_grad():
        v = b - a
        to_pixel = at.unsqueeze(-2) - a
        t = ((to_pixel * v).sum(-1) / (v * v).sum(-1).clamp(min=MIN_EDGE_SQUARED)).clamp(0.0, 1.0)
        squared = (to_pixel - t.unsqueeze(-1) * v).square().sum(-1)
        edge = squared.argmin(dim=-1)
        t = t.gather(-1, edge.unsqueeze(-1))
    offset = (1.0 - t) * a[edge] + t * b[edge] - at
    return Nearest(offset.detach().norm(dim=-1), offset, v[edge])


def winding(vertices: Polyline, at: Tensor) -> Tensor:
    """Winding number of the closed polyline (V, 2) around each point (P, 2): (P) int64.

    Counts the edges that a ray to the left crosses, half-open in y so that a vertex on the ray counts once; a
    crossing exactly at the point counts.
    """
    with torch.no_grad():
        a, b = edges(vertices, Mode.CLOSED)
        x, y = at[..., 0].unsqueeze(-1), at[..., 1].unsqueeze(-1)
        crossing, direction = _crossings(a, b, y)
        return (direction * (crossing <= x)).sum(-1)


def _crossings(a: Tensor, b: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """The x at which edges a to b (E, 2) cross the lines y (..., 1).

    Returns x (..., E), infinite where there is no crossing, and the direction: +1 down, -1 up, 0 none.
    """
    starts_above, ends_above = a[:, 1] <= y, b[:, 1] <= y
    direction = starts_above.long() - ends_above.long()
    rise = torch.where(direction != 0, b[:, 1] - a[:, 1], 1.0)
    x = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
    return torch.where(direction != 0, x, torch.inf), direction


def signed_area(vertices: Polyline) -> Tensor:
    """Shoelace area of the closed polyline (V, 2), px^2; positive when it turns from the x to the y axis."""
    a, b = edges(vertices, Mode.CLOSED)
    return 0.5 * (a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]).sum()


def signed_distance(vertices: Polyline, at: Tensor) -> Tensor:
    """u = s d of closed shapes (P), px: the distance of points (P, 2) to the polyline (V, 2), signed.

    It is positive where the winding number is not zero. The sign is a constant in the backward pass. The
    derivative of u with respect to the nearest point is the unit vector s (c - x) / d; where d vanishes it is
    the outward normal of the nearest edge, or zero for an edge without length or a shape without area.
    """
    near = nearest(vertices, at, Mode.CLOSED)
    with torch.no_grad():
        sign = torch.where(winding(vertices, at) != 0, 1.0, -1.0).double()
        towards = sign.unsqueeze(-1) * _unit(near.offset, near.distance)
        vx, vy = near.along.unbind(-1)
        outward = signed_area(vertices).sign() * _unit(torch.stack((vy, -vx), dim=-1), near.along.norm(dim=-1))
        normal = torch.where((near.distance < ON_OUTLINE).unsqueeze(-1), outward, towards)
    return _with_gradient(sign * near.distance, (near.offset * normal).sum(-1))


def distance(vertices: Polyline, at: Tensor) -> Tensor:
    """d of open strokes: distance to the polyline (V, 2) of each point (P, 2), px.

    On the line itself the derivative is zero: there the coverage is symmetric in the direction of movement.
    """
    near = nearest(vertices, at, Mode.OPEN)
    with torch.no_grad():
        on_line = (near.distance < ON_OUTLINE).unsqueeze(-1)
        towards = torch.where(on_line, 0.0, _unit(near.offset, near.distance))
    return _with_gradient(near.distance, (near.offset * towards).sum(-1))


def _unit(vector: Tensor, length: Tensor) -> Tensor:
    """vector / length (P, 2), zero where the length is zero."""
    length = length.unsqueeze(-1)
    return torch.where(length > 0.0, vector / torch.where(length > 0.0, length, 1.0), 0.0)


def _with_gradient(value: Tensor, carrier: Tensor) -> Tensor:
    """The value of one tensor with the derivative of another."""
    return value.detach() + (carrier - carrier.detach())


def smooth_step(u: Tensor, edge_width: float) -> Tensor:
    """phi(u) = z^2 (3 - 2 z), z = clamp(u / (1.5 w) + 0.5, 0, 1).

    It rises from 0 at u = -0.75 w to 1 at 0.75 w, with slope 1 / w at u = 0. u (P) and w in px.
    """
    z = (u / (2.0 * HALF_SUPPORT * edge_width) + 0.5).clamp(0.0, 1.0)
    return z * z * (3.0 - 2.0 * z)


def coverage_relaxed(vertices: Polyline, half_width: Tensor, at: Tensor, mode: Mode, edge_width: float) -> Tensor:
    """Relaxed coverage (P) in [0, 1] of the points `at` (P, 2) by one curve.

    vertices: (V, 2) px. half_width: scalar px, used by open strokes only. edge_width: px, > 0.
    """
    if mode is Mode.CLOSED:
        return smooth_step(signed_distance(vertices, at), edge_width)
    d = distance(vertices, at)
    return smooth_step(half_width - d, edge_width) - smooth_step(-half_width - d, edge_width)


def coverage_exact(vertices: Polyline, half_width: Tensor, mode: Mode, width: int, height: int) -> Tensor:
    """Area coverage (H, W) in [0, 1] of every pixel by one curve, without a gradient.

    vertices: (V, 2) px. half_width: scalar px, used by open strokes only.
    """
    with torch.no_grad():
        if mode is Mode.CLOSED:
            return _fill_coverage(vertices, width, height)
        return _stroke_coverage(vertices, half_width, width, height)


def _fill_coverage(vertices: Polyline, width: int, height: int) -> Tensor:
    """Area of each pixel (H, W) in which the winding number is not zero, exact in x and y.

    The picture is cut at all heights where an edge begins, ends or crosses another, so that between two neighbouring
    cuts the edges keep their order and bound trapezoids.
    """
    a, b = edges(vertices, Mode.CLOSED)
    y = _cuts(a, b, height)
    middle, thickness = 0.5 * (y[1:] + y[:-1]), y[1:] - y[:-1]
    crossing, direction = _crossings(a, b, middle.unsqueeze(-1))
    # The few true crossings of each line come first when sorted; the rest, at infinity, is cut off.
    crossing, order = crossing.sort(dim=-1)
    most = int((direction != 0).sum(-1).max())
    crossing, order = crossing[:, :most], order[:, :most]
    inside = (direction.gather(-1, order).cumsum(-1) != 0).double()
    enters = inside - torch.nn.functional.pad(inside, (1, 0))[:, :-1]
    v = b - a
    slope = torch.where(direction != 0, v[:, 0] / torch.where(v[:, 1] != 0.0, v[:, 1], 1.0), 0.0).gather(-1, order)
    half = 0.5 * thickness.unsqueeze(-1) * slope.abs()
    right = torch.arange(width, dtype=torch.float64, device=a.device) + 1.0
    covered = torch.zeros(len(middle), width, dtype=torch.float64, device=a.device)
    for k in range(most):
        beyond = right - crossing[:, k, None].nan_to_num(posinf=width + 1.0)
        covered += enters[:, k, None] * _mean_of_ramp(beyond - half[:, k, None], beyond + half[:, k, None])
    rows = torch.zeros(height, width, dtype=torch.float64, device=a.device)
    return rows.index_add(0, middle.long(), covered * thickness.unsqueeze(-1)).clamp(0.0, 1.0)


def _cuts(a: Tensor, b: Tensor, height: int) -> Tensor:
    """Heights within the picture, rising: the pixel rows' sides, the ends of the edges, and where two edges cross."""
    v = b - a
    across = _cross(v.unsqueeze(1), v)
    between = a - a.unsqueeze(1)
    parallel = across == 0.0
    along = torch.where(parallel, torch.nan, _cross(between, v) / torch.where(parallel, 1.0, across))
    along_other = torch.where(parallel, torch.nan, _cross(between, v.unsqueeze(1)) / torch.where(parallel, 1.0, across))
    meet = (along > 0.0) & (along < 1.0) & (along_other > 0.0) & (along_other < 1.0)
    crossings = (a[:, 1].unsqueeze(1) + along * v[:, 1].unsqueeze(1))[meet]
    sides = torch.arange(height + 1, dtype=torch.float64, device=a.device)
    return torch.cat((sides, a[:, 1], crossings)).clamp(0.0, float(height)).unique()


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _mean_of_ramp(low: Tensor, high: Tensor) -> Tensor:
    """Mean of clamp(u, 0, 1) over low <= u <= high."""

    def antiderivative(u: Tensor) -> Tensor:
        return 0.5 * u.clamp(0.0, 1.0) ** 2 + u.clamp(min=1.0) - 1.0

    width = high - low
    thin = width < 1e-9
    mean = (antiderivative(high) - antiderivative(low)) / torch.where(thin, 1.0, width)
    return torch.where(thin, (0.5 * (low + high)).clamp(0.0, 1.0), mean)


def _stroke_coverage(vertices: Polyline, half_width: Tensor, width: int, height: int) -> Tensor:
    """Mean over sub-samples of box(r - d) - box(-r - d), with box(u) = clamp(u / h + 0.5, 0, 1)."""
    h = 1.0 / EXACT_SUBSAMPLES
    device = half_width.device
    cells = _grid(width, height, EXACT_SUBSAMPLES, device)
    cells = cells.view(height, EXACT_SUBSAMPLES, width, EXACT_SUBSAMPLES, 2).transpose(1, 2)
    covered = torch.zeros(height, width, dtype=torch.float64, device=device)
    # A sub-sample is covered where d < r + h / 2 and lies within 0.54 px of its pixel's centre, so pixels
    # farther than r + 1 from the line are left out.
    centres = pixel_centres(width, height, device)
    within = nearest(vertices, centres, Mode.OPEN).distance < half_width + 1.0
    d = nearest(vertices, cells[within], Mode.OPEN).distance
    outer = ((half_width - d) / h + 0.5).clamp(0.0, 1.0)
    inner = ((-half_width - d) / h + 0.5).clamp(0.0, 1.0)
    covered[within] = (outer - inner).mean(dim=(-2, -1))
    return covered


def coverage(
    vertices: Polyline, half_width: Tensor, mode: Mode, width: int, height: int, settings: RasterSettings
) -> Tensor:
    """Coverage (H, W) of one curve as the settings ask; "exact" has the derivative of the relaxed edge."""
    centres = pixel_centres(width, height, half_width.device)
    relaxed = coverage_relaxed(vertices, half_width, centres, mode, settings.edge_width)
    if settings.coverage == "relaxed":
        return relaxed
    return _with_gradient(coverage_exact(vertices, half_width, mode, width, height), relaxed)


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
