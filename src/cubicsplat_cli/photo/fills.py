"""Parameters that a fit optimises in place of those of its curves: linear gradients, with a colour at either end, and
the parameters of restricted shapes; and their updates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.raster.engine import Rates, grow, unmoved
from cubicsplat_cli.scene import shapes
from cubicsplat_cli.scene.arrays import Array, CurveArrays, contiguous, like, namespace, sigmoid
from cubicsplat_cli.scene.gradients import LINEAR, Gradients, linear_frames

LEAST_LENGTH = 1.0  # px, of the way from one colour to the other
LOGIT_LIMIT = 9.0  # as in the engines
ENDS_RATE = 0.4  # of that of the control points
LEAST_AXIS = 0.25  # px, of half the first axis: where that is a point, the second one has no direction


@dataclass(eq=False)
class LinearFills(CurveArrays):
    """ends (N, 2, 2) px: start and end, seen from the curve's middle, with which they move. stop_logits (N, 2, 3): of
    the colours there. moments (N, 10, 4), ages (N,) int32: Adan's, as in `OptimiserState`.
    """

    ends: Array
    stop_logits: Array
    moments: Array
    ages: Array

    @classmethod
    def flat(cls, colour_logits: Array, along: Array) -> LinearFills:
        """Return fills of one colour (n, 3) at both ends, which lie at -along and along (n, 2) px."""
        xp = namespace(along)
        ends, stop_logits = xp.stack((-along, along), axis=1), xp.stack((colour_logits, colour_logits), axis=1)
        return cls(contiguous(ends), contiguous(stop_logits), *unmoved(along, 10))

    def gradients(self, middles: Array) -> Gradients:
        """Return the gradients that the engine draws, for curves with these middles (N, 2) px."""
        xp, n, device = namespace(middles), len(middles), middles.device
        places = middles[:, None] + self.ends
        colours = sigmoid(self.stop_logits)
        return Gradients(
            xp.full((n,), LINEAR, dtype=xp.int32, device=device),
            contiguous(linear_frames(places[:, 0], places[:, 1])),
            xp.full((n,), 2, dtype=xp.int32, device=device),
            contiguous(xp.broadcast_to(xp.arange(2, dtype=xp.float32, device=device), (n, 2))),
            xp.concat((colours, xp.ones_like(colours[..., :1])), axis=-1),
        )

    def resize(self, across: float, down: float) -> None:
        """Adapt to a picture whose sides are multiplied by these factors; see `OptimiserState.resize`."""
        self.ends *= like(self.ends, [across, down])
        growth = namespace(self.ends).full_like(self.moments[0, :, 0], across * down)
        growth[:4] = (across * down) ** 0.5
        grow(self.moments, growth)

    def learn(
        self, middles: Array, frames_gradient: Array, stops_gradient: Array, rates: Rates, still: Array | None
    ) -> None:
        """Do an Adan update (see `adan` in curve.h) by dL/d of the gradients' frames and stops. middles: of the curves
        before the step that gave these. still (N,): curves that stay as they are.
        """
        xp, n = namespace(middles), len(middles)
        active = sigmoid(self.stop_logits)
        of_colours = stops_gradient[..., :3] * active * (1.0 - active)
        of_ends = self._of_ends(middles, frames_gradient)
        found = xp.concat((xp.reshape(of_ends, (n, 4)), xp.reshape(of_colours, (n, 6))), axis=1)
        rate = xp.full_like(found[0], rates.colours)
        rate[:4] = ENDS_RATE * rates.points
        if still is not None:
            found, rate = xp.where(still[:, None], 0.0, found), rate * ~still[:, None]
        self.ages += 1
        step = rate * adan(found, self.moments, self.ages, rates)
        self.ends -= xp.reshape(step[:, :4], (n, 2, 2))
        moved = self.stop_logits - xp.reshape(step[:, 4:], (n, 2, 3))
        self.stop_logits[...] = xp.clip(moved, -LOGIT_LIMIT, LOGIT_LIMIT)
        along = self.ends[:, 1] - self.ends[:, 0]
        length = xp.sqrt(xp.sum(along * along, axis=1, keepdims=True))
        # Ends that are too near are moved apart along their line.
        missing = 0.5 * xp.clip(LEAST_LENGTH - length, min=0.0) * along / xp.clip(length, min=1e-6)
        self.ends += xp.stack((-missing, missing), axis=1)

    def _of_ends(self, middles: Array, frames_gradient: Array) -> Array:
        """Return dL/d(ends) (N, 2, 2) from dL/d of the frames, whose first row is s = v / |v|^2 and -s start."""
        xp = namespace(middles)
        starts = middles + self.ends[:, 0]
        along = self.ends[:, 1] - self.ends[:, 0]
        squared = xp.clip(xp.sum(along * along, axis=1, keepdims=True), min=1e-12)
        slope, shift = along / squared, frames_gradient[:, 0, 2:3]
        of_slope = frames_gradient[:, 0, :2] - shift * starts
        of_along = of_slope / squared - 2.0 * slope * xp.sum(of_slope * slope, axis=1, keepdims=True)
        return xp.stack((-of_along - shift * slope, of_along), axis=1)


def middles_of(points: Array, ring_ends: Array | None) -> Array:
    """Return the mean (N, 2) of each curve's control points (N, K, 2), without padding; see `Scene`."""
    xp = namespace(points)
    if ring_ends is None:
        return xp.mean(points[:, : points.shape[1] // 3 * 3], axis=1)
    count = 3 * ring_ends[:, -1:]
    used = xp.arange(points.shape[1], device=points.device) < count
    return xp.sum(points * used[..., None], axis=1) / xp.astype(count, points.dtype)


def adan(gradient: Array, moments: Array, ages: Array, rates: Rates) -> Array:
    """Return Adan's step for (N, V) parameters, before the rate, and update the moments (N, V, 4)."""
    xp, (keep1, keep2, keep3) = namespace(gradient), rates.keep
    mean, change, square, previous = (moments[..., k] for k in range(4))
    age = xp.astype(ages, gradient.dtype)[:, None]
    difference = xp.where(age == 1.0, 0.0, gradient - previous)
    mean *= keep1
    mean += (1.0 - keep1) * gradient
    change *= keep2
    change += (1.0 - keep2) * difference
    ahead = gradient + keep2 * difference
    square *= keep3
    square += (1.0 - keep3) * ahead * ahead
    previous[...] = gradient
    bias1, bias2, bias3 = (1.0 - keep**age for keep in rates.keep)
    return (mean / bias1 + keep2 * change / bias2) / (xp.sqrt(square / bias3) + rates.epsilon)


@dataclass(eq=False)
class Shapes(CurveArrays):
    """N shapes of a kind. values (N, P): their parameters, px, see `scene.shapes`. moments (N, P, 4), ages (N,) int32:
    Adan's, as in `OptimiserState`.
    """

    kind: str
    values: Array
    moments: Array
    ages: Array

    @classmethod
    def nearest(cls, kind: str, points: Array) -> Shapes:
        """Return the shapes nearest to closed curves (N, K, 2) that have not moved yet."""
        values = contiguous(shapes.nearest_shape(kind, points))
        return cls(kind, values, *unmoved(points, values.shape[1]))

    @property
    def has_axes(self) -> bool:
        """True for ellipses and rectangles."""
        return self.kind in shapes.TEMPLATES

    def points(self) -> Array:
        """Return the control points (N, K, 2) px."""
        return shapes.shape_points(self.kind, self.values)

    def map(self) -> np.ndarray:
        """Return (K, V), for polygons: the matrix that gives the control points from V vertices."""
        eye = np.eye(self.values.shape[1] // 2, dtype=np.float32)
        return contiguous(shapes.polygon_points(np.stack((eye, eye), axis=-1))[..., 0].T)

    def learn(self, of_points: Array, rates: Rates) -> None:
        """Do an Adan update by dL/d of the control points."""
        self.ages += 1
        gradient = shapes.shape_gradient(self.kind, self.values, of_points)
        self.values -= rates.points * adan(gradient, self.moments, self.ages, rates)
        if self.has_axes:
            now = shapes.lengths(self.values)
            self.values[:, 2:4] *= namespace(now).clip(now, min=LEAST_AXIS) / now

    def resize(self, across: float, down: float) -> None:
        """Adapt to a picture whose sides are multiplied by these factors; see `OptimiserState.resize`."""
        both = (across * down) ** 0.5
        factors = [across, down, across, down, both] if self.has_axes else [across, down]
        self.values *= like(self.values, factors * (self.values.shape[1] // len(factors)))
        self.moments *= like(self.values, [both, both, both * both, both])
