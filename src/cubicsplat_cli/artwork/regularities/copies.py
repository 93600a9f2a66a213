"""Outlines that are alike but for where they lie, or mirrored: one is the model, the others its copies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cubicsplat_cli.artwork.finish.merges import SEEN_SIGMA
from cubicsplat_cli.artwork.finish.parameters import LEAST
from cubicsplat_cli.artwork.geometry.transforms import RigidTransform
from cubicsplat_cli.artwork.regularities.alike import (
    FARTHEST,
    FEWEST,
    LARGEST,
    MEAN,
    SIGMAS,
    SYSTEMATIC,
    TRIES,
    Track,
)
from cubicsplat_cli.raster.point_tree import ClosedLines

NEAR = 0.4  # px by which the extents of outlines that are alike differ
FIRST_LOOK = 16  # points of an outline that are compared before all of them are
# px that points are off at most: at first, as what is alike and of one size lies nearly right at once; after a step; at
# last; and in the mean.
LIMITS = 3.0 * FARTHEST, LARGEST, FARTHEST, MEAN
# As it is, mirrored either way, turned by half a circle.
FLIPS = np.array([[x, y] for y in (1.0, -1.0) for x in (1.0, -1.0)])


def found_copies(
    tracks: Mapping[int, Track], step: float, mirrors: tuple[float, float]
) -> dict[int, tuple[int, RigidTransform]]:
    """The outlines that are copies, by number: the number of the model of each, and how that comes to lie where it
    does. tracks: those of all, in the order in which they are to be models.

    step: of the file's grid, px, of which shifts are whole multiples. mirrors: twice where the axes of the canvas are,
    across which pairs lie that are nearly there.
    """
    names, boxes = list(tracks), np.array([track.extent for track in tracks.values()]).reshape(-1, 2, 2)
    widths, heights = (boxes[:, 1] - boxes[:, 0]).T.copy()
    tells = np.array([len(track.seen) >= FEWEST for track in tracks.values()], dtype=bool)
    lines = ClosedLines([t.tree for t in tracks.values()], [t.seen for t in tracks.values()], boxes)
    models = np.zeros(len(names), dtype=bool)
    copies: dict[int, tuple[int, RigidTransform]] = {}
    for i in np.flatnonzero(tells).tolist():
        # Most pairs are of other sizes.
        sized = models & (np.abs(widths - widths[i]) <= NEAR) & (np.abs(heights - heights[i]) <= NEAR)
        found = lines.first_on(i, np.flatnonzero(sized), FLIPS, LIMITS, (FIRST_LOOK, TRIES), LEAST)
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
