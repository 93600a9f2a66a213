"""The distance of an outline from another one, moved or mirrored."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.finish.merges import Visibility, samples_along
from cubicsplat_cli.artwork.finish.parameters import LEAST
from cubicsplat_cli.artwork.geometry.outlines import Ring, dense, flattened
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.record import record

FEWEST = 8  # points that show
STEP = 0.5  # px between the points of an outline
MOST = 400  # points of a piece
TRIES = 4  # times that points are brought nearer
LARGEST = 3.0  # px that they move at most to be
FARTHEST, MEAN = 0.2, 0.06  # px that what is alike may be off, its farthest point and in the mean,
# to which middles and radii are known too
SYSTEMATIC = 0.02  # px, the error of an axis or a shift besides that by chance
EXACT = 1e-6  # px by which what is alike and held so may be off
SIGMAS = 3.0  # errors within which places are one
CLEAR = 3.0  # nats by which a regularity must explain more than chance


@record
class Track:
    """A closed outline as a polyline, and its visible parts. points: (n, 2) px; tree: of them; seen: (m, 2) points that
    show."""

    points: np.ndarray
    tree: PointTree
    seen: np.ndarray

    @classmethod
    def of(cls, ring: Ring, visibility: Visibility) -> Track:
        points = dense(flattened(ring, STEP), STEP)
        samples, weights, _, _ = samples_along(ring, visibility, MOST)
        return cls(points, PointTree(points), samples[visibility.shows(weights)])

    @cached_property
    def extent(self) -> np.ndarray:
        """(2, 2) the least and the greatest x and y, px."""
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])

    def off(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (n,) how far points (n, 2) lie off the outline, and (n, 2) the unit directions in which they do."""
        return self.tree.off_line(points, LEAST)
