"""What pixels tell of fills and edges, by the native library: which fills are near, the shares of at most three of them
in a blend, where in its pixel each lies, and how colours change.

Colours are premultiplied RGBA in levels of 0..255, pictures (H, W, 4) float32, palettes (P, 4) float64. All raise
EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from ctypes import c_int64
from functools import partial

import numpy as np

from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.cpu import doubles, floats, int32s, int64s, native

_native = partial(native, "regions")
SLOTS, REACH = 4, 3  # colours that are looked at near a pixel, and px up to which they lie away
SEAM_STEPS = 32  # of the share of a fill beside a seam
CLEARLY = 0.5  # levels by which what comes later must explain better
STRANGE = 24.0  # levels of residual that the colours near a pixel do not explain: something thin lies there
# Px of the width of an edge, and the weight of the well: of a step between two fills as if its pixel's share were off
# by so much in squares.
EDGE, WELL = 0.5, 0.1
ROUNDS = 100


def spread(values: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """(H, W) float32 by how much the values (H, W, C) of a window of rows x columns px around each pixel, both odd,
    differ, in the channel with most; what lies beyond the border does not count.
    """
    values = floats(values)
    out = np.empty(values.shape[:2], np.float32)
    _native("cs_spread", values, *values.shape, rows, columns, out)
    return out


def nearest_fills(values: np.ndarray, palette: np.ndarray, *, straight: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """(...) int32 index of the fill nearest to values (..., 4), and (...) float32 its distance in levels: Euclid's if
    that is to be `straight`, else that of the channel that is farthest off.
    """
    values, palette = (floats(each) for each in (values, palette))
    index, gap = np.empty(values.shape[:-1], np.int32), np.empty(values.shape[:-1], np.float32)
    _native("cs_nearest_fills", index.size, values, len(palette), palette, straight, index, gap, result=None)
    return index, gap


def near_fills(fills: np.ndarray, y: np.ndarray, x: np.ndarray, reach: int) -> np.ndarray:
    """(n, SLOTS) int32 the different fills >= 0 nearest to the pixels y, x of a map (H, W), up to `reach` px away along
    rows and columns; -1 where there are fewer.
    """
    fills, pixels = int32s(fills), int64s(y * fills.shape[1] + x)
    near = np.empty((len(pixels), SLOTS), np.int32)
    _native("cs_near", fills, *fills.shape, len(pixels), pixels, reach, SLOTS, near, None)
    return near


def best_blend(values: np.ndarray, palette: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (n, 4) as blends of the pair of near fills (n, SLOTS) that explains them best: the fill with the greater
    share (n,) int32, and the residual (n,) in levels; -1 and infinity where there is no fill near.

    Fills farther away must explain clearly better than nearer ones.
    """
    values, palette, near = floats(values), doubles(palette), int32s(near)
    winner, residual = np.empty(len(values), np.int32), np.empty(len(values))
    _native("cs_unmix", len(values), values, palette, near.shape[1], near, winner, residual, result=None)
    return winner, residual


def residual_of_three(values: np.ndarray, palette: np.ndarray, near: np.ndarray) -> np.ndarray:
    """(n,) levels that values (n, 4) are off the nearest blend of three of the fills near them (n, SLOTS) int32, or of
    two that explain them about as well; infinity where there are fewer fills.
    """
    values, palette, near = floats(values), doubles(palette), int32s(near)
    residual = np.empty(len(values))
    _native("cs_unmix_three", len(values), values, palette, near.shape[1], near, residual, result=None)
    return residual


