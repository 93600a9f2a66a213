"""The regions of a flat picture: every pixel belongs to one, blends on edges to the nearer of their two fills."""

from __future__ import annotations

from collections import Counter
from dataclasses import field
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest
from cubicsplat_cli.artwork.regions.fills import (
    APART,
    BLEND,
    CLEAR,
    CONTACT,
    MOST_PALETTE,
    MOST_SMALL,
    PURE,
    SAME,
    commoner_fills,
    flat_pixels,
    has_square,
    picture_fills,
)
from cubicsplat_cli.artwork.regions.hairlines import (
    LESS,
    MOST_RESIDUAL,
    MOST_SEEN,
    NONE,
    missing_fills,
    nearest_line_fills,
    stands,
    with_lines,
    without,
)
from cubicsplat_cli.artwork.regions.hidden_fills import hidden_fills, line_blends
from cubicsplat_cli.artwork.regions.pen_lines import pen_blends
from cubicsplat_cli.artwork.regions.pixel_lines import joined_at_corners, with_pixel_lines
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.borders import BorderMap, border_map
from cubicsplat_cli.raster.unmix import (
    REACH,
    STRANGE,
    best_blend,
    components,
    near_fills,
    nearest_fills,
    off_palette,
    part_facts,
    part_fills,
    residual_of_three,
)
from cubicsplat_cli.record import record

# Pixels that show a fill in blends only, and their least share of all pixels that no blend explains.
FEWEST, LEAST_STRANGE = 4, 0.002
# A region below SPECK px must have a pixel of which its fill has the share MOSTLY. A region below CRUMB px, or without
# such a pixel, must have that share in all, and lie amid another region, so that it is no blend of two. It must also be
# purely of another colour, unless there are MANY_DOTS, too many to be tried one by one in the finished drawing.
SPECK, MOSTLY, CRUMB, MANY_DOTS = 9, 0.9, 3, 400

# (H, W) bool: what a shadow shades, and what it would shade if that did not lie above it.
ShadowSides = tuple[np.ndarray, np.ndarray]


@record
class FlatPicture:
    """A picture without gradients, noise or blur, and what is known of it.

    levels: (H, W, 4) premultiplied RGBA. palette: (P, 4) levels, its fill colours, or None. labels: (H, W) int32 which
    of them every pixel has most of, or None. standing: (G, 4) levels, fills that stand for gradients, of no thin line.
    """

    levels: np.ndarray
    palette: np.ndarray | None = None
    labels: np.ndarray | None = None
    standing: np.ndarray = field(default_factory=lambda: NONE)


@record
class Regions:
    """labels: (H, W) int32, 0..R-1, each label one connected region. fills: (R, 4) levels, premultiplied; fill_of: (R,)
    the index of each region's fill in the palette."""

    labels: np.ndarray
    fills: np.ndarray
    fill_of: np.ndarray

    @property
    def count(self) -> int:
        return len(self.fills)

    @cached_property
    def areas(self) -> np.ndarray:
        """(R,) px of every region."""
        return np.bincount(self.labels.ravel(), minlength=self.count)

    def ground(self) -> list[int]:
        """The regions on the canvas's border of the fill that three or all of its corners show: pieces of one that goes
        on beyond and encloses the rest, as it does where the canvas is larger; none where that is clear.
        """
        labels, fill_of = self.labels, self.fill_of
        fill, count = Counter(fill_of[labels[[0, 0, -1, -1], [0, -1, 0, -1]]].tolist()).most_common(1)[0]
        rim = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])).tolist()
        return [k for k in rim if count >= 3 and fill_of[k] == fill and self.fills[k, 3] > CLEAR]

    @cached_property
    def borders(self) -> BorderMap:
        """The map of their borders."""
        return border_map(self.labels)


