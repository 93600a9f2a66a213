"""Lines too thin to show their fill: every pixel of one is a blend of it with the fills beside it.

These pixels are no blends of the fills around them alone, but of those and another fill of the picture, which is the
same all along the line.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.regions.fills import ALIKE, CONTACT, LONG, MOST_SMALL, OPAQUE, SAME, SEEN
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import REACH, best_blend, blend_with, fills_of_lines, near_fills, off_palette

CLOSE = 10.0  # levels, the residual of a blend with the fill of a line
MOST_SEEN = 32  # fills, the commonest, of which lines are sought; with more, those that no pixel shows pure are not
WINDOW = 7  # px around a pixel in which a line keeps its fill
# A pixel belongs to a line that covers half of it, or a share of LESS if its neighbours on either side have less.
# Where two shapes share a pixel, up to a quarter of their ground shows through, which is no line.
LESS = 0.3
MOST_RESIDUAL = 40.0  # levels of a pixel's residual that count against a fill at most; of a pixel that no fill explains
LATER = 0.1  # levels by which each fill must explain a line better than commoner ones
NONE, NOWHERE = np.zeros((0, 4)), -1e4  # no fill, and a level that no colour has
Place = tuple[np.ndarray, np.ndarray]  # rows and columns (n,) of pixels


def missing_fills(
    levels: np.ndarray, place: Place, beside: np.ndarray, step: float = 1.0, close: float = CLOSE
) -> np.ndarray:
    """Return (k, 4) the fills of lines that the palette lacks: common colours of the unexplained pixels of a place in a
    picture (H, W, 4), of which the others nearby are blends with the fills beside them (n, 4).

    step: levels within which pixels are of one colour; close: levels by which blends are off."""
    found, values = list[np.ndarray](), levels[place]
    left, steps = np.ones(len(values), dtype=bool), np.rint(values / step)
    while len(found) < MOST_SMALL and left.sum() >= LONG:
        colours, index, counts = np.unique(steps[left], axis=0, return_inverse=True, return_counts=True)
        far = np.zeros(len(colours))
        np.maximum.at(far, index.reshape(-1), largest(np.abs(values[left] - beside[left])))
        common = (counts >= LONG) & (step * (colours[:, 3] + 0.5) > OPAQUE)
        if not common.any():
            break
        own = (steps == colours[int(np.where(common, far, -1.0).argmax())]).all(axis=1)
        fill, shown = np.median(values[own], axis=0), np.zeros(levels.shape[:2], np.uint8)
        found.append(fill)
        shown[place[0][own], place[1][own]] = 1
        near = ndimage.maximum_filter(shown, 2 * WINDOW + 1)[place] > 0
        at = np.flatnonzero(left & near)
        left[at[blend_with(values[at], fill, beside[at], beside[at])[1] <= close]] = False
        left[largest(np.abs(values - fill)) <= max(step, SAME)] = False
    return np.array(found).reshape(-1, 4)


def nearest_line_fills(
    levels: np.ndarray,
    place: Place,
    palette: np.ndarray,
    near: np.ndarray,
    standing: np.ndarray,
    close: float = CLOSE,
    less: float = LESS,
    window: int = WINDOW,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the fill (n,) of the line to which each unexplained pixel of a place in a picture (H, W, 4) belongs, -1
    for none; and (n,) bool: True if the pixel is mostly the line's, or lies on its middle.

    standing: (G, 4) fills that no line has. close: levels of a line's residual. less: share from which a pixel on the
    middle belongs to the line. window: px in which a line keeps its fill.
    """
    first = palette[near[:, 0]]
    second = palette[np.where(near[:, 1] >= 0, near[:, 1], near[:, 0])]
    # A pale line is a blend of any darker fill: of those it is the palest.
    fills, costs = without(palette, standing)[:MOST_SEEN], (MOST_RESIDUAL, SEEN, LATER)
    fill, share, gap = fills_of_lines(levels[place], place, fills, (first, second), window, costs)
    fill = np.where(gap <= close, fill, -1)
    shares = np.zeros(levels.shape[:2])
    shares[place] = np.where(fill >= 0, share, 0.0)
    return fill, (fill >= 0) & ((share >= 0.5) | ((share >= less) & _ridge(shares, place)))


