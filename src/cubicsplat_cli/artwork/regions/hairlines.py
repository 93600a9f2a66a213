"""Lines too thin to show their fill anywhere near: every pixel of one is a blend of it with what lies beside it.

Such pixels are no blend of the fills around them, but they are one of those with some other fill of the picture, all
along the line the same one.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.regions.fills import ALIKE, OPAQUE
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import (
    REACH,
    STRANGE,
    best_blend,
    blend_with,
    fills_of_lines,
    near_fills,
    off_palette,
    residual_of_three,
)

# Residual, in levels, of a blend that the fill of a line must explain; lines are sought with so many commonest fills.
CLOSE, MOST_FILLS = 10.0, 32
WINDOW = 7  # px around a pixel in which a line keeps its fill
# A pixel is a line's by half of it, or by LESS where its neighbours to either side have less of it.
# Where two shapes share a pixel up to a quarter of what is beneath shows through, which is no line.
LESS = 0.3
# A fill that no flat pixel has is that of LEAST_PIXELS pixels and more, of such fills at most MOST_NEW are taken.
LEAST_PIXELS, MOST_NEW = 24, 8
# Levels beyond which a pixel that a fill does not explain counts no more against it, and by which each fill must
# explain a line better than commoner ones.
MOST_RESIDUAL, LATER = 40.0, 0.1
LENGTH = 8  # px along which pixels hang together that the labels do not explain, for a line to be there
NONE, NOWHERE = np.zeros((0, 4)), -1e4  # no fill, and a level that no colour has
FAINT = 8.0  # levels by which a fill must explain a line better, of which it would have hardly anything


def unexplained(values: np.ndarray, palette: np.ndarray, near: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """(n,) bool: values (n, 4) that are no blend of two, nor of three, of the fills near them (n, slots)."""
    strange = residual > STRANGE
    strange[strange] = residual_of_three(values[strange], palette, near[strange]) > CLOSE
    return strange


def missing_fills(values: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """(k, 4) fills of lines, that the palette lacks: common colours among strange values (n, 4), of which the others
    are blends with the fill beside them (n, 4).
    """
    found: list[np.ndarray] = []
    left = np.ones(len(values), dtype=bool)
    while len(found) < MOST_NEW and left.sum() >= LEAST_PIXELS:
        colours, index, counts = np.unique(np.rint(values[left]), axis=0, return_inverse=True, return_counts=True)
        far = np.zeros(len(colours))
        np.maximum.at(far, index.reshape(-1), np.abs(values[left] - beside[left]).max(axis=1))
        common = (counts >= LEAST_PIXELS) & (colours[:, 3] >= OPAQUE)
        if not common.any():
            break
        fill = colours[int(np.where(common, far, -1.0).argmax())]
        found.append(fill)
        own = np.flatnonzero(left)
        left[own[blend_with(values[own], fill, beside[own], beside[own])[1] <= CLOSE]] = False
        left[own[(np.rint(values[own]) == fill).all(axis=1)]] = False
    return np.array(found).reshape(-1, 4)


def nearest_line_fills(
    values: np.ndarray,
    place: tuple[np.ndarray, np.ndarray],
    size: tuple[int, ...],
    palette: np.ndarray,
    near: np.ndarray,
    standing: np.ndarray,
    close: float = CLOSE,
    less: float = LESS,
    window: int = WINDOW,
    faint: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) the fill of the line that each strange value (n, 4), at rows and columns (n,), belongs to, -1 for none; and
    whether it is mostly or by its place the line's (n,).

    standing: (G, 4) fills that no line has. close: levels by which the pixels of a line are off. less: share from which
    a pixel on its middle is the line's. window: px in which it keeps its fill. faint: levels that it costs a fill to
    have no share in its pixels.
    """
    first = palette[near[:, 0]]
    second = palette[np.where(near[:, 1] >= 0, near[:, 1], near[:, 0])]
    costs = (MOST_RESIDUAL, faint, LATER)
    fill, share, gap = fills_of_lines(
        values, place, without(palette, standing)[:MOST_FILLS], (first, second), window, costs
    )
    fill = np.where(gap <= close, fill, -1)
    shares = np.zeros(size)
    shares[place] = np.where(fill >= 0, share, 0.0)
    return fill, (fill >= 0) & ((share >= 0.5) | ((share >= less) & _ridge(shares, place)))