@record
class PixelFills:
    """The fill of every pixel: fills (H, W) int32, indices into a palette (P, 4). parts: (H, W) int32 the connected
    pixels of one fill, numbered from 0 on; sure: (H, W) bool, pixels that are their fill, or for the most part; pure:
    (H, W) int32 the fill of pixels that are one, -1 for blends; banded: (H, W) bool, those of shading in bands.
    """

    palette: np.ndarray
    fills: np.ndarray
    parts: np.ndarray
    sure: np.ndarray
    pure: np.ndarray
    banded: np.ndarray

    def regions(self, min_area: float) -> Regions:
        """The parts as regions; those of less than `min_area` px, and specks, join a neighbour."""
        sizes, found, fill_of = part_facts(self.parts, self.fills, self.sure)
        joins = _without_specks(self.parts, sizes, found, min_area)
        numbers = np.cumsum(np.bincount(joins) > 0, dtype=np.int32) - 1  # without gaps between them
        joins = numbers[joins]
        votes = np.zeros((int(joins.max()) + 1, len(self.palette)), np.int64)
        np.add.at(votes, (joins, fill_of), sizes)
        fill_of = votes.argmax(axis=1)
        return Regions(joins[self.parts], self.palette[fill_of], fill_of)


def find_regions(picture: FlatPicture) -> Regions:
    """The regions of a picture, but for specks, by its `pixel_fills`."""
    return pixel_fills(picture).regions(0.0)


def pixel_fills(picture: FlatPicture, most: int | None = None) -> PixelFills:
    """The fills of a picture: of its palette, and those that only thin lines and small details have; with these no more
    than `most`, where that is not None. Where its labels are known the palette has them all.
    """
    levels = picture.levels
    palette = picture_fills(levels) if picture.palette is None else picture.palette
    if picture.labels is None:
        flat = flat_pixels(levels, SAME)
        palette, pure, banded = _with_missing_fills(levels, palette, flat, most)
        palette, pure, lined = with_pixel_lines(levels, palette, pure, most)
        if most is None and len(palette) <= MOST_SEEN:  # chosen fills stay
            inks, false = pen_blends(levels, palette, pure, flat)
            numbers = np.append(np.where(false, -1, np.cumsum(~false) - 1), -1).astype(np.int32)
            palette, pure = np.vstack([palette[~false], inks]), numbers[pure]
            lined &= pure >= 0
        fills = _blends_shared_out(levels, palette, pure, picture.standing)
        lined &= ~stands(palette, picture.standing)[fills]
        fills = np.where(lined, fills, with_lines(levels, palette, fills, STRANGE, LESS, picture.standing))
    else:
        fills, banded = picture.labels, np.zeros(picture.labels.shape, dtype=bool)
        pure = np.where(off_palette(levels, palette, fills) <= PURE, fills, -1)
    fills = joined_at_corners(fills, levels, palette)
    parts, _ = components(fills)
    # A restored picture has crumbs of its noise.
    sure = _sure(levels, palette, parts, fills, pure, dots=picture.labels is None)
    return PixelFills(palette, fills, parts, sure, pure, banded)