def blend_with(
    values: np.ndarray, fill: np.ndarray, first: np.ndarray, second: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The share (n,) of a fill in values that are its blends with one or both of two others, and the residual (n,) in
    levels. Each of the four is (n, 4), or (4,) for all; two fills are taken where they explain about as well as three.
    """
    given = [doubles(each) for each in (values, fill, first, second)]
    count = max((len(each) for each in given if each.ndim == 2), default=1)
    share, residual = np.empty(count), np.empty(count)
    steps = [part for each in given for part in (each, 4 * (each.ndim - 1))]
    _native("cs_blend_with", count, *steps, share, residual, result=None)
    return share, residual


def seam_shares(
    values: np.ndarray, own: np.ndarray, beside: np.ndarray, grounds: np.ndarray, odd: float
) -> tuple[np.ndarray, np.ndarray]:
    """Values (n, 4) as seams of two fills (n, 4) each, the one in front with a share a, the other with (1 - a)^2, over
    what is left of one of the grounds (G, 4): the share (n,) of the fill beside, in SEAM_STEPS, and the residual (n,)
    in levels, inf where all grounds are within `odd` levels of one of the two.

    Later grounds must explain clearly better than earlier ones.
    """
    values, share, rest = floats(values), np.empty(len(values)), np.empty(len(values))
    given = len(values), values, doubles(own), doubles(beside), len(grounds), doubles(grounds)
    _native("cs_seam_shares", *given, SEAM_STEPS, float(odd), CLEARLY, share, rest, result=None)
    return share, rest


def fills_of_lines(
    values: np.ndarray,
    place: tuple[np.ndarray, np.ndarray],
    palette: np.ndarray,
    beside: tuple[np.ndarray, np.ndarray],
    window: int,
    costs: tuple[float, float, float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of values (n, 4) at rows and columns (n,) the fill (n,) that explains those in a window of so many px around each
    best, as blends with the two fills beside them, two of (n, 4); its share (n,) in the value, and the residual (n,).

    costs: levels beyond which a residual costs no more, those that a fill costs that has no share, and those that it
    costs for each fill before it in the palette.
    """
    values, palette = floats(values), doubles(palette)
    (y, x), (first, second) = (int64s(each) for each in place), (doubles(each) for each in beside)
    fill, share, residual = np.empty(len(values), np.int64), np.empty(len(values)), np.empty(len(values))
    found = (window, *costs, fill, share, residual)
    _native("cs_line_fills", len(values), values, y, x, len(palette), palette, first, second, *found)
    return fill, share, residual


def distance_to_blends(values: np.ndarray, fills: np.ndarray, first: int = 0) -> np.ndarray:
    """(n,) the Euclidean distance of values (n, 4) to the nearest blend of two fills of (P, 4), one of them from
    `first` on; infinite where there is none.
    """
    values, fills = floats(values), doubles(fills)
    square = np.empty(len(values))
    _native("cs_off_blends", len(values), values, len(fills), fills, first, square, result=None)
    return np.sqrt(square)


def part_fills(levels: np.ndarray, owner: np.ndarray, even: float, side: float) -> tuple[np.ndarray, np.ndarray]:
    """(P, 4) the fills that the parts of a picture show, and how many px (P,) each has.

    owner: (H, W) int32 the part of each pixel, from 1 on, 0 for none. even: levels up to which the colours of a part
    may differ for it to show one fill, the commonest colour, or the median where none has a quarter of it; others show
    the mean in every cell of `side` levels.
    """
    levels, owner = floats(levels), int32s(owner)
    room = int(np.count_nonzero(owner))
    fills, sizes = np.empty((room, 4)), np.empty(room)
    parts = int(owner.max(initial=0))
    count = _native("cs_part_fills", owner.size, levels, owner, parts, float(even), side, fills, sizes, result=c_int64)
    return fills[:count].copy(), sizes[:count].copy()


def joined_fills(fills: np.ndarray, weights: np.ndarray, same: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """At most so many of the fills (P, 4), and their weights: in the given order each joins the nearest one before it
    that is within `same` levels, or is kept.
    """
    fills, weights = doubles(fills), np.array(weights, np.float64)
    kept = np.empty(min(len(fills), most), np.int64)
    count = _native("cs_join_fills", len(fills), fills, weights, same, most, kept, result=c_int64)
    return fills[kept[:count]], weights[kept[:count]]


def components(values: np.ndarray) -> tuple[np.ndarray, int]:
    """(H, W) int32 the parts of equal values (H, W) >= -1, connected along the sides of pixels, numbered from 0 on by
    their values and then their first pixels; and how many there are.
    """
    values = int32s(values)
    labels = np.empty_like(values)
    return labels, _native("cs_components", values, *values.shape, labels, result=c_int64)


def blend_pairs(
    values: np.ndarray, parts: np.ndarray, palette: np.ndarray, near: np.ndarray, farther: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (n, 4) as blends of a fill near them (n, SLOTS) and another one of the palette (P, 4): both (n,) int32,
    and the share (n,) float32 of the latter. In a small part, a letter, these are of as few fills as explain it all.

    parts: (n,) int32 the part of each value, from 0 on. farther: levels by which a fill that is not near must explain a
    value better, and by which fewer fills may explain a part worse.
    """
    values, parts, palette, near = floats(values), int32s(parts), doubles(palette), int32s(near)
    first, second = (np.empty(len(values), np.int32) for _ in range(2))
    share = np.empty(len(values), np.float32)
    given = parts, len(palette), palette, near.shape[1], near, float(farther)
    _native("cs_blend_pairs", len(values), values, *given, first, second, share)
    return first, second, share


def finer_labels(
    first: np.ndarray, second: np.ndarray, share: np.ndarray, palette: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """The labels (H steps, W steps) int32 and levels (H steps, W steps, 4) float32 of a picture in so many steps a
    pixel each way. first, second: (H, W) int32 the fills of each pixel, of a palette (P, 4), the same where it has one;
    share: (H, W) float32 of the second.

    The shares of a pixel's two fills are known, but not where they lie in it. They lie so that borders are short: of
    all fields u in [0, 1], the share of the second fill in each step of a pixel, that one is sought whose mean over
    each pixel is its share, which is hardly ever between 0 and 1, and which is smooth. It is found by descent on

        1/2 |mean of u - share|^2 + w (u (1 - u) + (e / pi)^2 |grad u|^2)

    (the phase field of Allen and Cahn 1979 with the double obstacle potential of Blowey and Elliott 1991, whose edges
    are half a sine wave e px wide), of which the well u (1 - u) grows from nothing, so that it settles what the shares
    have left open, and not the other way round. The same for any number of threads.
    """
    (height, width), palette = first.shape, doubles(palette)
    labels = np.empty((height * steps, width * steps), np.int32)
    levels = np.empty((*labels.shape, 4), np.float32)
    given = int32s(first), int32s(second), floats(share), palette, ROUNDS, EDGE, WELL, work().threads
    _native("cs_phase_field", height, width, steps, *given, labels, levels)
    return labels, levels


def edge_variances(
    levels: np.ndarray, luma: np.ndarray, most: int, even: float, contrast: float, off: float
) -> np.ndarray:
    """(n,) variances, px^2, of the blur of level or upright edges between two even places of a picture (H, W, 4).

    luma: (H, W) the light in which edges are sought, at most so many each way. even: levels by which places are even;
    contrast: levels of an edge; off: share of the contrast by which an edge's pixels may be off the line between the
    colours that they blend, as those of a thin line between two areas are.
    """
    levels, luma = (floats(each) for each in (levels, luma))
    out = np.empty(2 * most)
    limits = (float(even), float(contrast), float(off))
    return out[: _native("cs_edge_widths", levels, luma, *luma.shape, most, *limits, out, result=c_int64)].copy()


def planes(values: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, C) the means of windows of size x size px, odd, of values (H, W, C), whose border goes on beyond it; and
    (H, W) by how much the planes through them change per px, in the channel with most; float32.
    """
    values = floats(values)
    means, slopes = np.empty_like(values), np.empty(values.shape[:2], np.float32)
    _native("cs_planes", values, *values.shape, size, means, slopes)
    return means, slopes


def second_differences(levels: np.ndarray) -> np.ndarray:
    """(H, W) float32 the larger one of those along the row and along the column, of the colour channel of a picture
    (H, W, 4) that has the largest; 0 where a pixel has no neighbours.
    """
    levels = floats(levels)
    out = np.empty(levels.shape[:2], np.float32)
    _native("cs_second_differences", levels, *levels.shape[:2], out, result=None)
    return out


def steps(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H - 1, W) and (H, W - 1) float32 how far each pixel of a picture (H, W, C) is from the one below, and from the
    one to the right, in the channel with most.
    """
    levels = floats(levels)
    height, width, channels = levels.shape
    down = np.empty((max(height - 1, 0), width), np.float32)
    along = np.empty((height, max(width - 1, 0)), np.float32)
    for out, apart in ((down, width * channels), (along, channels)):
        _native("cs_steps", levels, *out.shape, channels, width * channels, apart, out, result=None)
    return down, along


def off_palette(levels: np.ndarray, palette: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """(H, W) how far each pixel of a picture (H, W, 4) is from the colour of a palette (P, 4) that its label (H, W)
    says, in the channel with most.
    """
    out = np.empty(labels.shape)
    given = floats(levels), labels.size, doubles(palette)
    _native("cs_off_palette", *given, int32s(labels), out, result=None)
    return out


def distinct(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The places (K,) at which the different ones of uint64 keys are first, in the order of the keys, and which of them
    each key is, of their shape.
    """
    keys = np.ascontiguousarray(keys, np.uint64)
    numbers, first = np.empty(keys.shape, np.int64), np.empty(keys.size, np.int64)
    return first[: _native("cs_distinct", keys.size, keys, numbers, first, result=c_int64)].copy(), numbers


def unexplained(
    levels: np.ndarray,
    painted: np.ndarray,
    space: np.ndarray,
    ringing: np.ndarray,
    reach: int,
    seam: float,
    unlike: float,
    own: float,
    allowed: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) by how many levels a picture (H, W, 4) is off what is painted (H, W, 4), in the channel with most; and
    (H, W) bool: the pixels that no colour painted near them explains, and those painted in a colour that the picture
    does not have near them.

    Both are compared after they were multiplied by `space` (4, 4). A pixel is off by as much as it lies outside of the
    colours that the other picture has within `reach` px, and by `seam` less where that has an edge, a range of more
    than `unlike`. It is unexplained if the mean over 3 x 3 px, or over a line of 5 px, is off by more than `allowed`
    plus its `ringing` (H, W, 4), and itself by more than the share `own` of that mean, and of `unlike`.
    """
    gap, where = np.empty(levels.shape[:2]), np.empty(levels.shape[:2], bool)
    given = floats(levels), doubles(painted), *levels.shape[:2], doubles(space)
    judged = reach, float(seam), float(unlike), float(own), float(allowed)
    _native("cs_unexplained", *given, floats(ringing), *judged, gap, where)
    return gap, where
