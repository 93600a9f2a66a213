"""Optional regularisers: the non-crossing penalty of LIVE (an ablation: it costs quality, see docs/ablations.md), and
one on thorns, joins at which an outline turns back on itself, which show when a file is enlarged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from cubicsplat_cli.scene import segments_from_points
from cubicsplat_cli.scene.arrays import Array, namespace
from cubicsplat_cli.settings import Mode, Recipe

THORN_TURN = math.radians(140.0)  # less than what is called a thorn, 150 degrees, so that those end below
LEAST_ARM = 0.3  # px: shorter handles are pulled no more than such
LEAST_CROSSING = 1e-6  # px^2, of the lengths of two handles, which are no shorter as a divisor
THORNS_FROM = 0.5  # of the fit: earlier they are on their way to something
_NEXT_TO_NOTHING = 1e-30


def regulariser(
    recipe: Recipe, points: Array, mode: Mode, ring_ends: Array | None, *, progress: float, pixels: int,
    joins: int, loss: float | Array,
) -> Array | None:  # fmt: skip
    """Gradient (N, K, 2) of what a recipe penalises beside the error of a picture of so many pixels, at this progress
    of the fit in [0, 1]; None where it is nothing. joins: of all curves. loss: of the last step.
    """
    found = None
    if recipe.geometric_reg > 0.0:
        found = crossing_gradient(points, mode, recipe.geometric_reg * pixels, ring_ends)
    if recipe.thorn_reg > 0.0 and progress > THORNS_FROM:
        # In shares of what a join has of the loss: what suits one picture then suits all.
        blunting = thorn_gradient(points, mode, recipe.thorn_reg, ring_ends) * (loss / joins)
        found = blunting if found is None else found + blunting
    return found


def crossing_penalty(points: Array, mode: Mode, ring_ends: Array | None = None) -> Array:
    """Mean over all cubics of the Xing loss of points (N, K, 2): 0 where no cubic's handles cross, at most 1.

    For a cubic A B C D let D1 = [AB x BC > 0] and D2 = AB x CD / (|AB| |CD|), the sine between the handles. A cubic
    whose handles turn the other way at its end crosses itself or nearly so: the loss is relu(-D2) where D1, else
    relu(D2). ring_ends: as in `Scene`. Source: LIVE (Ma et al., "Towards Layer-wise Image Vectorization", CVPR 2022),
    section on the Xing loss.
    """
    xp, found = namespace(points), _segments(points, mode, ring_ends)
    first, last, side = _handles(points, mode, found)
    sine = _cross(first, last) / xp.clip(_length(first) * _length(last), min=LEAST_CROSSING)
    return xp.sum(xp.clip(side * sine, min=0.0) * found.real) / xp.sum(xp.astype(found.real, points.dtype))


def crossing_gradient(points: Array, mode: Mode, weight: float, ring_ends: Array | None = None) -> Array:
    """Gradient of weight * crossing_penalty with respect to the points, (N, K, 2)."""
    xp, found = namespace(points), _segments(points, mode, ring_ends)
    first, last, side = _handles(points, mode, found)
    # The sine is the cosine between the first handle, turned by a right angle, and the last one.
    turned = xp.stack((-first[..., 1], first[..., 0]), axis=-1)
    sine, of_turned, of_last = _cosine(turned, last, LEAST_CROSSING)
    factor = weight * side * ((side * sine > 0.0) & found.real) / xp.sum(xp.astype(found.real, points.dtype))
    of_first = factor[..., None] * xp.stack((of_turned[..., 1], -of_turned[..., 0]), axis=-1)
    of_last = factor[..., None] * of_last
    starts, ends = -of_first, xp.zeros_like(of_last[:, :1])
    if mode is Mode.CLOSED:
        starts = starts + _taken(of_last, found.before) * found.real[..., None]
    else:
        starts, ends = starts + xp.concat((ends, of_last[:, :-1]), axis=1), of_last[:, -1:]
    return _together(starts, of_first, -of_last, ends, mode)


def thorn_gradient(points: Array, mode: Mode, weight: float, ring_ends: Array | None = None) -> Array:
    """Gradient (N, K, 2) of weight times the sum over all joins of relu(t - `THORN_TURN`), t the turn in radians from
    the handle before the join to the one after it; at most weight / `LEAST_ARM` a point. ring_ends: as in `Scene`.
    """
    xp, found = namespace(points), _segments(points, mode, ring_ends)
    joins, joined = _taken(points, 3 * found.index), found.real
    if mode is Mode.OPEN:
        joined = joined & (found.index > 0)
    arriving = joins - _taken(points, 3 * found.before + 2)
    leaving = _taken(points, 3 * found.index + 1) - joins
    turn, of_arriving, of_leaving = _turn(arriving, leaving)
    factor = xp.astype((turn > THORN_TURN) & joined, points.dtype)[..., None]
    of_arriving, of_leaving = factor * of_arriving, factor * of_leaving
    nothing = xp.zeros_like(of_arriving[:, :1])
    if mode is Mode.CLOSED:
        thirds = -_taken(of_arriving, found.after) * found.real[..., None]
    else:
        thirds = -xp.concat((of_arriving[:, 1:], nothing), axis=1)
    gradient = _together(of_arriving - of_leaving, of_leaving, thirds, nothing, mode)
    # The angle at a handle of no length may change at any rate.
    size = xp.clip(_length(gradient)[..., None], min=1e-9)
    return weight * gradient * xp.clip(1.0 / (LEAST_ARM * size), max=1.0)


@dataclass(frozen=True)
class _Segments:
    """Of each segment, (N, M) or, where curves do not differ, (1, M): its number, and those of the ones before and
    after it, round its ring if it is closed, else from 0 to the number of segments; and, (N, M), whether it is one, and
    not room that a shorter curve leaves.
    """

    index: Array
    before: Array
    after: Array
    real: Array


def _segments(points: Array, mode: Mode, ring_ends: Array | None) -> _Segments:
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
    return _Segments(index, before, after, xp.broadcast_to(index < ends[:, -1:], (len(points), count)))


def _handles(points: Array, mode: Mode, found: _Segments) -> tuple[Array, Array, Array]:
    """First and last handle (N, M, 2) of each cubic, and (N, M) -1 where it turns left between them, else 1."""
    xp = namespace(points)
    a, b, c = (_taken(points, 3 * found.index + k) for k in range(3))
    d = _taken(points, 3 * found.after)
    first, middle, last = b - a, c - b, d - c
    return first, last, 1.0 - 2.0 * xp.astype(_cross(first, middle) > 0, points.dtype)


def _cosine(u: Array, v: Array, least: float) -> tuple[Array, Array, Array]:
    """u v / max(|u| |v|, least) of vectors (..., 2), and its derivatives by u and by v."""
    xp = namespace(u)
    product = _length(u) * _length(v)
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
    cross, along = _cross(u, v), xp.sum(u * v, axis=-1)
    across = xp.abs(cross) + 1e-6
    squared = across * across + along * along
    by_cross, by_along = (xp.sign(cross) * along / squared)[..., None], (-across / squared)[..., None]
    of_u = by_cross * xp.stack((v[..., 1], -v[..., 0]), axis=-1) + by_along * v
    of_v = by_cross * xp.stack((-u[..., 1], u[..., 0]), axis=-1) + by_along * u
    return xp.atan2(across, along), of_u, of_v


def _together(starts: Array, seconds: Array, thirds: Array, end: Array, mode: Mode) -> Array:
    """(N, K, 2) from what each segment's first three points have, (N, M, 2), and a stroke's last one, (N, 1, 2)."""
    xp, (n, m, _) = namespace(starts), starts.shape
    found = xp.reshape(xp.stack((starts, seconds, thirds), axis=2), (n, 3 * m, 2))
    return found if mode is Mode.CLOSED else xp.concat((found, end), axis=1)


def _taken(values: Array, index: Array) -> Array:
    """Of (N, K, 2) those at (N or 1, M) places of each curve: (N, M, 2)."""
    return namespace(values).take_along_axis(values, index[..., None], axis=1)


def _length(u: Array) -> Array:
    xp = namespace(u)
    return xp.sqrt(xp.sum(u * u, axis=-1))


def _cross(u: Array, v: Array) -> Array:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
