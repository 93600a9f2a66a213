"""Contours fitted whole, many at a time, by the native library.

All raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from ctypes import c_int64

import numpy as np

from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.cpu import bools, doubles, int64s, native
from cubicsplat_cli.record import record


@record
class FittedContour:
    """Outline fitted to a contour. form: CIRCLE, ELLIPSE or BOX of raster/outlines.py with its values (6,), or -1
    for a ring: anchors (A, 2) px, controls (A, 2, 2) px, lines and smooth (A,) bool. doubtful: whether a ring lies more
    than a tenth of a px off its points in the mean, or crosses itself.
    """

    form: int
    values: np.ndarray
    anchors: np.ndarray
    controls: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray
    doubtful: bool


def independent(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The weights (n,) 1/px^2 of a loop of points (n, 2), less where neighbouring points err together: drawing programs
    sample edges on a grid of about quarter pixels, so those of a nearly level or upright stretch err together as far as
    it takes to cross a row of samples, and count as one.
    """
    out = np.empty(len(points))
    native("outlines", "cs_independent", len(points), doubles(points), doubles(weights), out, result=None)
    return out


def fitted_contours(
    ends: np.ndarray,
    points: np.ndarray,
    weights: np.ndarray,
    known: np.ndarray,
    prices: np.ndarray,
    astray: np.ndarray,
) -> tuple[list[FittedContour], int]:
    """The outline nearest to each of some closed contours, and how many of these are none, since they have fewer than
    three different points. The same for any number of threads.

    ends: (C,) where the points of each contour end; points: (n, 2) px; weights: (n,) 1/px^2, 0 where unknown; known:
    (n,) bool, unknown points that are corners; prices: (C,) nats of a parameter. astray: (C,) bool, whether what
    encloses much more or less than its points do is fitted again, ever closer to them.
    """
    ends, loops = int64s(ends), len(ends)
    room = 2 * (len(points) + loops)
    form, values, pieces = np.full(loops, -1, np.int32), np.zeros((loops, 6)), np.empty(loops, np.int64)
    anchors, controls = np.empty((room, 2)), np.empty((room, 2, 2))
    lines, smooth, doubtful = np.empty(room, bool), np.empty(room, bool), np.zeros(loops, bool)
    given = ends, doubles(points), doubles(weights), bools(known), doubles(prices), bools(astray)
    out = form, values, pieces, anchors, controls, lines, smooth, doubtful
    bad = native("outlines", "cs_fit_contours", loops, *given, work().threads, *out, result=c_int64)
    places = (2 * (np.concatenate([[0], ends])[:-1] + np.arange(loops))).tolist()
    found = []
    for k, (place, count) in enumerate(zip(places, np.maximum(pieces, 0).tolist(), strict=True)):
        own = slice(place, place + count)
        path = anchors[own].copy(), controls[own].copy(), lines[own].copy(), smooth[own].copy()
        found.append(FittedContour(int(form[k]), values[k], *path, bool(doubtful[k])))
    return found, int(bad)
