"""Outlines that are alike but for where they lie, or mirrored, or turned: one is the model, the others its copies.

For a turn both outlines are walked round at even steps. Seen from their middles the steps are complex numbers, and of
two outlines that are alike those of one are those of the other times a turn, from some step on: the correlation of the
two rows, by the fast Fourier transform, says from which, and its argument is the turn. Copies of one outline that lie
evenly around a middle then share it, and their angles are whole multiples of the n-th part of a turn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.finish.merges import SEEN_SIGMA
from cubicsplat_cli.artwork.finish.parameters import LEAST
from cubicsplat_cli.artwork.geometry.transforms import RigidTransform
from cubicsplat_cli.artwork.regularities.alike import (
    CLEAR,
    FARTHEST,
    FEWEST,
    LARGEST,
    MEAN,
    SIGMAS,
    SYSTEMATIC,
    TRIES,
    Track,
    nearest,
)
from cubicsplat_cli.raster.point_tree import ClosedLines
from cubicsplat_cli.record import record

STEPS = 128  # round an outline
# Px by which lengths of outlines that are alike differ, and their steps in the mean and extents.
LENGTH_OFF, NEAR = 0.8, 0.4
ALIKE = 0.1  # px by which turns that fit as well differ in that
MOST_PARTS = 36  # of a turn
# Where all of them shows: px that what is alike is off, its farthest point, with the middles of the extents on each
# other, and px^2 for every px of the length by which areas differ, beyond the least.
ASTRAY, AREA_OFF, LEAST_AREA_OFF = 0.6, 0.1, 1.0
FIRST_LOOK = 16  # points of an outline that are compared before all of them are
MOST_MODELS = 32  # of about its size that an outline is compared with, the first ones
# As it is, mirrored either way, turned by half a circle.
FLIPS = np.array([[x, y] for y in (1.0, -1.0) for x in (1.0, -1.0)])


@record
class Walk:
    """An outline at even steps, clockwise as seen. middle: of the steps, steps: from there, complex numbers of px;
    length: px."""

    middle: complex
    steps: np.ndarray
    length: float

    @classmethod
    def of(cls, track: Track) -> Walk:
        points = track.points @ np.array([1.0, 1.0j])
        if (np.conj(points) * np.roll(points, -1)).imag.sum() < 0.0:
            points = points[::-1]
        closed = np.append(points, points[0])
        along = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(closed)))])
        steps = np.interp(np.arange(STEPS) / STEPS * along[-1], along, closed)
        middle = complex(steps.mean())
        return cls(middle, steps - middle, float(along[-1]))

    @cached_property
    def waves(self) -> np.ndarray:
        """(STEPS,) the Fourier coefficients of the steps."""
        return np.fft.fft(self.steps)

    @cached_property
    def mirrored_waves(self) -> np.ndarray:
        """The same of the steps mirrored about the level axis, and run through clockwise again."""
        return np.fft.fft(np.conj(self.steps)[::-1])

    @cached_property
    def radius(self) -> float:
        """The root mean square of the steps, px."""
        return float(np.sqrt((np.abs(self.steps) ** 2).mean()))

    @cached_property
    def area(self) -> float:
        """Px^2 within the steps."""
        return 0.5 * float((np.conj(self.steps) * np.roll(self.steps, -1)).imag.sum())

    def is_certain(self, numbers: int, pairs: float) -> bool:
        """Return whether an outline of so many variables is unlikely to be like another in one of so many pairs by
        chance: a turn and a shift say three of them, each other is right by chance for the farthest it may be off over
        the size.
        """
        sizes = self.radius / (2.0 * FARTHEST)
        return sizes > 1.0 and (numbers - 3) * math.log(sizes) > math.log(pairs) + CLEAR


@record
class Turn:
    """A transform by a turn. signs, angle: as in `RigidTransform`; pivot, at: (2,) px, the middle of the model and
    where it comes to lie; errors: standard errors of the angle, radians, and of that place, px."""

    signs: tuple[float, float]
    angle: float
    pivot: np.ndarray
    at: np.ndarray
    errors: tuple[float, float]

    @property
    def transform(self) -> RigidTransform:
        """The transform itself."""
        x, y = (self.at - RigidTransform(self.signs, (0.0, 0.0), self.angle).points(self.pivot)).tolist()
        return RigidTransform(self.signs, (x, y), self.angle)

    def near(self, angle: float) -> bool:
        """Return whether an angle is within the errors of this one."""
        return abs(math.remainder(self.angle - angle, 2.0 * math.pi)) <= SIGMAS * self.errors[0]


def turned_onto(model: Track, own: Walk, track: Track, walk: Walk) -> Turn | None:
    """The rotation that takes a model to an outline, not mirrored where either will do; None where they are not
    alike. own, walk: of the two."""
    if min(len(model.seen), len(track.seen)) < FEWEST or abs(own.length - walk.length) > LENGTH_OFF:
        return None
    for mirrored in (False, True):
        match = np.fft.ifft(walk.waves * np.conj(own.mirrored_waves if mirrored else own.waves))
        off = own.radius**2 + walk.radius**2 - 2.0 * np.abs(match) / STEPS
        if off.min() > NEAR**2:
            continue
        # Of the turns that a star or a cross leaves the choice between, the smallest.
        angles = np.angle(match[off <= off.min() + ALIKE**2])
        angle = float(angles[int(np.abs(angles).argmin())])
        found = _fitted(model, own.middle, track, (1.0, -1.0 if mirrored else 1.0), angle, walk.middle)
        if found is not None:
            return found
    return None


def _fitted(
    model: Track, middle: complex, track: Track, signs: tuple[float, float], angle: float, onto: complex
) -> Turn | None:
    """Return the turn with which the model lies nearest to an outline; None where it lies not near enough. onto: where
    the middle of the model begins to lie."""
    pivot = np.array([middle.real, middle.imag])

    def distances(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how far both lie off each other, and the derivatives by the x and y of the middle and the angle."""
        at, matrix = numbers[:2], RigidTransform(signs, (0.0, 0.0), float(numbers[2])).matrix
        spokes = (model.seen - pivot) @ matrix
        forth, ahead = track.off(spokes + at)
        back, behind = model.off((track.seen - at) @ matrix.T + pivot)
        ways, levers = np.concatenate([ahead, -behind @ matrix]), np.concatenate([spokes, track.seen - at])
        rows = np.column_stack([ways, levers[:, 0] * ways[:, 1] - levers[:, 1] * ways[:, 0]])
        return np.concatenate([forth, back]), rows

    fit = nearest(np.array([onto.real, onto.imag, angle]), distances)
    if fit is None:
        return None
    at, angle = fit.numbers[:2], float(fit.numbers[2])
    chance = 2.0 * SEEN_SIGMA * np.sqrt(np.diag(np.linalg.inv(fit.gram)))
    levers = np.concatenate([model.seen - pivot, track.seen - at])
    reach = math.sqrt(float((levers**2).sum(axis=1).mean()))
    errors = math.hypot(float(chance[2]), SYSTEMATIC / reach), math.hypot(float(chance[:2].max()), SYSTEMATIC)
    return Turn(signs, math.remainder(angle, 2.0 * math.pi), pivot, at, errors)


