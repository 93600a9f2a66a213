"""The best division of a run of points between two corners into lines and cubics, by dynamic programming.

Nodes are laid along the run, denser where it bends; each pair of nodes gets the best line and the best cubic with the
tangents measured there, and the cheapest path through them is the division. The price of a piece is half of chi^2 plus
the price of a parameter times their number (description length).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.cubics import fit_cubics
from cubicsplat_cli.artwork.smoothing import LocalFits, arc_lengths

MOST_NODES = 64
STRAIGHT_SHARE = 0.05  # of sqrt(1/px): how dense nodes are on straight stretches against bent ones
SAMPLES = 20
WIDEST_TURN = math.radians(200.0)  # of one cubic, all bends added
LINE_PARAMETERS, CUBIC_PARAMETERS = 2, 5


@dataclass(frozen=True)
class Section:
    """A run of m points. fits: of its m points. ends, tangents: (2, 2), where it starts and stops, px and unit.

    weights: (m,) 1/px^2, 0 where the points tell nothing. corners: whether the run starts and stops at a corner.
    """

    fits: LocalFits
    weights: np.ndarray
    ends: np.ndarray
    tangents: np.ndarray
    corners: tuple[bool, bool]


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


def divide(section: Section, price: float) -> Division:
    """The cheapest division. price: of a parameter, in nats."""
    nodes = _nodes(section)
    first, last = _pairs(nodes, section)
    lines, cubics, line_cost, cubic_cost = _fits(section, nodes, first, last, price)
    straight = line_cost <= cubic_cost
    path = _cheapest(len(nodes.index), first, last, np.where(straight, line_cost, cubic_cost))
    chosen, cost = path
    stops = np.append(first[chosen], len(nodes.index) - 1)
    return Division(
        breaks=nodes.index[stops],
        anchors=nodes.at[stops],
        tangents=nodes.tangent[stops],
        level=nodes.level[stops],
        lines=straight[chosen],
        cubics=np.where(straight[chosen, None, None], lines[chosen], cubics[chosen]),
        cost=cost,
    )


def _nodes(section: Section) -> _Nodes:
    fits, m = section.fits, len(section.weights)
    known = section.weights > 0.0
    density = np.sqrt(np.minimum(np.abs(fits.curvature), 1.0)) + STRAIGHT_SHARE
    s = arc_lengths(fits.positions)
    measure = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(s))])
    count = int(min(MOST_NODES, max(2, m // 2)))
    index = np.unique(np.searchsorted(measure, np.linspace(0.0, measure[-1], count)[1:-1]))
    extreme, at, tangent = _extrema(fits, known)
    index = index[known[index] & (index > 1) & (index < m - 2)]
    away = np.abs(index[:, None] - extreme[None, :]).min(axis=1, initial=m) > 1
    index = index[away]
    order = np.argsort(np.concatenate([index, extreme]), kind="stable")
    inner = np.concatenate([index, extreme])[order]
    at = np.concatenate([fits.positions[index], at])[order]
    tangent = np.concatenate([fits.tangents[index], tangent])[order]
    level = np.concatenate([np.zeros(len(index), bool), np.ones(len(extreme), bool)])[order]
    return _Nodes(
        np.concatenate([[0], inner, [m]]).astype(int),
        np.concatenate([section.ends[:1], at, section.ends[1:]]),
        np.concatenate([section.tangents[:1], tangent, section.tangents[1:]]),
        np.concatenate([[False], level, [False]]),
    )


def _extrema(fits: LocalFits, known: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the run is horizontal or vertical for a moment: index (E,), position (E, 2), tangent (E, 2)."""
    m = len(known)
    found, at, tangent = [], [], []
    for c in (0, 1):
        t = fits.tangents[:, c]
        cross = (t[:-1] * t[1:] <= 0.0) & known[:-1] & known[1:] & (np.abs(fits.curvature[:-1]) > 2e-3)
        for k in np.flatnonzero(cross):
            k = int(k if abs(t[k]) < abs(t[k + 1]) else k + 1)
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


def _pairs(nodes: _Nodes, section: Section) -> tuple[np.ndarray, np.ndarray]:
    """Node pairs that one piece could join: those next to each other, and those with not too much turn between."""
    t = nodes.tangent
    turn = np.arctan2(t[:-1, 0] * t[1:, 1] - t[:-1, 1] * t[1:, 0], (t[:-1] * t[1:]).sum(1))
    total = np.concatenate([[0.0], np.cumsum(np.abs(turn))])
    first, last = np.triu_indices(len(t), 1)
    keep = (total[last] - total[first] <= WIDEST_TURN) | (last == first + 1)
    return first[keep], last[keep]


def _fits(section: Section, nodes: _Nodes, first: np.ndarray, last: np.ndarray, price: float):
    m = len(section.weights)
    lo, hi = nodes.index[first], nodes.index[last]
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    index = np.minimum((lo[:, None] + (hi - lo)[:, None] * share).astype(int), m - 1)
    points = section.fits.positions[index]
    weights = section.weights[index] * ((hi - lo) / SAMPLES)[:, None]
    ends = np.stack([nodes.at[first], nodes.at[last]], axis=1)
    tangents = np.stack([nodes.tangent[first], nodes.tangent[last]], axis=1)
    fits = fit_cubics(ends, tangents, points, weights)
    starts_at_corner = section.corners[0] & (first == 0)
    stops_at_corner = section.corners[1] & (last == len(nodes.index) - 1)
    parameters = CUBIC_PARAMETERS + starts_at_corner + 0.0 * stops_at_corner - nodes.level[last]
    cubic_cost = 0.5 * (weights * fits.squares).sum(1) + price * parameters
    line_cost = 0.5 * _line_misfit(points, weights) + price * LINE_PARAMETERS
    thirds = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])[:, None]
    lines = ends[:, :1] * (1.0 - thirds) + ends[:, 1:] * thirds
    return lines, fits.cubics, line_cost, cubic_cost


def _line_misfit(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(P,) chi^2 of the best line through each run of points (P, K, 2)."""
    total = np.maximum(weights.sum(1), 1e-12)
    centred = points - ((weights[..., None] * points).sum(1) / total[:, None])[:, None]
    xx = (weights * centred[..., 0] ** 2).sum(1)
    yy = (weights * centred[..., 1] ** 2).sum(1)
    xy = (weights * centred[..., 0] * centred[..., 1]).sum(1)
    return np.maximum(0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy**2), 0.0)


def _cheapest(count: int, first: np.ndarray, last: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, float]:
    """Indices of the pairs on the cheapest path from node 0 to node count - 1, in order, and its cost."""
    best = np.full(count, np.inf)
    best[0] = 0.0
    via = np.full(count, -1)
    order = np.argsort(last, kind="stable")
    bounds = np.searchsorted(last[order], np.arange(count + 1))
    for node in range(1, count):
        own = order[bounds[node] : bounds[node + 1]]
        totals = best[first[own]] + cost[own]
        k = int(np.argmin(totals))
        best[node], via[node] = totals[k], own[k]
    path, node = [], count - 1
    while node > 0:
        path.append(via[node])
        node = first[via[node]]
    return np.array(path[::-1], dtype=int), float(best[-1])
