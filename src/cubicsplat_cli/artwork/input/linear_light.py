"""Pictures whose edges were blended in linear light, as they are when they are blended as SVG viewers blend them.

Colours are mixed as their sRGB values, or, in games, films and some browsers, as the light that these stand for: then
the pixels of an edge are lighter than what they are taken for, and a shape of light colour seems up to a quarter of a
pixel too wide. Along a straight edge the place grows evenly from one column to the next, and pixels lie on the line
between two colours, in the space in which they were blended only.

Where a drawing begins a fraction of a pixel within the picture's border, what lies beneath each shape shines through
along that with the same share, whatever the colours of both.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest, light_of_srgb
from cubicsplat_cli.artwork.input.condition import CONTRAST
from cubicsplat_cli.artwork.regions.hidden_fills import BLEND
from cubicsplat_cli.artwork.regions.sampling import FEWEST, MOST
from cubicsplat_cli.raster.shades import blends, nearest_paints
from cubicsplat_cli.raster.unmix import REACH, SLOTS

# Edges that tell: px by which the places differ between three columns, and between the two spaces, at least; in rows of
# how many px in all they are looked at each way.
DIFFERENT, LOOKED_AT = 0.1, 2**20
# Px by which a place may be off at most, which corners are; times the squares in linear light that those in sRGB are:
# 2.2 and more in pictures blended there, even with 4 x 4 samples a pixel, else at most 1.1.
CORNER, BETTER = 0.2, 1.4
EVEN = 2.0  # levels by which the pixels of a square of 2 x 2 px in one colour may differ
CELL = 8.0  # levels that are one colour near a blend
# Of what shines through along a rim, levels by which two pixels are one colour, and by which blends are off that were
# rounded once for each layer.
RIM_EVEN, RIM_OFF = 1.0, 2.0
RIM_FEWEST, MOST_COLOURS = 16, 32  # px of a border that show a colour, and colours that it may have
EXPLAINED = 0.95  # of a border's pixels, those that one share explains
MOST_BENEATH = 0.5  # the share that is left to what is beneath: the drawing begins in the outer half of the pixels


def without_linear_light(levels: np.ndarray) -> np.ndarray:
    """A picture (H, W, 4) in levels with its edges blended as sRGB values; the same array where they are already, or it
    is not opaque, or has too few edges to tell.
    """
    if min(levels.shape[:2]) < 4 or (levels[..., 3] < 255.0).any() or not _blended_in_light(levels[..., :3]):
        return levels
    colours = levels[..., :3]
    blended = ~_pure(colours)
    cells = np.rint(colours / CELL).astype(np.int32) @ np.array([1, 64, 4096], np.int32)
    near, places = nearest_paints(np.where(blended, -1, cells), np.flatnonzero(blended), REACH, SLOTS)
    values, ends = levels[blended], levels.reshape(-1, 4)[places]
    again, off = blends(light_of(values), near, light_of(ends), ends, three=True)
    out = levels.copy()
    out[blended] = np.where((off <= BLEND)[:, None], np.rint(again), values)
    return out


def light_of(values: np.ndarray) -> np.ndarray:
    """The linear light of sRGB values, both in 0..255."""
    return 255.0 * light_of_srgb(np.asarray(values, np.float64) / 255.0)


def levels_of(light: np.ndarray) -> np.ndarray:
    """The sRGB values of linear light, both in 0..255: the inverse of `light_of`."""
    light = np.clip(light / 255.0, 0.0, 1.0)
    return 255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)


def _blended_in_light(colours: np.ndarray) -> bool:
    """True if the edges of a picture (H, W, 3) are straighter, and their colours nearer to blends, in linear light."""
    parts = [_steps(c) for c in (colours, colours.swapaxes(0, 1))]
    found = np.concatenate([part[:: 1 + len(part) // MOST] for part in parts]).astype(np.float64)
    (places, off), (in_light, off_in_light) = _places(found), _places(light_of(found))
    telling = (np.ptp(places, axis=1) > DIFFERENT) & (np.abs(places - in_light).max(axis=1) > DIFFERENT)
    if telling.sum() < FEWEST:
        return False
    squares, squares_in_light = (np.minimum(each, CORNER**2)[telling].mean() for each in (off, off_in_light))
    return bool(squares > BETTER * squares_in_light)


def _steps(colours: np.ndarray) -> np.ndarray:
    """(n, 4, 3, 3) pieces of a picture (H, W, 3), of 4 rows and 3 columns, whose first and last row each have one
    colour, with an edge between them.
    """
    tops = np.arange(0, len(colours) - 3, 1 + colours[..., 0].size // LOOKED_AT)
    upper, lower = colours[tops], colours[tops + 3]
    contrast = largest(np.abs(lower[:, 1:-1] - upper[:, 1:-1]))
    y, x = np.nonzero(_alike(upper) & _alike(lower) & (contrast > CONTRAST))
    return colours[tops[y, None, None] + np.arange(4)[:, None], x[:, None, None] + np.arange(3)]


def _alike(colours: np.ndarray) -> np.ndarray:
    """(H, W - 2) bool: the three pixels in a row of (H, W, 3) that have one colour."""
    steps = largest(np.abs(np.diff(colours, axis=1)))
    return np.asarray((steps[:, :-1] == 0.0) & (steps[:, 1:] == 0.0))


def _places(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) px, the height of the edge in each column of some pieces (n, 4, 3, 3), and (n,) px^2 by which it is not
    straight and its pixels are no blends.
    """
    first, last = steps[:, :1, :1], steps[:, 3:, :1]
    share, rest = blend_of(steps, first, last, most=None)
    rest = rest / np.linalg.norm(last - first, axis=-1)[..., None]
    place = share[:, 1:3].sum(axis=1)
    bend = place[:, 0] - 2.0 * place[:, 1] + place[:, 2]
    return place, bend**2 + (rest[:, 1:3] ** 2).sum(axis=-1).max(axis=(1, 2))


