"""The free parameters of outlines, and how their cubics move with them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np

from cubicsplat_cli.artwork.geometry.fine import changes, fine_ring
from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring, polygon_lengths
from cubicsplat_cli.artwork.geometry.transforms import RigidTransform
from cubicsplat_cli.artwork.geometry.variables import Pieces
from cubicsplat_cli.raster.cubics import held_ring
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.record import record

# Nearer to the canvas' border than this, px, a coordinate is on it and stays there.
ON_BORDER = 0.06
LEAST_SIZE = 0.05  # px, of a primitive
FINEST_TURN = 1e-9
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
        """Whether a number is pinned; axis: 0 for x, 1 for y, 2 for lengths."""
        return any(abs(value - pin) < FINEST_TURN for pin in (self.x, self.y, self.lengths)[axis])


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
        return RingParameters(ring_pieces(outline.ring(), constraints), constraints, outline)
    return PrimitiveParameters(outline, _pinned(outline, constraints.pins))


def _on_border(box: Rectangle, constraints: Constraints) -> bool:
    """Whether a rectangle with sharp corners has a side that stays where it is."""
    x, y = (box.x, box.x + box.width), (box.y, box.y + box.height)
    ends = np.array([x[0], y[0], x[1] - constraints.width, y[1] - constraints.height])
    pinned = any(constraints.pins.hold(0, v) for v in x) or any(constraints.pins.hold(1, v) for v in y)
    return box.angle == 0.0 and box.radius == 0.0 and (pinned or bool((np.abs(ends) < ON_BORDER).any()))


def _pinned(shape: Circle | Ellipse | Rectangle, pins: Pins) -> np.ndarray:
    """(numbers,) bool: which numbers of a primitive are pinned; a side is where both of its ends are."""
    values = _numbers(shape)
    if isinstance(shape, Rectangle):
        starts = [pins.hold(axis, values[axis]) for axis in (0, 1)]
        ends = [pins.hold(axis, values[axis] + values[axis + 2]) for axis in (0, 1)]
        sides = [start and end for start, end in zip(starts, ends, strict=True)]
        return np.array([*starts, *sides, pins.hold(2, shape.radius), False])
    constraints = [pins.hold(axis, value) for axis, value in zip((0, 1, 2, 2), values, strict=False)]
    return np.array(constraints[: len(values)] + [False] * (len(values) - len(constraints)))


def without_specks(ring: Ring) -> Ring:
    """The ring without pieces that no pixel sees and that turn what hangs on them about: those shorter than SPECK px,
    and than SMOOTH_SPECK px where they go on smoothly.
    """
    while ring.pieces > 3:
        share = _speck_lengths(ring.cubics, ring.smooth)
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
        rest = np.arange(ring.pieces) != i
        ring = Ring(anchors[rest], controls[rest], ring.lines[rest], smooth[rest])
    return ring


def _speck_lengths(cubics: np.ndarray, smooth: np.ndarray) -> np.ndarray:
    """(S,) the lengths of the pieces (S, 4, 2) of a ring, of the least that they may have."""
    least = np.where(smooth | np.append(smooth[1:], smooth[:1]), SMOOTH_SPECK, SPECK)
    return np.asarray(polygon_lengths(cubics) / least)


class RingParameters:
    """A ring: its anchors, the directions of smooth joints, handle lengths, and handles at corners."""

    def __init__(self, pieces: Pieces, constraints: Constraints, origin: Rectangle | None = None) -> None:
        self.pieces, self.constraints, self.origin = pieces, constraints, origin
        self.cubics, self.lines = pieces.cubics, pieces.lines

    @property
    def jacobian(self) -> SparseRows:
        return self.pieces.jacobian

    def moved(self, step: np.ndarray) -> RingParameters:
        return RingParameters(self.pieces.moved(step), self.constraints, self.origin)

    def trimmed(self) -> RingParameters:
        """The ring without pieces that have become too short to matter, itself where there are none."""
        if (_speck_lengths(self.cubics, self.pieces.smooth) >= 1.0).all():
            return self
        ring = self.pieces.ring()
        shorter = ring if self.origin is not None else without_specks(ring)
        return self if shorter is ring else RingParameters(ring_pieces(shorter, self.constraints), self.constraints)

    def outline(self) -> Outline:
        p = self.pieces
        if self.origin is not None:
            low, high = p.anchors.min(axis=0), p.anchors.max(axis=0)
            return Rectangle(float(low[0]), float(low[1]), *(high - low).tolist())
        return p.ring()


def ring_pieces(ring: Ring, constraints: Constraints) -> Pieces:
    """A ring with what is held in place; what lies near the canvas's border is brought onto it."""
    held = (constraints.width, constraints.height), ON_BORDER, (constraints.pins.x, constraints.pins.y)
    outline, joints = held_ring(ring.anchors, ring.controls, ring.lines, ring.smooth, *held)
    return Pieces(*outline, joints.lines, joints.smooth, joints.level, joints.tied)


