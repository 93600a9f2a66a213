"""A picture without its soft shadows: every pixel of a shaded ground becomes the ground, at edges its share does.

A shape that covers a soft area in the ground's own colour, a white card on white, would be lost with it. It gets a
placeholder fill until the drawing is finished.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.areas import EXPLAINED
from cubicsplat_cli.artwork.gradients.flattening import placeholders, with_placeholders
from cubicsplat_cli.artwork.gradients.parts import smooth_parts
from cubicsplat_cli.artwork.gradients.shade import CLOSE
from cubicsplat_cli.artwork.regions.fills import ALIKE, EVEN, ROUNDED, SAME, SEEN, eight_bit
from cubicsplat_cli.artwork.regions.regions import ShadowSides
from cubicsplat_cli.artwork.shadows.casters import LEAST_CASTER
from cubicsplat_cli.artwork.shadows.shadow import FAINT, Shadow, falls_on, shadow_of
from cubicsplat_cli.artwork.shadows.soft import REACH, SHARP_BEND, SoftArea, soft_areas
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Rgba


@record
class Lifted:
    """levels: (H, W, 4) the picture without its shadows. shadow: those of boxes, or None; shaded: (H, W) bool, the
    pixels that showed them; areas: soft areas of any other form; fills: placeholders with the fills they stand for."""

    levels: np.ndarray
    shadow: Shadow | None = None
    areas: tuple[SoftArea, ...] = ()
    shaded: np.ndarray | None = None
    fills: tuple[tuple[Rgba, Rgba], ...] = ()

    def __bool__(self) -> bool:
        """Return True if the picture had shadows."""
        return self.shadow is not None or bool(self.areas)

    @cached_property
    def sides(self) -> list[ShadowSides]:
        """For each soft area, the pixels (H, W) bool that it shades and those that it would shade if they did not lie
        above it, all of them inside shapes."""
        return [sides_of(area.share > FAINT / 255.0, area.mask) for area in self.areas]

    def meant(self, drawing: Drawing) -> Drawing:
        """Return the drawing with the true fills in place of placeholders, which are rounded as other fills may be."""

        def meant(shape: Shape) -> Shape:
            if shape.gradient is None:
                for stand, fill in self.fills:
                    if max(abs(one - other) for one, other in zip(shape.fill, stand, strict=True)) <= SAME:
                        return shape.filled(fill, drawing.width, drawing.height)
            return shape

        return replace(drawing, shapes=tuple(map(meant, drawing.shapes)))


def sides_of(dark: np.ndarray, shaded: np.ndarray) -> ShadowSides:
    """Return the pixels (H, W) bool inside of shaded ones, and of others, in which a shadow would be dark."""
    inner, outer = ndimage.binary_erosion(shaded, ndimage.SQUARE), ndimage.binary_dilation(shaded, ndimage.SQUARE)
    return inner & dark, ~outer & dark


def lifted(levels: np.ndarray, areas: tuple[SoftArea, ...] | None = None) -> Lifted:
    """Return a picture (H, W, 4), premultiplied levels, without its shadows; the same array if it has none. areas: the
    soft areas to remove, if they are known."""
    parts = smooth_parts(levels, SHARP_BEND, np.inf)
    if areas is not None:
        return without_areas(levels, parts.numbers, areas)
    shadow = shadow_of(parts)
    if shadow is None:
        return without_areas(levels, parts.numbers, tuple(soft_areas(parts)))
    grounds, taken = _shaded_grounds(levels, shadow), shadow.shaded.mask
    above = np.logical_or.reduce([cast.mask for cast in shadow.casts]) & ~taken
    out, meant = _without_grounds(levels, np.where(taken, 0, parts.numbers), grounds, above, 1.0, SEEN)
    return Lifted(out, shadow, (), np.logical_or.reduce([area.mask for area in grounds]), meant)


def without_areas(
    levels: np.ndarray, parts: np.ndarray, areas: tuple[SoftArea, ...], rough: float = 1.0, line: float = SEEN
) -> Lifted:
    """Return a picture (H, W, 4) in levels without soft areas; the same array if there are none. parts: (H, W) int32,
    connected parts of one colour, 0 for none. rough: how many times as much pixels differ from their fill as in a clean
    picture. line: as of `with_placeholders`."""
    if not areas:
        return Lifted(levels)
    dark = np.logical_or.reduce([area.scale * area.share > FAINT for area in areas])
    above = dark & ~np.logical_or.reduce([area.mask for area in areas])
    out, meant = _without_grounds(levels, parts, areas, above, rough, line)
    return Lifted(out, None, areas, None, meant)


def _without_grounds(
    levels: np.ndarray, parts: np.ndarray, grounds: Sequence[SoftArea], above: np.ndarray, rough: float, line: float
) -> tuple[np.ndarray, tuple[tuple[Rgba, Rgba], ...]]:
    """Return a picture (H, W, 4) in levels whose shaded grounds are even; and placeholders in it, with their fills.
    above: (H, W) bool, the pixels that cover the shadows. parts, rough, line: as of `without_areas`."""
    cards = _like_ground(levels, parts, grounds, above, rough)
    stands, paints = placeholders([card.fill for card in cards], levels.reshape(-1, 4)), [*grounds, *cards]
    paint = np.where(parts > 0, parts + len(paints) - 1, -1).astype(np.int32)
    for k, area in enumerate(paints):
        paint[area.mask] = k
    fills = np.array([area.fill for area in grounds] + stands)
    meant = tuple((eight_bit(stand), eight_bit(card.fill)) for stand, card in zip(stands, cards, strict=True))
    return with_placeholders(levels, paint, [area.colours for area in paints], fills, line), meant


def _shaded_grounds(levels: np.ndarray, shadow: Shadow) -> list[SoftArea]:
    """Return the visible pixels of the grounds on which the shadow of boxes falls, and their shades."""
    colour, grounds = shadow.shaded.colour, shadow.shaded.grounds
    shares, owner = [shadow.share_on(ground.mask) for ground in grounds], np.full(levels.shape[:2], -1)
    for k, (ground, share) in enumerate(zip(grounds, shares, strict=True)):
        casters = np.logical_or.reduce([cast.mask for cast in shadow.casts if falls_on(cast.mask, ground.mask)])
        off = largest(np.abs(ground.fill + share[..., None] * (colour - ground.fill) - levels))
        near = ndimage.binary_dilation(ground.mask, ndimage.SQUARE, iterations=REACH) & (off <= EVEN)
        owner[(ground.mask & (off <= CLOSE + ALIKE)) | (near & ~casters & (owner < 0))] = k
    return [SoftArea(ground.fill, owner == k, colour, shares[k]) for k, ground in enumerate(grounds)]


def _like_ground(
    levels: np.ndarray, parts: np.ndarray, grounds: Sequence[SoftArea], above: np.ndarray, rough: float
) -> list[SoftArea]:
    """Return the shapes above a shadow in the fill of a ground: an area for each fill, which has this colour
    everywhere, unlike a ground. Arguments as of `_without_grounds`."""
    out = dict[tuple[float, ...], np.ndarray]()
    numbers, sizes = np.unique(parts[above & (parts > 0)], return_counts=True)
    boxes = ndimage.find_objects(parts)
    for number in numbers[sizes >= LEAST_CASTER]:
        box = boxes[number - 1]
        inside = parts[box] == number
        values = levels[box][inside]
        fill = np.rint(np.median(values, axis=0)).astype(float)
        even = (largest(np.abs(values - fill)) <= ROUNDED * rough).mean() >= EXPLAINED
        if even and min(np.abs(ground.fill - fill).max() for ground in grounds) <= SAME * rough:
            out.setdefault(tuple(fill.tolist()), np.zeros(parts.shape, dtype=bool))[box] |= inside
    cards = []
    for colour, mask in out.items():
        fill = np.array(colour)
        # Ringing makes the rims of shapes uneven.
        rim = above & (largest(np.abs(levels - fill)) <= SAME * rough)
        shown = ndimage.binary_propagation(mask, None, rim)
        cards.append(SoftArea(fill, shown, fill, np.zeros(parts.shape)))
    return cards
