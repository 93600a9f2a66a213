"""The areas and lines in which a picture differs visibly from its drawing.

A pixel is unexplained by as much as it lies outside of all colours that are drawn within a px or so of it: edges that
are a little off are none. What is left is averaged over squares and along short lines, so that noise goes and lines of
one px stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.input.restore import LUMA_CHROMA
from cubicsplat_cli.raster import ndimage

# Levels of luma or chroma that people see in an area, about 3 to 4 in CIEDE2000.
UNLIKE = 6.0
# What a JPEG leaves of edges, as a share of the range of values in the block around, px: of luma, and of chroma of half
# the size.
RINGING, BLOCKS = 0.05, ((8, slice(0, 1)), (16, slice(1, 3)))
SIDE = 5  # px, of the lines along which residuals are averaged
OWN = 0.5  # of the mean around it that a pixel is off itself
NOISY = 3.0  # standard deviations of the noise, in the mean of SIDE px
SEAM = 8.0  # levels that edges of a clean picture may be off: half of one of 4 x 4 samples a pixel
MARGIN = 5  # px around an area that are looked at with it
SQUARE = np.ones((3, 3), dtype=bool)
# Rows and columns of the pixels over which residuals are averaged: a square of 3 x 3 px, and lines in four directions.
_ALONG = range(SIDE)
STENCILS = (
    [(1 + i, 1 + j) for i in range(3) for j in range(3)],
    [(SIDE // 2, i) for i in _ALONG],
    [(i, SIDE // 2) for i in _ALONG],
    [(i, i) for i in _ALONG],
    [(i, SIDE - 1 - i) for i in _ALONG],
)
# Px times levels of an area that people see, and px of a shape, in a clean picture: a dot of a px; and in one with
# noise: 60 px of what is just unlike, or a short line.
LEAST_CLEAN, SMALLEST_CLEAN = 160.0, 1
LEAST, SMALLEST = 60.0 * UNLIKE, 6


@dataclass(frozen=True, eq=False)
class Area:
    """rows, columns: its window on the canvas. where: (h, w) bool, its pixels. weight: what it adds to the error."""

    rows: slice
    columns: slice
    where: np.ndarray
    weight: float


@dataclass(frozen=True)
class ErrorModel:
    """The errors that a picture may have beside its drawing.

    noise: standard deviation in levels; error: that of pixels on edges. jpeg: whether edges ring. blur: standard
    deviation, px. least: px times levels of an area. smallest: px of a shape. seam: levels by which what lies beneath
    shows through on edges.
    """

    noise: float
    error: float
    jpeg: bool
    blur: float
    least: float
    smallest: float
    seam: float

    @property
    def clean(self) -> bool:
        """Whether every difference is one of the drawing."""
        return self.seam > 0.0

    @classmethod
    def of(cls, condition: Condition, min_area: float) -> ErrorModel:
        least, smallest = (LEAST_CLEAN, SMALLEST_CLEAN) if condition.clean else (LEAST, SMALLEST)
        seam = SEAM if condition.clean else 0.0
        return cls(
            condition.noise, condition.edge_error, condition.jpeg, condition.blur, least, max(smallest, min_area), seam
        )


@dataclass(frozen=True, eq=False)
class Picture:
    """The picture that drawings are compared with. levels: (H, W, 4); seen: (H, W, 4), in luma and chroma; model: of
    its errors; ringing: (H, W, 4) levels by which a JPEG's edges are off in luma and chroma, else 0.
    """

    levels: np.ndarray
    seen: np.ndarray
    model: ErrorModel
    ringing: np.ndarray

    @classmethod
    def of(cls, levels: np.ndarray, model: ErrorModel) -> Picture:
        """A picture with such errors."""
        seen = levels @ LUMA_CHROMA
        return cls(levels, seen, model, _ringing(seen, model))


def areas(picture: Picture, painted: np.ndarray) -> list[Area]:
    """The areas in which a picture is unlike what is painted, (H, W, 4) in levels, the worst first."""
    gap, model = largest(np.abs(picture.levels - painted)), picture.model
    where = _unlike(picture, painted, gap > OWN * UNLIKE)
    if gap[where].sum() < model.least:
        return []
    height, width = gap.shape
    reach = MARGIN + math.ceil(2.0 * model.blur)
    parts, _ = ndimage.label(ndimage.binary_dilation(where, SQUARE), SQUARE)
    found = []
    for number, (rows, columns) in enumerate(ndimage.find_objects(parts), start=1):
        rows = slice(max(rows.start - reach, 0), min(rows.stop + reach, height))
        columns = slice(max(columns.start - reach, 0), min(columns.stop + reach, width))
        own = where[rows, columns] & (parts[rows, columns] == number)
        off = gap[rows, columns][own]
        if off.sum() >= model.least:
            found.append(Area(rows, columns, own, float((off**2).sum())))
    return sorted(found, key=lambda area: -area.weight)


def _unlike(picture: Picture, painted: np.ndarray, rough: np.ndarray) -> np.ndarray:
    """(H, W) bool: of the rough pixels (H, W) bool those that no colour drawn near them explains, and those drawn in a
    colour that the picture does not have near them.
    """
    out, place = np.zeros(rough.shape, dtype=bool), np.nonzero(rough)
    if not len(place[0]):
        return out
    seen, drawn, model = picture.seen, painted @ LUMA_CHROMA, picture.model
    reach = 1 + math.ceil(model.blur)
    for one, other in ((seen, drawn), (drawn, seen)):
        off = _beyond(one, other, place, reach, model.seam)
        at = np.nonzero(largest(np.abs(off)) > OWN * UNLIKE)
        if not len(at[0]):
            continue
        own, padded = off[at], np.pad(off, ((SIDE // 2,) * 2, (SIDE // 2,) * 2, (0, 0)))
        allowed = UNLIKE + NOISY * model.noise / SIDE**0.5 + picture.ringing[at]
        for offsets in STENCILS:
            mean = sum(padded[at[0] + dy, at[1] + dx] for dy, dx in offsets) / len(offsets)
            out[at] |= ((np.abs(mean) > allowed) & (own * np.sign(mean) > OWN * np.abs(mean))).any(axis=1)
    return out


def _beyond(one: np.ndarray, other: np.ndarray, place: tuple[np.ndarray, ...], reach: int, seam: float) -> np.ndarray:
    """(H, W, 4) by how much a picture is, at some rows and columns (n,), outside of the colours that another one has
    within `reach` px; by so much less where that has an edge, beneath which other shapes may end.
    """
    low, high = _range(other, place, reach)
    slack = np.where(largest(high - low) > UNLIKE, seam, 0.0)[:, None]
    off = np.zeros(one.shape)
    off[place] = one[place] - np.clip(one[place], low - slack, high + slack)
    return off


def _range(values: np.ndarray, place: tuple[np.ndarray, ...], reach: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 4) the least and the greatest values of a picture (H, W, 4) within `reach` px of rows and columns (n,)."""
    padded = np.pad(values, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    low = np.full((len(place[0]), values.shape[2]), np.inf)
    high = -low
    for dy in range(2 * reach + 1):
        for dx in range(2 * reach + 1):
            beside = padded[place[0] + dy, place[1] + dx]
            low, high = np.minimum(low, beside), np.maximum(high, beside)
    return low, high


def _ringing(seen: np.ndarray, model: ErrorModel) -> np.ndarray:
    """(H, W, 4) levels by which a JPEG's edges are off in a picture (H, W, 4) in luma and chroma; else 0."""
    out = np.zeros(seen.shape, dtype=np.float32)
    for block, channels in BLOCKS if model.jpeg else ():
        window, values = (2 * block + 1, 2 * block + 1, 1), seen[..., channels]
        spread = ndimage.maximum_filter(values, window) - ndimage.minimum_filter(values, window)
        out[..., channels] = RINGING * spread
    return out
