"""Photographs within a page: parts of a picture that `choose_style` calls photos, if it calls the rest a drawing.

The even areas of a page end at its photos, and text is thin. So the rest, where whole squares fit into it, may be a
photo. The same comparison with a drawing decides on it as on whole pictures; what is here only proposes.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.channels import largest, packed, summed, widened
from cubicsplat_cli.artwork.gradients.parts import Patch
from cubicsplat_cli.artwork.input.enlargement import before_enlargement
from cubicsplat_cli.artwork.input.evenness import SAVED, SMALL, TILE, contrasts
from cubicsplat_cli.artwork.regions.fills import FLAT_RANGE, OPAQUE, flat_pixels
from cubicsplat_cli.artwork.style import ARTWORK, COLOUR, PHOTO, UNSEEN, choose_style
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import bends_and_steps, part_spreads
from cubicsplat_cli.raster.unmix import spread
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels

LEAST_SIDE = 2 * TILE  # px
FRAME = 8  # px of a frame around a photo, at most, and of an edge's blends
LEAST_LINE = 0.9  # share of one colour in a row of a frame
# Levels of root mean square error of an even area against one colour or gradient: rounding, and twice the error of a
# JPEG away from edges. A photo's grain is more.
GRAIN = 1.0
LEAST_FILLED = 0.9  # share of a rectangle with all its corners that a photo fills; the rest may be as even as the page
MOST_IN_ONE = 0.35  # of a photo's px in one colour: up to .25 in photos, at least .5 in text in a JPEG
# Median second difference of photos that are no rectangles, in levels: 6 to 37 in 20 photos, 2 to 6 in 22 objects with
# soft shading.
GRAINY = 7.0
# The same as a share of the range of levels within the REACH of a JPEG's ringing, px: up to 0.03 in rectangles, and
# 0.06 in other forms, that are drawings with ringing; at least 0.04 in rectangular photos, 0.06 in 95 % of the others.
REACH, RINGING = 17, 0.03
SOFT, FAINT = 2.0, 1e-6  # px of a picture's continuation beyond a mask; its weight relative to the mean colour's
OTHER = 64.0  # levels of distance to its surroundings that a placeholder gives up to differ from the other ones
LEAST_REST = 0.002  # share of the picture, away from its photos, that is drawn
Window = tuple[slice, slice]  # rows and columns


@record
class PhotoPart(Patch):
    """A photograph in a picture. stand_in: (3,) levels of its placeholder, a fill unlike its surroundings."""

    stand_in: np.ndarray

    @property
    def rectangular(self) -> bool:
        return bool(self.mask.all())


@record
class Page:
    """A drawing with photographs in it, which are opaque.

    picture: (H, W, 3) float32 in [0, 1], over white. flat: (H, W, 3), or premultiplied (H, W, 4), with placeholders for
    the photographs. reason: the measurement that calls it a drawing.
    """

    picture: np.ndarray
    flat: np.ndarray
    parts: tuple[PhotoPart, ...]
    reason: str


def page_of(target: np.ndarray, suits: Callable[[np.ndarray, PhotoPart], bool]) -> Page | None:
    """Return the page in a picture, (H, W, 3) or premultiplied (H, W, 4), float32 in [0, 1]; None if it is no drawing
    with photographs at its own size. suits: tells if a part of the picture over white (H, W, 3) is better as a photo.
    """
    picture = target if target.shape[2] == 3 else target[..., :3] + (1.0 - target[..., 3:])
    levels = np.rint(255.0 * picture).astype(np.float32)
    # Palettes may round opaque pixels to 254.
    opaque = np.all(np.rint(255.0 * target[..., 3:]) >= OPAQUE, axis=2)
    parts = [part for part in _photos(levels, _even_areas(levels)) if opaque[part.window][part.mask].all()]
    # The edges of an enlarged picture are nowhere even, nor thin.
    if not parts or before_enlargement(with_channels(levels, 4, 255.0))[1] != (1.0, 1.0):
        return None
    parts = [part for part in parts if suits(picture, part)]
    if not parts:
        return None
    flat, opacity = levels.copy(), target[..., 3:].copy()
    for part in parts:
        _put_placeholder(part, flat)
        opacity[part.window][part.mask] = 1.0
    if _drawn_share(flat, parts) < LEAST_REST:
        return None
    flat = flat / np.float32(255.0)
    if target.shape[2] == 4:
        flat = np.concatenate([np.maximum(flat - (1.0 - opacity), 0.0), opacity], axis=2)
    rest = choose_style(flat)
    if rest.name != ARTWORK:
        return None
    return Page(picture, flat, tuple(parts), rest.reason)


def _put_placeholder(part: PhotoPart, flat: np.ndarray) -> None:
    """Write the placeholder of a part into levels (H, W, 3), blended with its surroundings unless it is a rectangle."""
    if part.rectangular:
        flat[part.window] = part.stand_in
        return
    wide = part.padded(1, flat.shape)
    crop, mask = flat[wide.window], wide.mask
    edge = mask & ndimage.binary_dilation(~mask, ndimage.SQUARE)
    inner = mask & ~ndimage.binary_dilation(edge, ndimage.SQUARE)
    outside, inside = _continued(crop, ~mask), _continued(crop, inner)
    # The share of the photo in a pixel at its edge, whose colour lies between both.
    apart = inside - outside
    share = summed((crop - outside) * apart) / np.maximum(summed(apart * apart), FLAT_RANGE**2)
    covered = np.where(edge, np.clip(share, 0.0, 1.0), mask)[..., None]
    flat[wide.window] = covered * part.stand_in + (1.0 - covered) * outside


def _continued(crop: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return a picture (h, w, 3) that continues softly beyond a mask (h, w) bool, which is not empty."""
    inside = mask[..., None].astype(np.float32)
    weights, sums = (ndimage.gaussian_filter(each, (SOFT, SOFT, 0.0)) for each in (inside, crop * inside))
    mean = crop[mask].mean(axis=0)
    return np.where(inside > 0.0, crop, (sums + FAINT * mean) / (weights + FAINT)).astype(np.float32)