def _ridge(shares: np.ndarray, place: Place) -> np.ndarray:
    """(n,) bool: pixels of shares (H, W) with no more on either side, and less than half within two px of one."""
    padded, share, out = np.pad(shares, 2), shares[place], np.zeros(len(place[0]), dtype=bool)
    for dy, dx in ((0, 1), (1, 0)):
        beside = [padded[place[0] + 2 + k * dy, place[1] + 2 + k * dx] for k in (-2, -1, 1, 2)]
        least = np.maximum(np.minimum(beside[0], beside[1]), np.minimum(beside[2], beside[3]))
        out |= (np.maximum(beside[1], beside[2]) <= share + 0.05) & (least < 0.5 * share)
    return out


def stands(palette: np.ndarray, standing: np.ndarray) -> np.ndarray:
    """Return (P,) bool: the fills of a palette (P, 4) that are placeholders for gradients, (G, 4)."""
    return np.asarray((np.abs(palette[:, None] - standing) < ALIKE).all(axis=2).any(axis=1))


def without(palette: np.ndarray, standing: np.ndarray) -> np.ndarray:
    """Return a palette (P, 4) with its placeholders for gradients, (G, 4), moved far from all colours."""
    return np.where(stands(palette, standing)[:, None], NOWHERE, palette)


def with_lines(
    levels: np.ndarray, palette: np.ndarray, labels: np.ndarray, off: float, less: float, standing: np.ndarray = NONE
) -> np.ndarray:
    """Return (H, W) int32 the labels of a picture (H, W, 4) with the thin lines that they lack.

    A line is a run of CONTACT px or more that the labels do not explain, with the pixels that are thin already.
    palette: (P, 4) the colours of the labels. off: levels beyond which the labels within a px do not explain a pixel.
    less: share from which a pixel on the middle of a line belongs to it. standing: (G, 4) colours that no line has.
    """
    solid = solid_labels(labels)
    away = np.zeros(labels.shape, dtype=bool)
    inner = (slice(1, -1), slice(1, -1))  # pixels on the rim blend with what is beyond the canvas
    away[inner] = off_palette(levels, palette, labels)[inner] > off
    y, x = np.nonzero(away)
    far = away.copy()
    far[y, x] = best_blend(levels[y, x], palette, near_fills(labels, y, x, 1))[1] > off
    seen = ndimage.binary_dilation(far | (solid < 0), ndimage.SQUARE)
    y, x = np.nonzero(long_parts(seen, seen) & (away | (solid < 0)))
    near = near_fills(solid, y, x, REACH)
    y, x, near = (each[near[:, 0] >= 0] for each in (y, x, near))
    if not len(y):
        return labels
    fill, own = nearest_line_fills(levels, (y, x), palette, near, standing, max(CLOSE, off), less, 3 * CONTACT)
    # Pixels beside an area of the line's colour are its edge.
    own &= ~(near_fills(solid, y, x, 1) == fill[:, None]).any(axis=1)
    out = labels.copy()
    out[y[own], x[own]] = fill[own]
    new = long_parts((solid < 0) | (out != labels), out != labels)
    return np.where(new, out, labels)


def long_parts(where: np.ndarray, some: np.ndarray, least: int = CONTACT) -> np.ndarray:
    """Return (H, W) bool: the connected parts of `where` that are `least` px long and have a pixel of `some` of it."""
    parts, count = ndimage.label(where, ndimage.SQUARE)
    long = np.zeros(count + 1, dtype=bool)
    long[1:] = [max(s.stop - s.start for s in box) >= least for box in ndimage.find_objects(parts)]
    return (long & (np.bincount(parts[some], minlength=count + 1) > 0))[parts]


def solid_labels(labels: np.ndarray) -> np.ndarray:
    """Return (H, W) the labels of pixels that belong to 3 x 3 px of one label, else -1."""
    return ndimage.maximum_filter(np.where(ndimage.alike(labels, 3), labels, -1), 3)
