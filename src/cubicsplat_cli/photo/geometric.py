"""Regularisers: the non-crossing penalty of LIVE (an ablation: it costs quality, see docs/lab/photos.md), and one on
spikes, which show when a file is enlarged: joins at which an outline turns back on itself, and slivers.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.raster.cpu import Blunting, address_of
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import segments_from_points
from cubicsplat_cli.scene.arrays import Array, namespace
from cubicsplat_cli.settings import Mode, Recipe

SPIKE_TURN = math.radians(147.0)  # a little less than what is called a spike, 150 degrees, so that those end below
LEAST_ARM = 0.3  # px: shorter handles are pulled no more than such
LEAST_CROSSING = 1e-6  # px^2, of the lengths of two handles, which are no shorter as a divisor
SPIKES_FROM = 0.1  # of the fit: a small penalty for long costs less than a large one for a short time
TURNS = 0.28  # times what a join has of the loss, for a radian that it turns too far
SLIVERS = 5.0  # times what a pixel has of the loss, for a px^2 of slivers
HELD = 3  # steps: the gradient changes slowly, and takes a tenth of a step
_NEXT_TO_NOTHING = 1e-30
# Of slivers: places where two sides of an outline, with the shape between them, run against each other.
THINNEST = 0.36  # px: a little more than what is called a sliver, a third of a px, so that those end above
EDGES = 12  # of a segment: its polyline, whose edges are held against one another
OPPOSITE = -0.5  # cosine between two edges that are two sides, and not one that bends
_PAIRS = 2**22  # of edges at once, of 4 bytes a value
_LEAST_LENGTH = 1e-6  # px


class Regulariser:
    """The penalties of a recipe beside the error of a picture. size: its width and height, px. joins: of all curves."""

    def __init__(self, recipe: Recipe, mode: Mode, size: tuple[int, int], joins: int) -> None:
        self.recipe, self.mode, self.size, self.joins = recipe, mode, size, joins
        self._held: Array | None = None
        self._left = 0  # steps for which that is good
        self._blunting: tuple[Blunting, np.ndarray] | None = None  # and the gradient that it points to

    def forget(self) -> None:
        """The curves are others from now on."""
        self._left = 0
        if self._blunting is not None:
            self._blunting[0].left = 0

    def due(self, progress: float) -> bool:
        """Whether spikes and slivers count at this progress of the fit in [0, 1]."""
        return self.recipe.spike_penalty > 0.0 and progress > SPIKES_FROM

    def blunting(self, points: np.ndarray, loss: float) -> Blunting:
        """The penalty on spikes and slivers as the CPU's engine takes it; loss: of the last step."""
        if self._blunting is None:
            found = np.empty_like(points)
            constants = SPIKE_TURN, LEAST_ARM, THINNEST, OPPOSITE, EDGES, HELD
            self._blunting = Blunting(*self._weights(), loss, *constants, 0, address_of(found)), found
        self._blunting[0].loss = loss
        return self._blunting[0]

    def _weights(self) -> tuple[float, float]:
        """Of turns and of slivers, times the loss."""
        # In shares of the loss that a join, and a pixel, has: what suits one picture then suits all.
        weight = self.recipe.spike_penalty
        return TURNS * weight / self.joins, SLIVERS * weight / (self.size[0] * self.size[1])

    def gradient(self, points: Array, ring_ends: Array | None, *, progress: float, loss: float | Array) -> Array | None:
        """(N, K, 2), at this progress of the fit in [0, 1]; None where it is nothing. loss: of the last step. Without
        what `blunting` says of numpy's arrays.
        """
        crossing, found = self.recipe.crossing_penalty * self.size[0] * self.size[1], None
        if crossing > 0.0:
            found = crossing_gradient(points, self.mode, crossing, ring_ends)
        if not self.due(progress) or isinstance(points, np.ndarray):
            return found
        if self._left == 0:
            self._held, self._left = self._of_spikes(points, ring_ends, loss), HELD
        self._left -= 1
        return self._held if found is None else found + self._held

    def _of_spikes(self, points: Array, ring_ends: Array | None, loss: float | Array) -> Array:
        turns, slivers = self._weights()
        found = spike_gradient(points, self.mode, turns * loss, self.size, ring_ends)
        if self.mode is Mode.CLOSED:
            found = found + sliver_gradient(points, slivers * loss, self.size, ring_ends)
        return found


