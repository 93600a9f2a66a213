"""A fit that begins with a drawing."""

from __future__ import annotations

from dataclasses import replace

import torch

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.photo.initial import COLOUR_MARGIN
from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.settings import FitSettings, Recipe

# Beyond these logits the optimiser keeps a value from moving on; the engines' own limit is 9.
MOST_LOGIT = 8.0
LEAST_HALF_WIDTH = 0.1  # px, the engines' own limit


def parameters_of(scene: Scene, settings: FitSettings, width: int, height: int) -> Parameters:
    """A scene's curves as a fit has them, on a canvas of width x height px.

    Raises InputError for strokes where the settings ask for fills, and the other way round.
    """
    if scene.mode is not settings.mode:
        what = "filled shapes" if scene.mode.value == "closed" else "strokes"
        raise InputError(f"the drawing to begin with has {what}; use --mode {scene.mode.value}")
    sized = scaled_scene(scene, width, height)
    colours = sized.colours.clamp(1e-3 * COLOUR_MARGIN, 1.0 - 1e-3 * COLOUR_MARGIN)
    return Parameters(
        sized.points.clone().contiguous(),
        torch.logit(colours).clamp(-MOST_LOGIT, MOST_LOGIT),
        torch.logit(sized.opacities.clamp(1e-6, 1.0 - 1e-6)).clamp(-MOST_LOGIT, MOST_LOGIT),
        sized.half_widths.clamp(min=LEAST_HALF_WIDTH),
        torch.full((sized.curves,), settings.recipe.soft_edge),
        sized.ring_ends,
    )


def warmed(recipe: Recipe, share: float) -> Recipe:
    """The recipe of a fit of whose curves a share in [0, 1] is in place already: softer means where there are few.

    Where all are, the edges begin as narrow as they end, the steps at half their size, and half as many curves are
    replaced.
    """
    rate = 1.0 - 0.5 * share
    return replace(
        recipe,
        edge_start=recipe.edge_end * (recipe.edge_start / recipe.edge_end) ** (1.0 - share),
        prune_fraction=recipe.prune_fraction * rate,
        rate_points=recipe.rate_points * rate,
        rate_colours=recipe.rate_colours * rate,
        rate_opacities=recipe.rate_opacities * rate,
        rate_half_widths=recipe.rate_half_widths * rate,
    )
