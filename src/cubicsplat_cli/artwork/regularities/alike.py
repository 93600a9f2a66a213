"""How far an outline lies from another one, moved or mirrored; outlines that are copies of another one, the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.finish.merges import SEEN_SIGMA, Visibility, samples_along
from cubicsplat_cli.artwork.finish.parameters import LEAST, MEAN_ERROR, RigidTransform
from cubicsplat_cli.artwork.geometry.fitting import SYSTEMATIC
from cubicsplat_cli.artwork.geometry.outlines import Ring, dense, flattened
from cubicsplat_cli.artwork.layers.translucent import SIGMAS
from cubicsplat_cli.raster.point_tree import ClosedLines, PointTree
from cubicsplat_cli.record import record

FEWEST = 8  # points that show
STEP = 0.5  # px between the points of an outline
FARTHEST = 0.2  # px that what is alike may be off at its farthest point
# As it is, mirrored either way, turned by half a circle.
FLIPS = np.array([[x, y] for y in (1.0, -1.0) for x in (1.0, -1.0)])


@record
class Track:
    """A closed outline as a polyline, and what shows. points: (n, 2) px; tree: of them; seen: (m, 2) that show."""

    points: np.ndarray
    tree: PointTree
    seen: np.ndarray

    @classmethod
    def of(cls, ring: Ring, visibility: Visibility) -> Track:
        points = dense(flattened(ring, STEP), STEP)
        samples, weights, _, _ = samples_along(ring, visibility)
        return cls(points, PointTree(points), samples[weights > 0.5 * visibility.sigma**-2])

    @cached_property
    def extent(self) -> np.ndarray:
        """(2, 2) the least and the greatest x and y, px."""
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])


def lines_of(tracks: Sequence[Track]) -> ClosedLines:
    """Return outlines to be laid on one another, or each on itself."""
    boxes = np.array([track.extent for track in tracks]).reshape(-1, 2, 2)
    trees, shown = [track.tree for track in tracks], [track.seen for track in tracks]
    # px off at most: at first, when the middles of two boxes may be FARTHEST off each way; at last; in the mean.
    limits = (1.0 + 2.0**0.5) * FARTHEST, FARTHEST, MEAN_ERROR
    # 16 points are compared before all are. They are brought nearer 4 times.
    return ClosedLines(trees, shown, boxes, limits, (16, 4), LEAST)


def found_copies(
    tracks: Mapping[int, Track], step: float, mirrors: tuple[float, float]
) -> dict[int, tuple[int, RigidTransform]]:
    """The outlines that are copies, by number: the number of the model of each, and how that comes to lie where it
    does. tracks: those of all, in the order in which they are to be models.

    step: of the file's grid, px, of which shifts are whole multiples. mirrors: twice where the axes of the canvas are,
    across which pairs lie that are nearly there.
    """
    names, lines = list(tracks), lines_of([*tracks.values()])
    widths, heights = np.array([np.ptp(track.extent, axis=0) for track in tracks.values()]).reshape(-1, 2).T.copy()
    tells = np.array([len(track.seen) >= FEWEST for track in tracks.values()], dtype=bool)
    models = np.zeros(len(names), dtype=bool)
    copies: dict[int, tuple[int, RigidTransform]] = {}
    for i in np.flatnonzero(tells).tolist():
        # Most pairs are of other sizes, whose ends are off by more than FARTHEST each.
        sized = models & (np.abs(widths - widths[i]) <= 2.0 * FARTHEST)
        sized &= np.abs(heights - heights[i]) <= 2.0 * FARTHEST
        found = lines.first_on(i, np.flatnonzero(sized), FLIPS)
        if found is None:
            models[i] = True
        else:
            model, flip, shift, told = found
            copies[names[i]] = names[model], _transform(tuple(FLIPS[flip].tolist()), shift, told, step, mirrors)
    return copies


def _transform(
    flip: tuple[float, float], shift: np.ndarray, told: np.ndarray, step: float, mirrors: tuple[float, float]
) -> RigidTransform:
    """The transform with a flip and about a shift (2,), of which the points of both outlines tell so much (2,)."""
    errors = 2.0 * SEEN_SIGMA / np.sqrt(told)
    for c in (0, 1):
        home = mirrors[c] if flip[c] < 0.0 else 0.0
        if abs(shift[c] - home) <= SIGMAS * np.hypot(errors[c], SYSTEMATIC):
            shift[c] = home
    return RigidTransform(flip, tuple((np.rint(shift / step) * step).tolist()))
