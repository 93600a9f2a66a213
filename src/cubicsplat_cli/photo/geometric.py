"""Regularisers: the non-crossing penalty of LIVE (an ablation: it costs quality, see docs/lab/photos.md), and one on
spikes, which show when a file is enlarged: joins at which an outline turns back on itself, and slivers.
"""

from __future__ import annotations

import math

from cubicsplat_cli.raster.cpu import Blunting
from cubicsplat_cli.raster.native import address_on
from cubicsplat_cli.scene import segments_from_points
from cubicsplat_cli.scene.arrays import Array, namespace
from cubicsplat_cli.settings import Mode, Recipe

SPIKE_TURN = math.radians(147.0)  # a little less than what is called a spike, 150 degrees, so that those end below
LEAST_ARM = 0.3  # px: shorter handles are pulled no more than such
LEAST_CROSSING = 1e-6  # px^2, of the lengths of two handles, which are no shorter as a divisor
SPIKES_FROM = 0.1  # of the fit: a small penalty for long costs less than a large one for a short time
TURNS = 0.28  # times what a join has of the loss, for a radian that it turns too far
SLIVERS = 5.0  # times what a pixel has of the loss, for a px^2 of slivers
HELD = 3  # steps for which a gradient is good: it changes slowly, and takes a tenth of a step
_NEXT_TO_NOTHING = 1e-30
# Of slivers: places where two sides of an outline, with the shape between them, run against each other.
THINNEST = 0.36  # px: a little more than what is called a sliver, a third of a px, so that those end above
EDGES = 12  # of a segment: its polyline, whose edges are held against one another
OPPOSITE = -0.5  # cosine between two edges that are two sides, and not one that bends


class Regulariser:
    """The penalties of a recipe beside a picture's error. size: its width and height, px. joins: of all curves."""

    def __init__(self, recipe: Recipe, mode: Mode, size: tuple[int, int], joins: int) -> None:
        self.recipe, self.mode, self.size, self.joins = recipe, mode, size, joins
        self._blunting: Blunting | None = None
        self.spikes: Array | None = None  # (N, K, 2): the gradient that an engine finds
        self._loss: Array | None = None

    def forget(self) -> None:
        """Find the gradient of spikes anew in the next step, because the curves are others."""
        if self._blunting is not None:
            self._blunting.left = 0

    def due(self, progress: float) -> bool:
        """Return whether spikes and slivers count at this progress of the fit, in [0, 1]."""
        return self.recipe.spike_penalty > 0.0 and progress > SPIKES_FROM

    def blunting(self, points: Array, *, progress: float, loss: float | Array) -> Blunting | None:
        """Return the penalty on spikes and slivers for an engine; None if they do not count.

        points: (N, K, 2), the engine's own. loss: of the last step; a tensor stays on its device.
        """
        if not self.due(progress):
            return None
        if self._blunting is None:
            weight = self.recipe.spike_penalty
            self.spikes = namespace(points).empty_like(points)
            gradient = address_on(points.device, self.spikes, "spikes", tuple(points.shape), "float32")
            # In shares of the loss that a join, and a pixel, has: what suits one picture then suits all.
            turns, slivers = TURNS * weight / self.joins, SLIVERS * weight / (self.size[0] * self.size[1])
            self._blunting = Blunting(
                turns, slivers, turn=SPIKE_TURN, arm=LEAST_ARM, thinnest=THINNEST, opposite=OPPOSITE, edges=EDGES,
                every=HELD, gradient=gradient,
            )  # fmt: skip
        if isinstance(loss, float):
            self._blunting.loss = loss
        else:
            self._loss = namespace(loss).asarray(loss, dtype=namespace(loss).float64)
            self._blunting.loss_at = address_on(points.device, self._loss, "loss", (), "float64")
        return self._blunting

    def crossing_gradient(self, points: Array, ring_ends: Array | None) -> Array | None:
        """Return the gradient (N, K, 2) of the penalty on self-crossings; None without one."""
        weight = self.recipe.crossing_penalty * self.size[0] * self.size[1]
        return crossing_gradient(points, self.mode, weight, ring_ends) if weight > 0.0 else None


