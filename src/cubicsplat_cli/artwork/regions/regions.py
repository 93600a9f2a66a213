"""The regions of a flat picture: every pixel belongs to one, blends on edges to the nearer of their two inks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.regions.diagonals import joined_at_corners
from cubicsplat_cli.artwork.regions.hairlines import (
    LESS,
    REACH,
    STRANGE,
    level_lines,
    missing_inks,
    nearest_line_inks,
    strangers,
    with_lines,
)
from cubicsplat_cli.artwork.regions.hidden_inks import hidden_inks, without_blends
from cubicsplat_cli.artwork.regions.inks import SAME, flat_pixels
from cubicsplat_cli.artwork.regions.line_blends import line_blends
from cubicsplat_cli.artwork.regions.rules import with_rules
from cubicsplat_cli.raster.unmix import best_blend, components, near_inks, nearest_inks

# A pixel within so many levels of an ink is that ink.
PURE = 2.5
MOST_PALETTE = 64  # inks, beyond which a picture has gradients and textures rather than lines in more inks
# Inks beyond which those that no pixel shows pure are not sought; levels by which these differ from all blends of two
# others; levels that are one colour; and the pixels that show it, also as a share of those that no blend explains.
MOST_SEEN, STRANGE_INK, ONE_COLOUR, FEWEST, LEAST_STRANGE = 24, 40.0, 24.0, 4, 0.002
# A region below SPECK px must have a pixel that is its ink by MOSTLY.
SPECK, MOSTLY = 9, 0.9


@dataclass(frozen=True, eq=False)
class FlatPicture:
    """A picture without gradients, noise or blur, and what is known of it.

    levels: (H, W, 4) premultiplied RGBA. palette: (P, 4) levels, its fill colours, or None. labels: (H, W) int32 which
    of them every pixel has most of, or None.
    """

    levels: np.ndarray
    palette: np.ndarray | None = None
    labels: np.ndarray | None = None


@dataclass(frozen=True)
class Regions:
    """labels: (H, W) int32, 0..R-1, each label one connected region. inks: (R, 4) levels, premultiplied; ink_of: (R,)
    the index of each region's ink in the palette."""

    labels: np.ndarray
    inks: np.ndarray
    ink_of: np.ndarray

    @property
    def count(self) -> int:
        return len(self.inks)

    def areas(self) -> np.ndarray:
        """(R,) px of every region."""
        return np.bincount(self.labels.ravel(), minlength=self.count)


@dataclass(frozen=True, eq=False)
class PixelInks:
    """The ink of every pixel: inks (H, W) int32, indices into a palette (P, 4). parts: (H, W) int32 the connected
    pixels of one ink, numbered from 0 on; sure: (H, W) bool, pixels that are their ink, or for the most part.
    """

    palette: np.ndarray
    inks: np.ndarray
    parts: np.ndarray
    sure: np.ndarray

    def regions(self, min_area: float) -> Regions:
        """The parts as regions; those of less than `min_area` px, and specks, join a neighbour."""
        labels = _numbered(_without_specks(self.parts, self.sure, max(min_area, 3.0)))
        ink_of = _majority(labels, self.inks)
        return Regions(labels, self.palette[ink_of], ink_of)


def find_regions(levels: np.ndarray, palette: np.ndarray, known: np.ndarray | None = None) -> Regions:
    """The regions of a picture, but for specks, by its `pixel_inks`."""
    return pixel_inks(levels, palette, known=known).regions(0.0)


def pixel_inks(
    levels: np.ndarray, palette: np.ndarray, most: int | None = None, known: np.ndarray | None = None
) -> PixelInks:
    """The inks of a picture (H, W, 4) in levels, of a palette (P, 4), and those that only thin lines and small details
    have: with these no more than `most`, where that is not None.

    known: (H, W) int32 the ink of every pixel, where that is known already; the palette then has them all.
    """
    if known is None:
        palette, pure = with_rules(levels, *_with_inks_of_lines(levels, palette, most), most)
        inks = _blends_shared_out(levels, palette, pure)
        inks = with_lines(levels, palette, inks, STRANGE, LESS)
    else:
        inks, pure = known, np.where(largest(np.abs(levels - palette[known])) <= PURE, known, -1)
    inks = joined_at_corners(inks, levels, palette)
    parts, _ = components(inks)
    return PixelInks(palette, inks, parts, _sure(levels, palette, parts, inks, pure))


