"""Measurements of a picture by the native library: its colours, its edges, and how its colours change.

All raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from ctypes import c_int64
from functools import partial

import numpy as np

from cubicsplat_cli.raster.cpu import doubles, floats, int32s, native

_native = partial(native, "regions")


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
