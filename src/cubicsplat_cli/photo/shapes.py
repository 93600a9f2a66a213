"""Parameters of restricted shapes, which a fit optimises in place of their control points."""

from __future__ import annotations

from dataclasses import dataclass

from cubicsplat_cli.photo.fills import adan
from cubicsplat_cli.raster.engine import Rates
from cubicsplat_cli.scene.arrays import Array, CurveArrays, contiguous, like, namespace
from cubicsplat_cli.scene.shapes import TEMPLATES, lengths, nearest_shape, shape_gradient, shape_points

LEAST_AXIS = 0.25  # px, of half the first axis: where that is a point, the second one has no direction


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
        """The shapes nearest to closed curves (N, K, 2), which have not moved yet."""
        xp, values = namespace(points), contiguous(nearest_shape(kind, points))
        zeros = xp.zeros((*values.shape, 4), dtype=xp.float32, device=points.device)
        return cls(kind, values, zeros, xp.zeros((len(points),), dtype=xp.int32, device=points.device))

    @property
    def has_axes(self) -> bool:
        """Whether they are ellipses or rectangles."""
        return self.kind in TEMPLATES

    def points(self) -> Array:
        """The control points (N, K, 2) px."""
        return shape_points(self.kind, self.values)

    def learn(self, of_points: Array, rates: Rates) -> None:
        """One Adan update by dL/d of the control points."""
        self.ages += 1
        gradient = shape_gradient(self.kind, self.values, of_points)
        self.values -= rates.points * adan(gradient, self.moments, self.ages, rates)
        if self.has_axes:
            now = lengths(self.values)
            self.values[:, 2:4] *= namespace(now).clip(now, min=LEAST_AXIS) / now

    def resize(self, across: float, down: float) -> None:
        """Goes over to a picture whose sides are so many times as long."""
        both = (across * down) ** 0.5
        factors = [across, down, across, down, both] if self.has_axes else [across, down]
        self.values *= like(self.values, factors * (self.values.shape[1] // len(factors)))
        # The loss is a sum over the pixels: see `OptimiserState.resize`.
        self.moments *= like(self.values, [both, both, both * both, both])
