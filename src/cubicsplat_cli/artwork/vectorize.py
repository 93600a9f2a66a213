"""From a flat picture to a drawing: inks, regions, layers, contours, outlines, finish."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.details.spots import SHAPE_PARAMETERS, with_spots
from cubicsplat_cli.artwork.finish.finish import goal_of
from cubicsplat_cli.artwork.finish.polish import polish
from cubicsplat_cli.artwork.gradients.blurred import without_blurred_gradients
from cubicsplat_cli.artwork.gradients.flattening import Flattened, flattened
from cubicsplat_cli.artwork.gradients.noisy import without_noisy_gradients
from cubicsplat_cli.artwork.input.intake import Intake, taken_in
from cubicsplat_cli.artwork.input.restore import restored, seen_as
from cubicsplat_cli.artwork.input.sharpened import sharpened
from cubicsplat_cli.artwork.layers.completion import outlines_of
from cubicsplat_cli.artwork.layers.extents import SHEET, Extent
from cubicsplat_cli.artwork.limits import MOST_DETAILED, MOST_POLISHED, enlarged, few_enough
from cubicsplat_cli.artwork.names import shape_name
from cubicsplat_cli.artwork.plan import planned
from cubicsplat_cli.artwork.regions.inks import eight_bit
from cubicsplat_cli.artwork.regions.sampling import samples_across
from cubicsplat_cli.artwork.regularities.regularities import regularised
from cubicsplat_cli.artwork.settings import CUTOUT, ON, ArtworkSettings
from cubicsplat_cli.artwork.shadows.lifting import lifted
from cubicsplat_cli.artwork.shadows.placing import with_shadow
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.strokes.find import with_strokes
from cubicsplat_cli.artwork.strokes.fit import fitted_strokes
from cubicsplat_cli.artwork.translucent.parts import Part, parts_of
from cubicsplat_cli.scene.paint import mean_ink

MOST_POINTS, MOST_FITTED = 60_000, 1500  # of contours, and contours; the smallest beyond become polygons


def draw(
    target: np.ndarray,
    settings: ArtworkSettings | None = None,
    intake: Intake | None = None,
    *,
    strokes: bool = False,
) -> Drawing:
    """The drawing of a flat picture: (H, W, 3) or (H, W, 4) premultiplied, float32 in [0, 1].

    What was made larger by a whole number is drawn as it was before. Very large pictures, and those of very many
    regions, are drawn with less detail (`limits`), which is logged. What has hardly a region of more than a few px is
    drawn as it looks from farther away. intake: `taken_in(target)`, where that is known already. strokes: shapes of
    even width become pen strokes.
    """
    settings, intake = settings or ArtworkSettings(), intake or taken_in(target)
    drawing = _with_its_shadow(intake, settings, strokes=strokes) or _drawn(intake, settings, strokes=strokes)
    return enlarged(in_palette(drawing, settings.palette), intake.scale, intake.width, intake.height)


def _with_its_shadow(intake: Intake, settings: ArtworkSettings, *, strokes: bool) -> Drawing | None:
    """The drawing of a clean picture with a soft shadow, in gradients; None where it has none, or there may be no
    gradients or not as many shapes.
    """
    if not _may_shine_through(intake, settings):
        return None
    without = intake.lifted or lifted(intake.levels)
    if without.shadow is None:
        return None
    drawing = with_shadow(_drawn(replace(intake, levels=without.levels), settings, strokes=strokes), without)
    if drawing is None or (settings.curves is not None and len(drawing.shapes) > settings.curves):
        return None
    return drawing


def _drawn(intake: Intake, settings: ArtworkSettings, *, strokes: bool) -> Drawing:
    """The drawing of what was taken in, in px of that; see `draw`."""
    condition = intake.condition
    error = condition.edge_error
    flat = without_gradients(intake, settings)
    even, inks = _even(flat.levels, intake, settings)
    standing = flat.inks if _may_shine_through(intake, settings) else None
    plan = planned(even, settings, intake.scale, condition.restored_error, standing, inks)
    height, width = plan.levels.shape[:2]
    shapes = _traced(plan.parts, (height, width), settings, flat)
    if any(part.extent.layer == SHEET for part in plan.parts):
        opaque = parts_of(plan.regions, plan.found, settings.completion == ON, None)
        if settings.curves is None or len(opaque) <= settings.curves:
            shapes = min(shapes, _traced(opaque, (height, width), settings, flat), key=_length)
    drawing = Drawing(width, height, shapes)
    grid = samples_across(plan.levels, plan.regions) if condition.clean else 0
    # Edges that were restored tell less than the picture as it came.
    came = plan.levels if condition.clean else flat.levels
    goal = goal_of(came.astype(float) / 255.0, condition.blur, seen_as(condition))
    drawing = polish(drawing, goal, settings.detail, error / 255.0)
    few = few_enough(drawing)
    if few:
        drawing = regularised(drawing, goal, settings.detail, grid, error / 255.0)
    # What was given up for fewer inks or shapes is no detail that was lost.
    if condition.clean and settings.free_inks and len(shapes) <= MOST_DETAILED:
        most = None if settings.curves is None else settings.curves - len(shapes)
        drawing = with_spots(drawing, goal, settings.detail, settings.min_area / intake.scale**2, most)
    if strokes:
        drawing = with_strokes(drawing, settings.detail, error / 255.0)
        drawing = fitted_strokes(drawing, goal) if few else drawing
    return _painted(drawing)


def _may_shine_through(intake: Intake, settings: ArtworkSettings) -> bool:
    """Whether shapes may be translucent: what is not clean says too little of a blend, who chooses the inks wants no
    others, and cutters know none.
    """
    return intake.condition.clean and settings.free_inks and settings.stacking != CUTOUT


def _even(levels: np.ndarray, intake: Intake, settings: ArtworkSettings) -> tuple[np.ndarray, np.ndarray | None]:
    """A picture without gradients as if it were clean, and its inks (k, 4) where they are known."""
    if intake.pens is not None:
        return sharpened(levels, intake.pens)
    return levels if intake.condition.clean else restored(levels, intake.condition, settings.colors), None


def _traced(
    parts: list[Part], canvas: tuple[int, int], settings: ArtworkSettings, flat: Flattened
) -> tuple[Shape, ...]:
    """The parts with their outlines. canvas: its height and width, px."""
    extents = [part.extent for part in parts]
    least, sought = _least_points(extents), len(parts) <= MOST_POLISHED
    shapes = []
    for part in parts:
        outlines = outlines_of(part.extent, canvas, settings.detail, least, settings.completion == ON, sought)
        ink = eight_bit(part.ink)
        shapes.append(Shape(ink, outlines, shape_name(ink, outlines, canvas[1], canvas[0]), flat.gradient(part.ink)))
    return tuple(shapes)


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


def in_palette(drawing: Drawing, palette: tuple[tuple[int, int, int], ...]) -> Drawing:
    """The drawing with every ink's colour replaced by the nearest of a palette; the same where that is empty."""
    if not palette:
        return drawing
    colours = np.array(palette)
    shapes = []
    for shape in drawing.shapes:
        nearest = int(((colours - np.array(shape.ink[:3])) ** 2).sum(axis=1).argmin())
        shapes.append(replace(shape, ink=(*palette[nearest], shape.ink[3])))
    return replace(drawing, shapes=tuple(shapes))


def _least_points(parts: list[Extent]) -> int:
    """The number of points below which contours become polygons, so that at most MOST_FITTED are above, of MOST_POINTS
    at most."""
    sizes = np.sort([len(contour.points) for part in parts for contour in part.contours])[::-1]
    over = np.flatnonzero((np.cumsum(sizes) > MOST_POINTS) | (np.arange(len(sizes)) >= MOST_FITTED))
    return int(sizes[over[0]]) + 1 if len(over) else 0
