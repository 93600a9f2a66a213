"""The shapes that an area of a picture asks for where its drawing does not explain it: their colours and outlines.

A pixel is unexplained by as much as it lies outside of all colours that are drawn within a px or so of it: edges that
are a little off are none. What is left is averaged over squares and along short lines, so that noise goes and lines of
one px stay.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import largest, widened
from cubicsplat_cli.artwork.geometry.outlines import Circle, Outline, Rectangle
from cubicsplat_cli.artwork.gradients.parts import Patch
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA
from cubicsplat_cli.artwork.input.condition import OUTLIER, Condition
from cubicsplat_cli.artwork.input.palette import OUTER, UNLIKE, has_border, modes, ringing
from cubicsplat_cli.artwork.layers.completion import DOT, outlines_of
from cubicsplat_cli.artwork.layers.extents import Extent, extents_of
from cubicsplat_cli.artwork.regions.fills import BLEND, OPAQUE, SEEN, eight_bit
from cubicsplat_cli.artwork.regions.pixel_lines import joined_at_corners
from cubicsplat_cli.artwork.regions.sampling import COVERS, share_positions
from cubicsplat_cli.artwork.shapes import Drawing, Shape, shape_name
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.stack import DrawnStack
from cubicsplat_cli.raster.unmix import blend_with, unexplained
from cubicsplat_cli.record import record

SIDE = 5  # px, of the lines along which residuals are averaged
OWN = 0.5  # of the mean around it that a pixel is off itself
MARGIN = 5  # px around an area that are looked at with it
# Px times levels of an area that people see, in a clean picture; and with noise, with px of a shape: 60 px of what is
# just unlike, or a short line.
LEAST_CLEAN, LEAST, SMALLEST = 160.0, 60.0 * UNLIKE, 6
RINGING = 12.0  # levels by which edges of a JPEG of quality 90 are off; with less, less of an area is enough
LINE = 3  # px of a shape from which it is a line where they are in a row
SOLID = 9  # px of an area that are surrounded by others of it, which show its colour
LESS = 0.2  # share from which a pixel on the middle of a line is the new shape's, as others are by half of them
SHOWS = 0.1  # coverage of a pixel by a shape that shows in it


@record
class Area(Patch):
    """Pixels of a canvas. weight: what they add to the error."""

    weight: float


@record
class TargetPicture:
    """The picture that drawings are compared with, in a condition. levels: (H, W, 4); least: px times levels of an
    area; smallest: px of a shape; ringing: (H, W, 4) levels by which ringing edges are off in luma and chroma, else 0.
    """

    levels: np.ndarray
    condition: Condition
    least: float
    smallest: float
    ringing: np.ndarray

    @classmethod
    def of(cls, levels: np.ndarray, condition: Condition, min_area: float) -> TargetPicture:
        """The picture in a condition. min_area: px^2 that a shape has at least."""
        seen, share = levels @ LUMA_CHROMA, 1.0 if condition.aliased else min(condition.restored_error / RINGING, 1.0)
        off = ringing(seen) if condition.jpeg or condition.sharpened else np.zeros(seen.shape, np.float32)
        return cls(levels, condition, max(LEAST_CLEAN, share * LEAST), max(1, round(share * SMALLEST), min_area), off)


def areas(picture: TargetPicture, painted: np.ndarray) -> list[Area]:
    """The areas in which a picture is unlike what is painted, (H, W, 4) in levels, the worst first."""
    condition = picture.condition
    allowed = UNLIKE + OUTLIER * condition.error_of_mean(SIDE)
    # What lies beneath shows through on edges of a clean picture.
    judged = 1 + math.ceil(condition.blur), SEEN if condition.clean else 0.0, UNLIKE, OWN, allowed
    gap, where = unexplained(picture.levels, painted, LUMA_CHROMA, picture.ringing, *judged)
    if gap[where].sum() < picture.least:
        return []
    reach = max(MARGIN + math.ceil(2.0 * condition.blur), OUTER if condition.noise else 0)
    parts, _ = ndimage.label(ndimage.binary_dilation(where, ndimage.SQUARE), ndimage.SQUARE)
    # Where most of it lies on the canvas's rim, whose pixels blend with what is beyond, a JPEG rings beside these.
    inner, unlike = gap if condition.clean else np.pad(gap[1:-1, 1:-1], 1), []
    for number, box in enumerate(ndimage.find_objects(parts), start=1):
        rows, columns = window = widened(box, reach, gap.shape)
        pixels = where[window] & (parts[window] == number)
        off = gap[window][pixels]
        weight = float((off**2).sum())
        if off.sum() < picture.least or 2.0 * (inner[window][pixels] ** 2).sum() <= weight:
            continue
        if not condition.noise or has_border(gap[window][..., None], pixels, ~where[window]):
            unlike.append(Area(rows.start, columns.start, pixels, weight))
    return sorted(unlike, key=lambda area: -area.weight)


@record
class Placed:
    """A new shape, and the number of the shape of the drawing that it lies on; -1 for none."""

    shape: Shape
    beneath: int


class Canvas:
    """The visible parts of a drawing's shapes. stack: they, as drawn; painted: (H, W, 4) levels of that; palette: their
    fills (P, 4) in levels, but for those that stand for gradients."""

    def __init__(self, drawing: Drawing, stack: DrawnStack, painted: np.ndarray) -> None:
        self.size = drawing.height, drawing.width
        fills = np.array([shape.fill for shape in drawing.shapes], dtype=float)
        self.fills = np.concatenate([fills[:, :3] * fills[:, 3:] / 255.0, fills[:, 3:]], axis=1)
        self.palette = np.unique(self.fills[[shape.gradient is None for shape in drawing.shapes]], axis=0)
        self.stack, self.painted = stack, painted


def proposals(area: Area, picture: TargetPicture, canvas: Canvas, detail: float) -> Iterator[list[Placed]]:
    """The ways to explain an area of a picture by shapes over what is painted."""
    window, condition = area.window, picture.condition
    values, ground = picture.levels[window].astype(float), canvas.painted[window].astype(float)
    inner = ndimage.binary_erosion(area.mask, ndimage.SQUARE)
    if condition.noise:
        values[inner] = ndimage.uniform_filter(values, (3, 3, 1))[inner]
    near = ndimage.binary_dilation(area.mask, ndimage.SQUARE, 2)
    # The uppermost shapes that cover half or more of each pixel, and that show in it; -1 for none.
    owners, touching = (canvas.stack.uppermost(*window, share) for share in (0.5, SHOWS))
    for colours in _colours(values, ground, area.mask, inner, canvas.palette, pure=condition.clean):
        shares, rest = np.zeros((len(colours), *near.shape)), np.full((len(colours), *near.shape), np.inf)
        for k, colour in enumerate(colours):
            shares[k][near], rest[k][near] = blend_with(values[near], colour, ground[near], ground[near])
        best = rest.argmin(axis=0)
        found: list[Placed] = []
        for k, colour in enumerate(colours):
            share = np.where(near & (best == k), shares[k], 0.0)
            cover = _cover(share, area.mask, condition.blur)
            if cover.any():
                contrast = max(float(np.median(largest(np.abs(colour - ground[cover])))), 1.0)
                drawn, fill = _Drawn(area, share, cover, owners, touching, canvas), eight_bit(colour)
                for beneath, outlines in drawn.outlines(picture.smallest, condition.edge_error / contrast, detail):
                    name = shape_name(fill, outlines, *canvas.size[::-1])
                    found.append(Placed(Shape(fill, outlines, name), beneath))
        yield found


def _cover(share: np.ndarray, where: np.ndarray, blur: float) -> np.ndarray:
    """(h, w) bool: a new shape's pixels: half of what it has most of beside them, at least; lines stay in one piece."""
    most = ndimage.maximum_filter(share, 3 + 2 * math.ceil(blur))
    cover = (share >= 0.5) | ((share >= np.maximum(LESS, 0.5 * most)) & where)
    levels = np.repeat(share[..., None], 4, axis=2)
    return joined_at_corners(cover.astype(np.int32), levels, COVERS / 255.0, whole=True) > 0