def evenly(turns: Sequence[Turn], step: float) -> list[RigidTransform]:
    """The transforms of the turns of one model: around a middle that they share, by whole parts of a turn, where they
    are so within their errors; by whole quarters of a turn otherwise where they are that. step: of the file's grid, px.
    """
    transforms = [_level(turn, step) for turn in turns]
    plain = [i for i, turn in enumerate(turns) if turn.signs[0] == turn.signs[1]]
    if len(plain) > 1 and (around := _around([turns[i] for i in plain], step)) is not None:
        for i, transform in zip(plain, around, strict=True):
            transforms[i] = transform
    return transforms


def _level(turn: Turn, step: float) -> RigidTransform:
    """The transform of a turn, by quarters on whole steps where that is within its errors."""
    quarter = 0.5 * math.pi * round(turn.angle / (0.5 * math.pi))
    if not turn.near(quarter):
        return turn.transform
    transform = replace(turn, angle=quarter).transform
    x, y = (round(s / step) * step for s in transform.shift)
    return replace(transform, shift=(x, y))


def _around(turns: Sequence[Turn], step: float) -> list[RigidTransform] | None:
    """The transforms around one middle by whole parts of a turn; None where some is not so within its errors."""
    for parts in range(2, MOST_PARTS + 1):
        part = 2.0 * math.pi / parts
        angles = [part * round(turn.angle / part) for turn in turns]
        if all(turn.near(angle) and angle for turn, angle in zip(turns, angles, strict=True)):
            break
    else:
        return None
    exact = [replace(turn, angle=angle) for turn, angle in zip(turns, angles, strict=True)]
    middles = np.array([np.linalg.solve((np.eye(2) - t.transform.matrix).T, t.transform.shift) for t in exact])
    errors = np.array([t.errors[1] / (2.0 * abs(math.sin(0.5 * t.angle))) for t in exact])
    middle = np.average(middles, axis=0, weights=errors**-2)
    middle = np.rint(middle / (0.5 * step)) * (0.5 * step)
    if (np.abs(middles - middle).max(axis=1) > SIGMAS * errors).any():
        return None
    return [replace(turn, pivot=middle, at=middle).transform for turn in exact]


