"""The free parameters of outlines, and how their cubics move with them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np

from cubicsplat_cli.artwork.geometry.fitting import PRECISION
from cubicsplat_cli.artwork.geometry.outlines import (
    FINE,
    Circle,
    Ellipse,
    Outline,
    Rectangle,
    Ring,
    following,
    pieces_of_rings,
    polygon_lengths,
    turn_matrix,
)
from cubicsplat_cli.raster.cubics import Pieces, held_ring
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.record import record

# px that outlines are off in the mean. What is nearer to the canvas' border is on it and stays there.
MEAN_ERROR = 0.06
LEAST = 1e-9  # px, and coefficients: less is of the arithmetic
SPECK, SMOOTH_SPECK = 0.3, 1.5  # px, ascending


class Parameters(Protocol):
    """An outline with its variables. cubics: (S, 4, 2); lines: (S,) bool; jacobian: (8 S, variables), rows by piece,
    control point and coordinate; moved: the same after a step (variables,); outline: as it stands."""

    cubics: np.ndarray
    lines: np.ndarray

    @property
    def jacobian(self) -> SparseRows: ...

    def moved(self, step: np.ndarray) -> Parameters: ...

    def outline(self) -> Outline: ...


@dataclass(frozen=True)
class Pins:
    """Numbers that are known: the x and y of edges and middles, and radii."""

    x: tuple[float, ...] = ()
    y: tuple[float, ...] = ()
    lengths: tuple[float, ...] = ()

    def hold(self, axis: int, value: float) -> bool:
        """Return whether a number is pinned; axis: 0 for x, 1 for y, 2 for lengths."""
        return any(abs(value - pin) < LEAST for pin in (self.x, self.y, self.lengths)[axis])


NO_PINS = Pins()


@record
class Constraints:
    """Coordinates that stay: those on the border of a canvas of width x height px, and pinned ones."""

    width: int
    height: int
    pins: Pins = NO_PINS


def parametrised(outline: Outline, constraints: Constraints) -> Parameters:
    """The parameters of an outline."""
    if isinstance(outline, Ring):
        return RingParameters(ring_pieces(without_specks(outline), constraints), constraints)
    if isinstance(outline, Rectangle) and _on_border(outline, constraints):
        return RingParameters(ring_pieces(outline.ring(), constraints), is_box=True)
    return PrimitiveParameters(outline, _pinned(outline, constraints.pins))


def _on_border(box: Rectangle, constraints: Constraints) -> bool:
    """Return whether a rectangle with sharp corners has a side that stays where it is."""
    x, y = (box.x, box.x + box.width), (box.y, box.y + box.height)
    ends = np.array([x[0], y[0], x[1] - constraints.width, y[1] - constraints.height])
    pinned = any(constraints.pins.hold(0, v) for v in x) or any(constraints.pins.hold(1, v) for v in y)
    return box.angle == 0.0 and box.radius == 0.0 and (pinned or bool((np.abs(ends) < MEAN_ERROR).any()))


def _pinned(shape: Circle | Ellipse | Rectangle, pins: Pins) -> np.ndarray:
    """(numbers,) bool: which numbers of a primitive are pinned; a side is where both of its ends are."""
    values = _numbers(shape)
    if isinstance(shape, Rectangle):
        starts = [pins.hold(axis, values[axis]) for axis in (0, 1)]
        ends = [pins.hold(axis, values[axis] + values[axis + 2]) for axis in (0, 1)]
        sides = [start and end for start, end in zip(starts, ends, strict=True)]
        return np.array([*starts, *sides, pins.hold(2, shape.radius), False])
    held = [pins.hold(axis, value) for axis, value in zip((0, 1, 2, 2), values, strict=False)]
    return np.array([*held, False][: len(values)])


def without_specks(ring: Ring) -> Ring:
    """The ring without pieces that no pixel sees and that turn what hangs on them about: those shorter than SPECK px,
    and than SMOOTH_SPECK px where they go on smoothly.
    """
    while ring.pieces > 3:
        share = polygon_lengths(ring.cubics) / np.where(ring.smooth | following(ring.smooth), SMOOTH_SPECK, SPECK)
        i = int(share.argmin())
        if share[i] >= 1.0:
            break
        j = (i + 1) % ring.pieces
        anchors, controls, smooth = ring.anchors.copy(), ring.controls.copy(), ring.smooth.copy()
        shift = 0.5 * (anchors[j] - anchors[i])
        controls[i - 1, 1] += shift
        controls[j, 0] -= shift
        anchors[j] -= shift
        smooth[j] &= smooth[i]
        ring = Ring(anchors, controls, ring.lines, smooth).chosen(np.arange(ring.pieces) != i)
    return ring


@dataclass(eq=False)
class RingParameters:
    """A ring: its anchors, the directions of smooth joints, handle lengths, and handles at corners.

    constraints: what holds the ring when pieces too short to matter are left out, None where all pieces stay. is_box:
    whether the ring is a level rectangle. ties: (variables, free) how the variables of the pieces follow from those
    that are free, None where all are.
    """

    pieces: Pieces
    constraints: Constraints | None = None
    ties: SparseRows | None = None
    is_box: bool = False

    def __post_init__(self) -> None:
        self.cubics, self.lines = self.pieces.cubics, self.pieces.lines

    @cached_property
    def jacobian(self) -> SparseRows:
        return self.pieces.jacobian if self.ties is None else self.pieces.jacobian.after(self.ties)

    def moved(self, step: np.ndarray) -> RingParameters:
        return replace(self, pieces=self.pieces.moved(step if self.ties is None else self.ties.times(step)))

    def trimmed(self) -> RingParameters:
        """Return the ring without pieces that have become too short to matter, itself where there are none."""
        if self.constraints is None:
            return self
        ring = _ring_of(self.pieces)
        shorter = without_specks(ring)
        return self if shorter is ring else RingParameters(ring_pieces(shorter, self.constraints), self.constraints)

    def outline(self) -> Outline:
        if self.is_box:
            low, high = self.pieces.anchors.min(axis=0), self.pieces.anchors.max(axis=0)
            return Rectangle(*low.tolist(), *(high - low).tolist())
        return _ring_of(self.pieces)


def ring_pieces(ring: Ring, constraints: Constraints) -> Pieces:
    """A ring with what is held in place; what lies near the canvas's border is brought onto it."""
    held = (constraints.width, constraints.height), MEAN_ERROR, (constraints.pins.x, constraints.pins.y)
    return held_ring(ring.anchors, ring.controls, ring.lines, ring.smooth, *held)


