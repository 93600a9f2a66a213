"""How a loop of boundary points divides into pieces: which corners are real, and the runs between them.

Every corner but a sure one that turns little, or has another near, is kept only if that is cheaper than doing without,
and so are those in a row along a rounding. The runs between the corners, or the whole loop where none is left, are
divided into lines and cubics by dynamic programming: nodes are laid along a run, denser where it bends, each pair of
them gets the best line and the best cubic with the tangents measured there, and the cheapest path through the nodes is
the division. The price of a piece is half of chi^2 plus the price of a parameter times their number (description
length).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.tracing.corners import Corners
from cubicsplat_cli.raster.cubics import Division, laid_out

# Drawing programs sample edges on a grid of about quarter pixels, so the points of a nearly level or upright stretch
# err together as far as the stretch takes to cross a row of samples; they count as one.
GRID = 0.25  # px
FLATTEST = 0.01


@dataclass(frozen=True)
class Layout:
    """A divided loop. corners: those kept. order: the points from the first piece on. division: its pieces.

    weights: (n,) of the points, in their own order, 0 next to corners.
    """

    corners: Corners
    order: np.ndarray
    division: Division
    weights: np.ndarray


def independent(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The weights (n,) 1/px^2 of a loop, less where neighbouring points err together."""
    way = np.roll(points, -3, axis=0) - np.roll(points, 3, axis=0)
    slope = np.abs(way).min(axis=1) / np.maximum(np.abs(way).max(axis=1), 1e-9)
    return weights / (1.0 + GRID / np.maximum(slope, FLATTEST))


def lay_out(points: np.ndarray, weights: np.ndarray, corners: Corners, price: float) -> Layout:
    """The loop divided, without the corners that do not pay. price: of a parameter, in nats."""
    given = corners.indices, corners.positions, corners.turns, corners.sure
    division, kept, start, chosen = laid_out(points, weights, given, price)
    return Layout(corners.taken(kept), (start + np.arange(len(points))) % len(points), division, chosen)
