"""Soft areas of any form on even grounds: shadows, glows and blurred lights, as they are seen.

A soft area of one colour leaves blends of that with its ground: colours on a straight line. How much of it a pixel has
is read off that line. Beneath what covers it, it goes on smoothly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from cubicsplat_cli.artwork.channels import largest, widened
from cubicsplat_cli.artwork.gradients.parts import CLEAR, LEAST_PLATEAU, RING, Part, part_of, plateau, smooth_parts
from cubicsplat_cli.artwork.gradients.shades import common_shade
from cubicsplat_cli.artwork.gradients.uniting import EXPLAINED
from cubicsplat_cli.artwork.regions.fills import OPAQUE
from cubicsplat_cli.artwork.shadows.casters import (
    LEAST_PART,
    LEAST_RANGE,
    OFF_LINE,
    ON_LINE,
    Ground,
    direction_from,
    end_of,
)
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import nearest_paints, part_spreads
from cubicsplat_cli.record import record

MOST_TRIED = 40  # grounds, the largest, looked at
LEAST_AREA, LEAST_CUT = 200, 8  # px of an area, and where nothing is beside it
ALIKE = 4.0  # levels by which the colours may differ that parts of one area tend to
CLOSE = 4.0  # levels by which an area is off where it goes on at most
ROUNDING = 0.5  # levels by which pixels are off what they were before they were rounded
REACH = 6  # px beneath what covers an area in which it goes on as it changes beside that
BESIDE = 32  # px around where an area is seen, beyond which it ends
ROUNDS_SEEN = 2  # in which more is found that shows an area
ROUNDS = 60  # of smoothing within what rounding leaves open


@record
class SoftArea:
    """ground: what it lies on, where it is seen; colour: (4,), opaque, in levels, that this tends to; share: (H, W) how
    much of that it has, everywhere."""

    ground: Ground
    colour: np.ndarray
    share: np.ndarray

    @property
    def mask(self) -> np.ndarray:
        """(H, W) bool where it is seen."""
        return self.ground.mask

    @property
    def scale(self) -> float:
        """Levels of a whole share."""
        return float(np.abs(self.colour - self.ground.fill).max())


def soft_areas(levels: np.ndarray, parts: np.ndarray, count: int) -> list[SoftArea]:
    """The soft areas of a picture (H, W, 4), premultiplied levels, other than gradients. parts, count: as of
    `smooth_parts`."""
    found, clear = list[tuple[Ground, np.ndarray]](), levels[..., 3] <= CLEAR
    smooth = cache(lambda: smooth_parts(levels, tip=np.inf)[0] > 0)  # which few pictures come to; shadows bend
    for part, fill, piece in _pieces(levels, parts, count):
        work().at()
        direction = direction_from(piece.pixels.values, fill)
        if direction is None or (fill[3] > CLEAR and _ends_at(clear, piece)) or _is_gradient(part, piece, smooth()):
            continue
        colour = end_of(fill, direction)
        if np.abs(colour - fill).max() <= LEAST_RANGE:
            continue  # nothing is as far from the fill as what was seen
        own = [g for g, end in found if (g.fill == fill).all() and np.abs(end - colour).max() <= ALIKE]
        if not own:
            own = [Ground(fill, np.zeros(parts.shape, dtype=bool))]
            found.append((own[0], colour))
        own[0].mask[part.rows, part.columns] = True
    areas: list[SoftArea] = []
    for ground, colour in found:
        # The middle of one area looks like the ground of another.
        others = [each.mask for each in areas if (each.ground.fill != ground.fill).any()]
        if not any((mask & ground.mask).sum() > 0.5 * ground.mask.sum() for mask in others):
            areas.append(_area(levels, parts, ground, colour))
    return [area for area in areas if area.mask.any()]


def _pieces(levels: np.ndarray, parts: np.ndarray, count: int) -> Iterator[tuple[Part, np.ndarray, Part]]:
    """Parts, their even grounds (4,), and the pieces of these that are not even."""
    if count == 0:
        return
    sizes, boxes, spreads = part_spreads(levels, parts, count)
    large = np.flatnonzero((sizes >= LEAST_PART) & (spreads > LEAST_RANGE))
    for i in large[np.argsort(-sizes[large], kind="stable")][:MOST_TRIED].tolist():
        part = part_of(levels, parts, i + 1, boxes[i])
        fill, even = plateau(part)
        if even.mean() >= LEAST_PLATEAU:
            for piece in part.pieces(~even):
                if len(piece) >= LEAST_AREA and piece.range() > LEAST_RANGE:
                    yield part, np.rint(fill), piece


def _ends_at(clear: np.ndarray, piece: Part) -> bool:
    """Whether a piece is cut off where nothing is, (H, W) bool, so that it may not go on there."""
    near = piece.patch.grown(REACH, clear.shape)
    return int((near.mask & clear[near.window]).sum()) >= LEAST_CUT


def _is_gradient(whole: Part, piece: Part, smooth: np.ndarray) -> bool:
    """Whether a piece of a part is a gradient that fades into the rest of that. smooth: (H, W) bool where gradients are
    sought."""
    if smooth[piece.rows, piece.columns].mean() < EXPLAINED:
        return False
    around = piece.patch.grown(RING, whole.levels.shape)
    rows, columns = around.places()
    own = whole.patch.at(rows, columns)
    around.mask[rows[~own] - around.top, columns[~own] - around.left] = False
    pixels = Part(whole.levels, around).pixels
    shade = common_shade(pixels, [])
    return shade is not None and bool(shade.explains(pixels).mean() >= EXPLAINED)


def _area(levels: np.ndarray, parts: np.ndarray, ground: Ground, colour: np.ndarray) -> SoftArea:
    """The soft area on a ground, seen there and where it goes on between what covers it."""
    line = colour - ground.fill
    scale = float(np.abs(line).max())
    off = levels - ground.fill
    seen = off @ line / float(line @ line)
    on_line = largest(np.abs(off - seen[..., None] * line)) <= OFF_LINE
    nothing = levels[..., 3] <= CLEAR
    seen = np.where(nothing, 0.0, scale * seen)
    own = ground.mask & on_line
    if not (own & (seen > OFF_LINE)).any():
        return SoftArea(replace(ground, mask=np.zeros_like(own)), colour, np.zeros(own.shape))
    # What is see-through shows the ground; so does what is no darker than the area elsewhere, if it is not even.
    through = levels[..., 3] < OPAQUE
    possible = on_line & (through | (seen <= float(seen[own].max()) + CLOSE))
    sizes, _, spreads = part_spreads(levels, parts, int(parts.max()))
    sizes, uneven = np.append(0, sizes), np.append(False, spreads > LEAST_RANGE)

    def share_of(pixels: np.ndarray) -> np.ndarray:
        """(parts + 1,) the share of each part's pixels that these (H, W) have, 0 of edges."""
        return np.bincount(parts.ravel(), pixels.ravel(), len(sizes)) / np.maximum(sizes, 1) * (sizes > 0)

    uneven |= share_of(through) > ON_LINE
    field = _continued(seen, own | nothing, scale)
    for _ in range(ROUNDS_SEEN):
        gap, shaded = np.abs(field - seen), field > OFF_LINE
        alike = uneven | (share_of(possible * gap) <= CLOSE)
        more = alike & (share_of(possible) >= ON_LINE) & (share_of(shaded) >= 0.5)
        own |= possible & ((shaded & (gap <= CLOSE)) | more[parts])
        field = _continued(seen, own | nothing, scale)
    return SoftArea(replace(ground, mask=own), colour, field / scale)