def crossing_gradient(points: Array, mode: Mode, weight: float, ring_ends: Array | None = None) -> Array:
    """Return the gradient (N, K, 2) of weight times the mean over all cubics of the Xing loss of points (N, K, 2). The
    loss of a cubic is 0 if its handles do not cross, and at most 1.

    For a cubic A B C D let D1 = [AB x BC > 0] and D2 = AB x CD / (|AB| |CD|), the sine between the handles. A cubic
    whose handles turn the other way at its end crosses itself or nearly so: the loss is relu(-D2) where D1, else
    relu(D2). ring_ends: as in `Scene`. Source: the Xing loss of LIVE (Ma et al., CVPR 2022).
    """
    xp, (index, before, after, real) = namespace(points), segments_of(points, mode, ring_ends)
    first, last, side = _handles(points, index, after)
    # The sine is the cosine between the first handle, turned by a right angle, and the last one.
    turned = xp.stack((-first[..., 1], first[..., 0]), axis=-1)
    sine, of_turned, of_last = _cosine(turned, last)
    factor = weight * side * ((side * sine > 0.0) & real) / xp.sum(xp.astype(real, points.dtype))
    of_first = factor[..., None] * xp.stack((of_turned[..., 1], -of_turned[..., 0]), axis=-1)
    of_last = factor[..., None] * of_last
    closed = mode is Mode.CLOSED
    if closed:
        starts = points_of_segments(of_last, before) * real[..., None] - of_first
    else:
        starts = xp.concat((xp.zeros_like(of_last[:, :1]), of_last[:, :-1]), axis=1) - of_first
    of_points = xp.reshape(xp.stack((starts, of_first, -of_last), axis=2), (len(points), -1, 2))
    return of_points if closed else xp.concat((of_points, of_last[:, -1:]), axis=1)


def _handles(points: Array, index: Array, after: Array) -> tuple[Array, Array, Array]:
    """Return the first and last handle (N, M, 2) of each cubic, and (N, M) -1 if it turns left between them, else 1."""
    xp = namespace(points)
    a, b, c = (points_of_segments(points, 3 * index + k) for k in range(3))
    d = points_of_segments(points, 3 * after)
    first, middle, last = b - a, c - b, d - c
    turn = first[..., 0] * middle[..., 1] - first[..., 1] * middle[..., 0]
    return first, last, 1.0 - 2.0 * xp.astype(turn > 0, points.dtype)


def _cosine(u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Return u v / max(|u| |v|, LEAST_CROSSING) of vectors (..., 2), and its derivatives by u and by v."""
    xp = namespace(u)
    product = xp.sqrt(xp.sum(u * u, axis=-1)) * xp.sqrt(xp.sum(v * v, axis=-1))
    divisor = xp.clip(product, min=LEAST_CROSSING)[..., None]
    cosine = xp.sum(u * v, axis=-1)[..., None] / divisor
    through = cosine * (product >= LEAST_CROSSING)[..., None]
    of_u, of_v = (
        other / divisor - through * own / xp.clip(xp.sum(own * own, axis=-1)[..., None], min=_NEXT_TO_NOTHING)
        for own, other in ((u, v), (v, u))
    )
    return cosine[..., 0], of_u, of_v


def segments_of(points: Array, mode: Mode, ring_ends: Array | None) -> tuple[Array, Array, Array, Array]:
    """Return of each segment of curves (N, K, 2), (N, M) or, where curves do not differ, (1, M): its number, and those
    of the ones before and after it, round its ring if it is closed, else from 0 to the number of segments; and, (N, M),
    whether it is one, and not room that a shorter curve leaves. ring_ends: as in `Scene`.
    """
    xp, count, device = namespace(points), segments_from_points(mode, points.shape[1]), points.device
    if ring_ends is None:
        ends = xp.full((1, 1), count, dtype=xp.int64, device=device)
    else:
        ends = xp.astype(ring_ends, xp.int64)
    index = xp.broadcast_to(xp.arange(count, device=device), (len(ends), count))
    before, after = xp.clip(index - 1, min=0), index + 1
    if mode is Mode.CLOSED:
        ended = xp.sum(xp.astype(index[:, :, None] >= ends[:, None, :], xp.int64), axis=-1)
        ring = xp.clip(ended, max=ends.shape[1] - 1)
        start = xp.take_along_axis(xp.concat((xp.zeros_like(ends[:, :1]), ends), axis=1), ring, axis=1)
        end = xp.take_along_axis(ends, ring, axis=1)
        before, after = xp.where(index == start, end - 1, before), xp.where(after >= end, start, after)
    return index, before, after, xp.broadcast_to(index < ends[:, -1:], (len(points), count))


def points_of_segments(values: Array, index: Array) -> Array:
    """Return (N, M, 2): the values (N, K, 2) at places (N or 1, M) of each curve."""
    return namespace(values).take_along_axis(values, index[..., None], axis=1)