def found_copies(
    tracks: Mapping[int, Track], numbers: Mapping[int, int], step: float, mirrors: tuple[float, float]
) -> dict[int, tuple[int, RigidTransform]]:
    """The outlines that are copies, by number: the number of the model of each, and how that comes to lie where it
    does. tracks: those of all, in the order in which they are to be models. numbers: how many variables each has.

    step: of the file's grid, px, of which shifts are whole multiples but after a turn. mirrors: twice where the axes of
    the canvas are, across which pairs lie that are nearly there.
    """
    walks = {k: Walk.of(track) for k, track in tracks.items()}
    names, pairs = list(tracks), 0.5 * len(tracks) ** 2
    # Most pairs are of other sizes.
    areas, lengths, radii = np.array([(w.area, w.length, w.radius) for w in walks.values()]).reshape(-1, 3).T
    whole = np.array([track.whole for track in tracks.values()], dtype=bool)
    tells = np.array([len(track.seen) >= FEWEST for track in tracks.values()], dtype=bool)
    boxes = np.array([track.extent for track in tracks.values()]).reshape(-1, 2, 2)
    widths, heights = (boxes[:, 1] - boxes[:, 0]).T.copy()
    lines = ClosedLines([t.tree for t in tracks.values()], [t.seen for t in tracks.values()], boxes)
    level: dict[int, tuple[int, RigidTransform]] = {}
    turns: dict[int, dict[int, Turn]] = {}  # by model
    # What is turned is a model too of what lies as it does, so that both are written as the same text.
    first, models = (np.zeros(len(names), dtype=bool) for _ in range(2))
    for i, (k, track) in enumerate(tracks.items()):
        sized = first & (np.abs(widths - widths[i]) <= NEAR) & (np.abs(heights - heights[i]) <= NEAR)
        able = np.flatnonzero(sized if tells[i] else [])
        full = np.abs(areas[able] - areas[i]) <= AREA_OFF * walks[k].length + LEAST_AREA_OFF
        able = able[full | ~(whole[able] & track.whole)][:MOST_MODELS]
        # Where all of it shows, what is alike and of one size lies nearly right at once.
        astray = np.where(whole[able] & track.whole, ASTRAY, LARGEST)
        found = lines.first_on(i, able, astray, FLIPS, (LARGEST, FARTHEST, MEAN), (FIRST_LOOK, TRIES), LEAST)
        if found is not None:
            on, flip, shift, told = found
            level[k] = names[on], _transform(tuple(FLIPS[flip].tolist()), shift, told, step, mirrors)
            continue
        first[i] = tells[i]
        long = models & (np.abs(lengths - lengths[i]) <= LENGTH_OFF) & (np.abs(radii - radii[i]) <= NEAR)
        like = [names[j] for j in np.flatnonzero(long & walks[k].is_certain(numbers[k], pairs))[:MOST_MODELS].tolist()]
        turned = ((m, turned_onto(tracks[m], walks[m], track, walks[k])) for m in like)
        model, turn = next(((m, turn) for m, turn in turned if turn is not None), (k, None))
        if turn is None:
            turns[k], models[i] = {}, True
        else:
            turns[model][k] = turn
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
