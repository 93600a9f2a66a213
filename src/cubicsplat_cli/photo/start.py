"""What a fit begins with: its ground, and a drawing where one is given."""

from __future__ import annotations

from dataclasses import replace

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.photo.fills import LinearFills, middles_of
from cubicsplat_cli.photo.initial import COLOUR_MARGIN, farthest
from cubicsplat_cli.photo.state import Background, FitCurves
from cubicsplat_cli.scene import Scene, scaled_scene
from cubicsplat_cli.scene.arrays import Array, contiguous, copied, logit, namespace
from cubicsplat_cli.scene.gradients import FLAT, LINEAR, Gradients, ends_of
from cubicsplat_cli.settings import FitSettings, Recipe

# Beyond these logits the optimiser keeps a value from moving on; the engines' own limit is 9.
MOST_LOGIT = 8.0
LEAST_HALF_WIDTH = 0.1  # px, the engines' own limit


def choose_background(target: Array, settings: FitSettings, weights: Array | None = None) -> Background:
    """The colour behind the curves: the picture's (weighted) mean, the given one, or none for a picture with
    transparency.
    """
    if target.shape[2] == 4:
        return None
    given = settings.background_colour
    if given is not None:
        return given
    # Along one axis after the other: a float32 sum over all pixels at once would lose digits.
    total = target if weights is None else target * weights[..., None]
    middle = total.sum(0).sum(0) / (target.shape[0] * target.shape[1] if weights is None else weights.sum())
    mean = [round(float(v) * 255) / 255 for v in middle]
    return mean[0], mean[1], mean[2]


def curves_of(
    scene: Scene, settings: FitSettings, width: int, height: int, background: Background = None
) -> FitCurves:  # fmt: skip
    """A scene's curves as a fit has them, on a canvas of width x height px.

    Raises InputError for strokes where the settings ask for fills, and the other way round, and for gradients other
    than those of the settings' fill.
    """
    if scene.mode is not settings.mode:
        what = "filled shapes" if scene.mode.value == "closed" else "strokes"
        raise InputError(f"the drawing to begin with has {what}; use --mode {scene.mode.value}")
    sized, xp = scaled_scene(scene, width, height), namespace(scene.points)
    soft = settings.recipe.edges == "soft"
    return FitCurves(
        settings.mode, width, height, contiguous(copied(sized.points)), _logits(sized.colours),
        xp.clip(logit(xp.clip(sized.opacities, 1e-6, 1.0 - 1e-6)), -MOST_LOGIT, MOST_LOGIT),
        xp.clip(sized.half_widths, min=LEAST_HALF_WIDTH), background, sized.ring_ends,
        edge_widths=xp.full_like(sized.half_widths, settings.recipe.soft_edge) if soft else None,
        fills=_fills(sized, settings),
    )  # fmt: skip


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
    xp, spans = namespace(stops), given.offsets[:, 1:2] - given.offsets[:, :1]
    whole = xp.all(spans == 1.0, axis=1) & xp.all(stops[..., 3] == 1.0, axis=1)
    if bool((painted & ~((given.kinds == LINEAR) & (given.counts == 2) & whole)).any()):
        raise InputError(
            "the drawing to begin with has gradients other than those of --fill linear; begin with another"
        )
    middles = middles_of(scene.points, scene.ring_ends)[painted]
    fills.ends[painted] = xp.stack(ends_of(given.frames[painted], middles), axis=1) - middles[:, None]
    fills.stop_logits[painted] = _logits(stops[painted][..., :3])
    return fills


def _logits(colours: Array) -> Array:
    xp, margin = namespace(colours), 1e-3 * COLOUR_MARGIN
    return xp.clip(logit(xp.clip(colours, margin, 1.0 - margin)), -MOST_LOGIT, MOST_LOGIT)


def keep_frozen(scene: Scene, start: Scene, count: int) -> None:
    """Gives the last `count` curves of a result back what they were in a start of its size, to the bit."""
    for name in ("points", "colours", "opacities", "half_widths"):
        values = getattr(start, name)
        kept = getattr(scene, name)[-count:]
        (kept[:, : values.shape[1]] if values.ndim == 3 else kept)[...] = values
    if scene.gradients is not None:
        _keep_fills(scene.gradients, start.gradients, count)


def _keep_fills(found: Gradients, start: Gradients | None, count: int) -> None:
    """Gives the last `count` curves back the fills of a start that `curves_of` took, flat ones if it has none."""
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
