"""Where a picture is shaded, on which even grounds, and what may cast the shadow.

Over an even ground g a shadow of colour c leaves g + s (c - g) with s from 0 to 1: all colours lie on one straight line
that begins at the ground. On one ground c may be anywhere along that line; it is taken for the last colour on it that
there is, black for a shadow of any grey. Two grounds tell where their lines meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.gradients.areas import LEAST_PLATEAU, MOST_PARTS, Part, plateau

LEAST_PART, LEAST_RANGE = 400, 5.0  # px of a shaded ground, and levels that it spans
MOST_TRIED = 6  # parts, the largest, looked at
OFF_LINE, ON_LINE = 1.6, 0.98  # levels off the line of a ground's colours, and share of its pixels so near to it
APART = 24.0  # levels between grounds, for their lines to tell where they meet
SAME_COLOUR = 12.0  # levels by which two lines may miss each other
RING, LEAST_SHADE = 4, 2.0  # px around what casts a shadow, and levels by which these are shaded
LEAST_CASTER, MOST_CASTERS = 16, 60
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


def casters_of(levels: np.ndarray, shaded: Shaded) -> list[np.ndarray]:
    """(H, W) bool each: what is no shaded ground, holes filled, and has shade around it; at most MOST_CASTERS."""
    grounds = np.logical_or.reduce([ground.mask for ground in shaded.grounds])
    share = np.abs(shaded.share(levels))
    scale = float(np.abs(shaded.colour - shaded.grounds[0].ink).max())
    rest = ~grounds
    if len(shaded.grounds) > 1:
        # What lies along the line between two grounds casts no shadow.
        rest = ndimage.binary_opening(np.pad(rest, 4, mode="edge"), CUT)[4:-4, 4:-4]
    labels, _ = ndimage.label(rest, SQUARE)
    out = []
    for k, box in enumerate(ndimage.find_objects(labels), start=1):
        wide = tuple(slice(max(s.start - RING, 0), s.stop + RING) for s in box)
        own = labels[wide] == k
        if own.sum() < LEAST_CASTER:
            continue
        ring = ndimage.binary_dilation(own, SQUARE, iterations=RING) & grounds[wide]
        if not ring.any() or scale * float(share[wide][ring].mean()) < LEAST_SHADE:
            continue
        mask = np.zeros(grounds.shape, dtype=bool)
        mask[wide] = own
        # Holes are those in which no ground of the same shadow shows.
        out.append(mask | (ndimage.binary_fill_holes(mask) & ~grounds))
        if len(out) > MOST_CASTERS:
            return []
    return out
