"""The fills and edges that pixels show, by the native library: the fills near a pixel, the shares of at most three of
them in a blend, the place of each in its pixel, changes of colour, and dither.

Colours are premultiplied RGBA in levels of 0..255, pictures (H, W, 4) float32, palettes (P, 4) float64, and distances
and residuals levels.
"""

from __future__ import annotations

from ctypes import c_int64
from functools import cache, partial
from pathlib import Path

import numpy as np

from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.native import Out, bools, doubles, floats, int32s, int64s, native
from cubicsplat_cli.raster.shades import nearest_paints

_native = partial(native, "regions")
SLOTS, REACH = 4, 3  # fills that are looked at near a pixel, and px up to which they lie away
SEAM_STEPS = 32  # of the share of a fill beside a seam
CLEARLY = 0.5  # levels by which a later ground must explain a seam better than an earlier one
STRANGE = 24.0  # levels of residual that the colours near a pixel do not explain: something thin lies there
# The weights of the network of `finer_labels`, and the contrast of its answers, which are blurred: means over all that
# a step may show.
SUBPIXELS, CONTRAST = Path(__file__).parent / "subpixels.npz", 2.0


def spread(values: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Return (H, W) float32: the range of the values (H, W, C) in a window of rows x columns px around each pixel, both
    odd, in the channel with the largest range. Places beyond the border do not count.
    """
    return _native("cs_spread", floats(values), *values.shape, rows, columns, Out(values.shape[:2], np.float32))


def nearest_fills(values: np.ndarray, palette: np.ndarray, *, straight: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return the index (...) int32 of the fill nearest to each of values (..., 4), and its distance (...) float32:
    Euclid's if `straight`, else that of the channel that is farthest off.
    """
    shape = values.shape[:-1]
    index, gap = Out(shape, np.int32), Out(shape, np.float32)
    given = index.array.size, floats(values), len(palette), floats(palette), straight
    return _native("cs_nearest_fills", *given, index, gap, result=None)


def near_fills(fills: np.ndarray, y: np.ndarray, x: np.ndarray, reach: int) -> np.ndarray:
    """Return (n, SLOTS) int32: the different fills >= 0 nearest to the pixels y, x of a map (H, W), up to `reach` px
    away along rows and columns; -1 in slots that are left.
    """
    return nearest_paints(fills, y * fills.shape[1] + x, reach, SLOTS)[0]


def best_blend(values: np.ndarray, palette: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Explain values (n, 4) as blends of two fills near them (n, SLOTS): of the best pair return the fill (n,) int32
    with the greater share, and the residual (n,); -1 and infinity if no fill is near.

    Fills farther away must explain clearly better than nearer ones.
    """
    given = len(values), floats(values), doubles(palette), near.shape[1], int32s(near)
    return _native("cs_unmix", *given, Out(len(values), np.int32), Out(len(values)), result=None)


def relabelled(
    labels: np.ndarray, seen: np.ndarray, fills: np.ndarray, place: tuple[np.ndarray, np.ndarray],
    candidates: np.ndarray, costs: tuple[float, float, float, float], *, bounded: bool,
) -> np.ndarray:  # fmt: skip
    """Choose labels (H, W) int32 of some pixels anew, in place, in at most 6 rounds of all at once, and return them: of
    candidates (n, k), fills of (P, 4) or -1, the one of which the pixel is a blend of half or more at the least cost.

    place: rows and columns (n,). costs: squares of a residual for each nat; the most nats for it; nats for each
    neighbour with another label; and those for a candidate after the first SLOTS. bounded: a pixel blends only with
    fills of its neighbours, and the nats have no bound.
    """
    pixels = place[0] * labels.shape[1] + place[1]
    given = *labels.shape, floats(seen), doubles(fills), len(pixels), int64s(pixels)
    slots = candidates.shape[1], int32s(candidates)
    _native("cs_relabel", *given, *slots, *map(float, costs), SLOTS, bounded, 6, labels)
    return labels


def with_joined_parts(
    labels: np.ndarray, seen: np.ndarray, fills: np.ndarray, most: int, costs: tuple[float, ...]
) -> np.ndarray:
    """Return labels (H, W) int32 of a picture (H, W, 4) in fills (P, 4) with small parts, of at most `most` px, joined
    to a neighbour where that costs less.

    costs: nats of a part, and of a pair of neighbours with different labels; the square of a misfit in levels, so that
    the residual of a pixel costs ln(1 + square / misfit^2); a bound, and half of what square / misfit^2 is beyond that
    is added; and the most levels between the fills of a part and a neighbour.
    """
    out = labels.astype(np.int32)
    _native("cs_join_parts", *labels.shape, floats(seen), doubles(fills), most, *map(float, costs), 6, out)
    return out


def residual_of_three(values: np.ndarray, palette: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return (n,): the distance of values (n, 4) to the nearest blend of three of the fills near them (n, SLOTS) int32,
    or of two that explain them about as well; infinity if there are fewer fills.
    """
    given = len(values), floats(values), doubles(palette), near.shape[1], int32s(near)
    return _native("cs_unmix_three", *given, Out(len(values)), result=None)


def blend_with(
    values: np.ndarray, fill: np.ndarray, first: np.ndarray, second: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share (n,) of a fill in values that are its blends with one or both of two others, and the residual
    (n,). Each of the four is (n, 4), or (4,) for all; two fills are taken if they explain about as well as three.
    """
    given = [doubles(array) for array in (values, fill, first, second)]
    count = max((len(array) for array in given if array.ndim == 2), default=1)
    steps = [part for array in given for part in (array, 4 * (array.ndim - 1))]
    return _native("cs_blend_with", count, *steps, Out(count), Out(count), result=None)


def seam_shares(
    values: np.ndarray, own: np.ndarray, beside: np.ndarray, grounds: np.ndarray, odd: float
) -> tuple[np.ndarray, np.ndarray]:
    """Explain values (n, 4) as seams of two fills (n, 4) each: the one in front has a share a, the other one (1 - a)^2,
    and one of the grounds (G, 4) the rest. Return the share (n,) of the fill beside, in SEAM_STEPS, and the residual
    (n,), inf if all grounds are within `odd` levels of one of the two fills.

    Later grounds must explain clearly better than earlier ones.
    """
    given = len(values), floats(values), doubles(own), doubles(beside), len(grounds), doubles(grounds)
    out = Out(len(values)), Out(len(values))
    return _native("cs_seam_shares", *given, SEAM_STEPS, float(odd), CLEARLY, *out, result=None)


def line_sections(
    levels: np.ndarray, areas: np.ndarray, palette: np.ndarray, line: np.ndarray, off: float, part: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return what a picture (H, W, 4) shows of lines in a fill (4,) between areas: their share (H, W) float32 of each
    pixel; the px (H, W) of the level and of the upright section there, each the sum of its shares, 0 where none is; and
    (H, W) bool, sections that fill whole pixels.

    areas: (H, W) the fills of a palette (P, 4) that areas show, -1 of other pixels. A section lies between two areas;
    its pixels are blends of the line and the nearer one, to `off` levels. A whole pixel has a share of `part`.
    """
    shape = levels.shape[:2]
    given = *shape, floats(levels), int32s(areas), doubles(palette), doubles(line), float(off), float(part)
    return _native(
        "cs_line_sections", *given, Out(shape, np.float32), Out(shape), Out(shape), Out(shape, bool), result=None
    )


def fills_of_lines(
    values: np.ndarray, place: tuple[np.ndarray, np.ndarray], palette: np.ndarray,
    beside: tuple[np.ndarray, np.ndarray], window: int, costs: tuple[float, float, float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Explain values (n, 4) at rows and columns (n,) as blends of one more fill with the two beside them, each (n, 4).
    Return the fill (n,) that best explains a window of so many px around each, its share (n,), and the residual (n,).

    costs: the most levels that a residual costs; levels that a fill without any share costs; and levels that a fill
    costs for each one before it in the palette.
    """
    count = len(values)
    places = [*map(int64s, place), len(palette), doubles(palette), *map(doubles, beside)]
    out = Out(count, np.int64), Out(count), Out(count)
    return _native("cs_line_fills", count, floats(values), *places, window, *costs, *out)


def distance_to_blends(values: np.ndarray, fills: np.ndarray, first: int = 0) -> np.ndarray:
    """Return (n,): the Euclidean distance of values (n, 4) to the nearest blend of two fills of (P, 4), one of them
    from the number `first` on; infinite if there is none.
    """
    given = len(values), floats(values), len(fills), doubles(fills), first
    return np.sqrt(_native("cs_off_blends", *given, Out(len(values)), result=None))


def part_fills(levels: np.ndarray, owner: np.ndarray, even: float, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the fills (P, 4) that the parts of a picture show, and the number of pixels (P,) of each.

    owner: (H, W) int32 the part of each pixel, from 1 on, 0 for none. even: levels up to which the colours of a part
    may differ for it to show one fill, the commonest colour, or the median if no colour has a quarter of it; other
    parts show the mean of the colours in each cell of `side` levels.
    """
    room, parts = int(np.count_nonzero(owner)), int(owner.max(initial=0))
    given = owner.size, floats(levels), int32s(owner), parts, float(even), side
    return _native("cs_part_fills", *given, Out((room, 4)), Out(room), result=c_int64)


def joined_fills(fills: np.ndarray, weights: np.ndarray, same: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Return at most so many of the fills (P, 4), and their weights: in the given order each fill joins the nearest one
    before it that is within `same` levels, or is kept.
    """
    fills, weights = doubles(fills), np.array(weights, np.float64)
    room = Out(min(len(fills), most), np.int64)
    kept = _native("cs_join_fills", len(fills), fills, weights, same, most, room, result=c_int64)
    return fills[kept], weights[kept]


def components(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the parts (H, W) int32 of equal values (H, W) >= -1, connected along the sides of pixels and numbered from
    0 on by their values and then their first pixels; and their number.
    """
    labels = np.empty(values.shape, np.int32)
    return labels, _native("cs_components", int32s(values), *values.shape, labels, result=c_int64)


def part_facts(parts: np.ndarray, values: np.ndarray, marked: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return of parts (H, W) int32, from 0 on, each of one of the values (H, W): its px (n,) int64, how many of these
    are marked (H, W) bool, (n,) int64, and its value (n,) int32.
    """
    count, given = int(parts.max()) + 1, (int32s(parts), int32s(values), bools(marked))
    outs = Out(count, np.int64), Out(count, np.int64), Out(count, np.int32)
    return _native("cs_part_facts", parts.size, *given, *outs, result=None)


def blend_pairs(
    values: np.ndarray, parts: np.ndarray, palette: np.ndarray, near: np.ndarray, farther: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Explain values (n, 4) as blends of a fill near them (n, SLOTS) and another one of the palette (P, 4): return both
    (n,) int32, and the share (n,) float32 of the latter. A small part, such as a letter, gets as few fills as possible.

    parts: (n,) int32 the part of each value, from 0 on. farther: levels by which a fill that is not near must explain a
    value better, and by which fewer fills may explain a part worse.
    """
    n = len(values)
    given = n, floats(values), int32s(parts), len(palette), doubles(palette), near.shape[1], int32s(near)
    return _native("cs_blend_pairs", *given, float(farther), Out(n, np.int32), Out(n, np.int32), Out(n, np.float32))


def finer_labels(
    first: np.ndarray, second: np.ndarray, share: np.ndarray, palette: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the labels (H steps, W steps) int32 and levels (H steps, W steps, 4) float32 of a picture in so many steps
    a pixel each way. first, second: (H, W) int32 the fills of each pixel, of a palette (P, 4), the same if it has one;
    share: (H, W) float32 of the second.

    The shares of a pixel's two fills are known, but not their places in it. A network of three full layers tells the
    share in each of 4 x 4 steps from those in the window around: the likeliest under shapes of all kinds, which
    tools/train_subpixels.py has trained it with. They are brought to the pixel's own share by a shift of their logits.
    Fewer steps are their means. The result is the same for any number of threads.
    """
    height, width = first.shape
    fine = height * steps, width * steps
    sizes, weights = _network()
    given = int32s(first), int32s(second), floats(share), doubles(palette), len(sizes) - 1, sizes, weights
    out = Out(fine, np.int32), Out((*fine, 4), np.float32)
    return _native("cs_subpixels", height, width, steps, *given, CONTRAST, work().threads, *out)


@cache
def _network() -> tuple[np.ndarray, np.ndarray]:
    """Return the sizes of the layers, input and output included, and the weights of all in a row."""
    with np.load(SUBPIXELS) as stored:
        layers = [stored[name] for name in stored.files]
    sizes = [layers[0].shape[1], *(len(matrix) for matrix in layers[::2])]
    return int32s(np.array(sizes)), floats(np.concatenate([each.ravel() for each in layers]))


def dither_dots(levels: np.ndarray, contrast: float) -> np.ndarray:
    """Return (H, W) bool: the pixels of a picture (H, W, C) in levels that dither would set: in one channel, the four
    neighbours along the sides are exactly alike, and the pixel differs by `contrast` levels or more.

    Pixels of a thin slanting line, whose only like neighbours meet them at two opposite corners, are none.
    """
    return _native("cs_dither_dots", floats(levels), *levels.shape, float(contrast), Out(levels.shape[:2], bool))


def guided_means(levels: np.ndarray, guide: np.ndarray, where: np.ndarray, px: float, alike: float) -> np.ndarray:
    """Return levels (H, W, C) with a weighted mean in place of each pixel of `where`, (H, W) bool.

    A neighbour's weight is a normal density of its distance, with a standard deviation of `px`, times one of its
    distance from the pixel in a guide (H, W, C), of `alike` levels (the joint bilateral filter of Petschnigg and others
    2004). The result is the same for any number of threads.
    """
    given = floats(levels), floats(guide), *levels.shape, bools(where), float(px), float(alike), work().threads
    return _native("cs_guided_means", *given, Out(levels.shape, np.float32))


def edge_variances(
    levels: np.ndarray, luma: np.ndarray, most: int, even: float, contrast: float, off: float, *, cut: bool = False
) -> np.ndarray:
    """Return (n,) variances, px^2, of the blur of edges between two even places of a picture (H, W, 4). cut: so count
    edges that others cut off too, which seem a little sharper than they are.

    luma: (H, W) the light in which edges are sought, at most so many each way. even: levels by which places are even;
    contrast: levels of an edge; off: share of the contrast by which an edge's pixels may be off the line between the
    colours that they blend, as the pixels of a thin line between two areas are.
    """
    given = floats(levels), floats(luma), *luma.shape, most, float(even), float(contrast), float(off), cut
    return _native("cs_edge_widths", *given, Out(2 * most), result=c_int64)


def planes(values: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Fit planes to windows of size x size px, odd, of values (H, W, C), whose border goes on beyond it. Return their
    means (H, W, C), and their slopes (H, W) per px in the channel with the largest; float32.
    """
    out = Out(values.shape, np.float32), Out(values.shape[:2], np.float32)
    return _native("cs_planes", floats(values), *values.shape, size, *out)


def second_differences(levels: np.ndarray) -> np.ndarray:
    """Return (H, W) float32: the larger one of the second differences along the row and along the column of a picture
    (H, W, 4), in the colour channel with the largest; 0 for a pixel without neighbours.
    """
    size = levels.shape[:2]
    return _native("cs_second_differences", floats(levels), *size, Out(size, np.float32), result=None)


def steps(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (H - 1, W) and (H, W - 1) float32: the distance of each pixel of a picture (H, W, C) from the one below,
    and from the one to the right, in the channel with the largest.
    """
    height, width, channels = levels.shape
    levels, row = floats(levels), width * channels

    def across(size: tuple[int, int], apart: int) -> np.ndarray:
        return _native("cs_steps", levels, *size, channels, row, apart, Out(size, np.float32), result=None)

    return across((max(height - 1, 0), width), row), across((height, max(width - 1, 0)), channels)


def off_palette(levels: np.ndarray, palette: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return (H, W): how far pixels (H, W, 4) are off their labels' palette colours (P, 4), in the worst channel."""
    given = floats(levels), labels.size, doubles(palette), int32s(labels)
    return _native("cs_off_palette", *given, Out(labels.shape), result=None)


def distinct(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the place (K,) of the first of each of the different uint64 keys, in the order of the keys, and the number
    of each key among these, in the shape of the keys.
    """
    numbers, room = np.empty(keys.shape, np.int64), Out(keys.size, np.int64)
    keys = np.ascontiguousarray(keys, np.uint64)
    return _native("cs_distinct", keys.size, keys, numbers, room, result=c_int64), numbers


def unexplained(
    levels: np.ndarray, painted: np.ndarray, space: np.ndarray, ringing: np.ndarray, reach: int, seam: float,
    unlike: float, own: float, allowed: float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return (H, W): by how many levels a picture (H, W, 4) is off the painted one (H, W, 4), in the channel with the
    largest; and (H, W) bool: the pixels that no colour painted near them explains, and the pixels painted in a colour
    that the picture does not have near them.

    Both pictures are compared after they are multiplied by `space` (4, 4). A pixel is off by as much as it lies outside
    the range of colours that the other picture has within `reach` px, and by `seam` less if that has an edge, a range
    of more than `unlike`. It is unexplained if the mean over 3 x 3 px, or over a line of 5 px, is off by more than
    `allowed` plus its `ringing` (H, W, 4), and itself by more than the share `own` of that mean, and of `unlike`.
    """
    size = levels.shape[:2]
    given = floats(levels), doubles(painted), *size, doubles(space), floats(ringing), reach
    limits = float(seam), float(unlike), float(own), float(allowed)
    return _native("cs_unexplained", *given, *limits, Out(size), Out(size, bool))