@record
class _Drawn:
    """Pixels of an area that one colour may explain. share: (h, w) what it covers of each pixel; cover: (h, w) bool,
    the pixels that are its own; owners, touching: (h, w) which shapes show so far.
    """

    area: Area
    share: np.ndarray
    cover: np.ndarray
    owners: np.ndarray
    touching: np.ndarray
    canvas: Canvas

    def outlines(self, smallest: float, error: float, detail: float) -> Iterator[tuple[int, tuple[Outline, ...]]]:
        """The outlines of connected parts of `smallest` px or more, and the shape each lies on; error: of shares."""
        found = share_positions(self.share, self.cover, 255.0 * error)
        parts, _ = ndimage.label(self.cover)
        sizes = np.bincount(parts.ravel())
        for number in (1 + np.flatnonzero(sizes[1:] >= smallest)).tolist():
            own = parts == number
            beneath = _beneath(self.owners[own], self.touching[own])
            if sizes[number] <= DOT:
                near = ndimage.binary_dilation(own, ndimage.SQUARE)
                seam = self.share[near].sum() < 1.0 and len(np.unique(self.owners[near])) > 1
                if seam or (self.cover & ~own)[near].any():
                    continue  # of a line between two shapes, of which dots here and there are none of the drawing
                yield beneath, (self._dot(own),)
                continue
            opaque = self.canvas.fills[np.maximum(self.owners, 0), 3] >= OPAQUE
            for extent in extents_of(own, (self.owners > beneath) & opaque & ~self.cover, found):
                yield beneath, outlines_of(self._placed(extent), self.canvas.size, detail)

    def _dot(self, own: np.ndarray) -> Circle | Rectangle:
        """A circle that covers as much as the shares in and around a part of very few px; of a row or column a box."""
        share = np.where(ndimage.binary_dilation(own, ndimage.SQUARE), self.share, 0.0)
        profiles = share.sum(axis=0), share.sum(axis=1)
        x, y = (float(each @ (np.arange(len(each)) + 0.5) / each.sum()) for each in profiles)
        x, y = x + self.area.left, y + self.area.top
        sides = [int(own.any(axis=axis).sum()) for axis in (0, 1)]
        if min(sides) > 1 or max(sides) < LINE:
            return Circle(x, y, math.sqrt(float(share.sum()) / math.pi))
        along = profiles[int(sides[1] > sides[0])]
        thick, length = float(along.max()), float(along.sum() / along.max())
        width, height = (length, thick) if sides[0] > 1 else (thick, length)
        return Rectangle(x - width / 2.0, y - height / 2.0, width, height)

    def _placed(self, extent: Extent) -> Extent:
        """An extent of the window on the canvas."""
        corner = np.array([self.area.left, self.area.top])
        contours = tuple(replace(each, points=each.points + corner) for each in extent.contours)
        return replace(extent, top=extent.top + corner[1], left=extent.left + corner[0], contours=contours)


