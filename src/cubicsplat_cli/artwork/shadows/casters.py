"""The shaded places of a picture, the even grounds below, and what may cast the shadow.

Over an even ground g a shadow of colour c leaves g + s (c - g) with s from 0 to 1: all colours lie on one straight line
that begins at the ground, c anywhere along that line; it is taken for the last colour on it that there is, black for a
shadow of any grey.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.parts import LEAST_PLATEAU, Part, Patch, part_of, plateau
from cubicsplat_cli.artwork.regions.fills import OPAQUE
from cubicsplat_cli.artwork.shadows.boxes import Box, box_of
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import part_spreads
from cubicsplat_cli.record import record

LEAST_PART, LEAST_RANGE = 400, 5.0  # px of a shaded ground, and levels that it spans
MOST_TRIED = 6  # parts, the largest, looked at
OFF_LINE, ON_LINE = 1.6, 0.98  # levels off the line of a ground's colours, and share of its pixels so near to it
RING, LEAST_SHADE = 4, 2.0  # px around what casts a shadow, and levels by which these are shaded
LEAST_CASTER, MOST_CASTERS = 16, 60
HIDDEN, MOST_COVERED = 4, 0.9  # px around what casts a shadow that may hide a ground; share of a picture that is one
LEAST_EVEN = 0.4  # share of a silhouette that is even, to be taken for it
CUT = np.ones((7, 7), dtype=bool)


@record
class Ground:
    """An even ground with a shadow on it. fill: (4,) premultiplied levels; mask: (H, W) bool."""

    fill: np.ndarray
    mask: np.ndarray


@record
class Shaded:
    """The shaded grounds of a picture, the largest first, and the colour (4,), opaque, in levels, that they tend to."""

    grounds: tuple[Ground, ...]
    colour: np.ndarray

    def share(self, levels: np.ndarray) -> np.ndarray:
        """(H, W) how much each pixel of a picture (H, W, 4) in levels is shaded, 0 off the grounds."""
        out = np.zeros(levels.shape[:2])
        for ground in self.grounds:
            line, own = self.colour - ground.fill, ground.mask
            out[own] = (levels[own] - ground.fill) @ line / max(float(line @ line), 1e-9)
        return out

    @cached_property
    def mask(self) -> np.ndarray:
        """(H, W) bool where the grounds are."""
        return np.asarray(np.logical_or.reduce([ground.mask for ground in self.grounds]))

    @cached_property
    def rest(self) -> np.ndarray:
        """(H, W) bool what is no ground, nor lies along the line between two, which casts no shadow."""
        if len(self.grounds) == 1:
            return ~self.mask
        return np.asarray(ndimage.binary_opening(np.pad(~self.mask, 4, mode="edge"), CUT)[4:-4, 4:-4])


def shaded_grounds(levels: np.ndarray, parts: np.ndarray, count: int) -> Shaded | None:
    """The grounds of a picture (H, W, 4), premultiplied levels, on which there may be a shadow; None without any.

    parts, count: as of `smooth_parts`.
    """
    if count == 0:
        return None
    sizes, boxes, spreads = part_spreads(levels, parts, count)
    large = np.flatnonzero(sizes >= LEAST_PART)
    large = large[np.argsort(-sizes[large], kind="stable")][:MOST_TRIED]
    found: list[tuple[Ground, np.ndarray]] = []
    for i in large[spreads[large] > LEAST_RANGE]:
        line = _line(part_of(levels, parts, i + 1, boxes[i]), levels.shape[:2])
        if line is not None:
            found.append(line)
    if not found:
        return None
    return Shaded(tuple(ground for ground, _ in found), end_of(found[0][0].fill, found[0][1]))


def _line(part: Part, shape: tuple[int, int]) -> tuple[Ground, np.ndarray] | None:
    """A ground in a picture (H, W), and the direction (4,) in which its colours leave it."""
    fill, even = plateau(part)
    if even.mean() < LEAST_PLATEAU:
        return None
    fill = np.rint(fill)
    direction = direction_from(part.pixels.values, fill)
    if direction is None:
        return None
    mask = np.zeros(shape, dtype=bool)
    mask[part.rows, part.columns] = True
    return Ground(fill, mask), direction


def direction_from(values: np.ndarray, fill: np.ndarray) -> np.ndarray | None:
    """The direction (4,) in which colours (n, 4) leave a fill, all in levels; None where that is not one line, or leads
    from what is opaque to what is not, as no shade does.
    """
    off = values - fill
    total = off.sum(axis=0)
    length = float(np.linalg.norm(total))
    if length == 0.0:
        return None
    direction = total / length
    along = off @ direction
    beside = largest(np.abs(off - along[:, None] * direction))
    clearing = fill[3] >= OPAQUE and direction[3] < -1e-6
    one_line = not clearing and (beside <= OFF_LINE).mean() >= ON_LINE and (along >= -OFF_LINE).mean() >= ON_LINE
    return direction if one_line else None


def end_of(fill: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The last colour (4,), opaque, in the direction from a fill."""
    if fill[3] < OPAQUE:
        lengths = [(255.0 - fill[3]) / max(float(direction[3]), 1e-9)]
    else:
        moving = np.flatnonzero(np.abs(direction[:3]) > 1e-6)
        lengths = [float((0.0 if direction[k] < 0 else 255.0) - fill[k]) / float(direction[k]) for k in moving]
    return np.append(np.clip((fill + min(lengths) * direction)[:3], 0.0, 255.0), 255.0)


