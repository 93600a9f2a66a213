"""From the parts of a plan to shapes with outlines, traced in the pixels or in several steps a pixel.

Thin parts of pictures without anti-aliasing, as letters of small text, are known to half a px, which is half of what
they are. Where an outline leaves a pixel of one out, or goes where none is, its pixels are drawn instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.finish.polish import MOST
from cubicsplat_cli.artwork.finish.state import SHAPE_PARAMETERS, State, begin
from cubicsplat_cli.artwork.geometry.fitting import few_lines
from cubicsplat_cli.artwork.geometry.outlines import Outline, pieces_of_rings, polygon
from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.layers.completion import outlines_of_all
from cubicsplat_cli.artwork.layers.extents import Extent
from cubicsplat_cli.artwork.layers.translucent import TranslucentPart
from cubicsplat_cli.artwork.limits import MOST_COMPLETED, MOST_REGIONS
from cubicsplat_cli.artwork.plan import Plan, planned
from cubicsplat_cli.artwork.regions.fills import PURE, eight_bit
from cubicsplat_cli.artwork.regions.regions import FlatPicture, PixelFills
from cubicsplat_cli.artwork.regions.sampling import ONE_SAMPLE, ROUNDING
from cubicsplat_cli.artwork.settings import ON, ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape, scaled_outline, shape_name
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.borders import border_map
from cubicsplat_cli.raster.outlines import coverage
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.raster.unmix import REACH, blend_pairs, components, finer_labels, near_fills

# Misfit of a pixel that no outline leaves which is where it should be; share of the blends with it in letters and thin
# lines, not in larger shapes; times as many regions, beyond which a picture falls to pieces. Share of the error that is
# left where a finer drawing is worth its pieces; px^2 of its least region, half a pixel.
FAR_OFF, LETTERS, MORE, LEFT, LEAST_AREA = 0.3**2, 0.1, 4, 0.4, 0.5
# Steps a pixel each way, as many as hardly any program takes more samples; fewer where there would be more than
# MOST_STEPS in all, for their memory.
STEPS, MOST_STEPS = 4, 10_000_000
# Times the error of pixels that a fill which is not near must explain one better than those that are.
FARTHER = 4.0
# Share of a pixel that a line may be off: one that runs through the pixel's middle covers half of it and more.
# In a letter of fewer than 50 px one that is off more counts, in a long line several.
MOST_OFF, FEW_OFF = 0.75, 0.02


def traced(
    parts: list[TranslucentPart],
    canvas: tuple[int, int],
    settings: ArtworkSettings,
    flat: Flattened,
    finer: float = 1.0,
    steps: int = 1,
) -> tuple[Shape, ...]:
    """The parts with their outlines, polygons where there is no time to fit them. canvas: its height and width, px;
    finer: times the detail; steps: a pixel each way, in which the parts are.
    """
    detail, completed, sought = finer * settings.detail, settings.completion == ON, len(parts) <= MOST_COMPLETED
    extents, canvas_in_steps = [part.extent for part in parts], (canvas[0] * steps, canvas[1] * steps)
    fitted: list[tuple[Outline, ...]] = []
    with work().stoppable():
        work().at("fitting outlines", 0.25)
        for outlines in outlines_of_all(extents, canvas_in_steps, detail, completed, sought, steps):
            fitted.append(outlines)
            work().at("fitting outlines", 0.25 + 0.25 * len(fitted) / len(parts))
    shapes = [_shape(part, outlines, canvas, flat, steps) for part, outlines in zip(parts, fitted, strict=False)]
    return (*shapes, *polygons(parts[len(fitted) :], canvas, flat, steps))


def polygons(
    parts: list[TranslucentPart], canvas: tuple[int, int], flat: Flattened, steps: int = 1
) -> tuple[Shape, ...]:
    """The parts as polygons of few lines, in a thousandth of the time; arguments as of `traced`."""
    few = [tuple(few_lines(contour.points) for contour in part.extent.contours) for part in parts]
    return tuple(_shape(part, outlines, canvas, flat, steps) for part, outlines in zip(parts, few, strict=True))


def _shape(
    part: TranslucentPart, outlines: tuple[Outline, ...], canvas: tuple[int, int], flat: Flattened, steps: int
) -> Shape:
    outlines = tuple(scaled_outline(outline, 1.0 / steps, 1.0 / steps) for outline in outlines)
    fill = eight_bit(part.fill)
    return Shape(fill, outlines, shape_name(fill, outlines, canvas[1], canvas[0]), flat.gradient(part.fill))


def length(shapes: tuple[Shape, ...]) -> float:
    """Of the description of shapes, in parameters."""
    return sum(SHAPE_PARAMETERS + sum(outline.parameters for outline in shape.outlines) for shape in shapes)


def or_finer(
    drawing: Drawing,
    goal: Goal,
    plan: Plan,
    settings: ArtworkSettings,
    flat: Flattened,
    placeholders: np.ndarray | None,
    error: float,
) -> tuple[Drawing, State | None]:
    """A drawing as it was traced; or, where it is far off in many of the blends of its fills, as small letters and thin
    lines are, the one that is traced in several steps a pixel, if that is much nearer. And its state, if it was drawn.

    plan: of the drawing, with the picture in which to look closer. settings: with areas in its px. placeholders: as of
    `planned`. error: in levels, of the picture's pixels beyond their rounding.
    """
    height, width = drawing.height, drawing.width
    steps = steps_of(height, width)
    if steps == 1 or not 0 < drawing.segments <= MOST:
        return drawing, None
    state = begin(drawing, goal)
    blends = plan.fills.pure.ravel() < 0
    if (state.misfit[blends] > FAR_OFF).sum() <= LETTERS * blends.sum():
        return drawing, state
    work().at("tracing finer")
    most = min(MORE * plan.regions.count, MOST_REGIONS)
    finer = in_steps(plan.levels, plan.fills, steps, ROUNDING + error, most)
    if finer is None:
        return drawing, state
    closer = replace(settings, min_area=max(settings.min_area, LEAST_AREA) * steps**2)
    parts = planned(finer, closer, 1, 0.0, placeholders, ONE_SAMPLE).parts
    other = Drawing(width, height, traced(parts, (height, width), settings, flat, float(steps), steps))
    nearer = begin(other, goal)
    return (other, nearer) if nearer.value < LEFT * state.value else (drawing, state)


def steps_of(height: int, width: int) -> int:
    """Steps a pixel each way of a picture; 1 where it has too many pixels for more."""
    return max(1, min(STEPS, math.isqrt(MOST_STEPS // (height * width))))


def in_steps(levels: np.ndarray, fills: PixelFills, steps: int, error: float, most: int) -> FlatPicture | None:
    """A picture (H, W, 4) in levels as one of so many steps a pixel each way, each of them a fill, or on an edge; None
    where it falls to more than `most` regions.

    error: in levels, of its pixels.
    """
    first = np.maximum(fills.pure, 0)
    second, share = first.copy(), np.zeros(first.shape, np.float32)
    y, x = np.nonzero(fills.pure < 0)
    near = near_fills(fills.pure, y, x, REACH)
    # Where nothing is pure, all that is known is what the pixel has most of.
    near[:, 0] = np.where(near[:, 0] < 0, fills.fills[y, x], near[:, 0])
    parts, _ = components((fills.pure < 0).astype(np.int32) - 1)
    pairs = blend_pairs(levels[y, x], parts[y, x], fills.palette, near, FARTHER * error)
    first[y, x], second[y, x], share[y, x] = pairs
    labels, finer = finer_labels(first, second, share, fills.palette, steps)
    return FlatPicture(finer, fills.palette, labels) if components(labels)[1] <= most else None


def with_pixels(drawing: Drawing, plan: Plan) -> Drawing:
    """The drawing of a plan's parts, one shape each, in their order, with the pixels of thin parts that it misses."""
    pairs = zip(drawing.shapes, plan.parts, strict=True)
    shapes = [_of_pixels(shape, part.extent, plan.levels, part.fill) for shape, part in pairs]
    return replace(drawing, shapes=tuple(shapes))


