"""The start of a fit: its background, new curves (small discs or short strokes), and a drawing if one is given."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.photo.fills import LinearFills, Shapes, middles_of
from cubicsplat_cli.photo.state import Background, FitCurves
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import Array, contiguous, copied, like, logit, namespace
from cubicsplat_cli.scene.gradients import FLAT, LINEAR, ends_of
from cubicsplat_cli.settings import ANY, FitSettings, Mode, Recipe

COLOUR_MARGIN = 0.02  # keeps the logits of black and white within reach of the optimiser
ABOUT_FARTHEST = 0.999  # of the squared distance
OPAQUE_LOGIT = 9.0  # an opacity of 0.99988
# Beyond these logits the optimiser keeps a value from moving on; the engines' own limit is 9.
MOST_LOGIT = 8.0
LEAST_HALF_WIDTH = 0.1  # px, the engines' own limit


def new_curves(
    points: Array, colours: Array, half_width: float, settings: FitSettings, size: tuple[int, int],
    background: Background = None,
) -> FitCurves:  # fmt: skip
    """Return curves of control points (n, K, 2), colours (n, 3) as logits, a half-width in px and the recipe's opacity,
    on a canvas of size (width, height) px.
    """
    recipe, xp = settings.recipe, namespace(points)
    shapes = None if settings.shapes == ANY else Shapes.nearest(settings.shapes, points)
    points = points if shapes is None else shapes.points()

    def all_alike(value: float) -> Array:
        return xp.full((points.shape[0],), value, dtype=points.dtype, device=points.device)

    return FitCurves(
        settings.mode, *size, contiguous(points), contiguous(colours), all_alike(first_opacity(recipe)),
        all_alike(half_width), background,
        edge_widths=all_alike(recipe.soft_edge) if recipe.edges == "soft" else None,
        fills=LinearFills.flat(colours, farthest(points)) if settings.fill == "linear" else None,
        restricted=shapes,
    )  # fmt: skip


def first_opacity(recipe: Recipe) -> float:
    """Return the logit of a new curve's opacity."""
    if recipe.opaque:
        return OPAQUE_LOGIT
    shared = recipe.shared_opacity
    return math.log(shared / (1.0 - shared)) if shared > 0.0 else recipe.opacity_logit


def farthest(points: Array, ring_ends: Array | None = None) -> Array:
    """Return (n, 2) px: of each curve's control points (n, K, 2) the first that is about farthest from their mean, less
    the mean. On a circle rounding would choose the very farthest.
    """
    xp, (n, k, _), device = namespace(points), points.shape, points.device
    away = points - middles_of(points, ring_ends)[:, None]
    if ring_ends is not None:
        away = away * (xp.arange(k, device=device) < 3 * ring_ends[:, -1:])[..., None]
    squared = xp.sum(away * away, axis=-1)
    about = squared >= ABOUT_FARTHEST * xp.max(squared, axis=1, keepdims=True)
    index = xp.argmax(xp.astype(about, xp.float32), axis=1)
    return away[xp.arange(n, device=device), index]


def control_points(centres: Array, radius: float, settings: FitSettings, generator: np.random.Generator) -> Array:
    """Return control points (n, K, 2) of new curves at `centres` (n, 2) px: circles of `radius` px, or bent strokes."""
    n = centres.shape[0]
    if settings.mode is Mode.CLOSED:
        return centres[:, None, :] + like(centres, radius * random_ring(n, 3 * settings.segments, generator))
    k = 3 * settings.segments + 1
    angle = generator.random((n, 1)) * 2 * math.pi
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    along = np.linspace(-1.5, 1.5, k)[None, :, None] * direction
    wobble = 0.15 * generator.standard_normal((n, k, 2))
    return centres[:, None, :] + like(centres, radius * (along + wobble))


def random_ring(n: int, k: int, generator: np.random.Generator) -> np.ndarray:
    """Return (n, k, 2): k points evenly on the unit circle, turned by a random angle for each of the n."""
    turn = generator.random((n, 1)) * 2 * math.pi
    angle = np.arange(k) / k * 2 * math.pi + turn
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def picture_colours_at(centres: Array, target: Array) -> Array:
    """Return logits (n, 3) of the straight colours of the target (H, W, C) at the centres."""
    xp, (height, width, _) = namespace(centres), target.shape
    x = xp.astype(xp.clip(centres[:, 0], 0.0, width - 1.0), xp.int64)
    y = xp.astype(xp.clip(centres[:, 1], 0.0, height - 1.0), xp.int64)
    return colour_to_logits(target[y, x])


