"""Boundaries and hulls of masks, local fits along chains of points, paths of straight lines, primitives and whole
contours fitted to points, and the coverage of pixels, by the native library.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import byref, c_int64
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.native import Out, bools, doubles, int32s, int64s, native
from cubicsplat_cli.record import record

_native = partial(native, "outlines")
CIRCLE, ELLIPSE, BOX = 0, 1, 2


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

    @property
    def given(self) -> tuple[Any, ...]:
        """The height and width of the picture, px, and the fields, as the library takes them."""
        return self.columns.shape[0], self.rows.shape[1], *self


def contours_of(
    part: np.ndarray, shown: np.ndarray, corner: tuple[int, int], edges: EdgePositions
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Return the loops around a part of a window (h, w) bool with its top and left at a corner, px, those that enclose
    most first: points (n, 2) px and their standard errors (n,), and the px^2 that each encloses, below 0 for a hole.

    The points of a rather level border come from the horizontal cracks, those of a steep one from the vertical cracks,
    so that there is one point a column or a row. At a pixel of the part that is not `shown` (h, w) bool, the points are
    the middles of cracks, and the errors inf.
    """
    room, count = 4 * sum(part.shape) + 64, c_int64(0)  # as many as loops have that are little longer than the box
    while True:
        points, sigma, ends, areas = np.empty((room, 2)), np.empty(room), np.empty(room, np.int64), np.empty((room, 2))
        given = bools(part), bools(shown), *part.shape, *corner, *edges.given, room
        loops = _native("cs_contours", *given, points, sigma, ends, areas, byref(count), result=c_int64)
        if max(count.value, loops) <= room:
            break
        room = max(count.value, loops)
    starts = [0, *ends[:loops].tolist()]
    order = sorted(range(loops), key=lambda k: (-areas[k, 0], -areas[k, 1]))
    parts = [(slice(starts[k], starts[k + 1]), float(areas[k, 0])) for k in order]
    return [(points[own].copy(), sigma[own].copy(), area) for own, area in parts]


