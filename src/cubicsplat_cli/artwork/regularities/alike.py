"""The distance of an outline from another one, moved or mirrored."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.finish.merges import SEEN_SIGMA, Visibility, samples_along
from cubicsplat_cli.artwork.geometry.outlines import Ring, dense, flattened
from cubicsplat_cli.artwork.regularities.mirrored import Axis
from cubicsplat_cli.artwork.regularities.ties import LEAST
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.record import record

FEWEST = 8  # points that show
STEP = 0.5  # px between the points of an outline
MOST = 400  # points of a piece
TRIES = 4  # times that points are brought nearer
LARGEST = 3.0  # px that they move at most to be
FARTHEST, MEAN = 0.2, 0.06  # px that what is alike may be off, its farthest point and in the mean
SYSTEMATIC = 0.02  # px, the error of an axis or a shift besides that by chance
SIGMAS = 3.0  # errors within which places are one
CLEAR = 3.0  # nats by which a regularity must explain more than chance


@record
class Track:
    """A closed outline as a polyline, and what of it shows. points: (n, 2) px; tree: of them; seen: (m, 2) points that
    show; whole: whether all of it does."""

    points: np.ndarray
    tree: PointTree
    seen: np.ndarray
    whole: bool

    @classmethod
    def of(cls, ring: Ring, visibility: Visibility) -> Track:
        points = dense(flattened(ring, STEP), STEP)
        samples, weights, _, _ = samples_along(ring, visibility, MOST)
        shown = weights > 0.5 * visibility.sigma**-2
        return cls(points, PointTree(points), samples[shown], bool(shown.all()))

    @cached_property
    def extent(self) -> np.ndarray:
        """(2, 2) the least and the greatest x and y, px."""
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])

    def off(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) how far points (n, 2) lie off the outline, and (n, 2) the unit directions in which they do."""
        return self.tree.off_line(points, LEAST)


@record
class Symmetry:
    """That an outline is about its own mirror image. error: standard error of where the axis is, px; most, mean: px by
    which points that show are off, the farthest and in the root mean square."""

    axis: Axis
    error: float
    most: float
    mean: float


def symmetry_of(track: Track, across: int) -> Symmetry | None:
    """The symmetry of an outline about an axis across a coordinate; None where hardly anything of it tells."""
    if len(track.seen) < FEWEST:
        return None
    low, high = track.points[:, across].min(), track.points[:, across].max()
    axis = Axis(across, 0.5 * float(low + high))
    for _ in range(TRIES):
        size, ways = track.off(axis.mirrored(track.seen))
        tells = float((ways[:, across] ** 2).sum())
        if size.max() > LARGEST or tells < 1.0:
            return None
        axis = Axis(across, axis.at - 0.5 * float((ways[:, across] * size).sum()) / tells)
    size, _ = track.off(axis.mirrored(track.seen))
    return Symmetry(axis, SEEN_SIGMA / np.sqrt(2.0 * tells), float(size.max()), float(np.sqrt((size**2).mean())))
