"""From boundary points to the outline an artist would have drawn: the fewest pieces that the points support.

Every choice is made by description length: half of chi^2 plus a price for each parameter (parameter_price). A primitive
is taken where it is no dearer than a ring. A ring is laid out between its corners (`laid_out`), fitted to the points as
a whole, and made more regular where that costs less than the parameters it saves: joints smooth that bend by 12, 4 or
1.5 degrees at most, and lines exactly level or upright that are so within two standard errors.

Corners are found where two flanks meet at an angle: the tangent is extrapolated to each place from its left and from
its right, by the widest run of neighbours that one line or parabola explains. On an arc both agree, however tight it
is; at a corner they differ by its angle, at every scale. The points next to a corner are biased (a pixel there sees
both flanks), so they never take part: the corner is the intersection of the flanks, and the points between must only
not contradict it, as those of a rounding do.

Of whole loops that are circles, ellipses or rectangles each kind, level and turned, with sharp and with round corners,
is fitted by distances with Huber's tails. Points near a sharp corner are biased and count less. A loop is no primitive
where every fit is far off, where its area does not suit its second moments, or where it does not run around what was
fitted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring, polygon
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.raster.outlines import CIRCLE, ELLIPSE, fewer_points, fitted_contours

PRECISION = 0.05  # px, to which a coordinate is worth knowing
PRICE = 0.5  # a piece too many is easier to take out, once drawn exactly, than one too few to put in
SYSTEMATIC = 0.02  # px, the error of points, an axis or a shift besides that by chance
HIDDEN_SIGMA = 3.0  # px: a point of a larger standard error tells nothing, it is hidden or unknown
TOLERANCE = 0.3  # px that lines are off the points where nothing else can be said of them
GAP = 2.5  # px between neighbouring points of a line, about one per px, from which it has a gap
WHOLE = 0.1  # px that the points around a dot may be off the edges of whole pixels


def fit_outlines(
    points: Sequence[np.ndarray],
    sigmas: Sequence[np.ndarray],
    detail: float = 1.0,
    corners: Sequence[np.ndarray | None] | None = None,
) -> list[Outline]:
    """The outline through each of some closed loops of boundary points; those without corners are fitted ever closer to
    the points where they have gone astray.

    points: of each (n, 2) px, n >= 3, about one per px, in order, the first not repeated. sigmas: (n,) their standard
    errors across the boundary, px; large or inf where the boundary is hidden or unknown, there it goes the simplest
    way. detail: > 0; more gives more pieces. corners: (n,) bool, hidden points that are corners. Raises InputError when
    the points make no loop.
    """
    for loop, sigma in zip(points, sigmas, strict=True):
        if loop.ndim != 2 or loop.shape[1] != 2 or sigma.shape != loop.shape[:1] or not len(loop):
            raise InputError(f"an outline needs points (n, 2) and sigma (n,), not {loop.shape} and {sigma.shape}")
    if not points:
        return []
    places, errors = np.concatenate(points), np.concatenate(sigmas)
    if not np.isfinite(places).all() or np.isnan(errors).any():
        raise InputError("the points of an outline must be finite")
    given = [None] * len(points) if corners is None else corners
    known = [np.zeros(len(loop), bool) if own is None else own for loop, own in zip(points, given, strict=True)]
    astray = np.array([own is None for own in given])
    weights = np.where(errors < HIDDEN_SIGMA, 1.0 / np.maximum(errors, SYSTEMATIC) ** 2, 0.0)
    prices = np.array([parameter_price(loop, detail) for loop in points])
    ends = np.cumsum([len(loop) for loop in points])
    found, unfit = fitted_contours(ends, places, weights, np.concatenate(known), prices, astray)
    if unfit:
        raise InputError("an outline needs at least 3 different points")
    outlines: list[Outline] = []
    for each, loop, sigma, own in zip(found, points, sigmas, given, strict=True):
        if each.form >= 0:
            outlines.append(primitive_of(each.form, each.values))
            continue
        # Where a part is hidden its points do not tell where the outline ought to run.
        otherwise = few_lines(loop) if own is None and each.doubtful and (sigma < HIDDEN_SIGMA).all() else None
        outlines.append(Ring(each.anchors, each.controls, each.lines, each.smooth, otherwise))
    return outlines


def parameter_price(points: np.ndarray, detail: float) -> float:
    """Nats a parameter costs: half of ln(extent / precision), over detail."""
    extent = float(np.max(np.ptp(points, axis=0)))
    return PRICE * max(math.log(max(extent, 1.0) / PRECISION), 1.0) / detail


def few_lines(points: np.ndarray, tolerance: float = TOLERANCE) -> Ring:
    """Few straight lines along the points (n, 2) of a loop, n >= 3, `tolerance` px about them, and nearer to those of
    one that is thinner than that.
    """
    closed = np.vstack([points, points[:1]])
    while len(few := fewer_points(closed, tolerance)[:-1]) < 3 and tolerance > SYSTEMATIC:
        tolerance *= 0.25
    return polygon(few if len(few) >= 3 else points)


def primitive_of(form: int, values: np.ndarray) -> Outline:
    """The primitive of a form, CIRCLE, ELLIPSE or BOX, and its values (6,), as in a `FittedContour`."""
    x, y, a, b, radius, angle = values.tolist()
    if form == CIRCLE:
        return Circle(x, y, a)
    if form == ELLIPSE:
        return Ellipse(x, y, a, b, angle)
    return Rectangle(x - a, y - b, 2.0 * a, 2.0 * b, radius, angle)


def dot_of(points: np.ndarray, shown: np.ndarray, corner: tuple[int, int]) -> Outline:
    """The outline of very few px, shown (h, w) bool in a window with such a corner x, y: a box of whole pixels if its
    points (n, 2) keep to their edges, else a circle.
    """
    y, x = np.nonzero(shown)
    low, high = np.array([[x.min(), y.min()], [x.max() + 1, y.max() + 1]], dtype=float) + corner
    off = np.minimum(np.abs(points - low), np.abs(points - high)).min(axis=1)
    if len(x) == np.prod(high - low) and off.max() < WHOLE:
        return Rectangle(*low.tolist(), *(high - low).tolist())
    cx, cy = points.mean(axis=0).tolist()
    return Circle(cx, cy, math.sqrt(len(x) / math.pi))
