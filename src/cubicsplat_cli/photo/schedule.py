"""What changes in the course of a fit: edge width, step sizes, replacements, and the exact finish.

Nearly all is a function of the progress in [0, 1]: the share of the steps or, under a time limit, of the time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from cubicsplat_cli.settings import Recipe

# The published course of the step sizes: (from this share of the steps on, factor).
PUBLISHED_RATES = ((0.0, 1.0), (0.5, 0.5), (0.6, 0.2), (0.9, 0.1))


@dataclass(frozen=True)
class Phase:
    """One step's settings: factor on every step size, edge width in px, area coverage in the forward pass or not."""

    rate: float
    edge_width: float
    exact: bool


class Schedule:
    """The course of a fit."""

    def __init__(self, recipe: Recipe, steps: int) -> None:
        self.recipe = recipe
        # Long fits gain from more reallocations, but each needs more steps for its new curves to settle.
        self.reallocations = round(recipe.reallocation_density * math.sqrt(steps)) if recipe.prune else 0
        self._done = 0
        self.finish_start = 1.0 - recipe.finish
        self.reallocations_end = recipe.reallocate_until * self.finish_start

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

    def reallocation(self, progress: float, gini: float | None = None, idle: float = 0.0) -> float:
        """Fraction of the curves to replace at this progress.

        idle: the fraction that the picture is no worse without, which all go unless the published rule is asked for.
        """
        recipe = self.recipe
        if recipe.prune_rule == "gini":
            return recipe.prune_fraction * min(1.0, max(0.0, ((gini or 0.0) - recipe.gini_threshold) / 0.5))
        return max(idle, recipe.prune_fraction * (1.0 - progress / self.reallocations_end))

    def take_reallocation(self, progress: float) -> bool:
        """Whether the next of the evenly spaced reallocations is due; it then counts as done."""
        share = (self._done + 1) / (self.reallocations + 1)
        if progress >= self.reallocations_end or progress < share * self.reallocations_end:
            return False
        self._done += 1
        return True


def _fall(along: float, end: float) -> float:
    """Cosine from 1 at 0 to `end` at 1."""
    return end + (1.0 - end) * 0.5 * (1.0 + math.cos(math.pi * min(max(along, 0.0), 1.0)))