def _with_inks_of_lines(levels: np.ndarray, palette: np.ndarray, most: int | None) -> tuple[np.ndarray, np.ndarray]:
    """The palette with the inks that only thin lines have, less those that lines of other inks make, and (H, W) int32
    the ink of pixels that are one.
    """
    palette, pure = _with_missing_inks(levels, palette, most)
    if len(palette) > MOST_SEEN:
        return palette, pure
    false = line_blends(palette, pure, flat_pixels(levels, SAME))
    return (palette[~false], _pure_inks(levels, palette[~false])) if false.any() else (palette, pure)


def _with_missing_inks(levels: np.ndarray, palette: np.ndarray, most: int | None) -> tuple[np.ndarray, np.ndarray]:
    pure = _pure_inks(levels, palette)
    y, x = np.nonzero(pure < 0)
    if len(y) == 0 or len(palette) >= min(most or MOST_PALETTE, MOST_PALETTE):
        return palette, pure
    near = near_inks(pure, y, x, REACH)
    strange = _strange(levels, palette, y, x, near, best_blend(levels[y, x], palette, near)[1])
    y, x, beside = y[strange], x[strange], palette[near[strange, 0]]
    other = ~level_lines(levels, (y, x), palette, beside)
    found = palette
    new = missing_inks(levels[y, x][other], beside[other])
    if len(new):
        palette = np.vstack([palette, new])[:most]
    if len(palette) <= MOST_SEEN:
        values = levels[y, x]
        fewest = max(FEWEST, LEAST_STRANGE * len(values))
        hidden = hidden_inks(values, palette, STRANGE_INK, ONE_COLOUR, fewest)
        if len(hidden):
            shown = np.isin(np.arange(len(palette)), pure[flat_pixels(levels, SAME)])
            palette = np.vstack([palette[without_blends(palette, shown, hidden)], hidden])[:most]
    return palette, pure if palette is found else _pure_inks(levels, palette)


