"""The schedule of a fit by steps: edge width, step sizes, reallocations, and the exact finish.

Nearly all is a function of the progress in [0, 1]: the share of the steps or, under a time limit, of the time.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.raster.engine import Rates
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import Array, as_numpy
from cubicsplat_cli.settings import FitSettings

# The published course of the step sizes: (from this share of the steps on, factor).
PUBLISHED_RATES = ((0.0, 1.0), (0.5, 0.5), (0.6, 0.2), (0.9, 0.1))
FLATNESS = 0.5  # px, of de Casteljau subdivision
FINISH_TOLERANCE = 0.1  # px: cairo's own, so that the file is drawn no finer than it was fitted
AFTER_STEPS = 5  # what comes after the last step takes about as long as so many


@record
class Phase:
    """One step's settings: factor on every step size, edge width in px, area coverage in the forward pass or not."""

    rate: float
    edge_width: float
    exact: bool


class Schedule:
    """The course of a fit with these settings."""

    def __init__(self, settings: FitSettings) -> None:
        self.settings, self.recipe = settings, settings.recipe
        # Long fits gain from more reallocations, but each needs more steps for its new curves to fall into place.
        density = self.recipe.reallocation_density if self.recipe.prune else 0.0
        self.reallocations = round(density * math.sqrt(settings.steps))
        self._done = 0
        self.finish_start = 1.0 - self.recipe.finish
        self.reallocations_end = self.recipe.reallocate_until * self.finish_start

    def progress(self, step: int, elapsed: float) -> float:
        """Share of the steps done or, where that is more, of the time used up; elapsed: seconds."""
        share, limit = step / self.settings.steps, self.settings.time_limit
        if limit is None or step == 0:
            return share
        after = AFTER_STEPS * elapsed / step
        return max(share, elapsed / max(limit - after, 1e-9))

    def phase(self, progress: float) -> Phase:
        """Settings at a progress in [0, 1], or a little beyond where the clock overtook the last step."""
        recipe = self.recipe
        if recipe.finish > 0.0 and progress >= self.finish_start:
            along = (progress - self.finish_start) / recipe.finish
            return Phase(recipe.finish_rate * _fall(along, recipe.finish_rate_end), recipe.finish_edge_width, True)
        along = progress / self.finish_start
        anneal = min(1.0, along / recipe.anneal) if recipe.anneal > 0 else 1.0
        width = recipe.edge_start * (recipe.edge_end / recipe.edge_start) ** anneal
        return Phase(self._rate(along), width, False)

    def _rate(self, along: float) -> float:
        if self.recipe.rate_course == "cosine":
            return _fall(along, self.recipe.rate_end)
        return [factor for start, factor in PUBLISHED_RATES if along >= start][-1]

    def raster(self, phase: Phase) -> RasterSettings:
        """Settings of drawing in this phase."""
        coverage = "exact" if phase.exact else "relaxed"
        if self.recipe.flatten == "de-casteljau":
            return RasterSettings(coverage, phase.edge_width, 64, FLATNESS, subdivide=True)
        samples = self.settings.finish_samples if phase.exact else self.settings.samples
        tolerance = FINISH_TOLERANCE if phase.exact and self.recipe.tolerance > 0.0 else self.recipe.tolerance
        return RasterSettings(coverage, phase.edge_width, samples, tolerance)

    def rates(self, phase: Phase, unit: float) -> Rates:
        """The step sizes of this phase; unit: of the recipe's lengths, px."""
        recipe = self.recipe
        return Rates(
            points=phase.rate * recipe.rate_points * unit,
            colours=phase.rate * recipe.rate_colours,
            opacities=0.0 if recipe.opaque else phase.rate * recipe.rate_opacities,
            half_widths=phase.rate * recipe.rate_half_widths * unit,
            edge_widths=phase.rate * recipe.rate_edge_widths,
            keep=(recipe.keep_mean, recipe.keep_change, recipe.keep_square),
            epsilon=recipe.epsilon,
        )

    def reallocation(self, progress: float, inequality: float = 0.0, idle: float = 0.0) -> float:
        """Fraction of the curves to replace at this progress.

        inequality: `gini` of their importance, which the published rule goes by. idle: the fraction that the picture
        is no worse without, which all go by the usual rule.
        """
        recipe = self.recipe
        if recipe.prune_rule == "gini":
            return recipe.prune_fraction * min(1.0, max(0.0, (inequality - recipe.gini_threshold) / 0.5))
        return max(idle, recipe.prune_fraction * (1.0 - progress / self.reallocations_end))

    def take_reallocation(self, progress: float) -> bool:
        """Whether the next of the evenly spaced reallocations is due; it then counts as done."""
        share = (self._done + 1) / (self.reallocations + 1)
        if progress >= self.reallocations_end or progress < share * self.reallocations_end:
            return False
        self._done += 1
        return True


def gini(importance: Array) -> float:
    """Gini coefficient (0: all equal, towards 1: few carry everything) of the positive parts of (N,) values."""
    values = np.sort(np.maximum(as_numpy(importance).astype(np.float64), 0.0))
    total = float(values.sum())
    n = len(values)
    if n == 0 or total <= 0:
        return 0.0
    ranks = np.arange(1, n + 1)
    return float((2 * ranks - n - 1) @ values) / (n * total)


def _fall(along: float, end: float) -> float:
    """Cosine from 1 at 0 to `end` at 1."""
    return end + (1.0 - end) * 0.5 * (1.0 + math.cos(math.pi * min(max(along, 0.0), 1.0)))
