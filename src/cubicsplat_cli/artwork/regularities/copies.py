"""Outlines that are alike but for where they lie, or mirrored, or turned: one is the model, the others its copies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cubicsplat_cli.artwork.finish.merges import SEEN_SIGMA
from cubicsplat_cli.artwork.geometry.transforms import RigidTransform
from cubicsplat_cli.artwork.regularities.alike import FARTHEST, LARGEST, MEAN, ON_IT, SIGMAS, SYSTEMATIC, TRIES, Track
from cubicsplat_cli.artwork.regularities.turned import FEWEST, LENGTH_OFF, NEAR, STEPS, Turn, Walk, evenly, turned_onto
from cubicsplat_cli.raster.point_tree import ClosedLines

SIZE_OFF = 0.4  # px by which the extents of two outlines that are alike may differ
# Where all of them shows: px that what is alike is off, its farthest point, with the middles of the extents on each
# other, and px^2 for every px of the length by which areas differ, beyond the least.
ASTRAY, AREA_OFF, LEAST_AREA_OFF = 0.6, 0.1, 1.0
FIRST_LOOK = 16  # points of an outline that are compared before all of them are
MOST_MODELS = 32  # of about its size that an outline is compared with, the first ones
# As it is, mirrored either way, turned by half a circle.
FLIPS = np.array([[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])


def found_copies(
    tracks: Mapping[int, Track], numbers: Mapping[int, int], step: float, mirrors: tuple[float, float]
) -> dict[int, tuple[int, RigidTransform]]:
    """The outlines that are copies, by number: the number of the model of each, and how that comes to lie where it
    does. tracks: those of all, in the order in which they are to be models. numbers: how many variables each has.

    step: of the file's grid, px, of which shifts are whole multiples but after a turn. mirrors: twice where the axes of
    the canvas are, across which pairs lie that are nearly there.
    """
    walks = {k: Walk.of(track) for k, track in tracks.items()}
    pairs = 0.5 * len(tracks) ** 2
    # Most pairs are of other sizes.
    names = list(tracks)
    areas = np.array([walk.area for walk in walks.values()])
    lengths = np.array([walk.length for walk in walks.values()])
    # Root mean squares of their points from the middle: no farther apart than the points.
    steps = np.array([walk.steps for walk in walks.values()]).reshape(-1, STEPS)
    radii = np.sqrt((steps.real**2 + steps.imag**2).mean(axis=1))
    whole = np.array([track.whole for track in tracks.values()], dtype=bool)
    tells = np.array([len(track.seen) >= FEWEST for track in tracks.values()], dtype=bool)
    boxes = np.array([track.extent for track in tracks.values()]).reshape(-1, 2, 2)
    wide, high = np.ascontiguousarray((boxes[:, 1] - boxes[:, 0]).T)
    lines = ClosedLines([t.tree for t in tracks.values()], [t.seen for t in tracks.values()], boxes)
    level: dict[int, tuple[int, RigidTransform]] = {}
    turns: dict[int, dict[int, Turn]] = {}  # by model
    # What is turned is a model too of what lies as it does, so that both are written as the same text.
    first, models = (np.zeros(len(names), dtype=bool) for _ in range(2))
    for i, (k, track) in enumerate(tracks.items()):
        sized = first & (np.abs(wide - wide[i]) <= SIZE_OFF) & (np.abs(high - high[i]) <= SIZE_OFF)
        able = np.flatnonzero(sized if tells[i] else [])
        full = np.abs(areas[able] - areas[i]) <= AREA_OFF * walks[k].length + LEAST_AREA_OFF
        able = able[full | ~(whole[able] & track.whole)][:MOST_MODELS]
        # Where all of it shows, what is alike and of one size lies nearly right at once.
        astray = np.where(whole[able] & track.whole, ASTRAY, LARGEST)
        found = lines.first_on(i, able, astray, FLIPS, (LARGEST, FARTHEST, MEAN), (FIRST_LOOK, TRIES), ON_IT)
        if found is not None:
            model, flip, shift, told = found
            level[k] = names[model], _transform(tuple(FLIPS[flip].tolist()), shift, told, step, mirrors)
            continue
        first[i] = tells[i]
        long = models & (np.abs(lengths - lengths[i]) <= LENGTH_OFF) & (np.abs(radii - radii[i]) <= NEAR)
        like = [names[j] for j in np.flatnonzero(long)[:MOST_MODELS].tolist()]
        is_told = walks[k].is_certain(numbers[k], pairs)
        turned = ((m, turned_onto(tracks[m], walks[m], track, walks[k])) for m in (like if is_told else ()))
        rotated = next(((m, turn) for m, turn in turned if turn is not None), None)
        if rotated is None:
            turns[k], models[i] = {}, True
        else:
            turns[rotated[0]][k] = rotated[1]
    copies: dict[int, tuple[int, RigidTransform]] = {}
    for model, own in turns.items():
        copies |= {k: (model, each) for k, each in zip(own, evenly(list(own.values()), step), strict=True)}
    for k, (model, transform) in level.items():
        between = copies.get(model)
        copies[k] = (model, transform) if between is None else (between[0], transform.after(between[1]))
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
