"""Outlines that are alike but for where they lie, or mirrored, or turned: one is the model, the others its copies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cubicsplat_cli.artwork.finish.merges import SEEN_SIGMA
from cubicsplat_cli.artwork.geometry.transforms import RigidTransform
from cubicsplat_cli.artwork.regularities.alike import FARTHEST, LARGEST, MEAN, ON_IT, SIGMAS, SYSTEMATIC, TRIES, Track
from cubicsplat_cli.artwork.regularities.turned import LENGTH_OFF, NEAR, STEPS, Turn, Walk, evenly, turned_onto
from cubicsplat_cli.record import record

SIZE_OFF = 0.4  # px by which the extents of two outlines that are alike may differ
# Where all of them shows: px that what is alike is off, its farthest point, with the middles of the extents on each
# other, and px^2 for every px of the length by which areas differ, beyond the least.
ASTRAY, AREA_OFF, LEAST_AREA_OFF = 0.6, 0.1, 1.0
FIRST_LOOK = 16  # points of an outline that are compared before all of them are
MOST_MODELS = 32  # of about its size that an outline is compared with, the first ones
FLIPS = ((1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))  # as it is, mirrored either way, turned by half a circle


@record
class Copy:
    """That an outline is like another one. model: its number; transform: how it comes to lie where it does."""

    model: int
    transform: RigidTransform


def found_copies(
    tracks: Mapping[int, Track], numbers: Mapping[int, int], step: float, mirrors: tuple[float, float]
) -> dict[int, Copy]:
    """The outlines that are copies, by number; tracks: those of all, in the order in which they are to be models.
    numbers: how many variables each has.

    step: of the file's grid, px, of which shifts are whole multiples but after a turn. mirrors: twice where the axes of
    the canvas are, across which pairs lie that are nearly there.
    """
    walks = {k: Walk.of(track) for k, track in tracks.items()}
    pairs = 0.5 * len(tracks) ** 2
    # Most pairs are of other sizes.
    names = list(tracks)
    spans = np.array([track.extent[1] - track.extent[0] for track in tracks.values()]).reshape(-1, 2)
    areas = np.array([walk.area for walk in walks.values()])
    lengths = np.array([walk.length for walk in walks.values()])
    # Root mean squares of their points from the middle, along the axes and in all: no farther apart than the points.
    steps = np.array([walk.steps for walk in walks.values()]).reshape(-1, STEPS)
    widths = np.sqrt(np.array([steps.real**2, steps.imag**2]).mean(axis=2))
    radii = np.hypot(*widths)
    whole = np.array([track.whole for track in tracks.values()], dtype=bool)
    level: dict[int, Copy] = {}
    turns: dict[int, dict[int, Turn]] = {}  # by model
    # What is turned is a model too of what lies as it does, so that both are written as the same text.
    first, models = (np.zeros(len(names), dtype=bool) for _ in range(2))
    for i, (k, track) in enumerate(tracks.items()):
        sized = (
            first & (np.abs(spans[:, 0] - spans[i, 0]) <= SIZE_OFF) & (np.abs(spans[:, 1] - spans[i, 1]) <= SIZE_OFF)
        )
        full = np.abs(areas - areas[i]) <= AREA_OFF * walks[k].length + LEAST_AREA_OFF
        sized &= full | ~(whole & track.whole)
        able = [names[j] for j in np.flatnonzero(sized)[:MOST_MODELS].tolist()]
        transforms = ((m, _transform(tracks[m], track, step, mirrors)) for m in able)
        found = next(((m, each) for m, each in transforms if each is not None), None)
        if found is not None:
            level[k] = Copy(*found)
            continue
        first[i] = True
        long = models & (np.abs(lengths - lengths[i]) <= LENGTH_OFF) & (np.abs(radii - radii[i]) <= NEAR)
        able = [names[j] for j in np.flatnonzero(long)[:MOST_MODELS].tolist()]
        told = walks[k].is_certain(numbers[k], pairs)
        turned = ((m, turned_onto(tracks[m], walks[m], track, walks[k])) for m in (able if told else ()))
        rotated = next(((m, turn) for m, turn in turned if turn is not None), None)
        if rotated is None:
            turns[k], models[i] = {}, True
        else:
            turns[rotated[0]][k] = rotated[1]
    copies: dict[int, Copy] = {}
    for model, own in turns.items():
        copies |= {k: Copy(model, each) for k, each in zip(own, evenly(list(own.values()), step), strict=True)}
    for k, copy in level.items():
        between = copies.get(copy.model)
        copies[k] = copy if between is None else Copy(between.model, copy.transform.after(between.transform))
    return copies


def _transform(model: Track, track: Track, step: float, mirrors: tuple[float, float]) -> RigidTransform | None:
    """The transform that takes a model to an outline; None where they are not alike."""
    (low, high), (start, end) = model.extent, track.extent
    if min(len(model.seen), len(track.seen)) < 8:
        return None
    for flip in FLIPS:
        signs = np.array(flip)
        shift = 0.5 * (start + end) - 0.5 * signs * (low + high)
        settled = _fitted(model, track, signs, shift)
        if settled is not None:
            shift, error = settled
            for c in (0, 1):
                home = mirrors[c] if flip[c] < 0.0 else 0.0
                if abs(shift[c] - home) <= SIGMAS * np.hypot(error[c], SYSTEMATIC):
                    shift[c] = home
            return RigidTransform(flip, tuple((np.rint(shift / step) * step).tolist()))
    return None


def _fitted(model: Track, track: Track, signs: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The shift (2,) with which the model lies nearest to an outline, and its standard errors (2,) px; None where it
    lies not near enough."""
    most = ASTRAY if model.whole and track.whole else LARGEST
    # Most outlines are not alike, which a few points tell.
    if track.off((model.seen * signs + shift)[:: len(model.seen) // FIRST_LOOK + 1])[0].max() > most:
        return None
    # Where all of it shows, what is alike and of one size lies nearly right at once.
    limits = most, LARGEST, FARTHEST, MEAN
    found = model.tree.laid_on(model.seen, track.tree, track.seen, (signs, shift), limits, TRIES, ON_IT)
    return None if found is None else (found[0], 2.0 * SEEN_SIGMA / np.sqrt(found[1]))
