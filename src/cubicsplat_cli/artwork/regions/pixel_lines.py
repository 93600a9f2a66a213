"""Lines of a pixel or so: level and upright ones exactly one px wide, and slanting ones kept in one piece.

The former are the frames and dividers of pages and programs. A pale one has a colour that a thinner dark line would
leave as well, so that its fill counts as a blend. But hardly any thinner line lies within one row of pixels.

Regions connect along the sides of pixels, so that slanting lines fall apart where their pixels meet at corners only.
They are joined by the pixel beside the corner that has more of the line's fill.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest
from cubicsplat_cli.artwork.regions.fills import ALIKE, LONG, MOST_SMALL, OPAQUE, PURE, SAME, SEEN, TOGETHER, has_square
from cubicsplat_cli.artwork.settings import MOST_COLORS
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import REACH, components, nearest_fills, seam_shares, steps
from cubicsplat_cli.record import record

SHORT = 5  # px of a pixel line whose fill longer ones show
MOST_GROUNDS = 4  # of one fill's pixel lines, and that may shine through seams besides nothing: the commonest
# Share of a line's fill in the pixel that joins, over its shares in the two pixels that meet: a line of one px across
# has a quarter at the corners, one half as wide a quarter of that, and one that Skia draws a tenth.
LEAST_SHARE = 0.09
WHOLE = 0.98  # share from which a pixel is the line's alone


@record
class _LineRuns:
    """Level or upright rows of pixels of one colour. y, x: (n, ) where they begin; length: (n,) px; upright: (n,) bool;
    colour, before, behind: (n, 4) levels of themselves and of the grounds on either side.
    """

    y: np.ndarray
    x: np.ndarray
    length: np.ndarray
    upright: np.ndarray
    colour: np.ndarray
    before: np.ndarray
    behind: np.ndarray

    def where(self, keep: np.ndarray) -> _LineRuns:
        return _LineRuns(*(each[keep] for each in vars(self).values()))


def with_pixel_lines(
    levels: np.ndarray, palette: np.ndarray, pure: np.ndarray, most: int | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The palette (P, 4) of a picture (H, W, 4) in levels with the fills of its pixel lines, at most `most` fills in
    all; the fill of every pixel that is one, (H, W) int32, -1 of others, with those of the pixel lines; and (H, W)
    bool, the pixels of these lines.
    """
    found = _runs(levels)
    # What blends the two sides may be an edge between them.
    told = largest(np.abs(blend_of(found.colour, found.before, found.behind)[1])) >= SEEN
    grounds = np.maximum(*(nearest_fills(each, palette)[1] for each in (found.before, found.behind)))
    found = found.where(told & (grounds <= SAME))
    out, fills, lined = pure.copy(), palette, np.zeros(pure.shape, dtype=bool)
    for colour in _colours(found, _doubtful(found, palette, pure)):
        gaps = largest(np.abs(fills - colour))
        if gaps.min() > ALIKE:
            if len(fills) >= min(most or MOST_COLORS, MOST_COLORS):
                continue
            fills, gaps = np.vstack([fills, colour]), np.append(gaps, 0.0)
        own = found.where(largest(np.abs(found.colour - colour)) <= ALIKE)
        on = np.zeros(out.shape, dtype=bool)
        for y, x, length, upright in zip(own.y, own.x, own.length, own.upright, strict=True):
            on[(slice(y, y + length), x) if upright else (y, slice(x, x + length))] = True
        on |= _corners(on, levels, pure, own) & (pure < 0)
        out[on & (pure < 0)] = gaps.argmin()
        lined |= on
    return fills, out, lined


def _corners(on: np.ndarray, levels: np.ndarray, pure: np.ndarray, own: _LineRuns) -> np.ndarray:
    """(H, W) bool: the pixels `on` pixel lines of one fill, and those that go on from them around corners: blends of it
    with a ground, of which it has most.
    """
    blends = np.zeros(on.shape, dtype=bool)
    y, x = np.nonzero(pure < 0)
    grounds, counts = np.unique(np.rint(np.concatenate([own.before, own.behind])), axis=0, return_counts=True)
    for ground in grounds[np.argsort(-counts, kind="stable")[:MOST_GROUNDS]]:
        share, rest = blend_of(levels[y, x], ground, own.colour[0])
        blends[y, x] |= (share >= 0.5) & (largest(np.abs(rest)) <= PURE)
    return ndimage.binary_dilation(on, ndimage.SQUARE, LONG, mask=blends | on)


