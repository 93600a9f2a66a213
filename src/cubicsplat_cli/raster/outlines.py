"""Boundaries and hulls of masks, local fits along chains of points, paths of straight lines, primitives and whole
contours fitted to points, and the coverage of pixels, by the native library.

All raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import byref, c_int64, c_void_p
from functools import partial
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.cpu import bools, doubles, int64s, native
from cubicsplat_cli.record import record

_native = partial(native, "outlines")
CIRCLE, ELLIPSE, BOX = 0, 1, 2
_ROOM = 64  # cracks beyond those around a mask's box


class EdgePositions(NamedTuple):
    """Sub-pixel positions across every crack of a picture, C-contiguous.

    rows: (H + 1, W) y of the border across the horizontal crack above pixel (y, x); columns: (H, W + 1) x of the border
    across the vertical crack left of it; row_sigma, column_sigma: their standard errors in px. rim: px within the
    canvas's border in which an edge may run and not show.
    """

    rows: np.ndarray
    row_sigma: np.ndarray
    columns: np.ndarray
    column_sigma: np.ndarray
    rim: float


def loop_points(cracks: np.ndarray, found: EdgePositions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sub-pixel points along a closed loop of cracks (n, 3) int64, as of `borders.Loops`: (m, 2) px, their standard
    errors (m,), and the index (m,) of each one's crack.

    Where the border runs rather level its points come from the horizontal cracks, else from the vertical ones, so that
    there is one point a column or a row.
    """
    count = len(cracks)
    out = np.empty((count, 2)), np.empty(count), np.empty(count, np.int64)
    given = count, int64s(cracks), *size_of(found), *found
    points = _native("cs_loop_points", *given, *out, result=c_int64)
    return out[0][:points], out[1][:points], out[2][:points]