def _ring_of(pieces: Pieces) -> Ring:
    """The ring as it stands."""
    return Ring(pieces.anchors, pieces.cubics[:, 1:3].copy(), pieces.lines.copy(), pieces.joints.smooth.copy())


class Still:
    """An outline that stays as it is."""

    def __init__(self, outline: Outline) -> None:
        self._outline = outline
        self.cubics, self.lines = pieces_of_rings([outline.ring(FINE)])
        self.jacobian = SparseRows(np.zeros(8 * len(self.lines) + 1, int), np.zeros(0, int), np.zeros(0), 0)

    def moved(self, _step: np.ndarray) -> Still:
        """Return the outline itself."""
        return self

    def outline(self) -> Outline:
        """The outline."""
        return self._outline


class PrimitiveParameters:
    """A circle, ellipse or rectangle: its own numbers; a rounded one keeps its corners round, a level one level."""

    def __init__(
        self,
        shape: Circle | Ellipse | Rectangle,
        pinned: np.ndarray,
        drawn: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        self.shape, self.pinned = shape, pinned
        self.values = np.array(_numbers(shape))
        self.free = np.ones(len(self.values), dtype=bool)
        if isinstance(shape, Rectangle):
            self.free[4] = shape.radius > 0.0
        if not isinstance(shape, Circle):
            self.free[-1] = shape.angle != 0.0
        self.free &= ~pinned
        self.cubics, self.lines = drawn or pieces_of_rings([shape.ring(FINE)])

    @cached_property
    def jacobian(self) -> SparseRows:
        return _changes(_alike(self.shape), self.free.tobytes())

    def moved(self, step: np.ndarray) -> PrimitiveParameters:
        values = self.values.copy()
        values[self.free] += np.clip(step, -2.0, 2.0)
        sides = slice(2, 3 if isinstance(self.shape, Circle) else 4)
        values[sides] = np.maximum(values[sides], PRECISION)
        if isinstance(self.shape, Rectangle):
            values[4] = np.clip(values[4], 0.0, 0.5 * values[sides].min())
        shape = type(self.shape)(*values.tolist())
        if shape.pieces != self.shape.pieces or not (isinstance(shape, Circle) or shape.angle == 0.0):
            return PrimitiveParameters(shape, self.pinned)
        # Points are linear in all numbers but the angle.
        change = self.jacobian.times((values - self.values)[self.free]).reshape(self.cubics.shape)
        return PrimitiveParameters(shape, self.pinned, (self.cubics + change, self.lines))

    def outline(self) -> Outline:
        return self.shape


def _numbers(shape: Circle | Ellipse | Rectangle) -> list[float]:
    return [float(getattr(shape, name)) for name in shape.__match_args__]


def _alike(shape: Circle | Ellipse | Rectangle) -> Circle | Ellipse | Rectangle:
    """A primitive that changes with its numbers as this one does: if level, wherever it lies and of whatever size."""
    if isinstance(shape, Circle):
        return Circle(0.0, 0.0, 1.0)
    if shape.angle != 0.0:
        return shape
    if isinstance(shape, Ellipse):
        return Ellipse(0.0, 0.0, 1.0, 1.0)
    return Rectangle(0.0, 0.0, 1.0, 1.0, shape.radius and 0.25)


@lru_cache(maxsize=64)
def _changes(shape: Circle | Ellipse | Rectangle, free: bytes) -> SparseRows:
    """Return the Jacobian of a primitive's ring by those of its numbers that are free, each a bool."""
    cubics = shape.ring(FINE).cubics
    columns = []
    for number in np.flatnonzero(np.frombuffer(free, dtype=bool)).tolist():
        if shape.__match_args__[number] == "angle":
            change = (cubics - cubics[:, 0].mean(axis=0)) @ turn_matrix(0.5 * np.pi)
        else:  # points are linear in all other numbers
            numbers = _numbers(shape)
            numbers[number] += 1.0
            change = type(shape)(*numbers).ring(FINE).cubics - cubics
        columns.append(change.ravel())
    rows, count = cubics.size, len(columns)
    values = np.array(columns).T.ravel()
    return SparseRows(np.arange(rows + 1) * count, np.tile(np.arange(count), rows), values, count)


@record
class RigidTransform:
    """A rigid transform of an outline: x and y times `signs`, 1 or -1 each, and then shifted by px."""

    signs: tuple[float, float]
    shift: tuple[float, float]

    def points(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 2) where they come to lie."""
        return points * np.array(self.signs) + np.array(self.shift)

    def outline(self, outline: Outline) -> Outline:
        """An outline where it comes to lie; a ring has the same pieces in the same order."""
        if isinstance(outline, Ring):
            return Ring(self.points(outline.anchors), self.points(outline.controls), outline.lines, outline.smooth)
        if not isinstance(outline, Circle) and self.signs[0] != self.signs[1]:
            outline = replace(outline, angle=-outline.angle)
        if isinstance(outline, Rectangle):
            half = np.array([0.5 * outline.width, 0.5 * outline.height])
            x, y = (self.points(np.array([outline.x, outline.y]) + half) - half).tolist()
            return replace(outline, x=x, y=y)
        x, y = self.points(np.array([outline.cx, outline.cy])).tolist()
        return replace(outline, cx=x, cy=y)


class CopyParameters:
    """An outline that is a copy of another one: all that is free about it is what is free about its model.

    source: the number of the model through all outlines of the drawing, itself no copy.
    """

    def __init__(self, model: Parameters, way: RigidTransform, source: int) -> None:
        self.model, self.way, self.source = model, way, source
        self.cubics, self.lines = way.points(model.cubics), model.lines

    @cached_property
    def jacobian(self) -> SparseRows:
        """The Jacobian by the variables of the model."""
        own = self.model.jacobian
        return SparseRows(own.starts, own.columns, own.values * np.array(self.way.signs)[own.rows % 2], own.count)

    def following(self, model: Parameters) -> CopyParameters:
        """The copy of the model after that has moved."""
        return CopyParameters(model, self.way, self.source)

    def moved(self, step: np.ndarray) -> CopyParameters:
        return self.following(self.model.moved(step))

    def outline(self) -> Outline:
        return self.way.outline(self.model.outline())
