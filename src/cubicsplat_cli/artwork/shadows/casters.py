"""Where a picture is shaded, on which even grounds, and what may cast the shadow.

Over an even ground g a shadow of colour c leaves g + s (c - g) with s from 0 to 1: all colours lie on one straight line
that begins at the ground. On one ground c may be anywhere along that line; it is taken for the last colour on it that
there is, black for a shadow of any grey. Two grounds tell where their lines meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.gradients.areas import MOST_PARTS
from cubicsplat_cli.artwork.gradients.parts import LEAST_PLATEAU, Part, plateau
from cubicsplat_cli.artwork.shadows.boxes import Box, box_of, filled
from cubicsplat_cli.raster import ndimage

LEAST_PART, LEAST_RANGE = 400, 5.0  # px of a shaded ground, and levels that it spans
MOST_TRIED = 6  # parts, the largest, looked at
OFF_LINE, ON_LINE = 1.6, 0.98  # levels off the line of a ground's colours, and share of its pixels so near to it
APART = 24.0  # levels between grounds, for their lines to tell where they meet
SAME_COLOUR = 12.0  # levels by which two lines may miss each other
RING, LEAST_SHADE = 4, 2.0  # px around what casts a shadow, and levels by which these are shaded
LEAST_CASTER, MOST_CASTERS = 16, 60
HIDDEN, MOST_COVERED = 4, 0.9  # px around what casts a shadow that may hide a ground; share of a picture that is one
LEAST_EVEN = 0.4  # share of a silhouette that is even, to be taken for it
CUT = np.ones((7, 7), dtype=bool)
WHOLE = (slice(None), slice(None))
SQUARE = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True)
class Ground:
    """An even ground with a shadow on it. ink: (4,) premultiplied levels; mask: (H, W) bool."""

    ink: np.ndarray
    mask: np.ndarray


@dataclass(frozen=True)
class Shaded:
    """The shaded grounds of a picture, the largest first, and the colour (4,), opaque, in levels, that they tend to."""

    grounds: tuple[Ground, ...]
    colour: np.ndarray

    def share(self, levels: np.ndarray, window: tuple[slice, slice] = WHOLE) -> np.ndarray:
        """(h, w) how much each pixel of a window is shaded, 0 off the grounds. levels: (h, w, 4) of it."""
        out = np.zeros(levels.shape[:2])
        for ground in self.grounds:
            line, own = self.colour - ground.ink, ground.mask[window]
            out[own] = (levels[own] - ground.ink) @ line / float(line @ line)
        return out


def shaded_grounds(levels: np.ndarray, parts: np.ndarray, count: int) -> Shaded | None:
    """The grounds of a picture (H, W, 4), premultiplied levels, on which there may be a shadow; None without any.

    parts, count: as of `smooth_parts`.
    """
    if count == 0:
        return None
    sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
    boxes = ndimage.find_objects(parts)
    large = np.flatnonzero(sizes >= LEAST_PART)
    large = large[np.argsort(-sizes[large], kind="stable")]
    if len(large) > MOST_PARTS:
        return None
    found: list[tuple[Ground, np.ndarray, float]] = []
    for i in large[:MOST_TRIED]:
        line = _line(Part(levels, parts == i + 1, boxes[i]))
        if line is not None:
            found.append(line)
    if not found:
        return None
    colour = _meeting(found)
    return Shaded(tuple(ground for ground, _, _ in found), colour)


def _line(part: Part) -> tuple[Ground, np.ndarray, float] | None:
    """A ground, the direction (4,) in which its colours leave it, and how far, in levels, they go."""
    if part.range() <= LEAST_RANGE and np.ptp(part.values, axis=0).max() <= LEAST_RANGE:
        return None
    ink, even = plateau(part)
    if even.mean() < LEAST_PLATEAU:
        return None
    ink = np.rint(ink)
    off = part.values - ink
    total = off.sum(axis=0)
    length = float(np.linalg.norm(total))
    if length == 0.0:
        return None
    direction = total / length
    along = off @ direction
    beside = np.abs(off - along[:, None] * direction).max(axis=1)
    if (beside <= OFF_LINE).mean() < ON_LINE or (along >= -OFF_LINE).mean() < ON_LINE:
        return None
    return Ground(ink, part.mask), direction, float(along.max())


def _meeting(found: list[tuple[Ground, np.ndarray, float]]) -> np.ndarray:
    """(4,) the colour that all grounds tend to."""
    ends = [_end(ground.ink, direction) for ground, direction, _ in found]
    first, one, least = found[0]
    for (second, other, farthest), end in zip(found[1:], ends[1:], strict=True):
        if np.abs(end - ends[0]).max() <= SAME_COLOUR or np.abs(first.ink - second.ink).max() < APART:
            continue
        # first + a one = second + b other
        (a, b), *_ = np.linalg.lstsq(np.stack([one, -other], axis=1), second.ink - first.ink, rcond=None)
        if a >= least and b >= farthest:
            meeting = 0.5 * (first.ink + a * one + second.ink + b * other)
            return np.append(np.clip(meeting[:3], 0.0, 255.0), 255.0)
    return ends[0]


def _end(ink: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The last colour (4,), opaque, in the direction from an ink."""
    if ink[3] < 254.5:
        lengths = [(255.0 - ink[3]) / max(float(direction[3]), 1e-9)]
    else:
        moving = np.flatnonzero(np.abs(direction[:3]) > 1e-6)
        lengths = [float((0.0 if direction[k] < 0 else 255.0) - ink[k]) / float(direction[k]) for k in moving]
    return np.append(np.clip((ink + min(lengths) * direction)[:3], 0.0, 255.0), 255.0)


