"""A penalty on slivers: places where two sides of an outline, with the shape between them, run against each other,
closer than about a third of a pixel.
"""

from __future__ import annotations

from ctypes import c_float, c_int32, c_void_p

import numpy as np

from cubicsplat_cli.photo.segments import SegmentIndices, interleaved, lengths, points_of_segments, segments_of
from cubicsplat_cli.raster.cpu import library
from cubicsplat_cli.scene.arrays import Array, as_numpy, like, namespace
from cubicsplat_cli.settings import Mode

THINNEST = 0.36  # px: a little more than what is called a sliver, a third of a px, so that those end above
EDGES = 12  # of a segment: its polyline, whose edges are held against one another
OPPOSITE = -0.5  # cosine between two edges that are two sides, and not one that bends
_PAIRS = 2**22  # of edges at once, of 4 bytes a value
_LEAST_LENGTH = 1e-6  # px


def sliver_gradient(
    points: Array, weight: float | Array, size: tuple[int, int], ring_ends: Array | None = None
) -> Array:
    """Gradient (N, K, 2), for closed curves, of weight times the sum over all pairs of opposite edges of
    l relu(D - |d|): d the distance in px of the middle of the one, of length l, from the other, if its foot lies on
    that and the shape lies between them and not beyond either; D `THINNEST`. The lengths count as given. size: width
    and height of the canvas, px, beyond which nothing counts. ring_ends: as in `Scene`.
    """
    if str(points.device) == "cpu":
        return weight * like(points, _native_gradient(as_numpy(points), size, ring_ends))
    return weight * gradient_by_arrays(points, size, ring_ends)


def _native_gradient(points: np.ndarray, size: tuple[int, int], ring_ends: Array | None) -> np.ndarray:
    """The same with weight 1, float32, by the native library. Raises EngineError where that is missing."""
    points = np.ascontiguousarray(points, np.float32)
    ends = None if ring_ends is None else np.ascontiguousarray(as_numpy(ring_ends), np.int32)
    found = np.empty_like(points)
    call = library().cs_slivers
    call.restype = None
    call.argtypes = [c_void_p, c_int32, c_int32, c_void_p, c_int32, c_int32, *[c_float] * 4, c_void_p]
    call(
        points.ctypes.data, points.shape[0], points.shape[1] // 3, None if ends is None else ends.ctypes.data,
        0 if ends is None else ends.shape[1], EDGES, THINNEST, OPPOSITE, *size, found.ctypes.data,
    )  # fmt: skip
    return found


