"""From a flat picture to a drawing.

`versions` yields the drawing, then ever simpler ones. Its stages, each with its package of `artwork/`:

1.  `prepare`: what happened to the picture, such as noise, blur, JPEG, enlargement or a scanner (`input`).
2.  `_with_its_shadow`: a soft shadow is lifted off, and drawn as gradients at the end (`shadows`).
3.  `plan.flat_fills`: gradients become flat placeholders (`gradients`), damaged edges become sharp (`input`), and the
    colours as few as requested (`regions`).
4.  `plan.planned`: fills, regions and the positions of edges (`regions`); the order of regions, their hidden parts, and
    translucent shapes (`layers`).
5.  `traced.traced`: an outline around each part (`layers`), fitted by lines, cubics and primitives (`geometry`).
6.  `_finished`: small letters and thin lines are traced again in steps finer than pixels (`traced`); outlines are
    optimised against the pixels, and missing details added (`finish`); symmetries and copies become exact
    (`regularities`).
7.  `finish.simpler`: simpler versions, if asked for.
8.  `_with_strokes`, `recoloured`: shapes of even width become strokes (`strokes`), and fills their best colours
    (`finish`).

`planar` cuts and overlaps finished drawings, and `structure` orders and groups their shapes, on request.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np

from cubicsplat_cli.artwork.finish.added import with_added
from cubicsplat_cli.artwork.finish.colours import ROUNDED, recoloured
from cubicsplat_cli.artwork.finish.polish import polish, polish_closer
from cubicsplat_cli.artwork.finish.simpler import simpler
from cubicsplat_cli.artwork.finish.state import goal_of
from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.prepare import Plain, PreparedInput, analysed, as_levels
from cubicsplat_cli.artwork.input.restore import seen_as
from cubicsplat_cli.artwork.limits import blocks_of
from cubicsplat_cli.artwork.plan import as_if_clean, flat_fills, planned
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.artwork.regions.sampling import samples_across
from cubicsplat_cli.artwork.regularities.regularities import regularised
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.settings import CUTOUT, ArtworkSettings
from cubicsplat_cli.artwork.shadows.lifting import lifted
from cubicsplat_cli.artwork.shadows.noisy import noisy_lifted
from cubicsplat_cli.artwork.shadows.slices import Shadows
from cubicsplat_cli.artwork.shapes import PRICE, Drawing, scaled_drawing
from cubicsplat_cli.artwork.traced import Outlined, length, or_finer, polygons, traced, with_pixels
from cubicsplat_cli.files.decode import Compression
from cubicsplat_cli.progress import Work, nothing, under_way, work
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.stack import Goal

# A clean picture whose longer side has fewer px than TRACED is traced in as many times the detail as it is smaller, to
# SMALLEST: artists draw as many pieces at any size, and a surplus piece is easier to remove than to insert.
TRACED, SMALLEST = 512, 128
SKETCH = 160  # px of the longer side of a picture that is drawn in well under a second


def prepare(
    target: np.ndarray, compression: Compression | None = None, plain: Callable[[], Plain] | None = None
) -> PreparedInput:
    """Return a picture prepared for `draw`; a small copy if the work is stopped. Parameters as of `analysed`."""
    prepared = None
    with work().stoppable():
        work().at("looking at the picture")
        prepared = analysed(target, compression, plain)
    return prepared or _small(target)


def draw(target: np.ndarray, settings: ArtworkSettings | None = None, prepared: PreparedInput | None = None) -> Drawing:
    """Return the drawing of a flat picture, the first of `versions`."""
    return next(versions(target, settings, prepared))


def versions(
    target: np.ndarray,
    settings: ArtworkSettings | None = None,
    prepared: PreparedInput | None = None,
    *,
    on_sketch: Callable[[Drawing], None] = nothing,
) -> Iterator[Drawing]:
    """Yield the drawing of a flat picture, (H, W, 3) or (H, W, 4) premultiplied, float32 in [0, 1], then ever simpler
    versions.

    An enlarged picture is drawn at its former size. A very large picture, or one of very many regions, is drawn with
    less detail (`limits`), and a warning is logged. A picture of hardly a region of more than a few px is drawn as it
    looks from a distance. prepared: `prepare(target)`, if known. on_sketch: is given the fitted outlines before their
    details, in px of the picture; an exception that it raises ends the drawing.

    If the current work (`progress.work`) is stopped, the drawing is what there is by then: outlines not yet fitted are
    polygons, and without regions it is the drawing of a small copy.
    """
    settings, prepared = settings or ArtworkSettings(), prepared or prepare(target)
    scaled, none_yet = _in_px_of(prepared, settings), True

    def show(sketch: Drawing) -> None:
        on_sketch(_enlarged(sketch, prepared))

    with work().stoppable():
        drawings = _with_its_shadow(prepared, scaled, show)
        for drawing in drawings or _fitted(*_likelier(prepared, scaled), scaled, show):
            none_yet = False
            yield _enlarged(drawing, prepared)
    if none_yet:
        small = _small(target)
        with under_way(Work()):
            clean = Flattened(small.levels)
            plan = planned(as_if_clean(clean, small, settings), _in_px_of(small, settings), small.condition)
        yield _enlarged(polygons(plan, clean), small)


def _in_px_of(prepared: PreparedInput, settings: ArtworkSettings) -> ArtworkSettings:
    """Return the settings with areas in px of the prepared levels."""
    return replace(settings, min_area=settings.min_area / prepared.mean_scale**2)


def _small(target: np.ndarray) -> PreparedInput:
    """Return a copy of a picture with at most SKETCH px a side, taken as clean."""
    height, width = target.shape[:2]
    factor = -(-max(height, width) // SKETCH)
    return PreparedInput(blocks_of(as_levels(target), factor), Condition(), (factor, factor), 1.0, width, height)


def _enlarged(drawing: Drawing, prepared: PreparedInput) -> Drawing:
    """Return a drawing of prepared levels in px of the picture."""
    across, down = prepared.scale
    whole = scaled_drawing(drawing, round(drawing.width * across), round(drawing.height * down))
    return replace(whole, width=prepared.width, height=prepared.height)


class _NoPlaceError(Exception):
    """Ends a drawing whose sketch has no place for its picture's shadow."""


