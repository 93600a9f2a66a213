"""From the parts of a plan to shapes with outlines, traced in the pixels or in several steps a pixel.

Outlines of thin parts in pictures without anti-aliasing, such as small letters, are uncertain by half a px, half of
their width. If an outline misses or adds a pixel of such a part, its pixels are drawn instead (`with_pixels`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.finish.polish import MOST
from cubicsplat_cli.artwork.finish.state import State, begin
from cubicsplat_cli.artwork.geometry.fitting import few_lines
from cubicsplat_cli.artwork.geometry.outlines import Outline, polygon
from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.input.condition import OUTLIER, Condition
from cubicsplat_cli.artwork.layers.completion import outlines_of_all
from cubicsplat_cli.artwork.layers.extents import Extent
from cubicsplat_cli.artwork.limits import MOST_COMPLETED, MOST_REGIONS
from cubicsplat_cli.artwork.plan import Plan, planned
from cubicsplat_cli.artwork.regions.fills import eight_bit
from cubicsplat_cli.artwork.regions.regions import FlatPicture, PixelFills
from cubicsplat_cli.artwork.regions.sampling import ROUNDING
from cubicsplat_cli.artwork.settings import ON, ArtworkSettings
from cubicsplat_cli.artwork.shapes import PRICE, SHAPE_PARAMETERS, Drawing, Shape, scaled_outline, shape_name
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.borders import border_map
from cubicsplat_cli.raster.stack import Goal
from cubicsplat_cli.raster.unmix import REACH, blend_pairs, components, finer_labels, near_fills
from cubicsplat_cli.record import record

# The misfit of a pixel whose outline must be wrong; the share of blends with it in letters and thin lines, which larger
# shapes never reach; how many times the regions a finer picture may have before it falls to pieces; the px^2 of its
# least region, half a pixel; the share of its parameters that merges leave, two thirds to four fifths.
FAR_OFF, LETTERS, MORE, LEAST_AREA, MERGED = 0.3**2, 0.05, 4, 0.5, 0.75
# Steps a pixel each way: hardly any program takes more samples. There are fewer if all would be more than MOST_STEPS,
# for their memory.
STEPS, MOST_STEPS = 4, 10_000_000
# The share of a pixel by which a line's coverage may be off (a line through the middle covers half and more), and the
# share of a part's pixels that may be off by more: none of a letter below 50 px, several of a long line.
MOST_OFF, FEW_OFF = 0.75, 0.02


def traced(plan: Plan, settings: ArtworkSettings, flat: Flattened, finer: float = 1.0, steps: int = 1) -> Drawing:
    """Return the parts of a plan as shapes with fitted outlines; polygons if the time is up. finer: a factor of the
    detail. steps: of the plan's picture, a pixel each way.
    """
    parts, canvas = plan.parts, plan.levels.shape[:2]
    detail, completed, sought = finer * settings.detail, settings.completion == ON, len(parts) <= MOST_COMPLETED
    fitted: list[tuple[Outline, ...]] = []
    with work().stoppable():
        work().at("fitting outlines", 0.25)
        for outlines in outlines_of_all([part.extent for part in parts], canvas, detail, completed, sought, steps):
            fitted.append(outlines)
            work().at("fitting outlines", 0.25 + 0.25 * len(fitted) / len(parts))
    return polygons(plan, flat, steps, fitted)


def polygons(plan: Plan, flat: Flattened, steps: int = 1, fitted: Sequence[tuple[Outline, ...]] = ()) -> Drawing:
    """Return the parts of a plan as shapes: the first ones with their fitted outlines, the others as polygons of few
    lines, which take a thousandth of the time. Other parameters as of `traced`.
    """
    height, width = (side // steps for side in plan.levels.shape[:2])
    few = (tuple(few_lines(contour.points) for contour in part.extent.contours) for part in plan.parts[len(fitted) :])
    shapes = []
    for part, outlines in zip(plan.parts, chain(fitted, few), strict=True):
        outlines = tuple(scaled_outline(outline, 1.0 / steps, 1.0 / steps) for outline in outlines)
        fill = eight_bit(part.fill)
        name = shape_name(fill, outlines, width, height)
        gradient, *over = flat.meant(part.fill) or (None,)
        shapes.append(Shape(fill, outlines, name, gradient, over=tuple(over)))
    return Drawing(width, height, tuple(shapes), banded=bool(plan.fills.banded.any()))


def length(drawing: Drawing) -> float:
    """Return the length of the description of a drawing, in parameters."""
    return sum(SHAPE_PARAMETERS + sum(outline.parameters for outline in shape.outlines) for shape in drawing.shapes)


@record
class Outlined:
    """A picture's outlines, not yet fitted to its pixels. flat, target, error: as of `plan.flat_fills`. placeholders:
    as of `planned`. smaller: by how many times its longer side is less than `vectorize.TRACED`, in px. unpainted: in
    placeholders."""

    flat: Flattened
    target: np.ndarray
    error: float
    placeholders: np.ndarray | None
    plan: Plan
    smaller: float
    unpainted: Drawing

    @property
    def drawing(self) -> Drawing:
        """The outlines in the mean colours of their gradients."""
        return self.unpainted.painted()


def or_finer(
    outlined: Outlined, goal: Goal, levels: np.ndarray, settings: ArtworkSettings, error: float
) -> tuple[Drawing, State | None]:
    """Return traced outlines, or those traced in several steps a pixel if that makes the description of the picture
    shorter; and their state, if known.

    The finer ones are tried if many blends of fills are far off, as in small letters and thin lines; in smaller
    pictures fewer suffice. levels: the picture for them, whose pixels are off by an error in levels beyond their
    rounding. settings: with areas in its px.
    """
    drawing, plan = outlined.unpainted, outlined.plan
    steps = steps_of(drawing.height, drawing.width)
    if steps == 1 or not 0 < drawing.segments <= MOST:
        return drawing, None
    state = begin(drawing, goal)
    blends = plan.fills.pure.ravel() < 0
    if outlined.smaller * (state.misfit[blends] > FAR_OFF).sum() <= LETTERS * blends.sum():
        return drawing, state
    work().at("tracing finer")
    most = min(MORE * plan.regions.count, MOST_REGIONS)
    picture = in_steps(levels, plan.fills, steps, ROUNDING + error, most)
    if picture is None:
        return drawing, state
    closer = replace(settings, min_area=max(settings.min_area, LEAST_AREA) * steps**2)
    plan = planned(picture, closer, Condition(aliased=True), outlined.placeholders)
    other = traced(plan, settings, outlined.flat, float(steps), steps)
    nearer = begin(other, goal)
    # Half of chi^2 falls by as many times what a pixel is off by chance, on average.
    falls = 0.5 * settings.detail * (state.stack.cost - nearer.stack.cost) * len(state.chance)
    longer = PRICE * (MERGED * length(other) - length(drawing))
    return (other, nearer) if falls > longer * float(state.chance.sum()) else (drawing, state)


def steps_of(height: int, width: int) -> int:
    """Return the steps a pixel each way for a picture; 1 if it has too many pixels for more."""
    return max(1, min(STEPS, math.isqrt(MOST_STEPS // (height * width))))


def in_steps(levels: np.ndarray, fills: PixelFills, steps: int, error: float, most: int) -> FlatPicture | None:
    """Return a picture (H, W, 4) in levels with so many steps a pixel each way, each in one fill or on an edge; None if
    it has more than `most` regions, specks aside. error: of its pixels, in levels.
    """
    first = np.maximum(fills.pure, 0)
    second, share = first.copy(), np.zeros(first.shape, np.float32)
    y, x = np.nonzero(fills.pure < 0)
    near = near_fills(fills.pure, y, x, REACH)
    # The main fill of a pixel is near too, even if no pure pixel shows it there.
    own = fills.fills[y, x]
    at = np.flatnonzero((near != own[:, None]).all(axis=1) & (near[:, -1] < 0))
    near[at, (near[at] >= 0).sum(axis=1)] = own[at]
    parts, _ = components((fills.pure < 0).astype(np.int32) - 1)
    # A fill that is not near must explain a pixel better than the near ones by more than chance.
    pairs = blend_pairs(levels[y, x], parts[y, x], fills.palette, near, OUTLIER * error)
    first[y, x], second[y, x], share[y, x] = pairs
    labels, finer = finer_labels(first, second, share, fills.palette, steps)
    large = np.bincount(components(labels)[0].ravel()) >= LEAST_AREA * steps**2
    return FlatPicture(finer, fills.palette, labels) if large.sum() <= most else None


def with_pixels(drawing: Drawing, plan: Plan) -> Drawing:
    """Return the drawing of a plan's parts, one shape each in their order, with pixels in place of wrong outlines."""
    pairs = zip(drawing.shapes, plan.parts, strict=True)
    shapes = (_of_pixels(shape, part.extent, plan.levels, part.fill) for shape, part in pairs)
    return replace(drawing, shapes=tuple(shapes))


