"""The best division of a run of points between two corners into lines and cubics, by dynamic programming.

Nodes are laid along the run, denser where it bends; each pair of nodes gets the best line and the best cubic with the
tangents measured there, and the cheapest path through them is the division. The price of a piece is half of chi^2 plus
the price of a parameter times their number (description length).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.tracing.smoothing import LocalFits, arc_lengths
from cubicsplat_cli.raster.cubics import cheapest_path, piece_misfits

SURE_WEIGHT = 4.0  # 1/px^2: points that know less are no place for a joint
FEWEST_NODES, MOST_NODES = 6, 48
NODES_PER_RADIAN = 4.0
STRAIGHT_SHARE = 0.01  # of sqrt(1/px): how dense nodes are on straight stretches against bent ones
WIDEST_TURN = math.radians(200.0)  # of one cubic, all bends added
LINE_PARAMETERS, CUBIC_PARAMETERS = 2, 5
BEND_PARAMETERS = 4  # of a line after a line where no corner was found
# The least that two pieces cost: two lines with a bend, or a line and a cubic.
PAIR_PARAMETERS = (LINE_PARAMETERS + CUBIC_PARAMETERS + 1, LINE_PARAMETERS + CUBIC_PARAMETERS)
CORNER_ERRORS = (0.15, 0.3)  # px and radians: how well the ends at corners are known beforehand
LEAST_ERRORS = (0.01, 0.01)  # px and radians


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
    chosen, kinds, cost = cheapest_path(len(nodes.index), first, last, costs, BEND_PARAMETERS * price)
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
    some = telling if len(telling) else np.zeros(1, dtype=int)
    given = np.searchsorted(telling, nodes.index), nodes.at, nodes.tangent, nodes.errors
    points, weights = section.fits.positions[some], section.weights[some]
    cubics, cubic_misfit, line_misfit, bends = piece_misfits(first, last, given, points, weights, price)
    starts, stops = section.corners & (first == 0), section.corners & (last == len(nodes.index) - 1)
    cubic_cost = 0.5 * cubic_misfit + price * (CUBIC_PARAMETERS + starts - nodes.level[last])
    line_cost = 0.5 * line_misfit + price * LINE_PARAMETERS + bends[:, 0] * ~starts + bends[:, 1] * ~stops
    ends = np.stack([nodes.at[first], nodes.at[last]], axis=1)
    thirds = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])[:, None]
    return ends[:, :1] * (1.0 - thirds) + ends[:, 1:] * thirds, cubics, line_cost, cubic_cost
