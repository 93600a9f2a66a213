"""The best division of a run of points between two corners into lines and cubics, by dynamic programming.

Nodes are laid along the run, denser where it bends; each pair of nodes gets the best line and the best cubic with the
tangents measured there, and the cheapest path through them is the division. The price of a piece is half of chi^2 plus
the price of a parameter times their number (description length).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.robust import OUTLYING, huber
from cubicsplat_cli.artwork.tracing.cubics import Ends, fit_cubics, rough_cubics
from cubicsplat_cli.artwork.tracing.smoothing import LocalFits, arc_lengths

SURE_WEIGHT = 4.0  # 1/px^2: points that know less are no place for a joint
FEWEST_NODES, MOST_NODES = 6, 48
NODES_PER_RADIAN = 4.0
STRAIGHT_SHARE = 0.01  # of sqrt(1/px): how dense nodes are on straight stretches against bent ones
SAMPLES = 20
WIDEST_TURN = math.radians(200.0)  # of one cubic, all bends added
LINE_PARAMETERS, CUBIC_PARAMETERS = 2, 5
BEND_PARAMETERS = 4  # of a line after a line where no corner was found
# The least that two pieces cost: two lines with a bend, or a line and a cubic.
PAIR_PARAMETERS = (LINE_PARAMETERS + CUBIC_PARAMETERS + 1, LINE_PARAMETERS + CUBIC_PARAMETERS)
CORNER_ERRORS = (0.15, 0.3)  # px and radians: how well the ends at corners are known beforehand
LEAST_ERRORS = (0.01, 0.01)  # px and radians
LINE_SLACK = math.radians(0.5)  # between a line and the tangent where it meets a cubic smoothly
HOPELESS = 400.0  # misfit, per price of a parameter and per point, above which a rough cubic need not be refined


@dataclass(frozen=True)
class Section:
    """A run of m points. fits: of its m points. ends, tangents: (2, 2), where it starts and stops, px and unit.

    weights: (m,) 1/px^2, 0 where the points tell nothing. errors: (2, 2) of the ends, px and radians. corners: whether
    the run starts and stops at corners, or is a loop.
    """

    fits: LocalFits
    weights: np.ndarray
    ends: np.ndarray
    tangents: np.ndarray
    errors: np.ndarray
    corners: bool


@dataclass(frozen=True)
class Division:
    """J pieces: breaks (J + 1,) point indices, anchors (J + 1, 2), tangents (J + 1, 2), lines (J,), cubics (J, 4, 2).

    level: (J + 1,) whether the tangent is exactly along an axis. cost: of all pieces, in nats.
    """

    breaks: np.ndarray
    anchors: np.ndarray
    tangents: np.ndarray
    level: np.ndarray
    lines: np.ndarray
    cubics: np.ndarray
    cost: float


@dataclass(frozen=True)
class _Nodes:
    index: np.ndarray
    at: np.ndarray
    tangent: np.ndarray
    level: np.ndarray
    errors: np.ndarray


def divide(section: Section, price: float) -> Division:
    """The cheapest division. price: of a parameter, in nats."""
    nodes = _nodes(section)
    plain = _undivided(section, nodes, price)
    if plain is not None:
        return plain
    first, last = _pairs(nodes)
    lines, cubics, line_cost, cubic_cost = _fits(section, nodes, first, last, price)
    costs = np.stack([line_cost, cubic_cost], axis=1)
    chosen, kinds, cost = _cheapest(len(nodes.index), first, last, costs, BEND_PARAMETERS * price)
    straight = kinds == 0
    stops = np.append(first[chosen], len(nodes.index) - 1)
    pieces = np.where(straight[:, None, None], lines[chosen], cubics[chosen])
    return _division(nodes, stops, straight, pieces, cost)


def _undivided(section: Section, nodes: _Nodes, price: float) -> Division | None:
    """The run as a single piece, where no two could be cheaper; None where they could."""
    ends = np.array([0]), np.array([len(nodes.index) - 1])
    lines, cubics, line_cost, cubic_cost = _fits(section, nodes, *ends, price)
    straight = line_cost <= cubic_cost
    if not section.corners or min(line_cost[0], cubic_cost[0]) > price * PAIR_PARAMETERS[int(straight[0])]:
        return None
    piece = np.where(straight[:, None, None], lines, cubics)
    return _division(nodes, np.concatenate(ends), straight, piece, float(min(line_cost[0], cubic_cost[0])))


def _division(nodes: _Nodes, stops: np.ndarray, straight: np.ndarray, pieces: np.ndarray, cost: float) -> Division:
    return Division(
        breaks=nodes.index[stops],
        anchors=nodes.at[stops],
        tangents=nodes.tangent[stops],
        level=nodes.level[stops],
        lines=straight,
        cubics=pieces,
        cost=cost,
    )


def _nodes(section: Section) -> _Nodes:
    fits, m = section.fits, len(section.weights)
    known = section.weights > SURE_WEIGHT
    density = np.where(known, np.sqrt(np.minimum(np.abs(fits.curvature), 1.0)) + STRAIGHT_SHARE, 0.0)
    s = arc_lengths(fits.positions)
    measure = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(s))])
    bend = float(np.abs(0.5 * (fits.curvature[1:] + fits.curvature[:-1]) * np.diff(s))[known[1:]].sum())
    count = int(min(MOST_NODES, FEWEST_NODES + NODES_PER_RADIAN * bend + 0.5 * math.sqrt(s[-1]), max(2, m // 2)))
    index = np.searchsorted(measure, np.linspace(0.0, measure[-1], count)[1:-1])
    # Where the known points of a run begin and end, the way may change to one that hides.
    edges = np.flatnonzero(known[1:] != known[:-1])
    index = np.unique(np.concatenate([index, edges + known[1:][edges]]))
    extreme, at, tangent = _extrema(fits, known)
    index = index[known[index] & (index > 1) & (index < m - 2)]
    away = np.abs(index[:, None] - extreme[None, :]).min(axis=1, initial=m) > 1
    index = index[away]
    order = np.argsort(np.concatenate([index, extreme]), kind="stable")
    inner = np.concatenate([index, extreme])[order]
    at = np.concatenate([fits.positions[index], at])[order]
    tangent = np.concatenate([fits.tangents[index], tangent])[order]
    level = np.concatenate([np.zeros(len(index), bool), np.ones(len(extreme), bool)])[order]
    errors = np.maximum(fits.errors[inner], LEAST_ERRORS)
    return _Nodes(
        np.concatenate([[0], inner, [m]]).astype(int),
        np.concatenate([section.ends[:1], at, section.ends[1:]]),
        np.concatenate([section.tangents[:1], tangent, section.tangents[1:]]),
        np.concatenate([[False], level, [False]]),
        np.concatenate([section.errors[:1], errors, section.errors[1:]]),
    )


def _extrema(fits: LocalFits, known: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the run is horizontal or vertical for a moment: index (E,), position (E, 2), tangent (E, 2)."""
    m = len(known)
    found: list[int] = []
    at, tangent = [], []
    for c in (0, 1):
        t = fits.tangents[:, c]
        cross = (t[:-1] * t[1:] <= 0.0) & known[:-1] & known[1:] & (np.abs(fits.curvature[:-1]) > 2e-3)
        for before in np.flatnonzero(cross).tolist():
            k = before if abs(t[before]) < abs(t[before + 1]) else before + 1
            if not 2 <= k < m - 2 or (found and min(abs(k - f) for f in found) < 2):
                continue
            here, bend = fits.tangents[k], fits.curvature[k]
            normal = np.array([-here[1], here[0]])
            slope = bend * normal[c]
            ds = float(np.clip(-t[k] / slope, -1.0, 1.0)) if abs(slope) > 1e-9 else 0.0
            found.append(k)
            at.append(fits.positions[k] + ds * here + 0.5 * ds * ds * bend * normal)
            axis = np.zeros(2)
            axis[1 - c] = math.copysign(1.0, here[1 - c])
            tangent.append(axis)
    order = np.argsort(found, kind="stable")
    shape = (len(found), 2)
    return (
        np.array(found, dtype=int)[order],
        np.reshape(at, shape)[order] if found else np.zeros(shape),
        np.reshape(tangent, shape)[order] if found else np.zeros(shape),
    )


