"""Points on the centre line of a stroke, halfway between both of its sides."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.geometry.beziers import points_at
from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.records import dataclass

STEP = 0.05  # px between the points of an outline
REST = 0.46  # of a width, that the outline is from a point halfway across at the least
MOST_MOVED = 0.3  # widths, that such a point lies off the skeleton at the most
# A width is even where it is off the usual one by no more than a share of it and so many px.
EVEN_SHARE, EVEN_PX = 0.05, 0.2
_ROUNDS = 3


@dataclass(frozen=True)
class Sides:
    """The outline of a shape as closely spaced points (n, 2), with a tree to find the nearest."""

    points: np.ndarray
    tree: PointTree

    @classmethod
    def of(cls, rings: tuple[Ring, ...]) -> Sides:
        """Points STEP px apart along the rings."""
        found = []
        for ring in rings:
            for cubic in ring.cubics:
                length = float(np.hypot(*np.diff(cubic, axis=0).T).sum())
                t = np.arange(max(1, int(np.ceil(length / STEP)))) / max(1, int(np.ceil(length / STEP)))
                found.append(points_at(cubic[None], t[None])[0])
        points = np.concatenate(found)
        return cls(points, PointTree(points))

    def nearest(self, places: np.ndarray) -> np.ndarray:
        """(n, 2) the points of the outline nearest to places (n, 2)."""
        return self.points[self.tree.query(places)[1]]


@dataclass(frozen=True)
class Centres:
    """Along a branch: points (n, 2) px, widths (n,) px, and true (n,), whether both sides lie opposite each other.
    slack: px by which the outline may be off.
    """

    points: np.ndarray
    widths: np.ndarray
    true: np.ndarray
    slack: float = 0.0

    def even(self, width: float) -> np.ndarray:
        """(n,) bool: points where the stroke has a width."""
        return self.true & (np.abs(self.widths - width) <= EVEN_SHARE * width + EVEN_PX + 2.0 * self.slack)


def centres_of(places: np.ndarray, sides: Sides, slack: float = 0.0) -> Centres:
    """The centres near places (n, 2) of a skeleton: from the nearest point of the outline across to the other side.

    slack: px by which the outline may be off.
    """
    middle = places
    for _ in range(_ROUNDS):
        near = sides.nearest(middle)
        far = sides.nearest(2.0 * middle - near)
        middle = 0.5 * (near + far)
    # The other side is opposite where a disc between the two reaches the outline nowhere else.
    radius = np.hypot(*(sides.nearest(middle) - middle).T)
    widths = np.hypot(*(near - far).T)
    moved = np.hypot(*(middle - places).T)
    true = (widths > 0.0) & (radius > REST * widths) & (moved < MOST_MOVED * np.maximum(widths, 1.0))
    return Centres(middle, widths, true, slack)
