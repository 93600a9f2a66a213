"""Corners of a loop of boundary points: where two flanks meet at an angle, and exactly where.

The tangent is extrapolated to each place from its left and from its right, by the widest run of neighbours that one
line or parabola explains. On an arc both agree, however tight it is; at a corner they differ by its angle, at every
scale. The points next to a corner are biased (a pixel there sees both flanks), so they never take part: the corner
is the intersection of the flanks, and the points between must only not contradict it, as those of a rounding do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.tracing.smoothing import arc_lengths, most_misfit
from cubicsplat_cli.raster.outlines import flanks
from cubicsplat_cli.raster.point_tree import PointTree

GAP = 1.0  # px to either side of a place that are not looked at
FARTHEST = 4.5  # px from the place to the nearest point of a flank
WIDEST_GAP = 14.0  # px of unknown points in which a thin tip may lie
# Points of a flank less one, and its degree: lines alone, and parabolas where there are enough points.
STRAIGHT = ((2, 1), (3, 1), (5, 1), (8, 1))
BENT = ((2, 1), (3, 1), (5, 2), (8, 2), (12, 2))
LONGEST = 12
FIRST_MISFIT = 4.0  # of the shortest flank
SMALLEST_TURN = math.radians(20.0)
SURE_TURN = 5.0  # standard errors
BLUNT_TURN = math.radians(150.0)  # above which a tip may end before its flanks meet
SPACING = 2.0  # px between corners
ROUNDING = 0.3  # px that points near a sharp corner may stay away from its flanks
SURE_SIGMA = 0.3  # px: less certain points take no part

Kinds = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Corners:
    """C corners in order: index (C,) of the first point after, position (C, 2) px, turn (C,) radians, in (-pi, pi).

    sure: (C,) bool, those that nothing may take away.
    """

    indices: np.ndarray
    positions: np.ndarray
    turns: np.ndarray
    sure: np.ndarray

    def taken(self, which: np.ndarray) -> Corners:
        """Some of the corners, in their order."""
        return Corners(self.indices[which], self.positions[which], self.turns[which], self.sure[which])

    def with_known(self, indices: np.ndarray, points: np.ndarray, weights: np.ndarray) -> Corners:
        """With corners right at hidden points of a loop in place of those found where these points are hidden.

        indices: (k,) of the points; points: (n, 2) px, weights: (n,) 1/px^2, 0 where hidden, of the loop.
        """
        if not len(indices):
            return self
        hidden = weights <= 0.0
        # Every hidden run, with the point after it, bears the number of the visible points before it.
        run = np.cumsum(~hidden) % max(int((~hidden).sum()), 1)
        number = np.where(hidden, run, np.where(np.roll(hidden, 1), np.roll(run, 1), -1))
        rest = self.taken(~np.isin(number[self.indices], number[indices]))
        added = np.concatenate([rest.indices, indices])
        order = np.argsort(added, kind="stable")
        none, known = np.zeros(len(indices)), np.ones(len(indices), dtype=bool)
        return Corners(
            added[order],
            np.concatenate([rest.positions, points[indices]])[order],
            np.concatenate([rest.turns, none])[order],
            np.concatenate([rest.sure, known])[order],
        )


@dataclass(frozen=True)
class _Flanks:
    """Of each place, the run on one side extrapolated to it.

    at: (n, 2) px. tangent: (n, 2) unit. error: (n,) of the tangent, radians, inf where there is no run. first: (n,) the
    run's point nearest to the place.
    """

    at: np.ndarray
    tangent: np.ndarray
    error: np.ndarray
    first: np.ndarray


def find_corners(points: np.ndarray, weights: np.ndarray) -> Corners:
    """The corners of a closed loop. points: (n, 2) px. weights: (n,) 1/px^2, 0 where unknown."""
    known = np.flatnonzero(weights > SURE_SIGMA**-2)
    n = len(known)
    if n < 6:
        return Corners(np.zeros(0, int), np.zeros((0, 2)), np.zeros(0), np.zeros(0, bool))
    pad = min(n, LONGEST + 6)
    index = known[np.arange(-pad, n + pad) % n]
    loop, sharp = points[index], weights[index]
    s = _unrolled(points, known, pad)
    places = 0.5 * (s[:-1] + s[1:])
    before, after = _both_sides(loop, sharp, s, places, STRAIGHT)
    turn, meet, score = _judged(loop, before, after)
    bent = _judged(loop, *_both_sides(loop, sharp, s, places, BENT))
    # A corner is one by lines and by parabolas; the smaller turn is the better founded one.
    choose = np.abs(bent[0]) < np.abs(turn)
    turn, score = np.where(choose, bent[0], turn), np.where(choose, bent[2], score)
    meet = np.where(choose[:, None], bent[1], meet)
    score[:pad] = score[pad + n :] = 0.0
    chosen = _strongest(score, meet)
    ends = zip(index[before.first[chosen]], index[after.first[chosen]], meet[chosen], strict=True)
    split = [_first_after(points, a, b, at) for a, b, at in ends]
    indices, order = np.unique(np.array(split, dtype=int), return_index=True)
    return Corners(indices, meet[chosen][order], turn[chosen][order], np.zeros(len(indices), bool))


def _first_after(points: np.ndarray, before: int, after: int, corner: np.ndarray) -> int:
    """Which point of a loop is the first one after a corner that lies between two of them."""
    n = len(points)
    between = (before + np.arange((after - before) % n + 1)) % n
    away = np.hypot(*(points[between] - corner).T)
    return int(between[1 + int(np.argmin(away[1:] + away[:-1]))])


def _unrolled(points: np.ndarray, known: np.ndarray, pad: int) -> np.ndarray:
    """Arc length at the known points of a loop, with `pad` more of them to either side."""
    s = arc_lengths(np.vstack([points, points[:1]]))
    own, total = s[known], s[-1]
    number = np.arange(-pad, len(known) + pad)
    return own[number % len(known)] + total * (number // len(known))


def _both_sides(
    loop: np.ndarray, weights: np.ndarray, s: np.ndarray, places: np.ndarray, kinds: Kinds
) -> tuple[_Flanks, _Flanks]:
    """The flanks before and after each place, both along the loop."""
    back = _flanks(loop[::-1], weights[::-1], -s[::-1], -places[::-1], kinds)
    before = _Flanks(back.at[::-1], -back.tangent[::-1], back.error[::-1], len(s) - 1 - back.first[::-1])
    return before, _flanks(loop, weights, s, places, kinds)


def _judged(loop: np.ndarray, a: _Flanks, b: _Flanks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turn, meeting point and score of each place; a score of 0 is no corner."""
    cross = a.tangent[:, 0] * b.tangent[:, 1] - a.tangent[:, 1] * b.tangent[:, 0]
    turn = np.arctan2(cross, (a.tangent * b.tangent).sum(1))
    gap = b.at - a.at
    t = (gap[:, 0] * b.tangent[:, 1] - gap[:, 1] * b.tangent[:, 0]) / np.where(np.abs(cross) > 1e-6, cross, np.inf)
    meet = a.at + t[:, None] * a.tangent
    reach = ((meet - loop[a.first]) * a.tangent).sum(1)
    onward = ((loop[b.first] - meet) * b.tangent).sum(1)
    good = np.abs(turn) >= np.maximum(SMALLEST_TURN, SURE_TURN * np.hypot(a.error, b.error))
    good &= np.minimum(reach, onward) > -0.5
    # A tip is drawn to where it is half a pixel wide; much farther on there is none, wherever the flanks would meet.
    most = FARTHEST + 0.5 / np.maximum(np.tan(0.5 * (math.pi - np.abs(turn))), 0.15)
    blunt = 0.5 * (loop[a.first] + loop[b.first]) + 0.5 * most[:, None] * (a.tangent - b.tangent)
    meet = np.where((np.maximum(reach, onward) > most)[:, None], blunt, meet)
    good &= (np.maximum(reach, onward) <= most) | (np.abs(turn) > BLUNT_TURN)
    good &= _contradiction(loop, meet, a, b) <= ROUNDING
    return turn, meet, np.where(good, 2.0 + np.abs(turn) - 0.15 * np.abs(reach - onward), 0.0)


