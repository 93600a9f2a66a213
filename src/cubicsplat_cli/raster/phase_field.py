"""Where in its pixels each fill lies, by the native library: labels in several steps a pixel.

The shares of a pixel's two fills are known, but not where they lie in it. They lie so that borders are short: of all
fields u in [0, 1], the share of the second fill in each step of a pixel, that one is sought whose mean over each pixel
is its share, which is hardly ever between 0 and 1, and which is smooth. It is found by descent on

    1/2 |mean of u - share|^2 + w (u (1 - u) + (e / pi)^2 |grad u|^2)

(the phase field of Allen and Cahn 1979 with the double obstacle potential of Blowey and Elliott 1991, whose edges are
half a sine wave e px wide), of which the well u (1 - u) grows from nothing, so that it settles what the shares have
left open, and not the other way round.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.cpu import doubles, floats, int32s, native

_native = partial(native, "regions")
# Px of the width of an edge, and the weight of the well: of a step between two fills as if its pixel's share were off
# by so much in squares.
EDGE, WELL = 0.5, 0.1
ROUNDS = 100


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

    The same for any number of threads.
    """
    (height, width), palette = first.shape, doubles(palette)
    labels = np.empty((height * steps, width * steps), np.int32)
    levels = np.empty((*labels.shape, 4), np.float32)
    given = int32s(first), int32s(second), floats(share), palette, ROUNDS, EDGE, WELL, work().threads
    _native("cs_phase_field", height, width, steps, *given, labels, levels)
    return labels, levels
