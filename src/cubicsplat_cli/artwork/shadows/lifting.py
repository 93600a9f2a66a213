"""A picture without its soft shadows: all pixels of a shaded ground become that ground again, at edges its share.

What covers a soft area and has the ground's own colour, a white card on white, would be lost with it: it gets a fill
that stands for its own until the drawing is finished.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.gradients.flattening import placeholders, with_placeholders
from cubicsplat_cli.artwork.gradients.parts import smooth_parts
from cubicsplat_cli.artwork.gradients.shade import CLOSE
from cubicsplat_cli.artwork.regions.fills import SAME, eight_bit
from cubicsplat_cli.artwork.shadows.shadow import FAINT, Shadow, Shares, falls_on, shadow_of
from cubicsplat_cli.artwork.shadows.soft import SoftArea, soft_areas
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Rgba

SHARP_BEND = 6.0  # levels, the second difference in a dark shadow of little blur
NEAR, BESIDE = 1.0, 6  # levels by which a pixel so many px beside a ground may be off to belong to it
LEAST_PART, EVEN = 12, 1.5  # px of an even part of what casts a shadow, and levels that it may span


@record
class ShadedGround:
    """fill, colour: (4,) levels of a ground, and that it tends to; mask: (H, W) bool where it is seen; share: (H, W)
    how much each of its pixels is shaded."""

    fill: np.ndarray
    colour: np.ndarray
    mask: np.ndarray
    share: np.ndarray


@record
class Lifted:
    """levels: (H, W, 4) the picture without its shadows. shadow: that of boxes, None where there is none; areas: those
    of any other form; shaded: (H, W) bool the pixels that showed the former; fills: what some fills stand for."""

    levels: np.ndarray
    shadow: Shadow | None = None
    areas: tuple[SoftArea, ...] = ()
    shaded: np.ndarray | None = None
    fills: tuple[tuple[Rgba, Rgba], ...] = ()

    def __bool__(self) -> bool:
        """Whether there was anything to take off."""
        return self.shadow is not None or bool(self.areas)

    def meant(self, drawing: Drawing) -> Drawing:
        """The drawing with the fills that are meant in place of those that stand for them."""
        meant, size = dict(self.fills), (drawing.width, drawing.height)
        return replace(
            drawing,
            shapes=tuple(
                shape.filled(meant[shape.fill], *size) if shape.gradient is None and shape.fill in meant else shape
                for shape in drawing.shapes
            ),
        )


def lifted(levels: np.ndarray, areas: tuple[SoftArea, ...] | None = None) -> Lifted:
    """A picture (H, W, 4), premultiplied levels, without its shadows; the same array where it has none. areas: those
    that are taken off, where they are known.
    """
    parts, count = smooth_parts(levels, SHARP_BEND, np.inf)
    shadow = shadow_of(levels, parts, count) if areas is None else None
    shaded: np.ndarray | None = None
    above, taken = np.zeros(parts.shape, dtype=bool), np.zeros(parts.shape, dtype=bool)
    if shadow is not None:
        grounds = _shaded_grounds(levels, shadow)
        shaded = np.logical_or.reduce([ground.mask for ground in grounds])
        taken = shadow.shaded.mask
        above = np.logical_or.reduce([cast.mask for cast in shadow.casts]) & ~taken
    else:
        areas = tuple(soft_areas(levels, parts, count)) if areas is None else areas
        grounds = [ShadedGround(area.ground.fill, area.colour, area.mask, area.share) for area in areas]
        for area in areas:
            above |= (area.scale * area.share > FAINT) & ~area.mask
    if not grounds:
        return Lifted(levels)
    cards = _like_ground(levels, parts, grounds, above)
    stands = placeholders([fill for fill, _ in cards], levels.reshape(-1, 4))
    # What a ground has where it is shaded, and a card anywhere.
    shades = [*grounds, *(ShadedGround(fill, fill, mask, np.zeros(parts.shape)) for fill, mask in cards)]
    colours = [lambda x, y, s=s: s.fill + s.share[y, x][:, None] * (s.colour - s.fill) for s in shades]
    paint = np.where((parts > 0) & ~taken, parts + len(shades) - 1, -1).astype(np.int32)
    for k, shade in enumerate(shades):
        paint[shade.mask] = k
    fills = np.array([ground.fill for ground in grounds] + stands)
    meant = tuple((eight_bit(s), eight_bit(fill)) for s, (fill, _) in zip(stands, cards, strict=True))
    return Lifted(with_placeholders(levels, paint, colours, fills), shadow, areas or (), shaded, meant)


def _shaded_grounds(levels: np.ndarray, shadow: Shadow) -> list[ShadedGround]:
    """What shows of the grounds on which the shadow of boxes falls."""
    shares, grounds, colour = Shares(shadow, levels.shape[:2]), shadow.shaded.grounds, shadow.shaded.colour
    owner = np.full(levels.shape[:2], -1, dtype=np.int32)
    for k, ground in enumerate(grounds):
        casters = np.zeros(owner.shape, dtype=bool)
        for cast in shadow.casts:
            if falls_on(cast.mask, ground.mask):
                casters |= cast.mask
        off = np.abs(ground.fill + shares.on(ground.mask)[..., None] * (colour - ground.fill) - levels).max(axis=2)
        own = ground.mask & (off <= CLOSE + 0.5)
        near = ndimage.binary_dilation(ground.mask, ndimage.SQUARE, iterations=BESIDE) & (off <= NEAR)
        owner[own | (near & ~casters & (owner < 0))] = k
    return [ShadedGround(g.fill, colour, owner == k, shares.on(g.mask)) for k, g in enumerate(grounds)]


def _like_ground(
    levels: np.ndarray, parts: np.ndarray, grounds: Sequence[ShadedGround], above: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The fills (4,) of what covers a shadow that a ground has too, and (H, W) bool where they are. above: (H, W) bool
    what covers it.
    """
    out: dict[tuple[float, ...], np.ndarray] = {}
    names, sizes = np.unique(parts[above & (parts > 0)], return_counts=True)
    boxes = ndimage.find_objects(parts)
    for name in names[sizes >= LEAST_PART]:
        box = boxes[name - 1]
        own = parts[box] == name
        values = levels[box][own]
        fill = np.rint(np.median(values, axis=0)).astype(float)
        if np.abs(values - fill).max() > EVEN or min(np.abs(g.fill - fill).max() for g in grounds) > SAME:
            continue
        out.setdefault(tuple(fill.tolist()), np.zeros(parts.shape, dtype=bool))[box] |= own
    return [(np.array(fill), mask) for fill, mask in out.items()]