def _continued(levels: np.ndarray, known: np.ndarray, most: float) -> np.ndarray:
    """(H, W) levels as they were before they were rounded, and on, up to `most`, where they are not known."""
    rows, columns = (np.flatnonzero((known & (levels > OFF_LINE)).any(axis=axis)) for axis in (1, 0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    window, out = widened(box, BESIDE, levels.shape), np.zeros(levels.shape)
    out[window] = _continued_within(levels[window], known[window], most)
    return out


def _continued_within(levels: np.ndarray, known: np.ndarray, most: float) -> np.ndarray:
    """The same of a window."""
    height, width = levels.shape
    at = np.flatnonzero(~known)
    found, places = nearest_paints(np.where(known, 0, -1), at, REACH, 1)
    beside = found[:, 0] == 0
    at, places = at[beside], places[beside, 0]
    row, column = np.divmod(places, width)
    behind = np.clip(2 * row - at // width, 0, height - 1), np.clip(2 * column - at % width, 0, width - 1)
    smooth = _inwards(levels, known)
    values = np.where(known[behind], 2.0 * smooth[row, column] - smooth[behind], smooth[row, column])
    goal, fixed = smooth.copy(), known.copy()
    goal.ravel()[at], fixed.ravel()[at] = np.clip(values, 0.0, most), True
    out = _inwards(goal, fixed)
    low, high = np.where(fixed, out - ROUNDING, -np.inf), np.where(fixed, out + ROUNDING, np.inf)
    for _ in range(ROUNDS):
        out = np.clip(ndimage.gaussian_filter(out, 1.0, truncate=3.0, mode="nearest"), low, high)
    return np.maximum(out, 0.0)


def _inwards(levels: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Levels (H, W); where they are not known the mean of those that are, near ones more."""
    out, left, sigma = levels.astype(float), ~known, 1.0
    weights, values = known.astype(float), np.where(known, levels, 0.0).astype(float)
    while left.any() and sigma < max(levels.shape):
        weights = ndimage.gaussian_filter(weights, sigma, truncate=3.0, mode="nearest")
        values = ndimage.gaussian_filter(values, sigma, truncate=3.0, mode="nearest")
        now = left & (weights > 1e-3)
        out[now] = values[now] / weights[now]
        left &= ~now
        sigma *= 2.0
    return out