def _of_pixels(shape: Shape, extent: Extent, levels: np.ndarray, fill: np.ndarray) -> Shape:
    """The shape of an extent, or its pixels in a picture (H, W, 4) of such a fill (4,), both in levels."""
    around = ndimage.binary_dilation(extent.shown, ndimage.SQUARE) & ~extent.shown
    # Pixels would leave gaps to smooth outlines of what lies above.
    if ndimage.binary_erosion(extent.shown, ndimage.SQUARE).any() or (around & extent.allowed).any():
        return shape
    height, width = extent.shown.shape
    levels = levels[extent.top : extent.top + height, extent.left : extent.left + width]
    own = extent.shown & (np.abs(levels - fill).max(axis=2) <= PURE)
    drawn = coverage(*pieces_of_rings(shape.oriented()), extent.top, extent.left, height, width)
    off = drawn - own
    if not own.any() or (np.abs(off) > MOST_OFF).sum() <= FEW_OFF * own.sum():
        return shape
    return replace(shape, outlines=tuple(_along_pixels(own, np.array([extent.left, extent.top]))))


def _along_pixels(own: np.ndarray, corner: np.ndarray) -> Iterator[Outline]:
    """The outlines of pixels (h, w) bool in a window with such a corner x, y."""
    for inside, cracks, _ in border_map(own.astype(np.int32)).loops:
        if inside:
            yield polygon(cracks[cracks[:, 2] != np.roll(cracks[:, 2], 1), :2] + corner.astype(float))
