"""Find the dots of dither, and the means of pixels on one side of the edges around them, natively."""

from __future__ import annotations

from functools import partial

import numpy as np

from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.native import Out, bools, floats, native

_native = partial(native, "dither")


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
