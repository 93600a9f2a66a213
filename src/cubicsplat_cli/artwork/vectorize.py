"""From a flat picture to a drawing: fills, regions, layers, contours, outlines, finish."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np

from cubicsplat_cli.artwork.finish.added import with_added
from cubicsplat_cli.artwork.finish.colours import ROUNDED, recoloured
from cubicsplat_cli.artwork.finish.polish import polish
from cubicsplat_cli.artwork.finish.simpler import simpler
from cubicsplat_cli.artwork.finish.state import PRICE, goal_of
from cubicsplat_cli.artwork.gradients.bands import banded_areas
from cubicsplat_cli.artwork.gradients.flattening import Flattened, flattened
from cubicsplat_cli.artwork.gradients.noisy import without_blurred_gradients, without_noisy_gradients
from cubicsplat_cli.artwork.input.chroma import mixture_of
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.pens import sharpened
from cubicsplat_cli.artwork.input.prepare import PreparedInput, analysed, as_levels
from cubicsplat_cli.artwork.input.recompressed import EDGE_ERROR, before_compression
from cubicsplat_cli.artwork.input.restore import MISFIT, restored, seen_as
from cubicsplat_cli.artwork.layers.extents import OVERLAY
from cubicsplat_cli.artwork.layers.translucent import parts_of
from cubicsplat_cli.artwork.limits import blocks_of, enlarged
from cubicsplat_cli.artwork.plan import planned
from cubicsplat_cli.artwork.regions.fewer import fewer_colours, nearest_colours
from cubicsplat_cli.artwork.regions.fills import picture_fills
from cubicsplat_cli.artwork.regions.regions import FlatPicture, find_regions
from cubicsplat_cli.artwork.regions.sampling import samples_across
from cubicsplat_cli.artwork.regularities.regularities import regularised
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.settings import CUTOUT, ON, ArtworkSettings
from cubicsplat_cli.artwork.shadows.lifting import lifted
from cubicsplat_cli.artwork.shadows.slices import placed, with_shadow
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.artwork.traced import length, or_finer, polygons, traced, with_pixels
from cubicsplat_cli.files.decode import Compression
from cubicsplat_cli.progress import Work, nothing, under_way, work
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.scene.paint import mean_fill

MANY = 150  # parts, whose finish takes longer than to find out whether they are worth it
# Px of the longer side below which clean pictures are traced in as many times the detail as they are smaller, down to
# SMALLEST: artists draw as many pieces at any size, and one too many is easier to take out than one too few to put in.
TRACED, SMALLEST = 512, 128
SKETCH = 160  # px of the longer side, of what is drawn in well under a second


def prepare(target: np.ndarray, compression: Compression | None = None) -> PreparedInput:
    """A picture prepared for `draw`; where the work under way is stopped, a small copy. compression: that
    of its file, if it has any loss.
    """
    prepared = None
    with work().stoppable():
        work().at("looking at the picture")
        prepared = analysed(target, compression)
    return prepared or _small(target)


def draw(target: np.ndarray, settings: ArtworkSettings | None = None, prepared: PreparedInput | None = None) -> Drawing:
    """The drawing of a flat picture; the first of `versions`."""
    return next(versions(target, settings, prepared))


def versions(
    target: np.ndarray,
    settings: ArtworkSettings | None = None,
    prepared: PreparedInput | None = None,
    *,
    on_sketch: Callable[[Drawing], None] = nothing,
) -> Iterator[Drawing]:
    """The drawing of a flat picture, (H, W, 3) or (H, W, 4) premultiplied, float32 in [0, 1], and ever
    simpler versions of it.

    What was made larger by a whole number is drawn as it was before. Very large pictures, and those of very many
    regions, are drawn with less detail (`limits`), which is logged. What has hardly a region of more than a few px is
    drawn as it looks from farther away. prepared: `prepare(target)`, where that is known already. on_sketch: given
    the shapes with their outlines fitted, which have all their pieces yet and no details, in px of the picture, where
    there are many and no soft shadow; what it raises ends the drawing.

    Where the work under way (`progress.work`) is stopped, the drawing is what there is by then: outlines not yet fitted
    are polygons, and where the regions were not known yet it is that of a smaller copy.
    """
    settings, prepared = settings or ArtworkSettings(), prepared or prepare(target)
    # Sketches without what shades them would not be like the picture.
    none_yet, unseen = True, partial(_versions, settings=settings, on_sketch=nothing)
    with work().stoppable():
        shaded = _with_its_shadow(prepared, settings, unseen)
        for each in shaded or _versions(prepared, settings, on_sketch):
            none_yet = False
            yield enlarged(each, prepared.scale, prepared.width, prepared.height)
    if none_yet:
        prepared = _small(target)
        yield enlarged(_sketch(prepared, settings), prepared.scale, prepared.width, prepared.height)


def _small(target: np.ndarray) -> PreparedInput:
    """A copy of a picture of at most SKETCH px a side, taken as it is."""
    height, width = target.shape[:2]
    factor = -(-max(height, width) // SKETCH)
    return PreparedInput(blocks_of(as_levels(target), factor), Condition(), factor, 1, width, height)


def _sketch(prepared: PreparedInput, settings: ArtworkSettings) -> Drawing:
    """The regions of a small picture as polygons."""
    with under_way(Work()):
        plan = planned(_even(Flattened(prepared.levels), prepared, settings), settings, prepared.scale, 0.0, None)
    height, width = plan.levels.shape[:2]
    return Drawing(width, height, polygons(plan.parts, (height, width), Flattened(prepared.levels)))


def _with_its_shadow(
    prepared: PreparedInput, settings: ArtworkSettings, versions: Callable[[PreparedInput], Iterator[Drawing]]
) -> Iterator[Drawing] | None:
    """The versions of a clean picture with a soft shadow, in gradients; None where it has none, or there may be no
    gradients or not as many shapes.
    """
    if not _may_shine_through(prepared, settings):
        return None
    without = lifted(prepared.levels) if prepared.lifted is None else prepared.lifted
    if not without:
        return None
    drawings = versions(replace(prepared, levels=without.levels))
    drawing = next(drawings)
    first = with_shadow(drawing, without)
    if first is None and (kept := placed(drawing, without.areas)):
        without = lifted(prepared.levels, kept)
        drawings = versions(replace(prepared, levels=without.levels))
        first = with_shadow(next(drawings), without)
    if first is None or (settings.curves is not None and len(first.shapes) > settings.curves):
        return None
    if without.areas:
        others, plain = versions(replace(prepared, condition=prepared.seen or prepared.condition)), None
        with work().stoppable():
            plain = next(others)
        if plain is not None and _description(plain, prepared.levels) < _description(first, prepared.levels):
            return chain([plain], others)
    return chain([first], filter(None, (with_shadow(each, without) for each in drawings)))


def _description(drawing: Drawing, levels: np.ndarray) -> float:
    """Nats of a drawing, and of what it leaves of its picture (H, W, 4) in levels: normal errors of any one size."""
    off = 255.0 * render_scene(scene_of(drawing)) - levels
    error = float(np.mean(off * off)) + ROUNDED
    return 0.5 * levels[..., 0].size * math.log(error) + PRICE * length(drawing.shapes)


def _versions(
    prepared: PreparedInput, settings: ArtworkSettings, on_sketch: Callable[[Drawing], None]
) -> Iterator[Drawing]:
    """The drawing of what was taken in, in px of that, and simpler versions of it; see `versions`."""
    condition = prepared.condition
    work().at("finding gradients", 0.05)
    flat = without_gradients(prepared, settings)
    work().at("finding colours", 0.1)
    even, seen, error = _even(flat, prepared, settings), flat.levels, condition.edge_error / 255.0
    # A blur hides steps; fills that are given are no bands.
    stepped = condition.jpeg and settings.free_fills and not condition.blur
    if banded := banded_areas(prepared.levels, even, flat, condition) if stepped else []:
        flat = without_noisy_gradients(prepared.levels, condition, banded, flat.areas)
        even, seen = _even(flat, prepared, settings), flat.levels
    if prepared.compression is not None and prepared.compression.tables and settings.free_fills and not condition.blur:
        even, seen = before_compression(prepared.levels, flat, even, prepared.compression)
        error = EDGE_ERROR / 255.0
    placeholders = flat.fills if _may_shine_through(prepared, settings) else None
    plan = planned(even, settings, prepared.scale, condition.restored_error, placeholders, condition.share_error)
    height, width = plan.levels.shape[:2]
    finer = TRACED / min(max(height, width, SMALLEST), TRACED) if condition.clean else 1.0
    shapes = traced(plan.parts, (height, width), settings, flat, finer)
    if any(part.extent.layer == OVERLAY for part in plan.parts):
        opaque = parts_of(plan.regions, plan.found, settings.completion == ON, None)
        if settings.curves is None or len(opaque) <= settings.curves:
            without = traced(opaque, (height, width), settings, flat, finer)
            if length(without) < length(shapes):
                plan, shapes = replace(plan, parts=opaque), without
    drawing, goal, state = Drawing(width, height, shapes), None, None
    scaled = replace(settings, min_area=settings.min_area / prepared.scale**2)
    with work().stoppable():
        grid = samples_across(plan.levels, plan.regions) if condition.clean else 0
        # Edges that were restored tell less than the picture as it came.
        came = plan.levels if condition.clean else seen
        space = seen_as(condition, sharp=seen is not flat.levels)
        goal = goal_of(came.astype(float) / 255.0, condition.blur, space, condition.share_error, error)
        if not (condition.aliased or condition.blur or prepared.pens):
            known = replace(plan, levels=came) if settings.free_fills else plan
            drawing, state = or_finer(drawing, goal, known, scaled, flat, placeholders, condition.restored_error)

        def show(settled: Drawing) -> None:
            if len(plan.parts) > MANY:
                on_sketch(enlarged(_painted(settled), prepared.scale, prepared.width, prepared.height))

        drawing = polish(drawing, goal, settings.detail, state, show)
        drawing = regularised(drawing, goal, settings.detail, grid)
        if condition.aliased:
            drawing = with_pixels(drawing, plan)
        # What was given up for fewer fills or shapes is no detail that was lost.
        if settings.free_fills:
            work().at("adding details", 0.93)
            drawing = with_added(drawing, goal, condition, settings.detail, scaled.min_area, settings.curves)
    further = iter(()) if goal is None else simpler(drawing, goal, settings.detail)
    for each in chain([drawing], further):
        painted = _painted(_with_strokes(each, goal, settings, error))
        leaks = None if condition.clean else flat
        yield recoloured(painted, prepared.levels, leaks) if settings.free_fills else painted


def _with_strokes(drawing: Drawing, goal: Goal | None, settings: ArtworkSettings, error: float) -> Drawing:
    """The drawing with strokes in place of shapes of even width, fitted to its goal: of all such, or of those whose
    description is shorter for it; cutters know none.
    """
    if settings.strokes is False or settings.stacking == CUTOUT or (goal is None and not settings.strokes):
        return drawing
    from cubicsplat_cli.artwork.strokes.find import as_strokes

    with work().stoppable():
        work().at("finding strokes", 0.97)
        found = as_strokes(drawing, settings.detail, error, shorter=not settings.strokes)
        if not any(shape.stroke for own in found for shape in own):
            return drawing
        from cubicsplat_cli.artwork.strokes.parameters import fitted_strokes, shorter_strokes

        if not settings.strokes and goal is not None:
            shorter = shorter_strokes(drawing, found, goal, settings.detail)
            return drawing if len(shorter.shapes) > (settings.curves or math.inf) else shorter
        drawing = replace(drawing, shapes=tuple(chain.from_iterable(found)))
        if goal is not None:
            drawing = fitted_strokes(drawing, goal)
    return drawing


def draw_flat(picture: FlatPicture, settings: ArtworkSettings) -> Drawing:
    """The drawing of a picture in flat fills, in no others than these, without regard to how the fills look."""
    height, width = picture.levels.shape[:2]
    work().at("finding regions", 0.1)
    plan = planned(picture, settings, 1, 0.0, None)
    drawing = Drawing(width, height, traced(plan.parts, (height, width), settings, Flattened(plan.levels)))
    with work().stoppable():
        goal = goal_of(plan.levels.astype(float) / 255.0)
        drawing = polish(drawing, goal, settings.detail)
        drawing = regularised(drawing, goal, settings.detail)
    return drawing  # noqa: RET504 (a stop leaves it as it was before)


def _may_shine_through(prepared: PreparedInput, settings: ArtworkSettings) -> bool:
    """Whether shapes may be translucent: what is not clean says too little of a blend, who chooses the fills wants no
    others, and cutters know none.
    """
    return prepared.condition.clean and settings.free_fills and settings.stacking != CUTOUT


def _even(flat: Flattened, prepared: PreparedInput, settings: ArtworkSettings) -> FlatPicture:
    """A picture without gradients as if it were clean, in the colours that are asked for."""
    if prepared.pens is not None:
        even = FlatPicture(*sharpened(flat.levels, prepared.pens))
    elif prepared.condition.clean:
        even = FlatPicture(flat.levels, standing=flat.fills)
    else:
        even = restored(flat.levels, prepared.condition, flat.fills)
    return even if settings.free_fills else _in_chosen_colours(even, settings)


def _in_chosen_colours(picture: FlatPicture, settings: ArtworkSettings) -> FlatPicture:
    """A clean picture in no more than the colours asked for, or in those of the palette that are near."""
    levels = picture.levels
    if picture.palette is None:
        picture = replace(picture, palette=picture_fills(levels))
    regions = find_regions(picture)
    known, first, number = np.unique(regions.fill_of, return_index=True, return_inverse=True)
    own, labels = regions.fills[first], number[regions.labels]
    areas = np.bincount(labels.ravel(), minlength=len(known))
    colours, owner = fewer_colours(own, areas, settings.colors)
    if settings.palette:
        colours, becomes = nearest_colours(colours, settings.palette, settings.palette_tolerance)
        owner = becomes[owner]
    # Blends keep their shares.
    return FlatPicture(mixture_of(levels, own, labels, MISFIT, 0.0, snap=0.0).painted(colours[owner]), colours)


def without_gradients(prepared: PreparedInput, settings: ArtworkSettings) -> Flattened:
    """The picture in flat fills, with its noise if it has any, and the gradients that some stand for: none where the
    fills are the user's choice, and in scans, whose light is never quite taken out.
    """
    levels, condition = prepared.levels, prepared.condition
    if not settings.free_fills or prepared.scanned:
        return Flattened(levels)
    if condition.clean:
        return flattened(levels)
    if not condition.only_blurred:
        return without_noisy_gradients(levels, condition)
    return prepared.flat or without_blurred_gradients(levels, condition.blur)


def _painted(drawing: Drawing) -> Drawing:
    """The drawing with each fill that stands for a gradient replaced by what the gradient looks like from far away."""
    size = drawing.width, drawing.height
    shapes = [
        s if s.gradient is None else replace(s.filled(mean_fill(s.gradient), *size), gradient=s.gradient)
        for s in drawing.shapes
    ]
    return replace(drawing, shapes=tuple(shapes))