def crossing_gradient(points: Array, mode: Mode, weight: float, ring_ends: Array | None = None) -> Array:
    """Gradient (N, K, 2) of weight times the mean over all cubics of the Xing loss of points (N, K, 2), which is 0
    where no handles of a cubic cross, and at most 1.

    For a cubic A B C D let D1 = [AB x BC > 0] and D2 = AB x CD / (|AB| |CD|), the sine between the handles. A cubic
    whose handles turn the other way at its end crosses itself or nearly so: the loss is relu(-D2) where D1, else
    relu(D2). ring_ends: as in `Scene`. Source: LIVE (Ma et al., "Towards Layer-wise Image Vectorization", CVPR 2022),
    section on the Xing loss.
    """
    xp, found = namespace(points), segments_of(points, mode, ring_ends)
    first, last, side = _handles(points, mode, found)
    # The sine is the cosine between the first handle, turned by a right angle, and the last one.
    turned = xp.stack((-first[..., 1], first[..., 0]), axis=-1)
    sine, of_turned, of_last = _cosine(turned, last, LEAST_CROSSING)
    factor = weight * side * ((side * sine > 0.0) & found.real) / xp.sum(xp.astype(found.real, points.dtype))
    of_first = factor[..., None] * xp.stack((of_turned[..., 1], -of_turned[..., 0]), axis=-1)
    of_last = factor[..., None] * of_last
    starts, ends = -of_first, xp.zeros_like(of_last[:, :1])
    if mode is Mode.CLOSED:
        starts = starts + points_of_segments(of_last, found.before) * found.real[..., None]
    else:
        starts, ends = starts + xp.concat((ends, of_last[:, :-1]), axis=1), of_last[:, -1:]
    return interleaved(starts, of_first, -of_last, ends, mode)


def spike_gradient(
    points: Array, mode: Mode, weight: float | Array, size: tuple[int, int], ring_ends: Array | None = None
) -> Array:
    """Gradient (N, K, 2) of weight times the sum over all joins on the canvas of relu(t - `SPIKE_TURN`), t the turn in
    radians from the handle before the join to the one after it; at most weight / `LEAST_ARM` a point. size: width and
    height of the canvas, px. ring_ends: as in `Scene`.
    """
    xp, found = namespace(points), segments_of(points, mode, ring_ends)
    joins, joined = points_of_segments(points, 3 * found.index), found.real
    if mode is Mode.OPEN:
        joined = joined & (found.index > 0)
    x, y = joins[..., 0], joins[..., 1]
    joined = joined & (x >= 0.0) & (x <= size[0]) & (y >= 0.0) & (y <= size[1])
    arriving = joins - points_of_segments(points, 3 * found.before + 2)
    leaving = points_of_segments(points, 3 * found.index + 1) - joins
    turn, of_arriving, of_leaving = _turn(arriving, leaving)
    factor = xp.astype((turn > SPIKE_TURN) & joined, points.dtype)[..., None]
    of_arriving, of_leaving = factor * of_arriving, factor * of_leaving
    nothing = xp.zeros_like(of_arriving[:, :1])
    if mode is Mode.CLOSED:
        thirds = -points_of_segments(of_arriving, found.after) * found.real[..., None]
    else:
        thirds = -xp.concat((of_arriving[:, 1:], nothing), axis=1)
    gradient = interleaved(of_arriving - of_leaving, of_leaving, thirds, nothing, mode)
    # The angle at a handle of no length may change at any rate.
    long = xp.clip(lengths(gradient)[..., None], min=1e-9)
    return weight * gradient * xp.clip(1.0 / (LEAST_ARM * long), max=1.0)


def _handles(points: Array, mode: Mode, found: SegmentIndices) -> tuple[Array, Array, Array]:
    """First and last handle (N, M, 2) of each cubic, and (N, M) -1 where it turns left between them, else 1."""
    xp = namespace(points)
    a, b, c = (points_of_segments(points, 3 * found.index + k) for k in range(3))
    d = points_of_segments(points, 3 * found.after)
    first, middle, last = b - a, c - b, d - c
    return first, last, 1.0 - 2.0 * xp.astype(cross(first, middle) > 0, points.dtype)


def _cosine(u: Array, v: Array, least: float) -> tuple[Array, Array, Array]:
    """u v / max(|u| |v|, least) of vectors (..., 2), and its derivatives by u and by v."""
    xp = namespace(u)
    product = lengths(u) * lengths(v)
    divisor = xp.clip(product, min=least)[..., None]
    cosine = xp.sum(u * v, axis=-1)[..., None] / divisor
    through = cosine * (product >= least)[..., None]
    of_u, of_v = (
        other / divisor - through * own / xp.clip(xp.sum(own * own, axis=-1)[..., None], min=_NEXT_TO_NOTHING)
        for own, other in ((u, v), (v, u))
    )
    return cosine[..., 0], of_u, of_v


