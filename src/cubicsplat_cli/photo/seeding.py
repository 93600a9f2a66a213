"""Where a fit gets new curves: all over the picture at its start, and later where the error is high."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cubicsplat_cli.photo.blobs import blob_points, box_mean, find_blobs
from cubicsplat_cli.photo.initial import colours_at, control_points, new_curves
from cubicsplat_cli.photo.state import Background, FitCurves
from cubicsplat_cli.scene.arrays import Array, like, namespace
from cubicsplat_cli.settings import FitSettings


@dataclass(frozen=True, eq=False)
class Seeder:
    """Makes new curves for a fit to a target (H, W, C).

    generator: draws all random numbers on the host, so that they are the same for every device. background: the
    curves'. weights: (H, W), of the pixels. The arrays are in one place, where the work is done.
    """

    settings: FitSettings
    generator: np.random.Generator
    background: Background
    target: Array
    weights: Array | None = None

    @cached_property
    def unit(self) -> float:
        """The unit of the recipe's lengths, px."""
        height, width, _ = self.target.shape
        return self.settings.recipe.unit(width, height, self.settings.curves) * spread_of(self.weights) ** 0.5

    def first(self) -> FitCurves:
        """The usual start of a fit: discs or strokes at random places."""
        centres = random_centres(self.settings.curves, self.target, self.generator, self.weights)
        points = control_points(centres, self.settings.recipe.start_size * self.unit, self.settings, self.generator)
        return self._curves(points, colours_at(centres, self.target))

    def seeds(self, count: int, image: Array) -> FitCurves:
        """New curves where the picture (H, W, C) is far from the target."""
        recipe = self.settings.recipe
        density = error_density(image, self.target, recipe.seed_blur, recipe.seed_power, self.weights)
        centres = draw_pixels(density, count, self.generator)
        size = recipe.seed_size * self.unit
        if recipe.seeding == "blobs":
            blobs = find_blobs(centres, image, self.target, size, self.generator, self.weights)
            return self._curves(blob_points(blobs, self.settings, self.generator), blobs.colour_logits)
        points = control_points(centres, size, self.settings, self.generator)
        return self._curves(points, colours_at(centres, self.target))

    def _curves(self, points: Array, colours: Array) -> FitCurves:
        height, width, _ = self.target.shape
        half_width = self.settings.recipe.half_width_size * self.unit
        return new_curves(points, colours, half_width, self.settings, (width, height), self.background)


def spread_of(weights: Array | None) -> float:
    """Share of the picture over which curves will spread: 1 for even weights, that of the region where only one counts.

    It is the square of the weights' mean over the mean of their squares.
    """
    if weights is None:
        return 1.0
    values = namespace(weights).astype(weights, namespace(weights).float64)
    return float(values.mean()) ** 2 / float((values * values).mean())


def error_density(image: Array, target: Array, blur: int, power: float, weights: Array | None = None) -> Array:
    """Where new curves are wanted: the squared error, weighted, blurred by a box of `blur` px, to a power; (H, W)."""
    difference = image - target
    difference *= difference
    error = sum(difference[..., channel] for channel in range(target.shape[2]))  # a sum over an axis takes longer
    return box_mean(error if weights is None else error * weights, blur) ** power


def random_centres(count: int, target: Array, generator: np.random.Generator, weights: Array | None = None) -> Array:
    """Random places (n, 2) px, by the pixels' weights; where there is transparency, only where there is something."""
    xp, (height, width, channels) = namespace(target), target.shape
    if channels == 4 or weights is not None:
        there = xp.clip(target[..., 3], min=1e-6) if channels == 4 else xp.ones_like(target[..., 0])
        return draw_pixels(there if weights is None else there * weights, count, generator)
    return like(target, generator.random((count, 2)) * (width, height))


def draw_pixels(density: Array, count: int, generator: np.random.Generator) -> Array:
    """Centres (count, 2) of pixels drawn, with replacement, in proportion to a density (H, W) >= 0."""
    xp, (height, width) = namespace(density), density.shape
    total = xp.cumulative_sum(xp.reshape(density, (-1,)), dtype=xp.float64)
    share = like(total, generator.random(count))
    pixels = height * width
    pixel = xp.clip(xp.searchsorted(total, share * total[-1], side="right"), max=pixels - 1)
    # Without any density all are alike; decided without a look at the value, which would wait for a GPU.
    pixel = xp.where(total[-1] > 0, pixel, xp.clip(xp.astype(share * pixels, pixel.dtype), max=pixels - 1))
    return xp.astype(xp.stack([pixel % width, pixel // width], axis=-1), xp.float32) + 0.5
