"""The fills of a flat picture, from the interiors of its regions only: edges hold blends.

Pictures are (H, W, 4) float32 premultiplied RGBA in levels of 0..255.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.settings import MOST_COLORS
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import nearest_paints
from cubicsplat_cli.raster.unmix import REACH, SLOTS, joined_fills, part_fills, spread

# Thresholds of colour in levels, the finest first, with which the whole artwork style tells colours apart.
ALIKE = 0.5  # numbers of one fill differ by less
EVEN = 1.0  # 8-bit pixels of one colour differ by no more, since each is rounded
ROUNDED = 1.6  # colours are off a straight line by no more, from the arithmetic and the rounding of drawing programs
PURE = 2.5  # a pixel this near to a fill is that fill
FLAT_RANGE = 3.0  # a pixel whose 3x3 neighbourhood spans no more is flat
SAME = 3.5  # fills nearer than this are one
SEEN = 8.0  # half of one of 4 x 4 samples a pixel at full contrast; a smaller difference may be a blend of the others
BLEND = 12.0  # levels by which a blend may be off the line between two fills; flat parts that span more are gradients
APART = 24.0  # colours farther apart than this are surely two; the bands in which gradients are drawn
# Levels of opacity up to which nothing is seen, and from which a fill hides what is beneath it.
CLEAR, OPAQUE = 1.0, 254.0
LEAST_FLAT = 0.02  # share of the pixels, below which a picture has no interiors
TOGETHER = 3  # squares of 2 x 2 px, or doubtful pixel lines, that show a fill together
LONG = 24  # px of lines too thin for a flat pixel that show a fill; px of the corner of a frame between its sides
CONTACT = 8  # px along which areas touch, or a line is missing, for that to count
MOST_SMALL = 16  # fills that only small squares, only pixel lines, only thin lines or only blends show
MOST_PALETTE = 64  # fills, beyond which a picture has gradients and textures rather than lines in more fills


def flat_pixels(levels: np.ndarray, limit: float = FLAT_RANGE) -> np.ndarray:
    """(H, W) bool: the 3x3 neighbourhood spans at most `limit` levels in every channel."""
    return spread(levels, 3, 3) <= limit


def in_squares(squares: np.ndarray) -> np.ndarray:
    """(H, W) bool: the pixels of squares of 2 x 2 px, (H - 1, W - 1) bool by their first pixels."""
    return ndimage.maximum_filter(np.pad(squares, (0, 1)), 2)


def in_even_squares(levels: np.ndarray) -> np.ndarray:
    """(H, W) bool: in a square of 2 x 2 px of one colour, of a picture (H, W, C)."""
    even = np.ones((len(levels) - 1, levels.shape[1] - 1), dtype=bool)
    for channel in np.moveaxis(levels, -1, 0):  # in turn, since copies of a large picture are large
        even &= ndimage.ranges(channel, 2)[1:, 1:] <= EVEN
    return in_squares(even)


def near_colours(levels: np.ndarray, shown: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of n pixels (H, W) bool the different colours nearby, of those shown, (H, W) bool, in a picture (H, W, C): as of
    `nearest_paints`, (n, SLOTS), and in levels, (n, SLOTS, C). Colours in one cell of 8 levels are one.
    """
    cells = np.rint(levels[..., :3] / 8.0).astype(np.int32) @ np.array([1, 64, 4096], np.int32)
    near, places = nearest_paints(np.where(shown, cells, -1), np.flatnonzero(pixels), REACH, SLOTS)
    return near, levels.reshape(-1, levels.shape[2])[places]


def has_square(pure: np.ndarray) -> np.ndarray:
    """(H, W) bool: belongs to a 2x2 square of one fill."""
    return in_squares(ndimage.alike(pure, 2)[1:, 1:]) & (pure >= 0)


def picture_fills(levels: np.ndarray) -> np.ndarray:
    """(P, 4) float64 the fills of the flat interiors in levels, the commonest first.

    A picture without flat interiors (noise, a photo) gives the bands of its smoothed colours.
    """
    flat = flat_pixels(levels)
    if flat.mean() < LEAST_FLAT:
        smooth = ndimage.uniform_filter(levels, (5, 5, 1), mode="nearest")
        return _limited(*part_fills(smooth, np.ones(flat.shape, np.int32), -1.0, APART))
    fills, weights = part_fills(levels, ndimage.label(flat)[0], BLEND, APART)
    colours, sizes = _small_fills(levels, flat)
    fills, weights = np.concatenate([fills, colours]), np.concatenate([weights, sizes])
    clear = np.count_nonzero(levels[..., 3] <= CLEAR)
    if clear and not (fills[:, 3] <= CLEAR).any():
        # No blend has no opacity: one such pixel in a corner shows that the ground is clear.
        fills, weights = np.vstack([fills, np.zeros(4)]), np.append(weights, clear)
    return _limited(fills, weights)


def _small_fills(levels: np.ndarray, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fills (k, 4) of shapes too small for a flat pixel (H, W) bool, and their px (k,): blends on edges hardly ever
    fill a square of 2 x 2 px with one colour.
    """
    y, x = np.nonzero(~ndimage.maximum_filter(flat, 4)[1:, 1:])  # squares with no flat pixel in or beside them
    corners = np.stack([levels[y + dy, x + dx] for dy in (0, 1) for dx in (0, 1)])
    even = largest(np.ptp(corners, axis=0)) <= EVEN
    colours, counts = np.unique(np.rint(corners[0][even]), axis=0, return_counts=True)
    common = np.argsort(-counts, kind="stable")[:MOST_SMALL]
    common = common[counts[common] >= TOGETHER]
    return colours[common].astype(float), counts[common].astype(float)


def _limited(fills: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Near fills joined to the commoner one; then the commonest."""
    kept, sizes = commoner_fills(fills, weights, SAME, 2 * MOST_COLORS)
    return kept[np.argsort(-sizes, kind="stable")[:MOST_COLORS]]


def commoner_fills(fills: np.ndarray, weights: np.ndarray, same: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """As `joined_fills`, each with the nearest commoner one."""
    order = np.argsort(-weights, kind="stable")
    return joined_fills(fills[order], weights[order], same, most)


def eight_bit(fill: np.ndarray) -> tuple[int, int, int, int]:
    """A fill in levels, premultiplied, as the 8-bit colour and opacity that a file holds."""
    alpha = int(np.clip(round(float(fill[3])), 0, 255))
    if alpha == 0:
        return (0, 0, 0, 0)
    r, g, b = (int(np.clip(round(float(v) * 255.0 / float(fill[3])), 0, 255)) for v in fill[:3])
    return (r, g, b, alpha)