def _beneath(owners: np.ndarray, touching: np.ndarray) -> int:
    """The uppermost shape of the owners (n,) of a new one, and of those that are the uppermost to show (n,) in most of
    it, as hairlines do.
    """
    names, counts = np.unique(touching, return_counts=True)
    return max(int(owners.max()), int(names[counts > 0.5 * len(touching)].max(initial=-1)))


def _colours(
    values: np.ndarray, ground: np.ndarray, where: np.ndarray, inner: np.ndarray, palette: np.ndarray, *, pure: bool
) -> Iterator[np.ndarray]:
    """(k, 4) the colours that an area (h, w) bool of a window may have, several ways: the one that is farthest from
    what is drawn; that of the palette which pixels are blends with; all that its inner pixels show.

    pure: a colour that is new shows as such in several pixels, as in a clean picture, and is no blend; one that does
    not comes last. Otherwise a blend is none where no area shows it.
    """
    value, beside = values[where], ground[where]
    off = ((value - beside) ** 2).sum(axis=1)
    strongest = off >= np.quantile(off, 0.75)
    farthest = np.median(value[strongest], axis=0)
    # A thin translucent colour is that of a seam between two shapes.
    new = not pure or (np.abs(value - farthest).max(axis=1) <= SEEN).sum() >= SOLID
    found = [blend_with(value, fill, beside, beside) for fill in palette]
    if not pure and inner.sum() < SOLID:
        # What damage has widened may be a narrower line in a fill that there is.
        new = min((np.median(rest[strongest]) for _, rest in found), default=np.inf) > BLEND
    if new and (farthest[3] >= OPAQUE or inner.sum() >= SOLID):
        yield farthest[None]
    if found:
        shares, rests = (np.array(each) for each in zip(*found, strict=True))
        share = np.median(shares[:, strongest], axis=1)
        costs = np.where(share >= LESS, rests.mean(axis=1), np.inf)
        if costs.min() < BLEND:
            # Black explains grey dots as well as their own grey does, which shows most of itself.
            yield palette[[np.where(costs <= costs.min() + 1.0, share, 0.0).argmax()]]
        several = np.unique(np.where(shares >= LESS, rests, np.inf).argmin(axis=0))
        if len(several) > 1:
            yield palette[several]
    places = modes(values[inner], SEEN, SOLID, np.zeros((0, 4)))
    if len(places):
        own = [np.abs(values[inner] - each).max(axis=1) <= SEEN for each in places]
        yield np.array([np.median(values[inner][each], axis=0) for each in own])
    if pure and not new and farthest[3] >= OPAQUE and np.ptp(beside, axis=0).max() <= SEEN:
        # Of dots smaller than a px, which show it nowhere, on one fill.
        yield farthest[None]