def _with_its_shadow(
    prepared: PreparedInput, settings: ArtworkSettings, on_sketch: Callable[[Drawing], None]
) -> Iterator[Drawing] | None:
    """Return the versions of a picture with a soft shadow, which is drawn as gradients, or as all else if these do not
    suit; None if it has none, or the settings allow no gradients or fewer shapes.
    """
    condition = prepared.condition
    if not settings.may_overlap or prepared.scanned or condition.only_blurred:
        return None
    lift = lifted if condition.clean else partial(noisy_lifted, condition=condition)
    without = lift(prepared.levels) if prepared.lifted is None else prepared.lifted
    if not without:
        return None

    # Compressed again, a drawing without its shadow gives another file.
    bare = replace(prepared, levels=without.levels, shaded=without.sides, compression=None)
    outlined, shadows = _outlined(bare, settings), Shadows(without)
    first = shadows.over(outlined.drawing)
    if first is None and (kept := shadows.placed(outlined.drawing)):
        without = lift(prepared.levels, areas=kept)
        bare = replace(bare, levels=without.levels, shaded=without.sides)
        outlined, shadows = _outlined(bare, settings), Shadows(without)
        first = shadows.over(outlined.drawing)
    if first is None:
        return None
    of_plain = None
    if without.areas:
        with work().stoppable():
            of_plain = _outlined(prepared, settings)
    if of_plain is not None:
        # Outlines are not fitted yet, which costs both most inside of what hides the shadow.
        shown = ~np.logical_or.reduce([outer for _, outer in without.sides])
        if _description(of_plain.drawing, prepared.levels, shown) < _description(first, prepared.levels, shown):
            return _fitted(of_plain, prepared, settings, on_sketch)

    def show(sketch: Drawing) -> None:
        if (whole := shadows.over(sketch)) is None:
            raise _NoPlaceError
        on_sketch(whole)

    drawings = map(shadows.over, _fitted(outlined, bare, settings, show))
    try:
        first = next(drawings)
    except _NoPlaceError:
        first = None
    if first is None or (settings.curves is not None and len(first.shapes) > settings.curves):
        return None if of_plain is None else _fitted(of_plain, prepared, settings, on_sketch)
    return chain([first], filter(None, drawings))


def _description(drawing: Drawing, levels: np.ndarray, shown: np.ndarray) -> float:
    """Return the description length, in nats, of a drawing and its errors at some pixels (H, W) of levels (H, W, 4)."""
    off = (255.0 * render_scene(scene_of(drawing)) - levels)[shown]
    return 0.5 * len(off) * math.log(float(np.mean(off * off)) + ROUNDED) + PRICE * length(drawing)


def _outlined(prepared: PreparedInput, settings: ArtworkSettings) -> Outlined:
    """Return the outlines of a prepared picture."""
    condition = prepared.condition
    flat, picture, target, error = flat_fills(prepared, settings)
    # An unclean picture does not show blends well enough.
    placeholders = flat.fills if condition.clean and settings.may_overlap else None
    plan = planned(picture, settings, condition, placeholders, prepared.shaded)
    smaller = TRACED / min(max(*plan.levels.shape[:2], SMALLEST), TRACED)
    drawing = traced(plan, settings, flat, smaller if condition.clean else 1.0)
    return Outlined(flat, target, error, placeholders, plan, smaller, drawing)


def _likelier(prepared: PreparedInput, settings: ArtworkSettings) -> tuple[Outlined, PreparedInput]:
    """Return the outlines of a prepared picture, and the picture. If its colours were rounded to a few, those of the
    same picture taken for a clean one may describe it in less: rounding changes blends, and what is thin.
    """
    outlined = _outlined(prepared, settings)
    if not prepared.condition.rounded:
        return outlined, prepared
    clean = replace(prepared, condition=Condition())
    both = (outlined, prepared), (_outlined(clean, settings), clean)
    levels, everywhere = prepared.levels, np.ones(prepared.levels.shape[:2], dtype=bool)
    return min(both, key=lambda each: _description(each[0].drawing, levels, everywhere))