def _even_areas(levels: np.ndarray) -> np.ndarray:
    """Return (H, W) int32 numbers of connected areas in one colour or linear gradient, TILE^2 px and more; else 0."""
    areas, count = ndimage.large_parts(flat_pixels(levels), TILE**2)
    _, _, spreads = part_spreads(with_channels(levels, 4, 255.0), areas, count)
    even = spreads <= 2.0 * GRAIN  # surely, since half of the range is the most that a mean leaves
    even[~even] = _off_planes(levels, *ndimage.renumbered(areas, np.append(False, ~even))) <= GRAIN
    return ndimage.renumbered(areas, np.append(False, even))[0]


def _off_planes(levels: np.ndarray, areas: np.ndarray, count: int) -> np.ndarray:
    """Return (count,) the root mean square errors of areas, from 1 on, in the worst channel of their best gradients."""
    y, x = np.nonzero(areas)
    owner, sides = areas[y, x] - 1, np.array(areas.shape, float)
    terms = [np.ones(len(y)), x / sides[1] - 0.5, y / sides[0] - 0.5, *levels[y, x].T.astype(float)]
    sums = np.array([[np.bincount(owner, a * b, count) for b in terms] for a in terms[:3]]).transpose(2, 0, 1)
    # A very thin area has no slope across; the small ridge keeps the equations solvable.
    normal, right = sums[..., :3] + 1e-6 * np.eye(3), sums[..., 3:]
    squares = np.stack([np.bincount(owner, a * a, count) for a in terms[3:]], axis=1)
    squares = squares - (right * np.linalg.solve(normal, right)).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0).max(axis=1, initial=0.0) / np.maximum(sums[:, 0, 0], 1.0)))


def _photos(levels: np.ndarray, even: np.ndarray) -> list[PhotoPart]:
    """Return the parts that are neither even nor thin and may be photos: rectangles that end at their strongest steps,
    within their frames, or other forms. What is inside of a part that is none, such as a shadow, may be.
    """
    parts, taken = list[PhotoPart](), np.zeros(even.shape, dtype=bool)
    labels, _ = ndimage.label(_opened(even == 0))
    for number, whole in sorted(enumerate(ndimage.find_objects(labels), 1), key=lambda one: -_shorter(one[1])):
        inside = labels[whole] == number
        if _shorter(whole) < LEAST_SIDE or taken[whole][inside].any():
            continue
        own = np.zeros_like(taken)
        own[whole] = ndimage.binary_fill_holes(inside)
        window = _ended(levels, whole)
        mask = _mask_of(own, even, window)
        if mask[[0, 0, -1, -1], [0, -1, 0, -1]].all() and mask.mean() >= LEAST_FILLED:
            mask = np.ones_like(mask)
        else:
            window, mask = whole, _mask_of(own, even, whole)
        if min(mask.shape) >= LEAST_SIDE and 2 * mask.sum() >= LEAST_SIDE**2:
            top, left = (side.start for side in window)
            part = PhotoPart(top, left, mask, _stand_in(levels, Patch(top, left, mask), parts))
            if _is_photo(levels, part):
                parts.append(part)
                taken |= own
    return parts


def _shorter(window: Window) -> int:
    return min(side.stop - side.start for side in window)


def _opened(mask: np.ndarray) -> np.ndarray:
    """Return the pixels of a mask (H, W) bool that squares a little wider than a TILE fit into."""
    narrowed = ndimage.minimum_filter(mask.astype(np.float32), TILE + 1)
    return np.asarray(ndimage.maximum_filter(narrowed, TILE + 1) > 0.0)


