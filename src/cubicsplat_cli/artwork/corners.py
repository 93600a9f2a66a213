"""Corners of a loop of boundary points: where two flanks meet at an angle, and exactly where.

The tangent is extrapolated to each point from its left and from its right, by the widest run of neighbours that one
line or parabola explains. On an arc both agree, however tight it is; at a corner they differ by its angle, at every
scale. The points next to a corner are biased (a pixel there sees both flanks), so they never take part: the corner
is the intersection of the flanks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.smoothing import WINDOW_MISFIT, arc_lengths

GAP = 1.5  # px next to a corner that are not looked at
FLANKS = (2, 3, 5, 8, 12)  # points of a flank less one; parabolas from PARABOLA on
PARABOLA = 5
SMALLEST_TURN = math.radians(20.0)
SPACING = 2.5  # px between corners
TIP_DISTANCE = 0.45  # px from a right angle's tip to the nearest boundary sample, at most


@dataclass(frozen=True)
class Corners:
    """C corners in order: index (C,) of the nearest point, position (C, 2) px, turn (C,) radians, in (-pi, pi)."""

    indices: np.ndarray
    positions: np.ndarray
    turns: np.ndarray


def find_corners(points: np.ndarray, weights: np.ndarray) -> Corners:
    """The corners of a closed loop. points: (n, 2) px. weights: (n,) 1/px^2, 0 where unknown."""
    n = len(points)
    pad = min(n, FLANKS[-1] + 4)
    index = np.arange(-pad, n + pad) % n
    loop, known = points[index], weights[index]
    s = arc_lengths(loop)
    inner = slice(pad, pad + n)
    back = _flanks(loop[::-1], known[::-1], s[-1] - s[::-1])
    a, ta, sure_a = (part[::-1][inner] for part in back)
    ta = -ta
    b, tb, sure_b = (part[inner] for part in _flanks(loop, known, s))
    turn = np.arctan2(ta[:, 0] * tb[:, 1] - ta[:, 1] * tb[:, 0], (ta * tb).sum(1))
    meet = _intersection(a, ta, b, tb)
    tip = np.hypot(*(meet - points).T)
    good = (np.abs(turn) >= SMALLEST_TURN) & sure_a & sure_b & (tip <= 2.0)
    good &= _nearest(meet, points) <= _tip_allowance(turn)
    chosen = _strongest(np.where(good, np.abs(turn) - 0.15 * tip, 0.0), meet)
    return Corners(chosen, meet[chosen], turn[chosen])


def _flanks(points: np.ndarray, weights: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The run after each point, extrapolated back to it: position, unit tangent (n, 2), and whether any fits."""
    n = len(points)
    start = np.searchsorted(s, s + GAP - 0.25)
    at, slope = points.copy(), np.tile([1.0, 0.0], (n, 1))
    growing = np.ones(n, dtype=bool)
    sure = np.zeros(n, dtype=bool)
    for length in FLANKS:
        index = start[:, None] + np.arange(length + 1)
        inside = index[:, -1] < n
        index = np.minimum(index, n - 1)
        degree = 2 if length >= PARABOLA else 1
        terms, misfit = _one_sided(points[index] - points[:, None], weights[index], s[index] - s[:, None], degree)
        ok = inside & (misfit <= (WINDOW_MISFIT if length > FLANKS[0] else 25.0)) & (weights[index] > 0.0).all(axis=1)
        growing &= ok | (length == FLANKS[0])
        take = growing & ok
        sure |= take
        at[take] = points[take] + terms[take, 0]
        slope[take] = terms[take, 1]
    return at, slope / np.maximum(np.hypot(*slope.T), 1e-12)[:, None], sure


def _one_sided(offsets: np.ndarray, weights: np.ndarray, ds: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    powers = ds[..., None] ** np.arange(degree + 1)
    w = weights + 1e-9
    weighted = powers * w[..., None]
    gram = np.einsum("nki,nkj->nij", weighted, powers)
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(degree + 1)
    terms = np.linalg.solve(gram, np.einsum("nki,nkc->nic", weighted, offsets))
    rest = offsets - powers @ terms
    slope = terms[:, 1] / np.maximum(np.hypot(*terms[:, 1].T), 1e-12)[:, None]
    across = rest[..., 0] * slope[:, None, 1] - rest[..., 1] * slope[:, None, 0]
    return terms, (w * across**2).sum(axis=1) / (ds.shape[1] - degree - 1)


def _intersection(a: np.ndarray, ta: np.ndarray, b: np.ndarray, tb: np.ndarray) -> np.ndarray:
    cross = ta[:, 0] * tb[:, 1] - ta[:, 1] * tb[:, 0]
    gap = b - a
    t = (gap[:, 0] * tb[:, 1] - gap[:, 1] * tb[:, 0]) / np.where(np.abs(cross) > 1e-6, cross, np.inf)
    return a + t[:, None] * ta


def _nearest(meet: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of each meeting point from the polyline near its own point."""
    best = np.full(len(points), np.inf)
    for k in range(-3, 3):
        p, q = np.roll(points, -k, axis=0), np.roll(points, -k - 1, axis=0)
        d = q - p
        t = np.clip(((meet - p) * d).sum(1) / np.maximum((d * d).sum(1), 1e-12), 0.0, 1.0)
        best = np.minimum(best, np.hypot(*(meet - p - t[:, None] * d).T))
    return best


def _tip_allowance(turn: np.ndarray) -> np.ndarray:
    """How far the samples may stay away from a sharp tip: it grows as the tip gets thinner than a pixel."""
    interior = np.maximum(math.pi - np.abs(turn), 0.1)
    return np.clip(TIP_DISTANCE / np.tan(interior / 2.0), 0.15, 3.0)


def _strongest(score: np.ndarray, meet: np.ndarray) -> np.ndarray:
    """Indices of the strongest corners, none within SPACING of a stronger one, in order."""
    chosen: list[int] = []
    for i in np.argsort(-score, kind="stable"):
        if score[i] <= 0.0:
            break
        if not chosen or np.hypot(*(meet[chosen] - meet[i]).T).min() >= SPACING:
            chosen.append(int(i))
    return np.array(sorted(chosen), dtype=int)