def _pairs(nodes: _Nodes) -> tuple[np.ndarray, np.ndarray]:
    """Node pairs that one piece could join: those next to each other, and those with not too much turn between."""
    t = nodes.tangent
    turn = np.arctan2(t[:-1, 0] * t[1:, 1] - t[:-1, 1] * t[1:, 0], (t[:-1] * t[1:]).sum(1))
    total = np.concatenate([[0.0], np.cumsum(np.abs(turn))])
    first, last = np.triu_indices(len(t), 1)
    keep = (total[last] - total[first] <= WIDEST_TURN) | (last == first + 1)
    return first[keep], last[keep]


def _fits(
    section: Section, nodes: _Nodes, first: np.ndarray, last: np.ndarray, price: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of node pairs: lines and cubics (P, 4, 2), and what they cost (P,), in nats."""
    # Only points that tell something are sampled: a few that show between hidden ones must not be missed.
    telling = np.flatnonzero(section.weights > 0.0)
    lo, hi = (np.searchsorted(telling, nodes.index[pair]) for pair in (first, last))
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    rank = (lo[:, None] + (hi - lo)[:, None] * share).astype(int)
    index = np.append(telling, 0)[np.minimum(rank, max(len(telling) - 1, 0))]
    points = section.fits.positions[index]
    share_of = ((hi - lo) / SAMPLES)[:, None]
    weights = section.weights[index] * share_of
    ends = np.stack([nodes.at[first], nodes.at[last]], axis=1)
    tangents = np.stack([nodes.tangent[first], nodes.tangent[last]], axis=1)
    errors = np.stack([nodes.errors[first], nodes.errors[last]], axis=1)
    single = section.weights[index]
    run = Ends(ends, tangents, errors)
    rough = rough_cubics(run, points, weights)
    curve_misfit = _bounded(rough.squares * single, share_of)
    close = (curve_misfit < HOPELESS * (price + (hi - lo))) | (last == first + 1)
    exact = fit_cubics(run.taken(close), points[close], weights[close])
    cubics = rough.cubics
    cubics[close] = exact.cubics
    curve_misfit[close] = _bounded(exact.squares * single[close], share_of[close]) + exact.strain
    starts, stops = section.corners & (first == 0), section.corners & (last == len(nodes.index) - 1)
    cubic_cost = 0.5 * curve_misfit + price * (CUBIC_PARAMETERS + starts - nodes.level[last])
    line_cost = 0.5 * _line_misfit(points, weights, single, ends, errors[..., 0]) + price * LINE_PARAMETERS
    line_cost += (
        _strain(ends, tangents[:, 0], errors[:, 0]) * ~starts + _strain(ends, tangents[:, 1], errors[:, 1]) * ~stops
    )
    thirds = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])[:, None]
    lines = ends[:, :1] * (1.0 - thirds) + ends[:, 1:] * thirds
    return lines, cubics, line_cost, cubic_cost


def _bounded(squares: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(P,) chi^2 of squared residuals (P, K) in sigmas, linear beyond OUTLYING, each counted `share` (P, 1) times."""
    return (share * huber(np.sqrt(squares), OUTLYING)).sum(axis=1)


def _strain(ends: np.ndarray, tangents: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """(P,) nats for the angle between lines (P, 2, 2) and the tangents (P, 2) where they meet a smooth run."""
    way = ends[:, 1] - ends[:, 0]
    angle = np.arctan2(way[:, 0] * tangents[:, 1] - way[:, 1] * tangents[:, 0], (way * tangents).sum(1))
    slack = LINE_SLACK + errors[:, 1]
    return 0.5 * np.minimum(np.abs(angle) / slack, 30.0) ** 2


def _line_misfit(
    points: np.ndarray, weights: np.ndarray, single: np.ndarray, ends: np.ndarray, errors: np.ndarray
) -> np.ndarray:
    """(P,) chi^2 of the best line through each run of points (P, K, 2) and near its ends (P, 2, 2)."""
    share = np.concatenate([weights / np.maximum(single, 1e-12), np.ones(errors.shape)], axis=1)
    single = np.concatenate([single, errors**-2.0], axis=1)
    squares = _line_squares(np.concatenate([points, ends], axis=1), single * share)
    return _bounded(squares * single, share)


def _line_squares(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(P, K) squared distances, px^2, from the best line through each run of points (P, K, 2)."""
    total = np.maximum(weights.sum(1), 1e-12)
    centred = points - ((weights[..., None] * points).sum(1) / total[:, None])[:, None]
    x, y = centred[..., 0], centred[..., 1]
    xx, yy, xy = (weights * x * x).sum(1), (weights * y * y).sum(1), (weights * x * y).sum(1)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)[:, None]
    return (x * np.sin(angle) - y * np.cos(angle)) ** 2


def _cheapest(
    count: int, first: np.ndarray, last: np.ndarray, costs: np.ndarray, bend: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """The cheapest path from node 0 to node count - 1: its pairs in order, their kinds, and its cost.

    costs: (P, 2) of each pair as a line (kind 0) and as a cubic (kind 1). bend: of a line after a line.
    """
    best = np.full((count, 2), np.inf)
    best[0, 1] = 0.0
    via = np.zeros((count, 2), dtype=int)
    kind_before = np.zeros((count, 2), dtype=int)
    order = np.argsort(last, kind="stable")
    bounds = np.searchsorted(last[order], np.arange(count + 1))
    surcharge = np.array([[bend, 0.0], [0.0, 0.0]])
    for node in range(1, count):
        own = order[bounds[node] : bounds[node + 1]]
        totals = best[first[own]][:, :, None] + surcharge[None] + costs[own][:, None, :]
        flat = totals.reshape(-1, 2)
        k = flat.argmin(axis=0)
        best[node] = flat[k, [0, 1]]
        via[node], kind_before[node] = own[k // 2], k % 2
    path, kinds, node, kind = [], [], count - 1, int(best[-1].argmin())
    while node > 0:
        pair = via[node, kind]
        path.append(pair)
        kinds.append(kind)
        node, kind = first[pair], kind_before[node, kind]
    return np.array(path[::-1], dtype=int), np.array(kinds[::-1], dtype=int), float(best[-1].min())
