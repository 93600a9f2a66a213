"""A picture without its soft shadow: every pixel of a shaded ground becomes that ground again, at edges its share does.

What casts a shadow and has the ground's own colour, a white card on white, would be lost with it: it gets a fill that
stands for its own until the drawing is finished.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.gradients.flattening import placeholders, with_placeholders
from cubicsplat_cli.artwork.gradients.parts import smooth_parts
from cubicsplat_cli.artwork.regions.fills import SAME, eight_bit
from cubicsplat_cli.artwork.shadows.casters import Ground
from cubicsplat_cli.artwork.shadows.shadow import Shadow, Shares, falls_on, shadow_of
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Rgba

SHARP_BEND = 6.0  # levels, the second difference in a dark shadow of little blur
NEAR, BESIDE = 1.0, 6  # levels by which a pixel so many px beside a ground may be off to belong to it
LEAST_PART, EVEN = 12, 1.5  # px of an even part of what casts a shadow, and levels that it may span


@record
class Lifted:
    """levels: (H, W, 4) the picture without its shadow. shadow: that, None where there is none; shaded: (H, W) bool the
    pixels that showed it; fills: what some fills stand for."""

    levels: np.ndarray
    shadow: Shadow | None = None
    shaded: np.ndarray | None = None
    fills: tuple[tuple[Rgba, Rgba], ...] = ()

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


def lifted(levels: np.ndarray) -> Lifted:
    """A picture (H, W, 4), premultiplied levels, without its shadow; the same array where it has none."""
    parts, count = smooth_parts(levels, SHARP_BEND)
    shadow = shadow_of(levels, parts, count)
    if shadow is None:
        return Lifted(levels)
    shares, grounds = Shares(shadow, levels.shape[:2]), shadow.shaded.grounds
    owner = _owner(levels, shadow, shares, grounds)
    cards = _like_ground(levels, parts, shadow, grounds)
    stands = placeholders([fill for fill, _ in cards], levels.reshape(-1, 4))
    # What a ground has where it is shaded, and a card anywhere.
    shaded = [(each.fill, shares.on(each.mask)) for each in grounds]
    shaded += [(fill, np.zeros(parts.shape)) for fill, _ in cards]
    end = shadow.shaded.colour
    colours = [lambda x, y, fill=fill, share=own: fill + share[y, x][:, None] * (end - fill) for fill, own in shaded]
    paint = np.where(parts > 0, parts + len(colours) - 1, -1).astype(np.int32)
    for ground in grounds:
        paint[ground.mask] = -1
    paint[owner >= 0] = owner[owner >= 0]
    for k, (_, mask) in enumerate(cards):
        paint[mask] = len(grounds) + k
    fills = np.array([ground.fill for ground in grounds] + stands)
    meant = tuple((eight_bit(s), eight_bit(fill)) for s, (fill, _) in zip(stands, cards, strict=True))
    return Lifted(with_placeholders(levels, paint, colours, fills), shadow, owner >= 0, meant)


def _owner(levels: np.ndarray, shadow: Shadow, shares: Shares, grounds: Sequence[Ground]) -> np.ndarray:
    """(H, W) int32 the number of the ground that shows in a pixel, shaded; -1 for none."""
    colour = shadow.shaded.colour
    out = np.full(levels.shape[:2], -1, dtype=np.int32)
    for k, ground in enumerate(grounds):
        casters = np.zeros(out.shape, dtype=bool)
        for cast in shadow.casts:
            if falls_on(cast.mask, ground.mask):
                casters |= cast.mask
        off = np.abs(ground.fill + shares.on(ground.mask)[..., None] * (colour - ground.fill) - levels).max(axis=2)
        if shadow.outlined:  # whose casters are known well
            own, near = ground.mask, off <= 2.0 * shadow.off
        else:
            own = ground.mask & (off <= shadow.off + 0.5)
            near = ndimage.binary_dilation(ground.mask, ndimage.SQUARE, iterations=BESIDE) & (off <= NEAR)
        out[own | (near & ~casters & (out < 0))] = k
    return out


def _like_ground(
    levels: np.ndarray, parts: np.ndarray, shadow: Shadow, grounds: Sequence[Ground]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The fills (4,) of what casts the shadow that a ground has too, and (H, W) bool where they are."""
    casters = np.logical_or.reduce([cast.mask for cast in shadow.casts])
    taken = shadow.shaded.mask
    out: dict[tuple[float, ...], np.ndarray] = {}
    names, sizes = np.unique(parts[casters & ~taken & (parts > 0)], return_counts=True)
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