def gradient_by_arrays(points: Array, size: tuple[int, int], ring_ends: Array | None = None) -> Array:
    """The same with weight 1, by whatever computes with such arrays: for a GPU."""
    xp, found = namespace(points), segments_of(points, Mode.CLOSED, ring_ends)
    edges = found.index.shape[1] * EDGES
    many = max(1, _PAIRS // edges**2)
    parts = []
    for begin in range(0, len(points), many):
        chosen = slice(begin, begin + many)
        own = found if ring_ends is None else SegmentIndices(*(each[chosen] for each in vars(found).values()))
        parts.append(_gradient(points[chosen], own, found.real[chosen], size))
    return xp.concat(parts, axis=0)


def _gradient(points: Array, found: SegmentIndices, real: Array, size: tuple[int, int]) -> Array:
    xp, (n, m) = namespace(points), real.shape
    t = xp.arange(EDGES + 1, dtype=points.dtype, device=points.device) / EDGES
    basis = xp.stack(((1 - t) ** 3, 3 * (1 - t) ** 2 * t, 3 * (1 - t) * t * t, t**3), axis=1)
    places = [*(3 * found.index + k for k in range(3)), 3 * found.after]
    corners = xp.stack([points_of_segments(points, place) for place in places], axis=2)
    vertices = xp.matmul(basis, corners)  # (n, m, EDGES + 1, 2)
    starts, ends = (xp.reshape(v, (n, m * EDGES, 2)) for v in (vertices[:, :, :-1], vertices[:, :, 1:]))
    long = xp.clip(lengths(ends - starts), min=_LEAST_LENGTH)
    along = (ends - starts) / long[..., None]
    force, share = _forces(starts, ends, along, long, xp.repeat(real, EDGES, axis=1), size)
    normals = xp.stack((-along[..., 1], along[..., 0]), axis=-1)
    of_middles = 0.5 * xp.matmul(force, normals)
    at_end = xp.sum(force * share, axis=1)
    of_starts = of_middles - normals * (xp.sum(force, axis=1) - at_end)[..., None]
    of_ends = of_middles - normals * at_end[..., None]
    nothing = xp.zeros_like(vertices[:, :, :1])
    of_vertices = xp.concat((xp.reshape(of_starts, (n, m, EDGES, 2)), nothing), axis=2)
    of_vertices = of_vertices + xp.concat((nothing, xp.reshape(of_ends, (n, m, EDGES, 2))), axis=2)
    a, b, c, d = (xp.matmul(basis.T, of_vertices)[:, :, k] for k in range(4))
    a = a + points_of_segments(d, found.before) * real[..., None]
    return interleaved(a, b, c, nothing[:, 0], Mode.CLOSED)


def _forces(
    starts: Array, ends: Array, along: Array, long: Array, is_edge: Array, size: tuple[int, int]
) -> tuple[Array, Array]:
    """Of each pair (n, V, V) the derivative by the distance of the first one's middle from the second edge, to its left
    positive, and where on that the foot lies, 0 to 1.
    """
    xp, middles = namespace(starts), 0.5 * (starts + ends)
    x, y = middles[..., 0], middles[..., 1]
    shown = (x >= 0.0) & (x <= size[0]) & (y >= 0.0) & (y <= size[1])
    origin = xp.mean(middles, axis=1)[:, None]  # near the curve, where float32 is fine
    middles, starts, ends = middles - origin, starts - origin, ends - origin
    normals = xp.stack((-along[..., 1], along[..., 0]), axis=-1)
    distance = _seen(normals, starts, middles)
    share = _seen(along / long[..., None], starts, middles)
    left = _windings(distance, starts[..., 1], ends[..., 1], middles[..., 1], is_edge)
    pair = xp.matmul(along, xp.matrix_transpose(along)) < OPPOSITE
    pair &= (xp.abs(distance) < THINNEST) & (distance != 0.0)
    pair &= xp.abs(share - 0.5) <= 0.5
    pair &= (is_edge & shown)[:, :, None] & is_edge[:, None, :]
    # Inside between them and outside beyond both: elsewhere it is a gap, or lies within the shape.
    within = xp.astype(distance > 0.0, left.dtype)
    pair &= (left[:, :, None] == within) & (left[:, None, :] == within)
    force = -xp.sign(distance) * long[:, :, None]
    return xp.where(pair, force, 0.0), share


def _windings(distance: Array, starts: Array, ends: Array, middles: Array, is_edge: Array) -> Array:
    """(n, V): the winding numbers to the left of the middle of each edge, by the edges that a ray from it towards +x
    crosses; the ray begins just left of the edge itself. starts, ends, middles: (n, V) y, px.
    """
    xp = namespace(distance)
    rising = ends > starts
    reached = (starts[:, None, :] <= middles[:, :, None]) != (ends[:, None, :] <= middles[:, :, None])
    number = xp.arange(starts.shape[1], device=distance.device)
    reached &= is_edge[:, None, :] & (number[:, None] != number)
    up = reached & rising[:, None, :] & (distance > 0.0)
    down = reached & ~rising[:, None, :] & (distance < 0.0)
    return xp.sum(xp.astype(up, xp.int64) - xp.astype(down, xp.int64), axis=-1) + xp.astype(rising, xp.int64)


def _seen(axes: Array, starts: Array, middles: Array) -> Array:
    """(n, V, V): each middle along each edge's axis from its start, a x m - a x s."""
    xp = namespace(axes)
    offset = xp.sum(axes * starts, axis=-1)
    return xp.matmul(middles, xp.matrix_transpose(axes)) - offset[:, None, :]