@record
class Caster:
    """Possible caster of a shadow. mask: (H, W) bool its silhouette, up to 2 px larger or smaller than itself; box:
    that."""

    mask: np.ndarray
    box: Box


def silhouettes_of(shaded: Shaded, share: np.ndarray) -> list[Patch]:
    """What is no shaded ground, and shaded around: what may cast the shadow, with its holes, up to 2 px larger than it
    is. share: (H, W) as of `Shaded.share`.
    """
    labels, _ = ndimage.label(shaded.rest, ndimage.SQUARE)
    shade = np.abs(share)
    least = LEAST_SHADE / float(np.abs(shaded.colour - shaded.grounds[0].fill).max())
    boxes = enumerate(ndimage.find_objects(labels), start=1)
    found = [Patch(box[0].start, box[1].start, labels[box] == k) for k, box in boxes]
    return [own for own in found if own.size >= LEAST_CASTER and _shade_around(own, shaded.mask, shade) >= least]


def casters_of(shaded: Shaded, silhouettes: list[Patch], even: np.ndarray) -> list[list[Caster]]:
    """The boxes that may cast the shadow, in a few readings, at most MOST_CASTERS each: silhouettes; of each such the
    even part, since a steep shade looks like a part of what casts it; and the grounds on others as well.

    even: (H, W) bool where colours change evenly.
    """
    if len(silhouettes) > MOST_CASTERS:
        return []
    rest, whole = shaded.rest, [_filled(own) for own in silhouettes]
    first = _boxes(whole, rest.shape)
    ways = [first, _boxes([_even(own, even & ~shaded.mask) for own in whole], rest.shape)]
    if len(shaded.grounds) > 1:
        hidden = ndimage.binary_dilation(rest, ndimage.SQUARE, iterations=HIDDEN)
        grounds = [_filled(Patch(0, 0, ground.mask)) for ground in shaded.grounds]
        inner = _boxes([own for own in grounds if own.mask.mean() < MOST_COVERED], rest.shape, hidden)
        ways.append(first + inner)
    return [way for way in ways if way]


def _filled(patch: Patch) -> Patch:
    """The silhouette with its holes."""
    return replace(patch, mask=np.asarray(ndimage.binary_fill_holes(patch.mask)))


def _shade_around(silhouette: Patch, grounds: np.ndarray, share: np.ndarray) -> float:
    """The mean share of shade on the grounds within RING px around a silhouette."""
    wide = silhouette.padded(RING, grounds.shape)
    ring = ndimage.binary_dilation(wide.mask, ndimage.SQUARE, iterations=RING) & grounds[wide.window] & ~wide.mask
    return float(share[wide.window][ring].mean()) if ring.any() else 0.0


def _even(silhouette: Patch, even: np.ndarray) -> Patch:
    """The largest of what is even in a silhouette, and what that surrounds; all where that is little."""
    labels, count = ndimage.label(silhouette.mask & even[silhouette.window], ndimage.SQUARE)
    if count == 0:
        return silhouette
    own = ndimage.binary_fill_holes(labels == 1 + int(np.bincount(labels.ravel())[1:].argmax()))
    inner = replace(silhouette, mask=ndimage.binary_dilation(own, ndimage.SQUARE) & silhouette.mask)
    return inner if inner.size > LEAST_EVEN * silhouette.size else silhouette


def _boxes(silhouettes: list[Patch], shape: tuple[int, ...], hidden: np.ndarray | None = None) -> list[Caster]:
    """The boxes among some silhouettes in a picture (H, W). hidden: as of `box_of`."""
    found = []
    for own in silhouettes:
        mask = np.zeros(shape, dtype=bool)
        mask[own.window] = own.mask
        box = box_of(mask, hidden)
        if box is not None:
            found.append(Caster(mask, box))
    return found
