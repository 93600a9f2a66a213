"""From a flat picture to a drawing: inks, regions, layers, contours, outlines, finish."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

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
from cubicsplat_cli.artwork.layers.seams import without_seams
from cubicsplat_cli.artwork.limits import MOST_POLISHED, MOST_REGIONS, bounded_regions, enlarged
from cubicsplat_cli.artwork.names import shape_name
from cubicsplat_cli.artwork.regions.inks import LEAST_FLAT, eight_bit, flat_pixels, picture_inks
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.regions.sampling import samples_across
from cubicsplat_cli.artwork.regularities.regularities import regularised
from cubicsplat_cli.artwork.settings import CUTOUT, ON, ArtworkSettings
from cubicsplat_cli.artwork.shadows.lifting import Lifted, lifted
from cubicsplat_cli.artwork.shadows.placing import with_shadow
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.strokes.find import with_strokes
from cubicsplat_cli.artwork.strokes.fit import fitted_strokes
from cubicsplat_cli.artwork.tracing.contours import ROUNDING, Crossings, crossings
from cubicsplat_cli.artwork.translucent.parts import Part, parts_of
from cubicsplat_cli.scene.paint import mean_ink

# Contours hold at most MOST_POINTS points, the smallest beyond become polygons. A picture of more than FEW regions has
# regions of LEAST_AREA px and more on average, or is blurred by the next of BLURS, px.
MOST_POINTS, FEW, LEAST_AREA = 60_000, 16, 10
BLURS = (0.0, 1.5, 3.0, 6.0, 12.0, 24.0)


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
    shaded = without_shadow(intake, settings)
    if shaded.shadow is not None:
        drawing = with_shadow(_drawn(replace(intake, levels=shaded.levels), settings, strokes=strokes), shaded)
    if shaded.shadow is None or drawing is None:
        drawing = _drawn(intake, settings, strokes=strokes)
    return enlarged(in_palette(drawing, settings.palette), intake.scale, intake.width, intake.height)


def without_shadow(intake: Intake, settings: ArtworkSettings) -> Lifted:
    """The picture without its soft shadow, where it is clean and is to have gradients."""
    if not intake.condition.clean or settings.palette or settings.colors is not None or settings.stacking == CUTOUT:
        return Lifted(intake.levels)
    return intake.lifted or lifted(intake.levels)


def _drawn(intake: Intake, settings: ArtworkSettings, *, strokes: bool) -> Drawing:
    """The drawing of what was taken in, in px of that; see `draw`."""
    condition = intake.condition
    error = condition.edge_error
    flat = without_gradients(intake, settings)
    even, inks = _even(flat.levels, intake, settings)
    # What is rounded says too little of a blend where it is not clean; and who chooses the inks wants no others.
    chosen = settings.palette or settings.colors is not None or settings.stacking == CUTOUT
    standing = flat.inks if condition.clean and not chosen else None
    levels, regions, found, parts = _planned(even, settings, intake.scale, condition.restored_error, standing, inks)
    height, width = levels.shape[:2]
    shapes = _traced(parts, (height, width), settings, flat)
    if any(part.extent.layer == SHEET for part in parts):
        opaque = parts_of(regions, found, settings.completion == ON, None)
        if settings.curves is None or len(opaque) <= settings.curves:
            shapes = min(shapes, _traced(opaque, (height, width), settings, flat), key=_length)
    drawing = Drawing(width, height, shapes)
    polished = len(shapes) <= MOST_POLISHED
    if polished:
        grid = samples_across(levels, regions) if condition.clean else 0
        # Edges that were restored tell less than the picture as it came.
        came = levels if condition.clean else flat.levels
        goal = goal_of(came.astype(float) / 255.0, condition.blur, seen_as(condition))
        drawing = polish(drawing, goal, settings.detail, error / 255.0)
        drawing = regularised(drawing, goal, settings.detail, grid, error / 255.0)
        # What was given up for fewer inks or shapes is no detail that was lost.
        if condition.clean and settings.colors is None and not settings.palette:
            most = None if settings.curves is None else settings.curves - len(shapes)
            drawing = with_spots(drawing, goal, settings.detail, settings.min_area / intake.scale**2, most)
    if strokes:
        drawing = with_strokes(drawing, settings.detail, error / 255.0)
        drawing = fitted_strokes(drawing, goal) if polished else drawing
    return _painted(drawing)


def _even(levels: np.ndarray, intake: Intake, settings: ArtworkSettings) -> tuple[np.ndarray, np.ndarray | None]:
    """A picture without gradients as if it were clean, and its inks (k, 4) where they are known."""
    if intake.pens is not None:
        return sharpened(levels, intake.pens)
    return levels if intake.condition.clean else restored(levels, intake.condition, settings.colors), None


def _traced(
    parts: list[Part], canvas: tuple[int, int], settings: ArtworkSettings, flat: Flattened
) -> tuple[Shape, ...]:
    """The parts with their outlines. canvas: its height and width, px."""
    least = _least_points([part.extent for part in parts])
    shapes = []
    for part in parts:
        outlines = outlines_of(part.extent, canvas, settings.detail, least, settings.completion == ON)
        ink = eight_bit(part.ink)
        shapes.append(Shape(ink, outlines, shape_name(ink, outlines, canvas[1], canvas[0]), flat.gradient(part.ink)))
    return tuple(shapes)


def _length(shapes: tuple[Shape, ...]) -> float:
    """Of the description of shapes, in parameters."""
    return sum(SHAPE_PARAMETERS + sum(outline.parameters for outline in shape.outlines) for shape in shapes)


def without_gradients(intake: Intake, settings: ArtworkSettings) -> Flattened:
    """The picture in flat inks, with its noise if it has any, and the gradients that some stand for: none where the
    inks are the user's choice.
    """
    levels, condition = intake.levels, intake.condition
    if settings.palette or settings.colors is not None:
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


def _planned(
    levels: np.ndarray,
    settings: ArtworkSettings,
    factor: int,
    error: float,
    standing: np.ndarray | None,
    inks: np.ndarray | None,
) -> tuple[np.ndarray, Regions, Crossings, list[Part]]:
    """The picture that is drawn, its regions, where they end, and the parts to draw: at most settings.curves of them.

    error: in levels, of pixels on edges beyond that of a clean picture. standing: (G, 4) inks that stand for gradients,
    of which no translucent shape makes others; None where no such shapes are sought. inks: (k, 4) those of the picture,
    None where they are not known.
    """
    min_area = settings.min_area / factor**2
    while True:
        soft, regions = _regions(levels, settings, min_area, inks)
        soft = without_seams(soft, regions)
        found = crossings(soft, regions, ROUNDING + error)
        fixed = None
        if standing is not None:
            fixed = (np.rint(regions.inks)[:, None] == standing[None]).all(axis=2).any(axis=1)
        parts = parts_of(regions, found, settings.completion == ON, fixed)
        if settings.curves is None or len(parts) <= settings.curves or min_area > levels[..., 0].size:
            return soft, regions, found, parts
        # The regions beyond as many as may be drawn join their neighbours.
        areas = np.sort(regions.areas())[::-1]
        min_area = max(2.0 * min_area, float(areas[min(settings.curves, len(areas) - 1)]) + 1.0)


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


def _regions(
    levels: np.ndarray, settings: ArtworkSettings, min_area: float, inks: np.ndarray | None
) -> tuple[np.ndarray, Regions]:
    """The regions of a picture, and the picture they are of: blurred where there would be as many as px."""
    many = max(FEW, levels.shape[0] * levels.shape[1] // LEAST_AREA)
    soft = levels
    for blur in BLURS:
        if blur:
            soft = ndimage.gaussian_filter(levels, (blur, blur, 0.0), mode="nearest")
        elif levels.shape[0] * levels.shape[1] > MOST_REGIONS and flat_pixels(levels).mean() < LEAST_FLAT:
            continue
        most = settings.colors if inks is None else min(len(inks), settings.colors or len(inks))
        palette = picture_inks(soft, most) if inks is None else inks[:most]
        regions = bounded_regions(soft, palette, min_area, most)
        if regions.count <= min(many, MOST_REGIONS):
            break
    return soft, regions


def _least_points(parts: list[Extent]) -> int:
    """The number of points below which contours become polygons, so that those above hold at most MOST_POINTS."""
    sizes = np.sort([len(contour.points) for part in parts for contour in part.contours])[::-1]
    over = np.flatnonzero(np.cumsum(sizes) > MOST_POINTS)
    return int(sizes[over[0]]) + 1 if len(over) else 0
