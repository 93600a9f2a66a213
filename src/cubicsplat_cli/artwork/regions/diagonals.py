"""Slanting thin lines kept in one piece: pixels of one fill that only touch at a corner are joined through a third.

Regions connect along the sides of pixels, so that a line of a pixel or two falls apart wherever its pixels meet at
corners only. The third pixel is the one of the two beside the corner that has the more of the line's fill in it.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of
from cubicsplat_cli.artwork.regions.fills import has_square

# Share of the line's fill in the pixel that joins, over those in the two that meet: a line of one px across has a
# quarter at the corners, one half as wide a quarter of that.
LEAST_SHARE = 0.15
WHOLE = 0.98  # share from which a pixel is the line's alone
REACH = 3  # px to each side of the pixel, in which a line has at most half of the pixels, and less than what it cuts
PASSES = 3


def joined_at_corners(fills: np.ndarray, levels: np.ndarray, palette: np.ndarray, *, whole: bool = False) -> np.ndarray:
    """(H, W) the fills of the pixels of a picture (H, W, 4), levels, with the diagonals of thin lines joined.

    fills: (H, W) indices into the palette (P, 4), levels. whole: of lines a px across with anti-aliasing
    alone, not of what may be a seam between shapes.
    """
    fills = fills.copy()
    for _ in range(PASSES):
        y, x, own = _corners(fills)
        ends = palette[fills[y, x]], palette[own][:, None]
        share, _ = blend_of(levels[y, x], *ends, within=False)
        meeting = [blend_of(levels[y[:, k], x[:, 1 - k]][:, None], *ends, within=False)[0] for k in (0, 1)]
        at, best = np.arange(len(y)), share.argmax(axis=1)
        both = np.ones(share.shape) if whole else np.clip(meeting[0] * meeting[1], 0.0, 1.0)
        good = (share >= LEAST_SHARE * both)[at, best]
        if not whole:
            # Lines without anti-aliasing, a px across: two pixels have all, and the others nothing, of the line.
            thick = has_square(fills)
            thin = ~thick[y[:, 0], x[:, 1]] & ~thick[y[:, 1], x[:, 0]]
            good |= (both.min(axis=1) >= WHOLE) & (np.abs(share) <= 1.0 - WHOLE).all(axis=1) & thin
        y, x = y[at, best], x[at, best]
        good[good] = _thin(fills, own[good], y[good], x[good])
        if not good.any():
            break
        fills[y[good], x[good]] = own[good]
    return fills


def _corners(fills: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners at which alone two pixels of one fill meet: rows (n, 2) and columns (n, 2) of the two others there, and
    the fill (n,).
    """
    a, b, c, d = fills[:-1, :-1], fills[:-1, 1:], fills[1:, :-1], fills[1:, 1:]
    falling = np.argwhere((a == d) & (a != b) & (a != c))
    rising = np.argwhere((b == c) & (b != a) & (b != d))
    y = np.concatenate([falling[:, :1] + [0, 1], rising[:, :1] + [0, 1]])
    x = np.concatenate([falling[:, 1:] + [1, 0], rising[:, 1:] + [0, 1]])
    return y, x, np.concatenate([a[tuple(falling.T)], b[tuple(rising.T)]])


def _thin(fills: np.ndarray, own: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n,) bool: around the pixels y, x a fill is thin, and thinner than theirs."""
    padded, side, theirs = np.pad(fills, REACH, constant_values=-1), 2 * REACH + 1, fills[y, x]
    mine, others = np.zeros((2, len(y)), dtype=int)
    for dy, dx in np.ndindex(side, side):  # a pass for each, since dither has as many corners as pixels
        found = padded[y + dy, x + dx]
        mine += found == own
        others += found == theirs
    return (2 * mine <= side * side) & (mine < others)