def _pure(colours: np.ndarray) -> np.ndarray:
    """(H, W) bool: the pixels of a picture (H, W, 3) in some square of 2 x 2 px of about one colour."""
    corners = [colours[y : len(colours) - 1 + y, x : colours.shape[1] - 1 + x] for y in (0, 1) for x in (0, 1)]
    even = largest(np.maximum.reduce(corners) - np.minimum.reduce(corners)) <= EVEN
    padded = np.pad(even, 1)
    return padded[:-1, :-1] | padded[1:, :-1] | padded[:-1, 1:] | padded[1:, 1:]


def without_rim(levels: np.ndarray, *, in_light: bool) -> np.ndarray:
    """A picture (H, W, 4) in levels with its drawing continued to the border on all sides; the same array where it ends
    there already, or is not opaque. in_light: whether its edges were blended in linear light.
    """
    if min(levels.shape[:2]) < RIM_FEWEST or (levels[..., 3] < 255.0).any():
        return levels
    out = levels
    for turns in range(4):
        rows = np.rot90(levels, turns)[:3, :, :3].astype(np.float64)
        own = _shone_through(rows, in_light)
        if own.any():
            out = levels.copy() if out is levels else out
            np.rot90(out, turns)[0, own, :3] = rows[1, own]
    return out


def _shone_through(rows: np.ndarray, in_light: bool) -> np.ndarray:
    """(W,) bool: the pixels of the first of three rows (3, W, 3) that have one and the same share of other colours than
    the next two rows have; none where fewer than two colours show that, since one might be that of a line.
    """
    even = largest(np.abs(rows[1] - rows[2])) <= RIM_EVEN
    inner, index, counts = np.unique(np.rint(rows[1, even]), axis=0, return_inverse=True, return_counts=True)
    shown = np.flatnonzero(counts >= RIM_FEWEST)
    none = np.zeros(rows.shape[1], dtype=bool)
    if not 2 <= len(shown) <= MOST_COLOURS or 2 * even.sum() < len(even):
        return none
    index, inner, counts = index.reshape(-1), inner[shown], counts[shown]
    outer = np.array([np.median(rows[0, even][index == k], axis=0) for k in shown])
    differs = largest(np.abs(outer - inner)) > RIM_OFF
    # Of white the ground, a page, tells nothing.
    shows = differs | (inner >= 255.0).all(axis=1)
    if differs.sum() < 2 or counts.sum() < EXPLAINED * even.sum():
        return none
    if ((_explained(inner, outer, in_light) & shows) @ counts).max() < EXPLAINED * counts.sum():
        return none
    none[even] = np.isin(index, shown[differs])
    return none


def _explained(inner: np.ndarray, outer: np.ndarray, in_light: bool) -> np.ndarray:
    """(T, K) bool: whether blends of colours inner (K, 3) with what another shape shows, or the white of a page, are
    `outer` (K, 3), for each of the shares that some of these would have.
    """
    beneath = np.concatenate([inner, outer, np.full((1, 3), 255.0)])
    start, end, ends = (light_of(v) if in_light else v for v in (inner, outer, beneath))
    span = ends - start[:, None]
    square = np.maximum((span * span).sum(axis=-1), 1e-9)
    shares = (((end - start)[:, None] * span).sum(axis=-1) / square).ravel()
    shares = np.append(shares[(shares > 0.0) & (shares <= MOST_BENEATH)], 0.0)
    blends = start[:, None] + shares[:, None, None, None] * span
    blends = levels_of(blends) if in_light else blends
    known = largest(np.abs(blends - outer[:, None])) <= RIM_OFF
    return np.asarray(known.any(axis=-1))
