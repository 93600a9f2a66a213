"""Regularisers: the non-crossing penalty of LIVE (an ablation: it costs quality, see docs/lab/photos.md), and one on
spikes, which show when a file is enlarged: joins at which an outline turns back on itself, and slivers.
"""

from __future__ import annotations

import math

from cubicsplat_cli.photo.segments import SegmentIndices, cross, interleaved, lengths, points_of_segments, segments_of
from cubicsplat_cli.photo.slivers import sliver_gradient
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


class Regulariser:
    """The penalties of a recipe beside the error of a picture. size: its width and height, px. joins: of all curves."""

    def __init__(self, recipe: Recipe, mode: Mode, size: tuple[int, int], joins: int) -> None:
        self.recipe, self.mode, self.size, self.joins = recipe, mode, size, joins
        self._held: Array | None = None
        self._left = 0  # steps for which that is good

    def forget(self) -> None:
        """The curves are others from now on."""
        self._left = 0

    def gradient(self, points: Array, ring_ends: Array | None, *, progress: float, loss: float | Array) -> Array | None:
        """(N, K, 2), at this progress of the fit in [0, 1]; None where it is nothing. loss: of the last step."""
        if self._left == 0:
            self._held, self._left = self._gradient(points, ring_ends, progress, loss), HELD
            if self.recipe.crossing_penalty > 0.0:
                self._left = 1
        self._left -= 1
        return self._held

    def _gradient(self, points: Array, ring_ends: Array | None, progress: float, loss: float | Array) -> Array | None:
        recipe, found = self.recipe, None
        pixels = self.size[0] * self.size[1]
        if recipe.crossing_penalty > 0.0:
            found = crossing_gradient(points, self.mode, recipe.crossing_penalty * pixels, ring_ends)
        if recipe.spike_penalty > 0.0 and progress > SPIKES_FROM:
            # In shares of the loss that a join, and a pixel, has: what suits one picture then suits all.
            weight = recipe.spike_penalty * loss
            blunting = spike_gradient(points, self.mode, TURNS * weight / self.joins, self.size, ring_ends)
            if self.mode is Mode.CLOSED:
                blunting = blunting + sliver_gradient(points, SLIVERS * weight / pixels, self.size, ring_ends)
            found = blunting if found is None else found + blunting
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
