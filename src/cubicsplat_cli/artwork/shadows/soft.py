"""Soft areas of any form on even grounds: shadows, glows and blurred lights, as they are seen.

A soft area of one colour blends with its ground, so that all colours lie on a straight line. The share of the area in a
pixel follows from the pixel's place on the line. Beneath the shapes that cover it, the area goes on smoothly.
"""

from __future__ import annotations

from functools import cache, cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import largest, widened
from cubicsplat_cli.artwork.gradients.areas import EXPLAINED
from cubicsplat_cli.artwork.gradients.parts import RING, Part, Parts, Patch, smooth_parts
from cubicsplat_cli.artwork.gradients.shades import common_shade
from cubicsplat_cli.artwork.regions.fills import ALIKE, CLEAR, CONTACT, OPAQUE, ROUNDED, SAME
from cubicsplat_cli.artwork.shadows.casters import (
    LEAST_RANGE,
    ON_LINE,
    Ground,
    direction_from,
    end_of,
    even_grounds,
    off_line,
    on_line,
)
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import nearest_paints
from cubicsplat_cli.record import record

LEAST_AREA = 200  # px of an area
SHARP_BEND = 6.0  # levels, the second difference in a dark shadow of little blur
REACH = 6  # px from the visible pixels of an area, or of its ground, in which it goes on as it changes there
BESIDE = 32  # px around the visible pixels of an area, beyond which it ends
ROUNDS = 60  # of smoothing within the error of rounding


