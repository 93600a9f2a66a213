"""What changes from step to step: edge width, step sizes, and when the exact finish begins."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .presets import Recipe


@dataclass(frozen=True)
class Phase:
    """One step's settings: factor on every step size, edge width in px, area coverage in the forward pass or not."""

    rate: float
    edge_width: float
    exact: bool


class Schedule:
    """The course of a fit of `steps` steps."""

    def __init__(self, recipe: Recipe, steps: int) -> None:
        self.recipe = recipe
        self.steps = steps
        self.finish_steps = min(steps, max(round(recipe.finish * steps), min(steps, recipe.finish_least)))
        self.finish_start = steps - self.finish_steps

    def phase(self, step: int) -> Phase:
        """Settings of step 0 .. steps - 1."""
        recipe = self.recipe
        if step >= self.finish_start:
            along = (step - self.finish_start) / max(self.finish_steps, 1)
            rate = recipe.finish_rate * _fall(along, recipe.finish_rate_end)
            return Phase(rate, recipe.finish_edge_width, True)
        along = step / max(self.finish_start, 1)
        anneal = min(1.0, along / recipe.anneal) if recipe.anneal > 0 else 1.0
        width = recipe.edge_start * (recipe.edge_end / recipe.edge_start) ** anneal
        return Phase(_fall(along, recipe.rate_end), width, False)

    def reallocation(self, step: int) -> float:
        """Fraction of the curves to replace after this step; 0 for none."""
        recipe = self.recipe
        done = step + 1
        last = recipe.reallocate_until * self.finish_start
        if not recipe.prune or recipe.reallocations < 1 or done >= last:
            return 0.0
        interval = max(1, round(last / (recipe.reallocations + 1)))
        if done % interval:
            return 0.0
        return recipe.prune_fraction * (1.0 - done / last)


def _fall(along: float, end: float) -> float:
    """Cosine from 1 at 0 to `end` at 1."""
    return end + (1.0 - end) * 0.5 * (1.0 + math.cos(math.pi * min(max(along, 0.0), 1.0)))
