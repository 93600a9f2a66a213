"""From boundary points to the outline an artist would have drawn: the fewest pieces that the points support.

Every choice is made by description length: half of chi^2 plus, for each parameter, ln(extent / precision).
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.corners import Corners, find_corners
from cubicsplat_cli.artwork.outlines import Outline, Ring, polygon
from cubicsplat_cli.artwork.primitives import fit_primitive
from cubicsplat_cli.artwork.refine import Feet, Pieces, refine
from cubicsplat_cli.artwork.sections import CORNER_ERRORS, LEAST_ERRORS, Division, Section, divide
from cubicsplat_cli.artwork.smoothing import HIDDEN_SIGMA, LocalFits, local_fits
from cubicsplat_cli.errors import InputError

PRECISION = 0.05  # px, to which a coordinate is worth knowing
FINEST_SIGMA = 0.02  # px: what is systematic in the points is never below this
# Drawing programs sample edges on a grid of about quarter pixels, so the points of a nearly level or upright stretch
# err together as far as the stretch takes to cross a row of samples; they count as one.
GRID = 0.25  # px
FLATTEST = 0.01
PLAIN_MISFIT = 1.2  # mean squared residual of a primitive, in sigmas, at which nothing else need be tried
CORNER_REACH = 1.5  # px around a corner in which points are biased
FEWEST_POINTS = 8
SMOOTH_JOINT = math.radians(15.0)


def fit_outline(points: np.ndarray, sigma: np.ndarray, detail: float = 1.0) -> Outline:
    """The outline through a closed loop of boundary points.

    points: (n, 2) px, n >= 3, about one per px, in order, the first not repeated. sigma: (n,) their standard errors
    across the boundary, px; large or inf where the boundary is hidden or unknown, there it goes the simplest way.
    detail: > 0; more gives more pieces. Raises InputError when the points make no loop.
    """
    points, weights = _checked(points, sigma)
    if len(points) < FEWEST_POINTS:
        return polygon(points)
    price = parameter_price(points, detail)
    primitive = fit_primitive(points, _independent(points, weights), price)
    if primitive is not None and primitive[2] <= PLAIN_MISFIT:
        return primitive[0]
    ring, cost = _fit_ring(points, weights, price)
    return primitive[0] if primitive is not None and primitive[1] <= cost else ring


def parameter_price(points: np.ndarray, detail: float) -> float:
    """Nats a parameter costs: ln(extent / precision) / detail."""
    extent = float(np.max(np.ptp(points, axis=0)))
    return max(math.log(max(extent, 1.0) / PRECISION), 1.0) / detail


def _checked(points: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points without repetitions, and their weights 1/px^2."""
    points, sigma = np.asarray(points, dtype=float), np.asarray(sigma, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or sigma.shape != points.shape[:1]:
        raise InputError(f"an outline needs points (n, 2) and sigma (n,), not {points.shape} and {sigma.shape}")
    if not np.isfinite(points).all() or np.isnan(sigma).any():
        raise InputError("the points of an outline must be finite")
    apart = np.hypot(*(points - np.roll(points, 1, axis=0)).T) > 1e-6
    points, sigma = points[apart], sigma[apart]
    if len(points) < 3:
        raise InputError(f"an outline needs at least 3 different points, not {len(points)}")
    return points, np.where(sigma < HIDDEN_SIGMA, 1.0 / np.maximum(sigma, FINEST_SIGMA) ** 2, 0.0)


def _fit_ring(points: np.ndarray, weights: np.ndarray, price: float) -> tuple[Ring, float]:
    corners = find_corners(points, weights)
    weights = _independent(points, weights)
    weights = _without_corners(points, weights, corners)
    if len(corners.indices):
        order, sections = _sections(points, weights, corners)
        divisions = [divide(section, price) for section in sections]
    else:
        order, division = _divided_loop(points, weights, price)
        divisions = [division]
    pieces, feet = _joined(divisions, cornered=len(corners.indices) > 0)
    pieces, feet, misfit = refine(pieces, points[order], weights[order], feet)
    levelled = with_level_lines(pieces, weights[order], feet)
    if levelled is not pieces:
        pieces, feet, misfit = refine(levelled, points[order], weights[order], feet)
    ring = as_ring(pieces)
    return ring, 0.5 * misfit + price * ring.parameters


def _independent(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The weights, less where neighbouring points err together."""
    way = np.roll(points, -3, axis=0) - np.roll(points, 3, axis=0)
    slope = np.abs(way).min(axis=1) / np.maximum(np.abs(way).max(axis=1), 1e-9)
    return weights / (1.0 + GRID / np.maximum(slope, FLATTEST))


def _without_corners(points: np.ndarray, weights: np.ndarray, corners: Corners) -> np.ndarray:
    weights = weights.copy()
    for at, turn in zip(corners.positions, corners.turns, strict=True):
        # In a thin tip both flanks share pixels farther away from the corner.
        reach = max(CORNER_REACH, min(0.6 / max(math.sin(0.5 * (math.pi - abs(turn))), 0.1), 5.0))
        weights[np.hypot(*(points - at).T) < reach] = 0.0
    return weights


def _sections(points: np.ndarray, weights: np.ndarray, corners: Corners) -> tuple[np.ndarray, list[Section]]:
    """The order of the points from the first corner on, and the runs between neighbouring corners."""
    n, starts = len(points), corners.indices
    sections, order = [], []
    for k, start in enumerate(starts):
        stop = starts[(k + 1) % len(starts)]
        run = (start + np.arange((stop - start - 1) % n + 1)) % n
        ends = corners.positions[[k, (k + 1) % len(starts)]]
        sections.append(_section(points[run], weights[run], ends))
        order.append(run)
    return np.concatenate(order), sections


def _section(points: np.ndarray, weights: np.ndarray, ends: np.ndarray) -> Section:
    known = np.flatnonzero(weights > 0.0)
    errors = np.array([CORNER_ERRORS, CORNER_ERRORS])
    if len(known) < 4:
        # Too short to measure: it is straight.
        way = ends[1] - ends[0]
        tangent = way / max(float(np.hypot(*way)), 1e-9)
        m = len(points)
        fits = LocalFits(
            ends[0] + way * (np.arange(m) + 0.5)[:, None] / m,
            np.tile(tangent, (m, 1)),
            np.zeros(m),
            np.ones(m),
            np.full((m, 2), 0.1),
        )
        return Section(fits, np.zeros(m), ends, np.stack([tangent, tangent]), errors, True)
    fits = local_fits(points, weights, closed=False)
    tangents = np.stack([_towards(fits, known[0], ends[0]), _towards(fits, known[-1], ends[1])])
    return Section(fits, weights, ends, tangents, errors, True)


def _towards(fits: LocalFits, index: int, end: np.ndarray) -> np.ndarray:
    """The tangent at an end, carried there from a point by the curvature."""
    tangent = fits.tangents[index]
    turn = float(np.clip(fits.curvature[index] * ((end - fits.positions[index]) @ tangent), -0.5, 0.5))
    cos, sin = math.cos(turn), math.sin(turn)
    return np.array([cos * tangent[0] - sin * tangent[1], sin * tangent[0] + cos * tangent[1]])


def _divided_loop(points: np.ndarray, weights: np.ndarray, price: float) -> tuple[np.ndarray, Division]:
    """A loop without corners, divided from two starting points; the cheaper one."""
    fits = local_fits(points, weights, closed=True)
    start = int(np.argmin(np.where(weights > 0.0, fits.positions[:, 0], np.inf)))
    best = _loop_from(fits, weights, start, price)
    breaks = best[1].breaks[1:-1]
    if len(breaks):
        other = int(best[0][breaks[len(breaks) // 2]])
        again = _loop_from(fits, weights, other, price)
        if again[1].cost < best[1].cost:
            best = again
    return best


def _loop_from(fits: LocalFits, weights: np.ndarray, start: int, price: float) -> tuple[np.ndarray, Division]:
    order = (start + np.arange(len(weights))) % len(weights)
    turned = fits.taken(order)
    at, tangent = turned.positions[[0, 0]], turned.tangents[[0, 0]]
    errors = np.maximum(turned.errors[[0, 0]], LEAST_ERRORS)
    return order, divide(Section(turned, weights[order], at, tangent, errors, False), price)


def _joined(divisions: list[Division], cornered: bool) -> tuple[Pieces, Feet]:
    """The divisions one after the other as a closed outline, and where the points start."""
    anchors = np.concatenate([d.anchors[:-1] for d in divisions])
    lines = np.concatenate([d.lines for d in divisions])
    level = np.concatenate([d.level[:-1] for d in divisions])
    cubics = np.concatenate([d.cubics for d in divisions])
    outgoing = cubics[:, 1] - cubics[:, 0]
    incoming = np.roll(cubics[:, 2] - cubics[:, 3], 1, axis=0)
    smooth = np.ones(len(anchors), dtype=bool)
    if cornered:
        starts = np.cumsum([0] + [len(d.lines) for d in divisions[:-1]])
        smooth[starts] = False
    smooth &= ~(lines & np.roll(lines, 1))
    count, piece, u = 0, [], []
    for d in divisions:
        sizes = np.diff(d.breaks)
        piece.append(count + np.repeat(np.arange(len(sizes)), sizes))
        u.append(np.concatenate([(np.arange(size) + 0.5) / size for size in sizes]))
        count += len(sizes)
    tied = np.arange(2 * len(anchors)).reshape(-1, 2)
    pieces = Pieces(anchors, incoming, outgoing, lines, smooth, level & smooth, tied)
    return pieces, Feet(np.concatenate(piece), np.concatenate(u))


def with_level_lines(pieces: Pieces, weights: np.ndarray, feet: Feet) -> Pieces:
    """The pieces with lines made exactly horizontal or vertical that are so within two standard errors."""
    tied, anchors = pieces.tied.copy(), pieces.anchors.copy()
    changed = False
    for i in np.flatnonzero(pieces.lines):
        j = pieces.ends[i]
        across = np.abs(anchors[j] - anchors[i])
        c = int(np.argmin(across))
        known = float(weights[feet.piece == i].sum())
        error = math.sqrt(12.0 / known) if known > 0.0 else 0.3
        if across[c] <= max(2.0 * error, 0.03) and across[c] < 0.2 * across[1 - c] and tied[i, c] != tied[j, c]:
            tied[tied == tied[j, c]] = tied[i, c]
            same = tied[:, c] == tied[i, c]
            anchors[same, c] = anchors[same, c].mean()
            changed = True
    if not changed:
        return pieces
    _, numbers = np.unique(tied, return_inverse=True)
    return Pieces(
        anchors, pieces.incoming, pieces.outgoing, pieces.lines, pieces.smooth, pieces.level, numbers.reshape(-1, 2)
    )


def as_ring(pieces: Pieces) -> Ring:
    """The ring that closed pieces make."""
    return Ring(pieces.anchors, pieces.cubics[:, 1:3].copy(), pieces.lines.copy(), pieces.smooth.copy())