def _of_pixels(shape: Shape, extent: Extent, levels: np.ndarray, fill: np.ndarray) -> Shape:
    """Return the shape of an extent; if that is wrong, the pixels of levels (H, W, 4) that are nearly its fill (4,)."""
    around = ndimage.binary_dilation(extent.shown, ndimage.SQUARE) & ~extent.shown
    # Not in wide parts, nor below other shapes: there pixels would leave gaps to smooth outlines.
    if ndimage.binary_erosion(extent.shown, ndimage.SQUARE).any() or (around & extent.allowed).any():
        return shape
    height, width = extent.shown.shape
    off = largest(np.abs(levels[extent.top : extent.top + height, extent.left : extent.left + width] - fill))
    own = extent.shown & (off <= 0.5 * off.max())
    drawn = shape.coverage(extent.top, extent.left, height, width)
    if not own.any() or (np.abs(drawn - own) > MOST_OFF).sum() <= FEW_OFF * own.sum():
        return shape
    corner = np.array([extent.left, extent.top], dtype=float)
    loops = [cracks for inside, cracks, _ in border_map(own.astype(np.int32)).loops if inside]
    turns = [cracks[cracks[:, 2] != np.roll(cracks[:, 2], 1), :2] for cracks in loops]
    return replace(shape, outlines=tuple(polygon(corners + corner) for corners in turns))
