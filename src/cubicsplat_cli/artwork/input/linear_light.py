"""Convert edges that were blended in linear light to edges blended as sRGB values, as SVG viewers blend them.

In games, films and some browsers, colours are mixed as linear light. Taken for mixed sRGB values, the pixels of such an
edge are too light, and a light shape seems up to a quarter of a pixel too wide. Only in the space in which an edge was
blended do its pixels lie on the line between two colours, and does a straight edge advance evenly by columns.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import FULL, blend_of, largest, light_of_srgb
from cubicsplat_cli.artwork.regions.fills import BLEND, SAME, in_even_squares, near_colours
from cubicsplat_cli.artwork.regions.sampling import CONTRAST, EXAMINED, FEWEST
from cubicsplat_cli.raster.shades import blends

# px; edges are compared whose places differ by more between columns, and between both spaces.
DIFFERENT = 0.1


def without_linear_light(levels: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 4) in levels with its edges of opaque colours blended as sRGB values; the same array if
    they are already, or if too few edges tell.
    """
    if min(levels.shape[:2]) < 4 or not blended_in_light(levels):
        return levels
    opaque, even = levels[..., 3] == FULL, in_even_squares(levels[..., :3])
    blended = opaque & ~even
    near, ends = near_colours(levels, opaque & even, blended)
    values = levels[blended]
    again, off = blends(in_light(values), near, in_light(ends), ends, three=True)
    out = levels.copy()
    # Of near colours, as within a gradient, blends are alike in both, and rounding again would only add noise.
    moved = (off <= BLEND) & (largest(np.abs(again - values)) > SAME)
    out[blended] = np.where(moved[:, None], np.rint(again), values)
    return out


def in_light(values: np.ndarray) -> np.ndarray:
    """Return the linear light of sRGB values, both in 0..255."""
    return 255.0 * light_of_srgb(np.asarray(values, np.float64) / 255.0)


def blended_in_light(levels: np.ndarray) -> bool:
    """Return True if the edges of a picture (H, W, 4) are straighter, and their colours nearer to blends, in linear
    light: by 1.4 times in squares. It is 2.2 times and more in pictures blended there, even with 4 x 4 samples a pixel,
    and else at most 1.1. Deviations count up to 0.2 px, as those of corners. Of level edges, which are looked at last,
    only the colours tell: by 10 times, since they are up to 5 times nearer in JPEGs by chance.
    """
    parts = [_edges(lines) for lines in (levels, levels.swapaxes(0, 1))]
    edges = np.concatenate([part[:: 1 + len(part) // EXAMINED] for part in parts]).astype(np.float64)
    (places, off), (places_in_light, off_in_light) = _places(edges), _places(in_light(edges))
    differ = np.abs(places - places_in_light).max(axis=1) > DIFFERENT
    for telling, least in ((differ & (np.ptp(places, axis=1) > DIFFERENT), 1.4), (differ, 10.0)):
        squares, squares_in_light = (np.minimum(error, 0.2**2)[telling] for error in (off, off_in_light))
        if len(squares) >= FEWEST and squares.mean() > least * squares_in_light.mean():
            return True
    return False


def _edges(levels: np.ndarray) -> np.ndarray:
    """Return (n, 4, 3, 3) the colours of opaque pieces of a picture (H, W, 4), of 4 rows and 3 columns, with an edge
    between their first and last rows, which each have one colour. Of pictures above a megapixel some rows are examined.
    """
    tops = np.arange(0, len(levels) - 3, 1 + levels[..., 0].size // 2**20)
    upper, lower = levels[tops, :, :3], levels[tops + 3, :, :3]
    contrast = largest(np.abs(lower[:, 1:-1] - upper[:, 1:-1]))
    y, x = np.nonzero(_alike(upper) & _alike(lower) & (contrast > CONTRAST))
    pieces = levels[tops[y, None, None] + np.arange(4)[:, None], x[:, None, None] + np.arange(3)]
    return pieces[(pieces[..., 3] == FULL).all(axis=(1, 2)), ..., :3]


def _alike(colours: np.ndarray) -> np.ndarray:
    """Return (H, W - 2) bool: True for three pixels in a row of (H, W, 3) that have one colour."""
    steps = largest(np.abs(np.diff(colours, axis=1)))
    return (steps[:, :-1] == 0.0) & (steps[:, 1:] == 0.0)


def _places(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 3) px, the height of the edge in each column of pieces (n, 4, 3, 3); and (n,) px^2 by which it is not
    straight and its pixels are no blends.
    """
    first, last = edges[:, :1, :1], edges[:, 3:, :1]
    share, rest = blend_of(edges, first, last, most=None)
    rest = rest / np.linalg.norm(last - first, axis=-1)[..., None]
    place = share[:, 1:3].sum(axis=1)
    bend = place[:, 0] - 2.0 * place[:, 1] + place[:, 2]
    return place, bend**2 + (rest[:, 1:3] ** 2).sum(axis=-1).max(axis=(1, 2))