def _contradiction(loop: np.ndarray, meet: np.ndarray, a: _Flanks, b: _Flanks) -> np.ndarray:
    """Largest distance from the two flanks, extended to where they meet, of the points between them."""
    worst = np.zeros(len(meet))
    for offset in range(1, 8):
        index = a.first + offset
        between = index < b.first
        if not between.any():
            break
        p = loop[np.minimum(index, len(loop) - 1)] - meet
        distances = []
        for away in (-a.tangent, b.tangent):
            along = np.maximum((p * away).sum(1), 0.0)
            distances.append(np.hypot(*(p - along[:, None] * away).T))
        worst = np.where(between, np.maximum(worst, np.minimum(*distances)), worst)
    return worst


def _flanks(points: np.ndarray, weights: np.ndarray, s: np.ndarray, places: np.ndarray, kinds: Kinds) -> _Flanks:
    """The run after each place, by the widest believed fit."""
    spread = np.diff(s)
    farthest = np.where(spread < WIDEST_GAP, np.maximum(FARTHEST, 0.5 * spread + 2.0), FARTHEST)
    believed = [
        (length, degree, most_misfit(length - degree) if k else FIRST_MISFIT)
        for k, (length, degree) in enumerate(kinds)
    ]
    return _Flanks(*flanks(points, weights, s, places, farthest, GAP, believed))


def _strongest(score: np.ndarray, meet: np.ndarray) -> np.ndarray:
    """Indices of the strongest corners, none within SPACING of a stronger one, in order."""
    able = np.flatnonzero((score > 0.0) & np.isfinite(meet).all(axis=1))
    near = PointTree(meet[able]).query_ball_point(meet[able], SPACING) if len(able) else []
    free, chosen = np.ones(len(able), dtype=bool), []
    for k in np.argsort(-score[able], kind="stable").tolist():
        if free[k]:
            chosen.append(int(able[k]))
            free[near[k]] = False
    return np.array(sorted(chosen), dtype=int)
