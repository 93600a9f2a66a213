"""A fit that begins with a drawing."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.gradients import FLAT, LINEAR, Gradients, ends_of
from cubicsplat_cli.photo.fills import LinearFills, middles_of
from cubicsplat_cli.photo.initial import COLOUR_MARGIN, farthest
from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.settings import FitSettings, Recipe

# Beyond these logits the optimiser keeps a value from moving on; the engines' own limit is 9.
MOST_LOGIT = 8.0
LEAST_HALF_WIDTH = 0.1  # px, the engines' own limit


def parameters_of(scene: Scene, settings: FitSettings, width: int, height: int) -> Parameters:
    """A scene's curves as a fit has them, on a canvas of width x height px.

    Raises InputError for strokes where the settings ask for fills, and the other way round, and for gradients other
    than those of the settings' fill.
    """
    if scene.mode is not settings.mode:
        what = "filled shapes" if scene.mode.value == "closed" else "strokes"
        raise InputError(f"the drawing to begin with has {what}; use --mode {scene.mode.value}")
    sized = scaled_scene(scene, width, height)
    return Parameters(
        sized.points.clone().contiguous(),
        _logits(sized.colours),
        torch.logit(sized.opacities.clamp(1e-6, 1.0 - 1e-6)).clamp(-MOST_LOGIT, MOST_LOGIT),
        sized.half_widths.clamp(min=LEAST_HALF_WIDTH),
        torch.full((sized.curves,), settings.recipe.soft_edge),
        sized.ring_ends,
        _fills(sized, settings),
    )


def _fills(scene: Scene, settings: FitSettings) -> LinearFills | None:
    """The scene's gradients as a fit has them."""
    given = scene.gradients
    if settings.fill == "flat":
        if given is None:
            return None
        raise InputError("the drawing to begin with has gradients; use --fill linear")
    fills = LinearFills.flat(_logits(scene.colours), farthest(scene.points, scene.ring_ends))
    if given is None:
        return fills
    painted, stops = given.kinds != FLAT, given.stops[:, :2]
    whole = (given.offsets[:, 1:2] - given.offsets[:, :1] == 1.0).all(1) & (stops[..., 3] == 1.0).all(1)
    if bool((painted & ~((given.kinds == LINEAR) & (given.counts == 2) & whole)).any()):
        raise InputError(
            "the drawing to begin with has gradients other than those of --fill linear; begin with another"
        )
    middles = middles_of(scene.points, scene.ring_ends)
    ends = torch.stack(ends_of(given.frames, middles), 1) - middles.unsqueeze(1)
    fills.ends[painted], fills.stop_logits[painted] = ends[painted], _logits(stops[..., :3])[painted]
    return fills


def _logits(colours: Tensor) -> Tensor:
    margin = 1e-3 * COLOUR_MARGIN
    return torch.logit(colours.clamp(margin, 1.0 - margin)).clamp(-MOST_LOGIT, MOST_LOGIT)


def keep_fills(found: Gradients, start: Gradients | None, count: int) -> None:
    """Gives the last `count` curves back the fills of a start that `parameters_of` took, flat ones if it has none."""
    if start is None:
        found.kinds[-count:] = FLAT
        return
    room = found.most_stops
    found.kinds[-count:], found.counts[-count:], found.frames[-count:] = start.kinds, start.counts, start.frames
    found.offsets[-count:], found.stops[-count:] = start.offsets[:, :room], start.stops[:, :room]


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