class Still:
    """An outline that stays as it is."""

    def __init__(self, outline: Outline) -> None:
        self._outline = outline
        ring = fine_ring(outline)
        self.cubics, self.lines = ring.cubics, ring.lines
        self.jacobian = SparseRows(np.zeros(8 * len(self.lines) + 1, int), np.zeros(0, int), np.zeros(0), 0)

    def moved(self, _step: np.ndarray) -> Still:
        """Itself."""
        return self

    def outline(self) -> Outline:
        """The outline."""
        return self._outline


class PrimitiveParameters:
    """A circle, ellipse or rectangle: its own numbers; a rounded one keeps its corners round, a level one level."""

    def __init__(self, shape: Circle | Ellipse | Rectangle, pinned: np.ndarray) -> None:
        self.shape, self.pinned = shape, pinned
        self.values = np.array(_numbers(shape))
        self.free = np.ones(len(self.values), dtype=bool)
        if isinstance(shape, Rectangle):
            self.free[4] = shape.radius > 0.0
        if not isinstance(shape, Circle):
            self.free[-1] = shape.angle != 0.0
        self.free &= ~pinned
        ring = fine_ring(shape)
        self.cubics, self.lines = ring.cubics, ring.lines

    @cached_property
    def jacobian(self) -> SparseRows:
        return _changes(_alike(self.shape), self.free.tobytes())

    def moved(self, step: np.ndarray) -> PrimitiveParameters:
        values = self.values.copy()
        values[self.free] += np.clip(step, -2.0, 2.0)
        return PrimitiveParameters(self._at(values), self.pinned)

    def _at(self, values: np.ndarray) -> Circle | Ellipse | Rectangle:
        v = values.tolist()
        if isinstance(self.shape, Circle):
            return Circle(v[0], v[1], max(v[2], LEAST_SIZE))
        across, down = max(v[2], LEAST_SIZE), max(v[3], LEAST_SIZE)
        if isinstance(self.shape, Ellipse):
            return Ellipse(v[0], v[1], across, down, v[4])
        return Rectangle(v[0], v[1], across, down, min(max(v[4], 0.0), 0.5 * min(across, down)), v[5])

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
    """The Jacobian by the numbers that are free, each a bool."""
    values = np.stack([change.ravel() for change in changes(shape)], axis=1)[:, np.frombuffer(free, dtype=bool)]
    rows, count = values.shape
    return SparseRows(np.arange(rows + 1) * count, np.tile(np.arange(count), rows), values.ravel(), count)


class CopyParameters:
    """An outline that is a copy of another one: all that is free about it is what is free about its model.

    source: the number of the model through all outlines of the drawing, itself no copy.
    """

    def __init__(self, model: Parameters, way: RigidTransform, source: int) -> None:
        self.model, self.way, self.source = model, way, source
        self.cubics, self.lines = way.points(model.cubics), model.lines

    @cached_property
    def jacobian(self) -> SparseRows:
        """Over the variables of the model."""
        own, matrix = self.model.jacobian, self.way.matrix
        if not matrix[0, 1]:  # x and y stay apart
            signs = np.tile(np.diag(matrix), 4 * len(self.lines))
            return SparseRows(own.starts, own.columns, own.values * np.repeat(signs, np.diff(own.starts)), own.count)
        pairs = 2 * np.arange(4 * len(self.lines))[:, None, None]
        places = np.broadcast_arrays(pairs + np.arange(2)[:, None], pairs + np.arange(2), matrix.T)
        rows, columns, values = (part.ravel() for part in places)
        return SparseRows.of(rows, columns, values, (8 * len(self.lines),) * 2).after(own)

    def following(self, model: Parameters) -> CopyParameters:
        """The copy of the model after that has moved."""
        return CopyParameters(model, self.way, self.source)

    def moved(self, step: np.ndarray) -> CopyParameters:
        return self.following(self.model.moved(step))

    def outline(self) -> Outline:
        return self.way.outline(self.model.outline())