@record
class SoftArea(Ground):
    """A ground, with the pixels of it that show a soft area. colour: the opaque colour (4,) in levels towards which it
    tends; share: (H, W) share of this colour, also in pixels that do not show the area; rough: times as much as in a
    clean picture by which pixels may differ from it."""

    colour: np.ndarray
    share: np.ndarray
    rough: float = 1.0

    def colours(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return (n, 4) levels of the area on its ground in columns x and rows y (n,)."""
        return self.fill + self.share[y, x][:, None] * (self.colour - self.fill)

    @property
    def scale(self) -> float:
        """Levels of a share of 1."""
        return float(np.abs(self.colour - self.fill).max())


@record
class Line:
    """Colours from a ground to its shade. off: (..., 4) levels of pixels from the ground; way: (4,) from there to the
    shade; error: in levels."""

    off: np.ndarray
    way: np.ndarray
    error: float

    @cached_property
    def shares(self) -> np.ndarray:
        """(...) how far pixels are on the way, 0 to 1."""
        return self.off @ self.way / max(float(self.way @ self.way), 1e-9)

    @property
    def scale(self) -> float:
        """Levels of a share of 1."""
        return float(np.abs(self.way).max())

    def apart(self, shares: np.ndarray) -> np.ndarray:
        """Return (..., 4) levels by which pixels differ from shares (...)."""
        return self.off - shares[..., None] * self.way

    def near(self, shares: np.ndarray) -> np.ndarray:
        """Return (...) bool, true for pixels that have these shares."""
        return largest(np.abs(self.apart(shares))) <= self.error

    @property
    def shaded(self) -> np.ndarray:
        """(...) bool, true for pixels of the ground or on the way, to within the error."""
        return self.near(self.shares) & (self.scale * self.shares >= -self.error)


def soft_areas(parts: Parts) -> list[SoftArea]:
    """Return the soft areas of a picture, by its even parts, other than gradients."""
    found, clear = list[tuple[Ground, np.ndarray]](), parts.levels[..., 3] <= CLEAR
    smooth = cache(lambda: smooth_parts(parts.levels, tip=np.inf).numbers > 0)  # needed in few pictures; shadows bend
    pieces = (
        (part, part.within(even), fill, piece)
        for part, fill, even in even_grounds(parts)
        for piece in part.pieces(~even)
        if len(piece) >= LEAST_AREA and piece.range() > LEAST_RANGE
    )
    for part, clean, fill, piece in pieces:
        work().at()
        # What clear pixels cut off cannot go on there.
        cut_off = clear[piece.patch.grown(REACH, clear.shape).places()].sum() >= CONTACT
        direction = direction_from(piece.pixels.values, fill)
        if direction is None or (fill[3] > CLEAR and cut_off):
            continue
        if _is_sharp(clean, fill, piece) or _is_gradient(part, piece, smooth()):
            continue
        # The end of its line is uncertain for a pale piece.
        colour, off = end_of(fill, direction), piece.pixels.values - fill
        same = [g for g, end in found if (g.fill == fill).all() and on_line(off, end - fill)]
        if not same:
            same = [Ground(fill, np.zeros(clear.shape, dtype=bool))]
            found.append((same[0], colour))
        same[0].mask[part.rows, part.columns] = True
    areas = (_area(parts, ground, colour) for ground, colour in found)
    return [area for area in areas if area is not None]


def _is_sharp(ground: Patch, fill: np.ndarray, piece: Part) -> bool:
    """Return True if a piece has an edge to its ground, of a colour `fill` (4,) in levels, that is not soft."""
    near = ground.grown(RING, piece.levels.shape).at(piece.rows, piece.columns)
    off = largest(np.abs(piece.pixels.values[near] - fill))
    return int((off > SHARP_BEND * RING * (RING + 1) / 2).sum()) >= CONTACT


def _is_gradient(whole: Part, piece: Part, smooth: np.ndarray) -> bool:
    """Return True if a piece of a part is a gradient fading into it. smooth: (H, W) bool, where these are sought."""
    if smooth[piece.rows, piece.columns].mean() < EXPLAINED:
        return False
    pixels = whole.around(piece).pixels
    shade = common_shade(pixels)
    return shade is not None and bool(shade.explains(pixels).mean() >= EXPLAINED)


def _area(parts: Parts, ground: Ground, colour: np.ndarray) -> SoftArea | None:
    """Return the soft area on a ground, with the pixels that show it there and between what covers it; None if none
    do."""
    levels = parts.levels
    colour = _surer(levels[ground.mask] - ground.fill, ground.fill, colour)
    off, way = levels - ground.fill, colour - ground.fill
    line = Line(off, way, off_line(off[ground.mask] @ way / max(float(np.linalg.norm(way)), 1e-9)))
    near, scale, nothing = line.near(line.shares), line.scale, levels[..., 3] <= CLEAR
    seen = np.where(nothing, 0.0, scale * line.shares)
    shown = ground.mask & near
    if not (shown & (seen > ROUNDED)).any():
        return None
    # Translucent pixels show the ground, and so do uneven ones that are no darker than the area elsewhere.
    through = levels[..., 3] < OPAQUE
    possible = near & (through | (seen <= float(seen[shown].max()) + SAME))
    sizes, _, spreads = parts.measured
    sizes, uneven = np.append(0, sizes), np.append(False, spreads > LEAST_RANGE)

    def share_of(pixels: np.ndarray) -> np.ndarray:
        """Return (parts + 1,) the share of each part that some pixels (H, W) have, 0 for edges."""
        return np.bincount(parts.numbers.ravel(), pixels.ravel(), len(sizes)) / np.maximum(sizes, 1) * (sizes > 0)

    uneven |= share_of(through) > ON_LINE
    field = _continued(seen, shown | nothing, scale)
    gap, shaded = np.abs(field - seen), field > ROUNDED
    alike = uneven | (share_of(possible * gap) <= SAME)
    on_way = (share_of(near) >= ON_LINE) & (share_of(possible) >= EXPLAINED)
    more = (alike & on_way & (share_of(shaded) >= 0.5))[parts.numbers] & near & ~shown
    if more.any():
        shown |= more
        field = _continued(seen, shown | nothing, scale)
        gap, shaded = np.abs(field - seen), field > ROUNDED
    shown |= possible & shaded & (gap <= SAME)
    # Programs that round colours before they blend them miss the line where little shows of the area.
    shown |= ground.mask & shaded & (largest(np.abs(line.apart(field / scale))) <= SAME)
    return SoftArea(ground.fill, shown, colour, _continued(seen, shown | nothing, scale) / scale)


def _surer(off: np.ndarray, fill: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """Return the colour (4,) at the end of a line that pixels tell, off (n, 4) levels from its fill (4,), from one that
    a pale piece told: by rounding it is off by as many times more as it is farther away than that piece's colours.
    """
    known = 0.0
    while True:
        line = Line(off, colour - fill, ROUNDED)
        depth, beside = line.scale * line.shares, largest(np.abs(line.apart(line.shares)))
        told = depth[beside <= ROUNDED].max(initial=0.0)
        if told <= known + SAME:
            return colour
        known = told
        near = (depth > 0.0) & (beside <= ROUNDED * (1.0 + depth / known))
        direction = depth[near] @ off[near]  # the least squares of all, through the fill
        colour = end_of(fill, direction / np.linalg.norm(direction))


def _continued(levels: np.ndarray, known: np.ndarray, most: float) -> np.ndarray:
    """Return (H, W) levels as they were before rounding, continued, up to `most`, into pixels that are not known."""
    (box,) = ndimage.find_objects(known & (levels > ROUNDED))
    window, whole = widened(box, BESIDE, levels.shape), np.zeros(levels.shape)
    levels, known = levels[window], known[window]
    height, width = levels.shape
    at = np.flatnonzero(~known)
    found, places = nearest_paints(np.where(known, 0, -1), at, REACH, 1)
    beside = found[:, 0] == 0
    at, (row, column) = at[beside], np.divmod(places[beside, 0], width)
    behind = np.clip(2 * row - at // width, 0, height - 1), np.clip(2 * column - at % width, 0, width - 1)
    smooth = inwards(levels, known)
    values = np.where(known[behind], 2.0 * smooth[row, column] - smooth[behind], smooth[row, column])
    goal, fixed = smooth.copy(), known.copy()
    goal.ravel()[at], fixed.ravel()[at] = np.clip(values, 0.0, most), True
    out = inwards(goal, fixed)
    low, high = np.where(fixed, out - ALIKE, -np.inf), np.where(fixed, out + ALIKE, np.inf)
    for _ in range(ROUNDS):
        out = np.clip(ndimage.gaussian_filter(out, 1.0, truncate=3.0, mode="nearest"), low, high)
    whole[window] = np.maximum(out, 0.0)
    return whole


def inwards(levels: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return levels (H, W) or (H, W, C), with the mean of the known levels nearby in pixels not known, (H, W) bool."""
    out, left, size = levels.reshape(*known.shape, -1).astype(float), ~known, 3
    weights, values = known.astype(float), np.where(known[..., None], out, 0.0)
    while left.any() and size < 2 * max(known.shape):
        for _ in range(2):  # means of means, which fall off with the distance
            weights = ndimage.uniform_filter(weights, size, mode="nearest")
            values = ndimage.uniform_filter(values, (size, size, 1), mode="nearest")
        now = left & (weights > 1e-3)
        out[now] = values[now] / weights[now][:, None]
        left &= ~now
        size = 2 * size - 1
    return out.reshape(levels.shape)