def fewer_points(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Return points (k, 2) of a chain of points (n, 2), n >= 1, in their order, the first and the last among them: all
    between two of them are within the tolerance of the straight line (Ramer 1972; Douglas and Peucker 1973).
    """
    return points[_native("cs_fewer_points", len(points), doubles(points), float(tolerance), Out(len(points), bool))]


def parabolas(
    points: np.ndarray, weights: np.ndarray, along: np.ndarray, kinds: Sequence[tuple[int, float]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit parabolas in arc length s about every point of a chain. Return the coefficients (n, 3, 2) of 1, s and s^2,
    the standard errors (n, 2) of the first two, and the half-windows (n,) in points.

    points: (n, 2) px; weights: (n,) 1/px^2, 0 for unknown points; along: (n,) arc lengths, px. kinds: half-windows from
    the shortest on, and the mean squared residual, in squared sigmas, up to which each is believed; the longest one
    before the first that is not believed is taken.
    """
    n, (halves, most) = len(points), zip(*kinds, strict=True)
    given = n, doubles(points), doubles(weights), doubles(along), len(kinds), int64s(halves), doubles(most)
    return _native("cs_parabolas", *given, Out((n, 3, 2)), Out((n, 2)), Out(n, np.int64), result=None)


def fewest_links(
    nodes: np.ndarray, place: np.ndarray, before: np.ndarray, after: np.ndarray, box: Sequence[int],
    masks: Sequence[np.ndarray], ends: np.ndarray, near: float, at_end: float,
) -> np.ndarray:  # fmt: skip
    """Return the nodes (k,) of the path with the fewest, then the shortest straight lines from one of the first to one
    of the last nodes (n, 2), px; none if there is no path. Lines go from lower to higher places (n,). before, after: px
    that it costs to start at each of the first nodes and to end at each of the last ones.

    box: the top and left of a window, px, and the height and width of the canvas. masks: (h, w) bool of the window,
    where lines may run: everywhere, and within near px, and within at_end px, of one of the two ends (2, 2), px. Beyond
    the canvas they go on as on its border; elsewhere beyond the window no line may run. Lines are checked at 32
    samples, and may show between them; the lines of a path that do are given up, up to 60 times.
    """
    top, left, *canvas = box
    links = len(nodes), doubles(nodes), doubles(place), len(before), doubles(before), len(after), doubles(after)
    given = int64s([top, left, *masks[0].shape, *canvas]), *map(bools, masks), doubles(ends), float(near), float(at_end)
    return _native("cs_fewest_links", *links, *given, Out(len(nodes), np.int64), result=c_int64)


def hull_mask(mask: np.ndarray) -> np.ndarray:
    """Return (h, w) bool: the pixels that lie by half or more in the convex hull of a mask's pixels."""
    return _native("cs_hull", bools(mask), *mask.shape, Out(mask.shape, bool))


class Runs:
    """Runs of one label in the rows of labels (H, W), whole numbers from 0 on."""

    def __init__(self, labels: np.ndarray) -> None:
        self.width = labels.shape[1]
        begins = np.ones(labels.shape, dtype=bool)
        begins[:, 1:] = labels[:, 1:] != labels[:, :-1]
        self.first = np.append(np.flatnonzero(begins), labels.size)
        self.labels = int32s(labels[begins])
        self.rows = np.append(0, np.cumsum(begins.sum(axis=1)))

    def held_by_hull(self, window: tuple[slice, slice], own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take the convex hull of the labels that are own (R,) bool in a window. Return how many further pixels (R,) of
        each label it holds by half or more, and how many of these (R,) have no neighbour along rows and columns beyond
        the hull or the window.
        """
        (top, bottom), (left, right) = ((side.start, side.stop) for side in window)
        given = self.first, self.labels, self.rows, self.width, top, left, bottom - top, right - left
        return _native("cs_hull_holds", *given, bools(own), Out(len(own), np.int64), Out(len(own), np.int64))


@record
class Heading:
    """Direction of an outline at its end. at: (2,) px; tangent: (2,) unit, onwards; error: its standard error, radians;
    bend: 1/px; misfit: mean squared residual of a smooth end, in sigmas."""

    at: np.ndarray
    tangent: np.ndarray
    error: float
    bend: float
    misfit: float


def heading(points: np.ndarray, sigma: np.ndarray, reach: float) -> Heading | None:
    """Return the direction of an outline at its end, by a parabola; None if too few points are known.

    points: (n, 2) px from the end on, which count up to `reach` px; sigma: (n,) their standard errors, px.
    """
    out = np.empty(7)
    given = len(points), doubles(points), doubles(sigma), float(reach)
    known = len(points) and _native("cs_heading", *given, out, result=c_int64)
    return Heading(out[:2], out[2:4], *out[4:].tolist()) if known else None


def coverage(cubics: np.ndarray, lines: np.ndarray, top: int, left: int, height: int, width: int) -> np.ndarray:
    """Return the coverage (height, width) float64, in [0, 1], of the pixels of a window by closed outlines.

    cubics: (S, 4, 2) px, of which some are lines (S,) bool. A loop of an outline that crosses itself is filled.
    """
    given = len(cubics), doubles(cubics), bools(lines), left, top, width, height
    return native("shapes", "cs_coverage", *given, Out((height, width)))


def misplaced(
    cubics: np.ndarray, lines: np.ndarray, corner: tuple[int, int], may: np.ndarray, box: tuple[slice, slice],
    must: np.ndarray, besides: np.ndarray | None,
) -> np.ndarray:  # fmt: skip
    """Return (k, 2) middles x, y of the pixels of a window that closed outlines wrongly enclose by more than half, or
    wrongly do not.

    cubics, lines: as of `coverage`. corner: the top and left of the window, px. may: (h, w) bool of the window, what
    they may enclose. box: rows and columns of the window; must, besides: bool of these, what they must enclose, and
    what else they may, None for nothing.
    """
    top, left = corner
    ends = int64s([*(side.start for side in box), *(side.stop for side in box)])
    given = len(cubics), doubles(cubics), bools(lines), left, top, *may.shape, bools(may), ends, bools(must)
    return native("shapes", "cs_misplaced", *given, besides, Out((may.size, 2)), result=c_int64)


@record
class FittedContour:
    """An outline fitted to a contour. form: CIRCLE, ELLIPSE or BOX, or -1 for a ring of anchors (A, 2) px, controls
    (A, 2, 2) px, lines and smooth (A,) bool. values (6,) of a form: the middle, px, the radius of a circle or the
    half-axes or half sides, the radius of a box's corners and the angle, 0 for a form without them. doubtful: true of a
    ring that lies more than a tenth of a px off its points in the mean, or crosses itself.
    """

    form: int
    values: np.ndarray
    anchors: np.ndarray
    controls: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray
    doubtful: bool


def fitted_contours(
    ends: np.ndarray, points: np.ndarray, weights: np.ndarray, known: np.ndarray, prices: np.ndarray, astray: np.ndarray
) -> tuple[list[FittedContour], int]:
    """Return the outline nearest to each of some closed contours, and how many of these have fewer than three different
    points, and no outline. The same for any number of threads.

    ends: (C,) the end of each contour's points; points: (n, 2) px; weights: (n,) 1/px^2, 0 for unknown points; known:
    (n,) bool, unknown points that are corners; prices: (C,) nats of a parameter. astray: (C,) bool, true if an outline
    that encloses much more or less than its points is fitted again, ever closer to them.
    """
    ends, loops = int64s(ends), len(ends)
    room = 2 * (len(points) + loops)
    form, values, pieces = np.full(loops, -1, np.int32), np.zeros((loops, 6)), np.empty(loops, np.int64)
    ring = np.empty((room, 2)), np.empty((room, 2, 2)), np.empty(room, bool), np.empty(room, bool)
    doubtful = np.zeros(loops, bool)
    given = ends, doubles(points), doubles(weights), bools(known), doubles(prices), bools(astray), work().threads
    unfit = _native("cs_fit_contours", loops, *given, form, values, pieces, *ring, doubtful, result=c_int64)
    starts = 2 * (np.concatenate([[0], ends])[:-1] + np.arange(loops))
    parts = map(slice, starts.tolist(), (starts + np.maximum(pieces, 0)).tolist())
    contours = []
    for own, kind, fit, bad in zip(parts, form.tolist(), values, doubtful.tolist(), strict=True):
        anchors, controls, lines, smooth = (array[own].copy() for array in ring)
        contours.append(FittedContour(kind, fit, anchors, controls, lines, smooth, bad))
    return contours, unfit