def _pure_inks(levels: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """(H, W) int32 the ink of pixels that are one, -1 for blends; a blend that looks like a third ink is a blend."""
    nearest, gap = nearest_inks(levels, palette)
    pure = np.where(gap <= PURE, nearest, -1).astype(np.int32)
    flat = flat_pixels(levels, SAME)
    solid = has_square(pure)
    # Whole components count that somewhere are flat or two pixels thick; thin ones are often edges between others.
    parts, count = components(pure)
    good = np.zeros(count, dtype=bool)
    good[parts[flat | solid]] = True
    return np.where(good[parts] & (pure >= 0), pure, _thin_but_real(levels, palette, pure, good[parts]))


def _thin_but_real(levels: np.ndarray, palette: np.ndarray, pure: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Thin components whose colour is no blend of two inks beside it keep it."""
    doubtful = (pure >= 0) & ~good
    settled = np.where(good, pure, -1)
    y, x = np.nonzero(doubtful)
    out = np.full(pure.shape, -1, dtype=np.int32)
    if len(y) == 0:
        return out
    near = near_inks(settled, y, x, REACH)
    residual = best_blend(levels[y, x], palette, near)[1]
    kept = residual > 12.0
    out[y[kept], x[kept]] = pure[y[kept], x[kept]]
    return out


def has_square(pure: np.ndarray) -> np.ndarray:
    """(H, W) bool: belongs to a 2x2 square of one ink."""
    same = (pure[:-1, :-1] == pure[1:, :-1]) & (pure[:-1, :-1] == pure[:-1, 1:]) & (pure[:-1, :-1] == pure[1:, 1:])
    out = np.zeros(pure.shape, dtype=bool)
    for dy in (0, 1):
        for dx in (0, 1):
            out[dy : dy + same.shape[0], dx : dx + same.shape[1]] |= same
    return out & (pure >= 0)


def _blends_shared_out(levels: np.ndarray, palette: np.ndarray, pure: np.ndarray) -> np.ndarray:
    """(H, W) int32 an ink for every pixel: blends go to the ink with the greater share."""
    y, x = np.nonzero(pure < 0)
    out = pure.copy()
    if len(y) == 0:
        return out
    near = near_inks(pure, y, x, REACH)
    winner, residual = best_blend(levels[y, x], palette, near)
    nearest, gap = nearest_inks(levels[y, x], palette)
    # Far from every ink, or not explained by those near: the nearest ink of all if that is closer.
    lost = (winner < 0) | ((residual > 40.0) & (gap < residual))
    out[y, x] = np.where(lost, nearest, winner)
    strange = _strange(levels, palette, y, x, near, residual)
    if not strange.any():
        return out
    y, x, near = y[strange], x[strange], near[strange]
    ink, own = nearest_line_inks(levels[y, x], (y, x), pure.shape, palette, near)
    out[y, x] = np.where(own, ink, np.where(ink >= 0, winner[strange], out[y, x]))
    return out


def _strange(
    levels: np.ndarray, palette: np.ndarray, y: np.ndarray, x: np.ndarray, near: np.ndarray, residual: np.ndarray
) -> np.ndarray:
    """(n,) bool: the pixels y, x that the inks near them do not explain; those on the canvas's rim, which blend with
    what is beyond it, are none.
    """
    height, width = levels.shape[:2]
    within = (y > 0) & (x > 0) & (y < height - 1) & (x < width - 1) & (near[:, 0] >= 0)
    return within & strangers(levels[y, x], palette, near, residual)


def _sure(
    levels: np.ndarray, palette: np.ndarray, labels: np.ndarray, inks: np.ndarray, pure: np.ndarray
) -> np.ndarray:
    """(H, W) bool: pixels that are their ink, or for the most part their ink rather than that of the region which their
    own touches most.
    """
    sure = pure >= 0
    count = int(labels.max()) + 1
    lacking = (np.bincount(labels.ravel(), sure.ravel(), count) == 0) & (
        np.bincount(labels.ravel(), None, count) < SPECK
    )
    if not lacking.any():
        return sure
    beside = _most_touched(labels, count, lacking)
    ink_of = _majority(labels, inks)
    y, x = np.nonzero(lacking[labels])
    base = palette[ink_of[beside[labels[y, x]]]]
    span = palette[inks[y, x]] - base
    share = ((levels[y, x] - base) * span).sum(axis=1) / np.maximum((span * span).sum(axis=1), 1e-9)
    sure = sure.copy()
    sure[y, x] = share >= MOSTLY
    return sure


def _without_specks(labels: np.ndarray, sure: np.ndarray, area: float) -> np.ndarray:
    """Components below `area` px, and small ones without a pixel that is surely theirs, go to the neighbour that they
    touch most.
    """
    for _ in range(8):
        count = labels.max() + 1
        sizes = np.bincount(labels.ravel(), minlength=count)
        has_sure = np.bincount(labels.ravel(), sure.ravel(), count) > 0
        doomed = (sizes < area) | (~has_sure & (sizes < SPECK))
        doomed[sizes == 0] = False
        if not doomed.any() or doomed.all():
            break
        target = _most_touched(labels, count, doomed)
        labels = target[labels]
    return labels


def _numbered(labels: np.ndarray) -> np.ndarray:
    """(H, W) int32 the labels without gaps between them, in their order."""
    number = np.cumsum(np.bincount(labels.ravel()) > 0, dtype=np.int32) - 1
    return np.asarray(number[labels], dtype=np.int32)


def _most_touched(labels: np.ndarray, count: int, doomed: np.ndarray) -> np.ndarray:
    """(count,) label to take over: itself where not doomed."""
    pairs = []
    for a, b in ((labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1])):
        edge = a != b
        for u, v in ((a[edge], b[edge]), (b[edge], a[edge])):
            keep = doomed[u] & ~doomed[v]
            pairs.append(u[keep].astype(np.int64) * count + v[keep])
    key, touches = np.unique(np.concatenate(pairs), return_counts=True)
    target = np.arange(count)
    order = np.argsort(touches, kind="stable")
    target[key[order] // count] = key[order] % count
    return target


def _majority(labels: np.ndarray, inks: np.ndarray) -> np.ndarray:
    most = int(inks.max()) + 1
    votes = np.bincount(labels.ravel().astype(np.int64) * most + inks.ravel(), minlength=(labels.max() + 1) * most)
    return votes.reshape(-1, most).argmax(axis=1)
