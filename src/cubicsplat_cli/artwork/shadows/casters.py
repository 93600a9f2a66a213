"""The shaded places of a picture, the even grounds below, and the shapes that may cast the shadow.

Over an even ground g a shadow of colour c leaves g + s (c - g) with s from 0 to 1. All colours lie on one straight line
that begins at the ground. The colour c may be anywhere along the line; the last colour on it is taken, which is black
for a shadow of any grey.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.parts import LARGE_AREA, RING, Part, Parts, Patch, patches_of
from cubicsplat_cli.artwork.gradients.shade import CLOSE
from cubicsplat_cli.artwork.regions.fills import OPAQUE, ROUNDED, SAME
from cubicsplat_cli.artwork.shadows.boxes import Box, box_of
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.record import record

LEAST_RANGE = 5.0  # levels that a shaded ground spans
MOST_GROUNDS = 40  # the largest, that are examined
ON_LINE = 0.98  # share of a ground's pixels that must lie on the line of its colours
BEND = 0.05  # share of its length by which a line of colours may be bent, blended in linear light and rounded there
LEAST_CASTER, MOST_CASTERS = 16, 60  # px of what covers a shadow, and silhouettes beyond which none is examined


@record
class Ground:
    """An even ground with a shadow on it. fill: (4,) premultiplied levels; mask: (H, W) bool, its pixels."""

    fill: np.ndarray
    mask: np.ndarray


@record
class Shaded:
    """The shaded grounds of a picture, the largest first; colour: (4,) opaque, in levels, towards which they tend."""

    grounds: tuple[Ground, ...]
    colour: np.ndarray

    def share(self, levels: np.ndarray) -> np.ndarray:
        """Return (H, W) how much each pixel of a picture (H, W, 4) in levels is shaded, 0 beside the grounds."""
        out = np.zeros(levels.shape[:2])
        for ground in self.grounds:
            line, mask = self.colour - ground.fill, ground.mask
            out[mask] = (levels[mask] - ground.fill) @ line / max(float(line @ line), 1e-9)
        return out

    @cached_property
    def mask(self) -> np.ndarray:
        """(H, W) bool, the pixels of the grounds."""
        return np.logical_or.reduce([ground.mask for ground in self.grounds])

    @cached_property
    def rest(self) -> np.ndarray:
        """(H, W) bool, the pixels of no ground, without the line between two grounds, which casts no shadow."""
        if len(self.grounds) == 1:
            return ~self.mask
        inner = ndimage.binary_erosion(~self.mask, ndimage.SQUARE, iterations=RING - 1, border_value=1)
        return ndimage.binary_dilation(inner, ndimage.SQUARE, iterations=RING - 1)


def even_grounds(parts: Parts) -> Iterator[tuple[Part, np.ndarray, np.ndarray]]:
    """Yield uneven parts of a picture, of the largest MOST_GROUNDS, that have an even ground: its colour (4,) in whole
    levels, and (n,) bool, the pixels of the part that show it."""
    for number in parts.uneven(LARGE_AREA, LEAST_RANGE)[:MOST_GROUNDS]:
        part = parts.part(number)
        fill, even = part.plateau()
        if even.any():
            yield part, np.rint(fill), even


def shaded_grounds(parts: Parts) -> Shaded | None:
    """Return the grounds among the parts of a picture that may show a shadow; None without any."""
    found: list[tuple[Ground, np.ndarray]] = []
    for part, fill, _ in even_grounds(parts):
        if (direction := direction_from(part.pixels.values, fill)) is not None:
            found.append((Ground(fill, parts.numbers == parts.numbers[part.rows[0], part.columns[0]]), direction))
    if not found:
        return None
    return Shaded(tuple(ground for ground, _ in found), end_of(found[0][0].fill, found[0][1]))


def direction_from(values: np.ndarray, fill: np.ndarray) -> np.ndarray | None:
    """Return the direction (4,) in which colours (n, 4) leave a fill, all in levels; None if they lie on no line, or if
    they become less opaque, as in no shadow."""
    off = values - fill
    total = off.sum(axis=0)
    length = float(np.linalg.norm(total))
    if length == 0.0:
        return None
    direction = total / length
    clearing = fill[3] >= OPAQUE and direction[3] < -1e-6
    one_way = not clearing and (off @ direction >= -ROUNDED).mean() >= ON_LINE
    return direction if one_way and on_line(off, direction) else None


def on_line(off: np.ndarray, way: np.ndarray) -> bool:
    """Return True if nearly all pixels, (n, 4) levels off a ground, are on a way (4,) from there."""
    direction = way / max(float(np.linalg.norm(way)), 1e-9)
    along = off @ direction
    beside = largest(np.abs(off - along[:, None] * direction))
    return bool((beside <= off_line(along)).mean() >= ON_LINE)


def off_line(along: np.ndarray) -> float:
    """Return the levels by which colours may be beside a line that goes so far, (n,) levels, from their ground."""
    return float(np.clip(BEND * along.max(), ROUNDED, SAME))


def end_of(fill: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the last colour (4,), opaque, in a direction from a fill."""
    if fill[3] < OPAQUE:
        lengths = [(255.0 - fill[3]) / max(float(direction[3]), 1e-9)]
    else:
        moving = np.flatnonzero(np.abs(direction[:3]) > 1e-6)
        lengths = [float((0.0 if direction[k] < 0 else 255.0) - fill[k]) / float(direction[k]) for k in moving]
    return np.append(np.clip((fill + min(lengths) * direction)[:3], 0.0, 255.0), 255.0)


