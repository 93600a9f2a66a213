"""From boundary points to the outline an artist would have drawn: the fewest pieces that the points support.

Every choice is made by description length: half of chi^2 plus a price for each parameter (parameter_price).
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.geometry.fewer import fewer_points
from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring, polygon
from cubicsplat_cli.artwork.tracing.corners import Corners, find_corners
from cubicsplat_cli.artwork.tracing.joining import as_ring, feet_of, joined, loosened, tightened, with_level_lines
from cubicsplat_cli.artwork.tracing.layout import independent, lay_out
from cubicsplat_cli.artwork.tracing.primitives import fit_primitive
from cubicsplat_cli.artwork.tracing.refine import Feet, refine
from cubicsplat_cli.artwork.tracing.smoothing import HIDDEN_SIGMA
from cubicsplat_cli.artwork.tracing.variables import Pieces
from cubicsplat_cli.errors import InputError

PRECISION = 0.05  # px, to which a coordinate is worth knowing
PRICE = 0.5  # a piece too many is easier to take out, once drawn exactly, than one too few to put in
FINEST_SIGMA = 0.02  # px: what is systematic in the points is never below this
FEWEST_POINTS = 8
TOLERANCE = 0.3  # px that lines are off the points where nothing else can be said of them
# Bends, in radians, up to which pieces that are not both lines are joined smoothly; the first that pays.
SMOOTHEST = (math.radians(12.0), math.radians(4.0), math.radians(1.5))
PLAIN_MISFIT = 1.2  # mean squared residual of a primitive, in sigmas, at which nothing else need be tried

Fitted = tuple[Pieces, Feet, float]


def fit_outline(
    points: np.ndarray, sigma: np.ndarray, detail: float = 1.0, corners: np.ndarray | None = None
) -> Outline:
    """The outline through a closed loop of boundary points.

    points: (n, 2) px, n >= 3, about one per px, in order, the first not repeated. sigma: (n,) their standard errors
    across the boundary, px; large or inf where the boundary is hidden or unknown, there it goes the simplest way.
    detail: > 0; more gives more pieces. corners: (n,) bool, hidden points that are corners. Raises InputError when
    the points make no loop.
    """
    points, weights, apart = _checked(points, sigma)
    if len(points) < FEWEST_POINTS:
        return polygon(points)
    price = parameter_price(points, detail)
    known = np.flatnonzero(corners[apart]) if corners is not None else np.zeros(0, dtype=int)
    # What has corners that nobody sees is none of those primitives that would do.
    primitive = None if len(known) else fit_primitive(points, independent(points, weights), price)
    if primitive is not None and primitive[2] <= PLAIN_MISFIT:
        return primitive[0]
    ring, cost = _fit_ring(points, weights, price, known)
    return primitive[0] if primitive is not None and primitive[1] <= cost else ring


def parameter_price(points: np.ndarray, detail: float) -> float:
    """Nats a parameter costs: half of ln(extent / precision), over detail."""
    extent = float(np.max(np.ptp(points, axis=0)))
    return PRICE * max(math.log(max(extent, 1.0) / PRECISION), 1.0) / detail


def _checked(points: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points without repetitions, their weights 1/px^2, and which of those given they are, (n,) bool."""
    points, sigma = np.asarray(points, dtype=float), np.asarray(sigma, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or sigma.shape != points.shape[:1]:
        raise InputError(f"an outline needs points (n, 2) and sigma (n,), not {points.shape} and {sigma.shape}")
    if not np.isfinite(points).all() or np.isnan(sigma).any():
        raise InputError("the points of an outline must be finite")
    apart = np.hypot(*(points - np.roll(points, 1, axis=0)).T) > 1e-6
    points, sigma = points[apart], sigma[apart]
    if len(points) < 3:
        raise InputError(f"an outline needs at least 3 different points, not {len(points)}")
    return points, np.where(sigma < HIDDEN_SIGMA, 1.0 / np.maximum(sigma, FINEST_SIGMA) ** 2, 0.0), apart


def _fit_ring(points: np.ndarray, weights: np.ndarray, price: float, known: np.ndarray) -> tuple[Ring, float]:
    """known: (k,) indices of hidden points that are corners."""
    corners = find_corners(points, weights).with_known(known, points, weights)
    ring, cost = _fit_between(points, weights, corners, price)
    if ring.pieces < 3 and ring.lines.all():
        # There and back again encloses nothing: the thin tips were no corners.
        ring, cost = _fit_between(points, weights, corners.taken(corners.sure), price)
    return (few_lines(points), cost) if ring.pieces < 3 and ring.lines.all() else (ring, cost)


def few_lines(points: np.ndarray, tolerance: float = TOLERANCE) -> Ring:
    """Few straight lines along the points (n, 2) of a loop, n >= 3, `tolerance` px about them."""
    few = fewer_points(np.vstack([points, points[:1]]), tolerance)[:-1]
    return polygon(few if len(few) >= 3 else points)


def _fit_between(points: np.ndarray, weights: np.ndarray, corners: Corners, price: float) -> tuple[Ring, float]:
    layout = lay_out(points, independent(points, weights), corners, price)
    points, weights = points[layout.order], layout.weights[layout.order]
    pieces = joined(layout.division)
    best = refine(loosened(pieces), points, weights, feet_of(layout.division))
    for widest in SMOOTHEST:
        trial = tightened(best[0], ~(pieces.lines & np.roll(pieces.lines, 1)), widest)
        best, done = _if_cheaper(best, trial, points, weights, price)
        if done:
            break
    best, _ = _if_cheaper(best, with_level_lines(best[0], weights, best[1]), points, weights, price)
    ring = as_ring(best[0])
    return ring, 0.5 * best[2] + price * ring.parameters


def _if_cheaper(
    best: Fitted, trial: Pieces, points: np.ndarray, weights: np.ndarray, price: float
) -> tuple[Fitted, bool]:
    """The fit of more regular pieces, if what it loses is worth less than the parameters it saves."""
    saved = best[0].joints.variables() - trial.joints.variables()
    if saved <= 0:
        return best, True
    fitted = refine(trial, points, weights, best[1])
    if 0.5 * (fitted[2] - best[2]) <= price * saved:
        return fitted, True
    return best, False