def _ended(levels: np.ndarray, window: Window) -> Window:
    """Return a window with sides moved inwards, by 2 FRAME px at most, to the strongest changes and beyond frames."""
    rows, columns = window
    grown = np.pad(levels, ((1, 1), (1, 1), (0, 0)), constant_values=-np.inf)  # the outside differs from any pixel
    part = grown[rows.start : rows.stop + 2, columns.start : columns.stop + 2]
    turned = part.swapaxes(0, 1)
    sides = (part[:, 1:-1], part[::-1, 1:-1], turned[:, 1:-1], turned[::-1, 1:-1])
    steps = [_strongest(side) for side in sides]
    top, bottom, left, right = (step + _frame(side[1 + step :]) for step, side in zip(steps, sides, strict=True))
    return slice(rows.start + top, rows.stop - bottom), slice(columns.start + left, columns.stop - right)


def _strongest(part: np.ndarray) -> int:
    """Return how many rows of a part come before its outermost step, from row to row, of half the largest or more."""
    rows = part[: min(2 * FRAME, len(part) // 3) + 1]
    sizes = np.median(largest(np.abs(np.diff(rows, axis=0))), axis=1)
    return int(np.argmax(sizes >= 0.5 * sizes.max()))


def _frame(part: np.ndarray) -> int:
    """Return the number of rows at the top of a part that belong to its frame."""
    rows = 0
    for row, (line, following) in enumerate(pairwise(part[: FRAME + 1]), 1):
        if (largest(np.abs(line - np.median(line, axis=0))) <= UNSEEN).mean() < LEAST_LINE:
            break
        if (largest(np.abs(following - line)) > FLAT_RANGE).mean() > 0.5:
            rows = row
    return rows


def _mask_of(own: np.ndarray, even: np.ndarray, window: Window) -> np.ndarray:
    """Return (h, w) bool, a window's pixels of a part (H, W) bool, without even areas that reach in from outside."""
    inside = even[window]
    counts = np.bincount(even.ravel())
    outside = np.bincount(inside.ravel(), minlength=len(counts)) < counts
    outside[0] = False
    free = ~ndimage.binary_dilation(outside[inside], ndimage.SQUARE)
    labels, count = ndimage.label(_opened(free))
    sizes = np.bincount(labels.ravel(), own[window].ravel(), count + 1)
    sizes[0] = 0.0
    # With the corners again, which squares do not fit into.
    wide = ndimage.maximum_filter((labels == int(sizes.argmax())).astype(np.float32), TILE // 2 - 1) > 0.0
    return np.asarray(ndimage.binary_fill_holes(wide & free))


def _stand_in(levels: np.ndarray, patch: Patch, others: list[PhotoPart]) -> np.ndarray:
    """Return (3,) levels unlike those around a patch, and those of others: alike, parts could unite."""
    wide = patch.padded(FRAME, levels.shape)
    near = levels[wide.window][~wide.mask]
    corners = np.array(np.meshgrid(*[(0.0, 255.0)] * 3)).reshape(3, -1).T
    used = [(corners == other.stand_in).all(axis=1) for other in others]
    far = [largest(np.abs(near - corner)).min(initial=255.0) for corner in corners]
    return corners[int(np.argmax(far - OTHER * np.sum(used, axis=0)))]


def _is_photo(levels: np.ndarray, part: PhotoPart) -> bool:
    """True if a part may be a photo: `choose_style` calls it one without doubt, or, of a small one, noise and edges do
    not explain it; it has no even ground, and it has grain: more than a JPEG's ringing, and, unless it is a rectangle,
    twice that and more than soft shading.
    """
    seen = levels[part.window]
    values, opaque = seen[part.mask], with_channels(seen, 4, 255.0)
    _, which, counts = np.unique(packed(values // COLOUR), return_inverse=True, return_counts=True)
    commonest = values[which.reshape(-1) == int(counts.argmax())].mean(axis=0)
    if (largest(np.abs(values - commonest)) <= UNSEEN).mean() > MOST_IN_ONE:
        return False
    bends, _ = bends_and_steps(opaque)
    grain = float(np.median(bends[part.mask]))
    ringing = RINGING * float(np.median(spread(seen, REACH, REACH)[part.mask]))
    if grain < (ringing if part.rectangular else max(GRAINY, 2.0 * ringing)):
        return False
    alone = seen if part.rectangular else opaque * part.mask[..., None]
    if max(part.mask.shape) <= SMALL:
        # Edges are as frequent in it as in a drawing.
        contrast = contrasts(alone)
        return contrast is not None and contrast.saved <= SAVED
    style = choose_style(alone / np.float32(255.0))
    return style.name == PHOTO and not style.doubtful


def _drawn_share(flat: np.ndarray, parts: list[PhotoPart]) -> float:
    """Return the share of pixels, away from the parts and their frames, that differ from a neighbour."""
    differ = spread(flat, 3, 3) > UNSEEN
    for part in parts:
        differ[widened(part.window, FRAME, differ.shape)] = False
    return float(differ.mean())