def _turn(u: Array, v: Array) -> tuple[Array, Array, Array]:
    """The angle between vectors (..., 2), in radians, and its derivatives by u and by v."""
    xp = namespace(u)
    turned, along = cross(u, v), xp.sum(u * v, axis=-1)
    across = xp.abs(turned) + 1e-6
    squared = across * across + along * along
    by_cross, by_along = (xp.sign(turned) * along / squared)[..., None], (-across / squared)[..., None]
    of_u = by_cross * xp.stack((v[..., 1], -v[..., 0]), axis=-1) + by_along * v
    of_v = by_cross * xp.stack((-u[..., 1], u[..., 0]), axis=-1) + by_along * u
    return xp.atan2(across, along), of_u, of_v


def sliver_gradient(
    points: Array, weight: float | Array, size: tuple[int, int], ring_ends: Array | None = None
) -> Array:
    """Gradient (N, K, 2), for closed curves, of weight times the sum over all pairs of opposite edges of
    l relu(D - |d|): d the distance in px of the middle of the one, of length l, from the other, if its foot lies on
    that and the shape lies between them and not beyond either; D `THINNEST`. The lengths count as given. size: width
    and height of the canvas, px, beyond which nothing counts. ring_ends: as in `Scene`.
    """
    xp, found = namespace(points), segments_of(points, Mode.CLOSED, ring_ends)
    edges = found.index.shape[1] * EDGES
    many = max(1, _PAIRS // edges**2)
    parts = []
    for begin in range(0, len(points), many):
        chosen = slice(begin, begin + many)
        own = found if ring_ends is None else SegmentIndices(*(each[chosen] for each in vars(found).values()))
        parts.append(_gradient(points[chosen], own, found.real[chosen], size))
    return weight * xp.concat(parts, axis=0)


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


@record
class SegmentIndices:
    """Of each segment, (N, M) or, where curves do not differ, (1, M): its number, and those of the ones before and
    after it, round its ring if it is closed, else from 0 to the number of segments; and, (N, M), whether it is one, and
    not room that a shorter curve leaves.
    """

    index: Array
    before: Array
    after: Array
    real: Array


def segments_of(points: Array, mode: Mode, ring_ends: Array | None) -> SegmentIndices:
    xp, count, device = namespace(points), segments_from_points(mode, points.shape[1]), points.device
    if ring_ends is None:
        ends = xp.full((1, 1), count, dtype=xp.int64, device=device)
    else:
        ends = xp.astype(ring_ends, xp.int64)
    index = xp.broadcast_to(xp.arange(count, device=device), (len(ends), count))
    before, after = xp.clip(index - 1, min=0), index + 1
    if mode is Mode.CLOSED:
        ring = xp.clip(
            xp.sum(xp.astype(index[:, :, None] >= ends[:, None, :], xp.int64), axis=-1), max=ends.shape[1] - 1
        )
        start = xp.take_along_axis(xp.concat((xp.zeros_like(ends[:, :1]), ends), axis=1), ring, axis=1)
        end = xp.take_along_axis(ends, ring, axis=1)
        before, after = xp.where(index == start, end - 1, before), xp.where(after >= end, start, after)
    return SegmentIndices(index, before, after, xp.broadcast_to(index < ends[:, -1:], (len(points), count)))


def interleaved(starts: Array, seconds: Array, thirds: Array, end: Array, mode: Mode) -> Array:
    """(N, K, 2) from what each segment's first three points have, (N, M, 2), and a stroke's last one, (N, 1, 2)."""
    xp, (n, m, _) = namespace(starts), starts.shape
    found = xp.reshape(xp.stack((starts, seconds, thirds), axis=2), (n, 3 * m, 2))
    return found if mode is Mode.CLOSED else xp.concat((found, end), axis=1)


def points_of_segments(values: Array, index: Array) -> Array:
    """Of (N, K, 2) those at (N or 1, M) places of each curve: (N, M, 2)."""
    return namespace(values).take_along_axis(values, index[..., None], axis=1)


def lengths(u: Array) -> Array:
    xp = namespace(u)
    return xp.sqrt(xp.sum(u * u, axis=-1))


def cross(u: Array, v: Array) -> Array:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