@dataclass(frozen=True)
class Caster:
    """What may cast a shadow. mask: (H, W) bool its silhouette, up to 2 px larger or smaller than itself; box: that."""

    mask: np.ndarray
    box: Box


def casters_of(levels: np.ndarray, shaded: Shaded, even: np.ndarray) -> list[list[Caster]]:
    """What may cast the shadow, in a few ways to see it, at most MOST_CASTERS each: what is no shaded ground; of each
    such the even part, since a steep shade looks like a part of what casts it; and the grounds on others as well.

    levels: (H, W, 4). even: (H, W) bool where colours change evenly.
    """
    grounds = np.logical_or.reduce([ground.mask for ground in shaded.grounds])
    share = np.abs(shaded.share(levels))
    rest = ~grounds
    if len(shaded.grounds) > 1:
        # What lies along the line between two grounds casts no shadow.
        rest = ndimage.binary_opening(np.pad(rest, 4, mode="edge"), CUT)[4:-4, 4:-4]
    labels, count = ndimage.label(rest, SQUARE)
    if count > MOST_CASTERS:
        return []
    scale = float(np.abs(shaded.colour - shaded.grounds[0].ink).max())
    masks = [
        filled(labels == k) for k, box in enumerate(ndimage.find_objects(labels), start=1) if _large(labels, box, k)
    ]
    around = [_shade_around(mask, grounds, share) * scale for mask in masks]
    masks = [mask for mask, shade in zip(masks, around, strict=True) if shade >= LEAST_SHADE]
    first = _boxes(masks)
    ways = [first, _boxes([_even(mask, even & ~grounds) for mask in masks])]
    if len(shaded.grounds) > 1:
        hidden = ndimage.binary_dilation(rest, SQUARE, iterations=HIDDEN)
        inner = _boxes([filled(ground.mask) for ground in shaded.grounds], hidden)
        ways.append(first + [caster for caster in inner if caster.mask.mean() < MOST_COVERED])
    return [way for way in ways if way]


def _large(labels: np.ndarray, box: tuple[slice, slice], k: int) -> bool:
    return bool((labels[box] == k).sum() >= LEAST_CASTER)


def _shade_around(mask: np.ndarray, grounds: np.ndarray, share: np.ndarray) -> float:
    """The mean share of shade on the grounds within RING px around a silhouette."""
    rows, columns = ndimage.find_objects(mask.astype(np.int8))[0]
    wide = (
        slice(max(rows.start - RING, 0), rows.stop + RING),
        slice(max(columns.start - RING, 0), columns.stop + RING),
    )
    ring = ndimage.binary_dilation(mask[wide], SQUARE, iterations=RING) & grounds[wide] & ~mask[wide]
    return float(share[wide][ring].mean()) if ring.any() else 0.0


def _even(mask: np.ndarray, even: np.ndarray) -> np.ndarray:
    """(H, W) bool the largest of what is even in a silhouette, and what that surrounds; all where that is little."""
    labels, count = ndimage.label(mask & even, SQUARE)
    if count == 0:
        return mask
    own = filled(labels == 1 + int(np.bincount(labels.ravel())[1:].argmax()))
    inner = ndimage.binary_dilation(own, SQUARE, iterations=1) & mask
    return inner if inner.sum() > LEAST_EVEN * mask.sum() else mask


def _boxes(masks: list[np.ndarray], hidden: np.ndarray | None = None) -> list[Caster]:
    boxes = [(mask, box_of(mask, hidden)) for mask in masks]
    return [Caster(mask, box) for mask, box in boxes if box is not None]