@record
class Caster:
    """A shape that may cast a shadow. mask: (H, W) bool its silhouette, to 2 px; box: the box with this silhouette."""

    mask: np.ndarray
    box: Box


def _silhouettes(shaded: Shaded, share: np.ndarray) -> list[Patch]:
    """Return the shapes on shaded grounds that are shaded around, and may cast the shadow, with their holes, up to 2 px
    too large. share: (H, W) as of `Shaded.share`."""
    labels, _ = ndimage.label(shaded.rest, ndimage.SQUARE)
    least = CLOSE / float(np.abs(shaded.colour - shaded.grounds[0].fill).max())
    found = []
    for patch in patches_of(labels):
        ring = patch.ring(RING, labels.shape)
        shade = np.abs(share[ring.window][ring.mask & shaded.mask[ring.window]])
        if patch.size >= LEAST_CASTER and len(shade) and shade.mean() >= least:
            found.append(replace(patch, mask=ndimage.binary_fill_holes(patch.mask)))
    return found


def casters_of(shaded: Shaded, share: np.ndarray, even: np.ndarray) -> list[list[Caster]]:
    """Return the boxes that may cast the shadow, in a few readings of at most MOST_CASTERS each: the silhouettes; the
    even part of each silhouette, since a steep shadow looks like a part of its caster; grounds on others too. share:
    (H, W) as of `Shaded.share`. even: (H, W) bool, pixels in which colours change evenly."""
    if len(silhouettes := _silhouettes(shaded, share)) > MOST_CASTERS:
        return []
    first = _boxes(silhouettes, even.shape)
    readings = [first, _boxes([_even(patch, even & ~shaded.mask) for patch in silhouettes], even.shape)]
    if len(shaded.grounds) > 1:
        hidden = ndimage.binary_dilation(shaded.rest, ndimage.SQUARE, iterations=RING)
        grounds = [Patch(0, 0, ndimage.binary_fill_holes(ground.mask)) for ground in shaded.grounds]
        readings.append(first + _boxes(grounds, even.shape, hidden))
    return [reading for reading in readings if reading]


def _even(silhouette: Patch, even: np.ndarray) -> Patch:
    """Return the largest even part of a silhouette, with its holes filled; the silhouette without any."""
    labels, count = ndimage.label(silhouette.mask & even[silhouette.window], ndimage.SQUARE)
    if count == 0:
        return silhouette
    part = ndimage.binary_fill_holes(labels == 1 + int(np.bincount(labels.ravel())[1:].argmax()))
    return replace(silhouette, mask=ndimage.binary_dilation(part, ndimage.SQUARE) & silhouette.mask)


def _boxes(silhouettes: list[Patch], shape: tuple[int, ...], hidden: np.ndarray | None = None) -> list[Caster]:
    """Return the boxes among some silhouettes in a picture (H, W). hidden: as of `box_of`."""
    found = []
    for patch in silhouettes:
        mask = np.zeros(shape, dtype=bool)
        mask[patch.window] = patch.mask
        if (box := box_of(mask, hidden)) is not None:
            found.append(Caster(mask, box))
    return found