def _doubtful(found: _LineRuns, palette: np.ndarray, pure: np.ndarray) -> np.ndarray:
    """(n,) bool: the pixel lines between two grounds that may be the edge of another line, of which a ground is the one
    px, or a seam of both: a fill shines through that somewhere shows over as many px, as it must lie beneath all of it.
    """
    out = np.zeros(len(found.length), dtype=bool)
    between = np.flatnonzero((largest(np.abs(found.before - found.behind)) > PURE) & (found.length >= LONG))
    if not len(between):
        return out
    own = found.where(between)
    middle, down = own.length // 2, ~own.upright
    y, x = own.y + middle * own.upright, own.x + middle * down
    for way in (-1, 1):
        near, far = (
            pure[(y + reach * down).clip(0, len(pure) - 1), (x + reach * own.upright).clip(0, pure.shape[1] - 1)]
            for reach in (way, 2 * way)
        )
        out[between] |= (near < 0) | (far != near)
    parts, count = components(pure)
    boxes = ndimage.find_objects(parts + 1)
    fills, extents = np.empty(count, dtype=int), np.zeros(len(palette))
    fills[parts.ravel()] = pure.ravel()
    sides = np.array([max(rows.stop - rows.start, columns.stop - columns.start) for rows, columns in boxes])
    np.maximum.at(extents, fills[fills >= 0], sides[fills >= 0])
    for fill in np.flatnonzero(extents >= LONG):
        _, rest = seam_shares(own.colour, own.before, own.behind, palette[fill, None], PURE)
        out[between] |= (rest <= PURE) & (own.length <= extents[fill])
    return out


def _colours(found: _LineRuns, doubtful: np.ndarray) -> list[np.ndarray]:
    """The colours of long pixel lines, those of most px first. doubtful: (n,) bool, lines that tell only together."""
    enough = found.length >= LONG
    long, alone = found.where(enough), ~doubtful[enough]
    colours, index = np.unique(np.rint(long.colour), axis=0, return_inverse=True)
    index = index.reshape(-1)
    sure = np.bincount(index, alone, len(colours)) > 0
    ways = np.stack([np.bincount(index, long.upright == way, len(colours)) for way in (False, True)])
    sure |= (ways.min(axis=0) > 0) & (ways.sum(axis=0) >= TOGETHER)
    sizes = np.where(sure, np.bincount(index, long.length, len(colours)), 0.0)
    return [colours[k] for k in np.argsort(-sizes, kind="stable")[:MOST_SMALL] if sizes[k]]


def _runs(levels: np.ndarray) -> _LineRuns:
    """All of SHORT px and more, opaque and one px wide, with an even row of another colour on either side."""
    parts, (down, along) = [], steps(levels)
    for upright in (False, True):
        lines = levels.swapaxes(0, 1) if upright else levels
        y, x, length = _rows(lines[..., 3] >= OPAQUE, *((along.T, down.T) if upright else (down, along)))
        sides = [lines[y + step, x] for step in (0, -1, 1)]
        parts.append((*((x, y) if upright else (y, x)), length, np.full(len(y), upright), *sides))
    return _LineRuns(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _rows(solid: np.ndarray, down: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The row and column at which level runs begin in a picture, and their px.

    solid: (H, W) bool, opaque pixels. down, along: its `steps`.
    """
    step, alike, on = down >= SEEN, along <= ALIKE, np.zeros(solid.shape, dtype=bool)
    differs = step[1:] & step[:-1] & solid[1:-1] & solid[2:] & solid[:-2]
    on[1:-1, 1:] = alike[1:-1] & alike[:-2] & alike[2:] & differs[:, 1:] & differs[:, :-1]
    first = np.flatnonzero(~on.ravel())
    length = np.diff(np.append(first, solid.size))
    keep = length >= SHORT
    return *divmod(first[keep], solid.shape[1]), length[keep]


def joined_at_corners(fills: np.ndarray, levels: np.ndarray, palette: np.ndarray, *, whole: bool = False) -> np.ndarray:
    """(H, W) the fills of the pixels of a picture (H, W, 4), levels, with the diagonals of thin lines joined.

    fills: (H, W) indices into the palette (P, 4), levels. whole: of lines a px across with anti-aliasing
    alone, not of what may be a seam between shapes.
    """
    fills = fills.copy()
    for _ in range(3):  # passes
        y, x, own = _touching(fills)
        ends = palette[fills[y, x]], palette[own][:, None]
        share, _ = blend_of(levels[y, x], *ends, most=None)
        meeting = [blend_of(levels[y[:, k], x[:, 1 - k]][:, None], *ends, most=None)[0] for k in (0, 1)]
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


def _touching(fills: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners where alone two pixels of one fill meet: rows, columns (n, 2) of the others there, and the fill (n,)."""
    a, b, c, d = fills[:-1, :-1], fills[:-1, 1:], fills[1:, :-1], fills[1:, 1:]
    falling = np.argwhere((a == d) & (a != b) & (a != c))
    rising = np.argwhere((b == c) & (b != a) & (b != d))
    y = np.concatenate([falling, rising])[:, :1] + [0, 1]
    x = np.concatenate([falling[:, 1:] + [1, 0], rising[:, 1:] + [0, 1]])
    return y, x, np.concatenate([a[tuple(falling.T)], b[tuple(rising.T)]])


def _thin(fills: np.ndarray, own: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n,) bool: within REACH px of the pixels y, x a fill is thinner than theirs, the one that it cuts."""
    padded, side, theirs = np.pad(fills, REACH, constant_values=-1), 2 * REACH + 1, fills[y, x]
    mine, others = np.zeros((2, len(y)), dtype=int)
    for dy, dx in np.ndindex(side, side):  # a pass for each, since dither has as many corners as pixels
        found = padded[y + dy, x + dx]
        mine += found == own
        others += found == theirs
    return mine < others
