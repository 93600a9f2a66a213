"""From a flat picture to a drawing: inks, regions, layers, contours, outlines, finish."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.finish import goal_of
from cubicsplat_cli.artwork.finish.polish import polish
from cubicsplat_cli.artwork.geometry.outlines import Outline
from cubicsplat_cli.artwork.gradients.blurred import without_blurred_gradients
from cubicsplat_cli.artwork.gradients.flattening import Flattened, flattened
from cubicsplat_cli.artwork.gradients.noisy import without_noisy_gradients
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.intake import Intake, as_levels, taken_in
from cubicsplat_cli.artwork.input.restore import in_colours, restored, seen_as
from cubicsplat_cli.artwork.input.sharpened import sharpened
from cubicsplat_cli.artwork.layers.completion import outlines_of_all, polygons_of
from cubicsplat_cli.artwork.layers.extents import SHEET
from cubicsplat_cli.artwork.limits import MOST_DETAILED, MOST_POLISHED, blocks_of, enlarged, few_enough
from cubicsplat_cli.artwork.names import shape_name
from cubicsplat_cli.artwork.plan import planned
from cubicsplat_cli.artwork.regions.fewer import fewer_colours, nearest_colours
from cubicsplat_cli.artwork.regions.inks import eight_bit, picture_inks
from cubicsplat_cli.artwork.regions.regions import FlatPicture, find_regions
from cubicsplat_cli.artwork.regions.sampling import samples_across
from cubicsplat_cli.artwork.regularities.regularities import regularised
from cubicsplat_cli.artwork.residual.added import SHAPE_PARAMETERS, with_added
from cubicsplat_cli.artwork.settings import CUTOUT, ON, ArtworkSettings
from cubicsplat_cli.artwork.shadows.lifting import lifted
from cubicsplat_cli.artwork.shadows.placing import with_shadow
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.translucent.parts import TranslucentPart, parts_of
from cubicsplat_cli.progress import Work, nothing, under_way, work
from cubicsplat_cli.scene.paint import mean_ink

MANY = 150  # parts, whose finish takes longer than to find out whether they are worth it
SKETCH = 160  # px of the longer side, of what is drawn in well under a second


def prepared(target: np.ndarray) -> Intake:
    """A picture prepared for `draw`; where the work under way is stopped, a small copy."""
    intake = None
    with work().stoppable():
        work().at("looking at the picture")
        intake = taken_in(target)
    return intake or _small(target)


def draw(
    target: np.ndarray,
    settings: ArtworkSettings | None = None,
    intake: Intake | None = None,
    *,
    strokes: bool = False,
    on_sketch: Callable[[Drawing], None] = nothing,
) -> Drawing:
    """The drawing of a flat picture: (H, W, 3) or (H, W, 4) premultiplied, float32 in [0, 1].

    What was made larger by a whole number is drawn as it was before. Very large pictures, and those of very many
    regions, are drawn with less detail (`limits`), which is logged. What has hardly a region of more than a few px is
    drawn as it looks from farther away. intake: `prepared(target)`, where that is known already. strokes: shapes of
    even width become pen strokes. on_sketch: given the regions as polygons, in px of the picture, where there are many;
    what it raises ends the drawing.

    Where the work under way (`progress.work`) is stopped, the drawing is what there is by then: outlines not yet fitted
    are polygons, and where the regions were not known yet it is that of a smaller copy.
    """
    settings, intake = settings or ArtworkSettings(), intake or prepared(target)
    drawing = None
    with work().stoppable():
        drawing = _with_its_shadow(intake, settings, strokes, on_sketch) or _drawn(intake, settings, strokes, on_sketch)
    if drawing is None:
        intake = _small(target)
        drawing = _sketch(intake, settings)
    return enlarged(drawing, intake.scale, intake.width, intake.height)


def _small(target: np.ndarray) -> Intake:
    """A copy of a picture of at most SKETCH px a side, taken as it is."""
    height, width = target.shape[:2]
    factor = -(-max(height, width) // SKETCH)
    return Intake(blocks_of(as_levels(target), factor), Condition(), factor, 1, width, height)


def _sketch(intake: Intake, settings: ArtworkSettings) -> Drawing:
    """The regions of a small picture as polygons."""
    with under_way(Work()):
        plan = planned(_even(intake.levels, intake, settings), settings, intake.scale, 0.0, None)
    height, width = plan.levels.shape[:2]
    flat = Flattened(intake.levels, np.zeros((0, 4)), ())
    return Drawing(width, height, _polygons(plan.parts, (height, width), flat))


def _with_its_shadow(
    intake: Intake, settings: ArtworkSettings, strokes: bool, on_sketch: Callable[[Drawing], None]
) -> Drawing | None:
    """The drawing of a clean picture with a soft shadow, in gradients; None where it has none, or there may be no
    gradients or not as many shapes.
    """
    if not _may_shine_through(intake, settings):
        return None
    without = intake.lifted or lifted(intake.levels)
    if without.shadow is None:
        return None
    drawing = with_shadow(_drawn(replace(intake, levels=without.levels), settings, strokes, on_sketch), without)
    if drawing is None or (settings.curves is not None and len(drawing.shapes) > settings.curves):
        return None
    return drawing


def _drawn(intake: Intake, settings: ArtworkSettings, strokes: bool, on_sketch: Callable[[Drawing], None]) -> Drawing:
    """The drawing of what was taken in, in px of that; see `draw`."""
    condition = intake.condition
    error = condition.edge_error
    work().at("finding gradients", 0.05)
    flat = without_gradients(intake, settings)
    work().at("finding colours", 0.1)
    even = _even(flat.levels, intake, settings)
    standing = flat.inks if _may_shine_through(intake, settings) else None
    plan = planned(even, settings, intake.scale, condition.restored_error, standing)
    height, width = plan.levels.shape[:2]
    if len(plan.parts) > MANY:
        sketch = Drawing(width, height, _polygons(plan.parts, (height, width), flat))
        with work().stoppable():
            on_sketch(enlarged(_painted(sketch), intake.scale, intake.width, intake.height))
    shapes = _traced(plan.parts, (height, width), settings, flat)
    if any(part.extent.layer == SHEET for part in plan.parts):
        opaque = parts_of(plan.regions, plan.found, settings.completion == ON, None)
        if settings.curves is None or len(opaque) <= settings.curves:
            shapes = min(shapes, _traced(opaque, (height, width), settings, flat), key=_length)
    drawing = Drawing(width, height, shapes)
    with work().stoppable():
        grid = samples_across(plan.levels, plan.regions) if condition.clean else 0
        # Edges that were restored tell less than the picture as it came.
        came = plan.levels if condition.clean else flat.levels
        goal = goal_of(came.astype(float) / 255.0, condition.blur, seen_as(condition))
        drawing = polish(drawing, goal, settings.detail, error / 255.0)
        few = few_enough(drawing)
        if few:
            work().at("regularising", 0.8)
            drawing = regularised(drawing, goal, settings.detail, grid, error / 255.0)
        # What was given up for fewer inks or shapes is no detail that was lost.
        if settings.free_inks and len(shapes) <= MOST_DETAILED:
            work().at("adding details", 0.93)
            min_area = settings.min_area / intake.scale**2
            drawing = with_added(drawing, goal, condition, settings.detail, min_area, settings.curves)
        if strokes:
            from cubicsplat_cli.artwork.strokes.find import with_strokes
            from cubicsplat_cli.artwork.strokes.fit import fitted_strokes

            work().at("finding strokes", 0.97)
            drawing = with_strokes(drawing, settings.detail, error / 255.0)
            drawing = fitted_strokes(drawing, goal) if few else drawing
    return _painted(drawing)


def _may_shine_through(intake: Intake, settings: ArtworkSettings) -> bool:
    """Whether shapes may be translucent: what is not clean says too little of a blend, who chooses the inks wants no
    others, and cutters know none.
    """
    return intake.condition.clean and settings.free_inks and settings.stacking != CUTOUT


def _even(levels: np.ndarray, intake: Intake, settings: ArtworkSettings) -> FlatPicture:
    """A picture without gradients as if it were clean, in the colours that are asked for."""
    if intake.pens is not None:
        even = FlatPicture(*sharpened(levels, intake.pens))
    else:
        even = FlatPicture(levels) if intake.condition.clean else restored(levels, intake.condition)
    return even if settings.free_inks else _in_chosen_colours(even, settings)


def _in_chosen_colours(picture: FlatPicture, settings: ArtworkSettings) -> FlatPicture:
    """A clean picture in no more than the colours asked for, or in those of the palette."""
    levels, palette = picture.levels, picture.palette
    regions = find_regions(levels, picture_inks(levels) if palette is None else palette, picture.labels)
    known, first, number = np.unique(regions.ink_of, return_index=True, return_inverse=True)
    own, labels = regions.inks[first], number[regions.labels]
    areas = np.bincount(labels.ravel(), minlength=len(known))
    colours, owner = fewer_colours(own, areas, settings.colors)
    if settings.palette:
        colours, becomes = nearest_colours(colours, settings.palette)
        owner = becomes[owner]
    return FlatPicture(in_colours(levels, labels, own, colours[owner]), colours)


def _traced(
    parts: list[TranslucentPart], canvas: tuple[int, int], settings: ArtworkSettings, flat: Flattened
) -> tuple[Shape, ...]:
    """The parts with their outlines, polygons where there is no time to fit them. canvas: its height and width, px."""
    completed, sought = settings.completion == ON, len(parts) <= MOST_POLISHED
    fitted: list[tuple[Outline, ...]] = []
    with work().stoppable():
        work().at("fitting outlines", 0.25)
        for outlines in outlines_of_all([part.extent for part in parts], canvas, settings.detail, completed, sought):
            fitted.append(outlines)
            work().at("fitting outlines", 0.25 + 0.25 * len(fitted) / len(parts))
    shapes = [_shape(part, outlines, canvas, flat) for part, outlines in zip(parts, fitted, strict=False)]
    return (*shapes, *_polygons(parts[len(fitted) :], canvas, flat))


def _polygons(parts: list[TranslucentPart], canvas: tuple[int, int], flat: Flattened) -> tuple[Shape, ...]:
    return tuple(_shape(part, polygons_of(part.extent), canvas, flat) for part in parts)


def _shape(part: TranslucentPart, outlines: tuple[Outline, ...], canvas: tuple[int, int], flat: Flattened) -> Shape:
    ink = eight_bit(part.ink)
    return Shape(ink, outlines, shape_name(ink, outlines, canvas[1], canvas[0]), flat.gradient(part.ink))


def _length(shapes: tuple[Shape, ...]) -> float:
    """Of the description of shapes, in parameters."""
    return sum(SHAPE_PARAMETERS + sum(outline.parameters for outline in shape.outlines) for shape in shapes)


def without_gradients(intake: Intake, settings: ArtworkSettings) -> Flattened:
    """The picture in flat inks, with its noise if it has any, and the gradients that some stand for: none where the
    inks are the user's choice, and in scans, whose light is never quite taken out.
    """
    levels, condition = intake.levels, intake.condition
    if not settings.free_inks or intake.scanned:
        return Flattened(levels, np.zeros((0, 4)), ())
    if condition.clean:
        return flattened(levels)
    if not condition.only_blurred:
        return without_noisy_gradients(levels, condition)
    return intake.flat or without_blurred_gradients(levels, condition.blur)


def _painted(drawing: Drawing) -> Drawing:
    """The drawing with each ink that stands for a gradient replaced by what the gradient looks like from far away."""
    shapes = []
    for shape in drawing.shapes:
        if shape.gradient is not None:
            ink = mean_ink(shape.gradient)
            shape = replace(shape, ink=ink, name=shape_name(ink, shape.outlines, drawing.width, drawing.height))
        shapes.append(shape)
    return replace(drawing, shapes=tuple(shapes))