def _fitted(
    outlined: Outlined, prepared: PreparedInput, settings: ArtworkSettings, on_sketch: Callable[[Drawing], None]
) -> Iterator[Drawing]:
    """Yield the versions, in px of the prepared levels, of a picture's outlines."""
    grid = samples_across(outlined.plan.levels, outlined.plan.regions) if prepared.condition.clean else 0
    drawing, goal = _finished(outlined, prepared, settings, grid, on_sketch)
    for version in chain([drawing], () if goal is None else simpler(drawing, goal, settings.detail)):
        painted = _with_strokes(version, goal, settings, outlined.error, grid).painted()
        leaks = None if prepared.condition.clean else outlined.flat
        simple = version is not drawing
        yield recoloured(painted, prepared.levels, leaks, simpler=simple) if settings.free_fills else painted


def _finished(
    outlined: Outlined,
    prepared: PreparedInput,
    settings: ArtworkSettings,
    grid: int,
    on_sketch: Callable[[Drawing], None],
) -> tuple[Drawing, Goal | None]:
    """Return the drawing of outlines after its finish, and the goal of that; None if the work stops before. grid: as of
    `samples_across`.
    """
    condition, plan, flat, target = prepared.condition, outlined.plan, outlined.flat, outlined.target
    drawing, goal, state = outlined.unpainted, None, None
    with work().stoppable():
        # Restored edges are less certain than those of the picture as it was read.
        levels = plan.levels if condition.clean else target
        space = seen_as(condition, sharp=target is not flat.levels)
        errors = condition.share_error, outlined.error
        goal = goal_of(levels.astype(float) / 255.0, condition.blur, space, *errors, plan.fills.banded)
        if not (condition.aliased or condition.blur or prepared.pens):
            sharp = levels if settings.free_fills else plan.levels
            drawing, state = or_finer(outlined, goal, sharp, settings, condition.restored_error)
        drawing = polish(drawing, goal, settings.detail, state, lambda fitted: on_sketch(fitted.painted()))
        if condition.clean and not (condition.aliased or grid):
            drawing = polish_closer(drawing, goal, settings.detail)
        drawing = regularised(drawing, goal, settings.detail, grid)
        if condition.aliased:
            drawing = with_pixels(drawing, plan)
        # With chosen fills or fewer shapes no detail is missing by mistake.
        if settings.free_fills:
            work().at("adding details", 0.93)
            drawing = with_added(drawing, goal, condition, settings.detail, settings.min_area, settings.curves)
    return drawing, goal


def _with_strokes(drawing: Drawing, goal: Goal | None, settings: ArtworkSettings, error: float, grid: int) -> Drawing:
    """Return a drawing with strokes, fitted to its goal, in place of shapes of even width: of all on request, else of
    those whose description becomes shorter; and with dashed ones in place of rows of dashes. None in a cutout. grid: as
    of `samples_across`.
    """
    # Without a goal the work has stopped already.
    if goal is None or settings.strokes is False or settings.stacking == CUTOUT:
        return drawing
    from cubicsplat_cli.artwork.strokes.dashes import with_dashes
    from cubicsplat_cli.artwork.strokes.find import as_strokes
    from cubicsplat_cli.artwork.strokes.frames import with_frames
    from cubicsplat_cli.artwork.strokes.parameters import fitted_strokes, shorter_strokes, with_shared_pens

    most = settings.curves or math.inf
    with work().stoppable():
        work().at("finding strokes", 0.97)
        strokes = as_strokes(drawing, settings.detail, error, shorter=not settings.strokes)
        found = any(shape.stroke for shape in chain.from_iterable(strokes))
        if not settings.strokes:
            shorter = shorter_strokes(drawing, strokes, goal, settings.detail) if found else drawing
            drawing = with_shared_pens(shorter if len(shorter.shapes) <= most else drawing, goal, settings.detail)
        elif found:
            drawing = replace(drawing, shapes=tuple(chain.from_iterable(strokes)))
            drawing = fitted_strokes(drawing, goal)
        drawing = with_dashes(drawing, goal, settings.detail)
        framed = with_frames(drawing, goal, settings.detail, error, sampled=bool(grid))
        drawing = framed if len(framed.shapes) <= most else drawing
    return drawing  # noqa: RET504 (a stop leaves an earlier one)


def draw_flat(picture: FlatPicture) -> Drawing:
    """Return the drawing of a picture of flat fills, in exactly these fills."""
    settings = ArtworkSettings()
    work().at("finding regions", 0.1)
    plan = planned(picture, settings, Condition())
    drawing = traced(plan, settings, Flattened(plan.levels))
    with work().stoppable():
        goal = goal_of(plan.levels.astype(float) / 255.0)
        drawing = polish(drawing, goal)
        drawing = regularised(drawing, goal, settings.detail)
    return drawing  # noqa: RET504 (a stop leaves an earlier one)
