"""A phase of the schedule in the engine's terms: how a step of it is drawn, and how far it moves."""

from __future__ import annotations

from cubicsplat_cli.photo.schedule import Phase
from cubicsplat_cli.raster.engine import Rates
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import FitSettings, Recipe

FLATNESS = 0.5  # px, of de Casteljau subdivision
FINISH_TOLERANCE = 0.1  # px: cairo's own, so that the file is drawn no finer than it was fitted


def raster_of(phase: Phase, settings: FitSettings) -> RasterSettings:
    """How a step of this phase is drawn."""
    recipe = settings.recipe
    coverage = "exact" if phase.exact else "relaxed"
    samples = settings.finish_samples if phase.exact else settings.samples
    if recipe.flatten == "de-casteljau":
        return RasterSettings(coverage, phase.edge_width, 64, FLATNESS, subdivide=True)
    tolerance = FINISH_TOLERANCE if phase.exact and recipe.tolerance > 0.0 else recipe.tolerance
    return RasterSettings(coverage, phase.edge_width, samples, tolerance)


def rates_of(phase: Phase, recipe: Recipe, unit: float) -> Rates:
    """The step sizes; unit: of the recipe's lengths, px."""
    return Rates(
        points=phase.rate * recipe.rate_points * unit,
        colours=phase.rate * recipe.rate_colours,
        opacities=0.0 if recipe.opaque else phase.rate * recipe.rate_opacities,
        half_widths=phase.rate * recipe.rate_half_widths * unit,
        edge_widths=phase.rate * recipe.rate_edge_widths,
        keep=(recipe.keep_mean, recipe.keep_change, recipe.keep_square),
        epsilon=recipe.epsilon,
    )