def _ridge(shares: np.ndarray, place: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(n,) bool, of pixels at rows and columns (n,) of shares (H, W): no neighbour to either side has more, and of
    those up to two px away one has less than half.
    """
    padded, own, out = np.pad(shares, 2), shares[place], np.zeros(len(place[0]), dtype=bool)
    for dy, dx in ((0, 1), (1, 0)):
        beside = [padded[place[0] + 2 + k * dy, place[1] + 2 + k * dx] for k in (-2, -1, 1, 2)]
        least = np.maximum(np.minimum(beside[0], beside[1]), np.minimum(beside[2], beside[3]))
        out |= (np.maximum(beside[1], beside[2]) <= own + 0.05) & (least < 0.5 * own)
    return out


def without(palette: np.ndarray, standing: np.ndarray) -> np.ndarray:
    """A palette (P, 4) with those of its fills that stand for gradients, (G, 4), far from all colours."""
    stands = (np.abs(palette[:, None] - standing) < ALIKE).all(axis=2).any(axis=1)
    return np.where(stands[:, None], NOWHERE, palette)


def with_lines(
    levels: np.ndarray,
    palette: np.ndarray,
    labels: np.ndarray,
    off: float,
    less: float,
    standing: np.ndarray = NONE,
) -> np.ndarray:
    """(H, W) int32 the labels of a picture (H, W, 4) with those of the thin lines that they lack.

    palette: (P, 4) the colours of the labels. off: levels beyond which the labels within a px do not explain a pixel.
    less: the share from which a pixel on the middle of a line is the line's. A line is what they do not explain along
    LENGTH px, together with what is thin already. standing: (G, 4) colours that no line has.
    """
    solid = solid_labels(labels)
    away = np.zeros(labels.shape, dtype=bool)
    inner = (slice(1, -1), slice(1, -1))  # pixels on the rim blend with what is beyond the canvas
    away[inner] = off_palette(levels, palette, labels)[inner] > off
    y, x = np.nonzero(away)
    far = away.copy()
    far[y, x] = best_blend(levels[y, x], palette, near_fills(labels, y, x, 1))[1] > off
    seen = ndimage.binary_dilation(far | (solid < 0), ndimage.SQUARE)
    place = _long_parts(seen, seen) & (away | (solid < 0))
    y, x = np.nonzero(place)
    near = near_fills(solid, y, x, REACH)
    y, x, near = (each[near[:, 0] >= 0] for each in (y, x, near))
    if not len(y):
        return labels
    search = standing, max(CLOSE, off), less, 3 * LENGTH, FAINT
    fill, own = nearest_line_fills(levels[y, x], (y, x), labels.shape, palette, near, *search)
    # What lies beside an area of the line's colour is its edge.
    own &= away[y, x] | (solid[y, x] < 0)
    own &= ~(near_fills(solid, y, x, 1) == fill[:, None]).any(axis=1)
    out = labels.copy()
    out[y[own], x[own]] = fill[own]
    new = _long_parts((solid < 0) | (out != labels), out != labels)
    return np.where(new, out, labels)


def _long_parts(where: np.ndarray, some: np.ndarray) -> np.ndarray:
    """(H, W) bool: the connected parts of `where` that have a pixel of `some` and go over LENGTH px."""
    parts, count = ndimage.label(where, ndimage.SQUARE)
    long = np.zeros(count + 1, dtype=bool)
    long[1:] = [max(s.stop - s.start for s in box) >= LENGTH for box in ndimage.find_objects(parts)]
    return (long & (np.bincount(parts[some & where], minlength=count + 1) > 0))[parts]


def solid_labels(labels: np.ndarray) -> np.ndarray:
    """(H, W) the labels of pixels that belong to 3 x 3 px of it, else -1."""
    middle = np.where(ndimage.alike(labels, 3) & (labels >= 0), labels, -1)
    return np.where(labels >= 0, ndimage.maximum_filter(middle, 3), -1)