def _with_missing_fills(
    levels: np.ndarray, palette: np.ndarray, flat: np.ndarray, most: int | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The palette with the fills that only thin lines have, and the bands of shading, less those that lines of other
    fills make; (H, W) int32 the fill of pixels that are one; and (H, W) bool the pixels of shading. flat: (H, W) bool,
    pixels amid a square of one colour.
    """
    known, banded = len(palette), np.zeros(levels.shape[:2], dtype=bool)
    pure = _pure_fills(levels, palette, flat)
    y, x = np.nonzero(pure < 0)
    if len(y) and known < min(most or MOST_PALETTE, MOST_PALETTE):
        near = near_fills(pure, y, x, REACH)
        residual = best_blend(levels[y, x], palette, near)[1]
        banded[y, x] = residual > BLEND
        banded = _shading(levels, palette, banded)
        strange = _strange(levels, palette, y, x, near, residual)
        y, x = y[strange], x[strange]
        bands = _bands(levels, palette, banded) if banded.any() else palette[:0]
        palette = np.vstack([palette, missing_fills(levels, (y, x), palette[near[strange, 0]]), bands])[:most]
        if len(palette) <= MOST_SEEN:
            fewest = max(FEWEST, LEAST_STRANGE * len(y))
            palette = np.vstack([palette, hidden_fills(levels[y, x], palette, MOST_RESIDUAL, APART, fewest)])[:most]
    if len(palette) > known:
        pure = _pure_fills(levels, palette, flat)
    if len(palette) <= MOST_SEEN:
        false = line_blends(levels, palette, pure, flat)
        if false.any():
            palette = palette[~false]
            pure = _pure_fills(levels, palette, flat)
    pure[banded] = nearest_fills(levels[banded], palette)[0]
    return palette, pure, banded


def _shading(levels: np.ndarray, palette: np.ndarray, unexplained: np.ndarray) -> np.ndarray:
    """(H, W) bool: areas 3 px thick of unexplained pixels of one opacity, some far from every fill, whose colours
    change by no more than a band a px.
    """
    inside = ndimage.binary_erosion(unexplained, ndimage.SQUARE)
    if not inside.any():
        return inside
    inside &= flat_pixels(levels[..., 3:]) & flat_pixels(levels, 2.0 * APART) & (levels[..., 3] > CLEAR)
    parts, count = ndimage.label(inside)
    far = np.bincount(parts[inside], nearest_fills(levels[inside], palette)[1] > APART, count + 1)
    return ndimage.binary_dilation((far >= CONTACT)[parts], ndimage.SQUARE)


def _bands(levels: np.ndarray, palette: np.ndarray, banded: np.ndarray) -> np.ndarray:
    """(k, 4) the fills, about APART levels apart, of the bands in which shading (H, W) bool is drawn, beyond those of a
    palette.
    """
    found = part_fills(levels, ndimage.label(banded)[0], BLEND, APART)
    fills, sizes = commoner_fills(*found, 0.5 * APART, MOST_SMALL)
    return fills[(sizes >= CONTACT) & (nearest_fills(fills, palette)[1] > APART)]


def _pure_fills(levels: np.ndarray, palette: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """(H, W) int32 the fill of pixels that are one, -1 for blends; a blend that looks like a third fill is a blend.
    flat: (H, W) bool, pixels amid a square of one colour.
    """
    nearest, gap = nearest_fills(levels, palette)
    pure = np.where(gap <= np.where(flat, SAME, PURE), nearest, -1).astype(np.int32)
    # Whole components count that somewhere are flat or two pixels thick; thin ones are often edges between others.
    parts, count = components(pure)
    good = np.zeros(count, dtype=bool)
    good[parts[flat | has_square(pure)]] = True
    settled = np.where(good[parts], pure, -1)
    # A thin one whose colour is no blend of two fills beside it is real.
    y, x = np.nonzero(settled != pure)
    near = near_fills(settled, y, x, REACH)
    real = best_blend(levels[y, x], palette, near)[1] > BLEND
    short = np.flatnonzero(real & (np.bincount(parts.ravel())[parts[y, x]] < CONTACT))
    place = y[short], x[short]
    real[short] = ~_blends_with_any(levels[place], palette, pure[place], near[short])
    real[real] = ~_on_a_slope(levels, palette, y[real], x[real], near[real])
    settled[y[real], x[real]] = pure[y[real], x[real]]
    return settled


def _blends_with_any(levels: np.ndarray, palette: np.ndarray, own: np.ndarray, near: np.ndarray) -> np.ndarray:
    """(n,) bool: pixels (n, 4) that are a fill, own (n,), but also a blend of another with the nearest, near (n, k)."""
    out, ground = np.zeros(len(levels), dtype=bool), palette[near[:, 0]]
    for fill in palette[:MOST_SEEN]:
        rest = blend_of(levels, ground, fill)[1]
        out |= (largest(np.abs(rest)) <= PURE) & (largest(np.abs(levels - fill)) > BLEND)
    return out & (near[:, 0] >= 0) & (near != own[:, None]).all(axis=1)


def _on_a_slope(levels: np.ndarray, palette: np.ndarray, y: np.ndarray, x: np.ndarray, near: np.ndarray) -> np.ndarray:
    """(n,) bool: pixels y, x that are blends of the nearest fill, near (n, k), and a pixel beside them."""
    ground, found = palette[near[:, 0]], np.zeros(len(y), dtype=bool)
    height, width = levels.shape[:2]
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = levels[np.clip(y + down, 0, height - 1), np.clip(x + right, 0, width - 1)]
        share, rest = blend_of(levels[y, x], ground, beside)
        found |= (share <= 0.5) & (largest(np.abs(rest)) <= PURE)
    return found & (near[:, 0] >= 0)


def _blends_shared_out(levels: np.ndarray, palette: np.ndarray, pure: np.ndarray, standing: np.ndarray) -> np.ndarray:
    """(H, W) int32 a fill for every pixel: blends go to the fill with the greater share."""
    y, x = np.nonzero(pure < 0)
    out, near = pure.copy(), near_fills(pure, y, x, REACH)
    winner, residual = best_blend(levels[y, x], palette, near)
    nearest, gap = nearest_fills(levels[y, x], without(palette, standing))
    # Far from every fill, infinitely off, or not explained by those near: the nearest fill of all if that is closer.
    lost = (residual > MOST_RESIDUAL) & (gap < residual)
    out[y, x] = np.where(lost, nearest, winner)
    strange = _strange(levels, palette, y, x, near, residual)
    if not strange.any():
        return out
    y, x, near = y[strange], x[strange], near[strange]
    fill, own = nearest_line_fills(levels, (y, x), palette, near, standing)
    out[y, x] = np.where(own, fill, np.where(fill >= 0, winner[strange], out[y, x]))
    return out


def _strange(
    levels: np.ndarray, palette: np.ndarray, y: np.ndarray, x: np.ndarray, near: np.ndarray, residual: np.ndarray
) -> np.ndarray:
    """(n,) bool: the pixels y, x that are no blend of two or three fills near them; those on the canvas's rim, which
    blend with what is beyond it, are none of these.
    """
    height, width = levels.shape[:2]
    within = (y > 0) & (x > 0) & (y < height - 1) & (x < width - 1) & (near[:, 0] >= 0)
    strange = within & (residual > STRANGE)
    strange[strange] = residual_of_three(levels[y[strange], x[strange]], palette, near[strange]) > BLEND
    return strange


def _sure(
    levels: np.ndarray, palette: np.ndarray, labels: np.ndarray, fills: np.ndarray, pure: np.ndarray, *, dots: bool
) -> np.ndarray:
    """(H, W) bool: pixels that are their fill, or for the most part their fill rather than that of the region which
    their own touches most. dots: whether regions of a px or two may be real, and blurred ones.
    """
    sure = pure >= 0
    sizes, found, fill_of = part_facts(labels, fills, sure)
    crumbs = sizes < CRUMB
    lacking = ((found == 0) & (sizes < SPECK)) | crumbs
    if not lacking.any():
        return sure
    beside, neighbours = _most_touched(labels, lacking)
    y, x = np.nonzero(lacking[labels])
    own = labels[y, x]
    ground, fill = palette[fill_of[beside[own]]], palette[fills[y, x]]
    share, _ = blend_of(levels[y, x], ground, fill, most=None)
    amid = (neighbours == 1) & (np.bincount(own, share, len(sizes)) >= MOSTLY) & dots
    if amid.sum() <= MANY_DOTS:
        plain = sure[y, x] & (largest(np.abs(fill - ground)) > APART)
        amid &= np.bincount(own, plain, len(sizes)) == sizes
    sure[y, x] = ((share >= MOSTLY) & ~crumbs[own]) | amid[own]
    return sure


def _without_specks(labels: np.ndarray, sizes: np.ndarray, sure: np.ndarray, area: float) -> np.ndarray:
    """(n,) the label that each takes over: those below `area` px, and small ones without a pixel surely theirs, go to
    the neighbour they touch most. sizes, sure: (n,) px of each, and those that are surely its own.
    """
    takes = np.arange(len(sizes))
    for _ in range(8):
        size, found = (np.bincount(takes, each, len(sizes)) for each in (sizes, sure))
        doomed = ((size < area) | ((found == 0) & (size < SPECK))) & (size > 0)
        if not doomed.any() or (doomed == (size > 0)).all():
            break
        target = _most_touched(labels, doomed)[0]
        takes, labels = target[takes], target[labels]
    return takes


def _most_touched(labels: np.ndarray, doomed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R,) label to take over: itself where not doomed; and how many other labels each doomed one may take."""
    borders, target = border_map(labels), np.arange(len(doomed))
    taking = np.flatnonzero(doomed[borders.first] & ~doomed[borders.second])
    order = taking[np.argsort(borders.cracks[taking], kind="stable")]
    target[borders.first[order]] = borders.second[order]
    return target, np.bincount(borders.first[taking], minlength=len(doomed))