def colour_to_logits(colours: Array) -> Array:
    """Return logits (n, 3) of colours (n, 3), or of the straight colours of premultiplied (n, 4)."""
    xp = namespace(colours)
    if colours.shape[-1] == 4:
        colours = colours[:, :3] / xp.clip(colours[:, 3:], min=1e-3)
    return logit(xp.clip(colours, COLOUR_MARGIN, 1.0 - COLOUR_MARGIN))


def choose_background(target: Array, settings: FitSettings, weights: Array | None = None) -> Background:
    """Return the colour behind the curves: the given one, else the picture's (weighted) mean; none if it has alpha."""
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


def curves_to_fit(scene: Scene, settings: FitSettings, width: int, height: int, background: Background) -> FitCurves:
    """Return a scene's curves as a fit has them, on a canvas of width x height px.

    Raises InputError for strokes if the settings ask for filled shapes, for filled shapes if they ask for strokes, and
    for gradients other than those of the settings' fill.
    """
    if scene.mode is not settings.mode:
        what = "filled shapes" if scene.mode.value == "closed" else "strokes"
        raise InputError(f"the drawing to begin with has {what}; use --mode {scene.mode.value}")
    sized, xp = scene.scaled(width, height), namespace(scene.points)
    soft = settings.recipe.edges == "soft"
    return FitCurves(
        settings.mode, width, height, contiguous(copied(sized.points)), _logits(sized.colours),
        _logits(sized.opacities, 1e-6),
        xp.clip(sized.half_widths, min=LEAST_HALF_WIDTH), background, sized.ring_ends,
        edge_widths=xp.full_like(sized.half_widths, settings.recipe.soft_edge) if soft else None,
        fills=_fills(sized, settings),
    )  # fmt: skip


def _fills(scene: Scene, settings: FitSettings) -> LinearFills | None:
    """Return the scene's gradients as a fit has them."""
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
        text = "the drawing to begin with has gradients other than those of --fill linear"
        raise InputError(f"{text}; begin with another")
    middles = middles_of(scene.points, scene.ring_ends)[painted]
    fills.ends[painted] = xp.stack(ends_of(given.frames[painted], middles), axis=1) - middles[:, None]
    fills.stop_logits[painted] = _logits(stops[painted][..., :3])
    return fills


def _logits(shares: Array, margin: float = 1e-3 * COLOUR_MARGIN) -> Array:
    """Return the logits, of at most MOST_LOGIT, of colours or opacities that are kept a margin from 0 and 1."""
    xp = namespace(shares)
    return xp.clip(logit(xp.clip(shares, margin, 1.0 - margin)), -MOST_LOGIT, MOST_LOGIT)


def keep_frozen(scene: Scene, start: Scene, count: int) -> None:
    """Restore the last `count` curves of a result, in place, to their values in a start of its size, to the bit."""
    for name in ("points", "colours", "opacities", "half_widths"):
        values = getattr(start, name)
        kept = getattr(scene, name)[-count:]
        (kept[:, : values.shape[1]] if values.ndim == 3 else kept)[...] = values
    fills, own = scene.gradients, start.gradients
    if fills is not None and own is None:
        fills.kinds[-count:] = FLAT
    elif fills is not None and own is not None:
        fills.kinds[-count:], fills.counts[-count:], fills.frames[-count:] = own.kinds, own.counts, own.frames
        room = fills.most_stops
        fills.offsets[-count:], fills.stops[-count:] = own.offsets[:, :room], own.stops[:, :room]


def warmed(recipe: Recipe, share: float) -> Recipe:
    """Return the recipe of a fit that begins with a share in [0, 1] of its curves in place: with all, the edges begin
    as narrow as they end, the steps at half their size, and half as many curves are replaced.
    """
    names = ("prune_fraction", "rate_points", "rate_colours", "rate_opacities", "rate_half_widths")
    lower = {name: getattr(recipe, name) * (1.0 - 0.5 * share) for name in names}
    edge_start = recipe.edge_end * (recipe.edge_start / recipe.edge_end) ** (1.0 - share)
    return replace(recipe, edge_start=edge_start, **lower)
