"""Corners of a loop of boundary points: where two flanks meet at an angle, and exactly where.

The tangent is extrapolated to each place from its left and from its right, by the widest run of neighbours that one
line or parabola explains. On an arc both agree, however tight it is; at a corner they differ by its angle, at every
scale. The points next to a corner are biased (a pixel there sees both flanks), so they never take part: the corner
is the intersection of the flanks, and the points between must only not contradict it, as those of a rounding do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.raster.outlines import corners_of


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


def find_corners(points: np.ndarray, weights: np.ndarray) -> Corners:
    """The corners of a closed loop. points: (n, 2) px. weights: (n,) 1/px^2, 0 where unknown."""
    indices, positions, turns = corners_of(points, weights)
    return Corners(indices, positions, turns, np.zeros(len(indices), bool))