def contours_of(
    part: np.ndarray, shown: np.ndarray, corner: tuple[int, int], found: EdgePositions
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """The loops around a part of a window (h, w) bool, with its top and left at a corner, px, those that enclose most
    first: points (n, 2) px and their standard errors (n,), as of `loop_points`, and the px^2 that each encloses, below
    0 for a hole. Where the pixel within the part is not one of those `shown` (h, w) bool, the points are middles of
    cracks, and the errors inf.
    """
    masks = [bools(mask) for mask in (part, shown)]
    room, count = 4 * sum(part.shape) + _ROOM, c_int64(0)
    while True:
        points, sigma, ends, told = np.empty((room, 2)), np.empty(room), np.empty(room, np.int64), np.empty((room, 2))
        given = *masks, *part.shape, *corner, *size_of(found), *found, room
        loops = _native("cs_contours", *given, points, sigma, ends, told, byref(count), result=c_int64)
        if max(count.value, loops) <= room:
            break
        room = max(count.value, loops)
    starts = [0, *ends[:loops].tolist()]
    order = sorted(range(loops), key=lambda k: (-told[k, 0], -told[k, 1]))
    parts = [(slice(starts[k], starts[k + 1]), float(told[k, 0])) for k in order]
    return [(points[own].copy(), sigma[own].copy(), area) for own, area in parts]


def size_of(found: EdgePositions) -> tuple[int, int]:
    """The height and width of a picture, px."""
    return found[2].shape[0], found[0].shape[1]


def fewer_points(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Those of the points (n, 2) of a chain, n >= 1, the first and the last among them, between which no other is more
    than `tolerance` off the straight line; (k, 2), in their order (Ramer 1972; Douglas and Peucker 1973).
    """
    kept = np.zeros(len(points), dtype=bool)
    _native("cs_fewer_points", len(points), doubles(points), float(tolerance), kept)
    return np.asarray(points[kept])


def parabolas(
    points: np.ndarray, weights: np.ndarray, along: np.ndarray, kinds: Sequence[tuple[int, float]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parabolas in arc length about every point of a chain: coefficients (n, 3, 2) of 1, s and s^2, the standard errors
    (n, 2) of the first two, and the half-windows (n,) in points.

    points: (n, 2) px; weights: (n,) 1/px^2, 0 where unknown; along: (n,) arc lengths, px. kinds: half-windows from the
    shortest on, and up to which mean squared residual, in squared sigmas, each is believed; the longest one is taken
    before the first that is not.
    """
    chain = len(points), doubles(points), doubles(weights), doubles(along)
    halves, most = np.array([half for half, _ in kinds], np.int64), np.array([limit for _, limit in kinds], np.float64)
    n = len(points)
    found = np.empty((n, 3, 2)), np.empty((n, 2)), np.empty(n, np.int64)
    _native("cs_parabolas", *chain, len(kinds), halves, most, *found, result=None)
    return found


@record
class Hiding:
    """The area in which lines may run: masks (h, w) bool of a window. box: its top and left, px, and height and width
    of the canvas, beyond which all is as on its border; elsewhere beyond the window no line may run. mask: everywhere;
    hidden, allowed: within near px, and within at_end px, of one of the two ends (2, 2), px."""

    box: tuple[int, int, int, int]
    mask: np.ndarray
    hidden: np.ndarray
    allowed: np.ndarray
    ends: np.ndarray
    near: float
    at_end: float


def fewest_links(
    nodes: np.ndarray, place: np.ndarray, before: np.ndarray, after: np.ndarray, hiding: Hiding
) -> np.ndarray:
    """(k,) nodes of the path with the fewest, then the shortest straight lines from one of the first to one of the last
    nodes (n, 2), px; none where there is no path. Lines go from lower to higher places (n,). before, after: px that it
    costs to start at each of the first nodes and to end at each of the last ones.

    Lines that pass at 32 samples may show between them; those of a path that do are given up, up to 60 times.
    """
    count, path = len(nodes), np.empty(len(nodes), np.int64)
    top, left, *canvas = hiding.box
    box = np.array([top, left, *hiding.mask.shape, *canvas], np.int64)
    masks = [bools(mask) for mask in (hiding.mask, hiding.hidden, hiding.allowed)]
    links = count, doubles(nodes), doubles(place), len(before), doubles(before), len(after), doubles(after)
    reach = doubles(hiding.ends), float(hiding.near), float(hiding.at_end)
    return path[: _native("cs_fewest_links", *links, box, *masks, *reach, path, result=c_int64)]


def nearest_primitive(
    points: np.ndarray, weights: np.ndarray, price: float
) -> tuple[int, np.ndarray, float, float] | None:
    """The cheapest primitive through a closed loop of points (n, 2): CIRCLE, ELLIPSE or BOX, its values (6,), its cost,
    nats, and the mean squared residual, in sigmas; None where none comes near.

    The values are the middle, px, the radius of a circle or the half-axes or half sides, the radius of a box's corners
    and the angle, 0 where there is none. Fitted by Levenberg's and Marquardt's method; the cost is half of Huber's loss
    of distances in standard errors, linear beyond 3, and the price of each parameter. weights: (n,) 1/px^2, 0 where
    unknown.
    """
    form, values, told = np.empty(3, np.int32), np.empty(6), np.empty(2)
    given = len(points), doubles(points), doubles(weights), float(price)
    found = _native("cs_nearest_primitive", *given, form, values, told, result=c_int64)
    return (int(form[0]), values, float(told[0]), float(told[1])) if found else None


def hull_mask(mask: np.ndarray) -> np.ndarray:
    """(h, w) bool: the pixels that lie by half or more in the convex hull of a mask's pixels."""
    mask = bools(mask)
    out = np.empty_like(mask)
    _native("cs_hull", mask, *mask.shape, out)
    return out


def held_by_hull(labels: np.ndarray, window: tuple[slice, slice], own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of a window of labels (H, W) int32, C-contiguous, how many pixels (R,) of each label the convex hull of those
    labels that are own (R,) bool holds by half or more, besides these, and how many of them (R,) have no neighbour
    along rows and columns beyond the hull or the window.
    """
    view, own = labels[window], bools(own)
    held, inner = np.zeros(len(own), np.int64), np.zeros(len(own), np.int64)
    rows = c_void_p(view.ctypes.data)  # of the whole array, so that they are apart
    _native("cs_hull_holds", rows, labels.shape[1], *view.shape, own, held, inner)
    return held, inner


def end_heading(points: np.ndarray, sigma: np.ndarray, reach: float) -> np.ndarray | None:
    """(7,) of an outline at its end: place x, y, px; unit tangent x, y onwards, and its standard error, radians; bend,
    1/px; and mean squared residual, in sigmas, of a parabola through what is near. None where too few points are known.

    points: (n, 2) px from the end on, n >= 1, of which those within `reach` px are looked at; sigma: (n,) their
    standard errors, px.
    """
    out = np.empty(7)
    given = len(points), doubles(points), doubles(sigma), float(reach)
    return out if _native("cs_heading", *given, out, result=c_int64) else None


def coverage(cubics: np.ndarray, lines: np.ndarray, top: int, left: int, height: int, width: int) -> np.ndarray:
    """(height, width) float64 coverage, in [0, 1], of the pixels of a window by closed outlines.

    cubics: (S, 4, 2) px, of which some are lines (S,) bool. A loop of an outline that crosses itself is filled.
    """
    out = np.empty((height, width))
    given = len(cubics), doubles(cubics), bools(lines)
    native("shapes", "cs_coverage", *given, left, top, width, height, out)
    return out


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
