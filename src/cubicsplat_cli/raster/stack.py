"""Stacks of shapes in double precision: their picture, and steps that bring it nearer to a target; and steps of one
polygon of a stack on a grid, other outlines and colours.

The structures mirror kernels/cpu/stack.h field by field. Pictures are (H, W, 4) float64, premultiplied, in [0, 1].
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from ctypes import byref, c_double, c_int32, c_int64, c_void_p
from dataclasses import field
from functools import cached_property, partial

import numpy as np

from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.native import Out, address_of, address_on, floats, int32s, int64s, members, native
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.record import record

_native, _at = partial(native, "finish"), partial(address_on, "cpu")
_OPAQUE = 254.5 / 255.0
FEWEST = 3  # vertices of a polygon
STEPS = 5  # that may be proposed for a polygon at once
SLACK = 3.0  # bytes by which a file may turn out smaller than the guess from the length of a path
PolygonStep = tuple[float, float, np.ndarray, np.ndarray]  # score, rise of the loss, vertices (n, 2) and levels (3,)


class _Goal(ctypes.Structure):
    _fields_ = [
        *members(c_int32, "width height grid reach threads"), *members(c_void_p, "target taps opaque half"),
        ("channels", c_double * 4), *members(c_double, "bound leak_weight steep"),
    ]  # fmt: skip


class _Stack(ctypes.Structure):
    _fields_ = [("layers", c_int32), *members(c_void_p, "ends cubics lines signs fills base beneath")]


class _Crossings(ctypes.Structure):
    _fields_ = members(c_void_p, "piece pixel t change slope")


class _Unknowns(ctypes.Structure):
    _fields_ = [
        *members(c_int32, "outlines variables"), *members(c_void_p, "first count start rows column value damping"),
        ("keep", c_double),
    ]  # fmt: skip


@record
class Goal:
    """The target of a stack and its error model. target: (H, W, 4); channels: the weights of the four; bound: of a
    pixel's weighted residual, beyond which it counts linearly; grid: 0 for exact areas, g for g x g samples a pixel;
    taps: (reach + 1,) weights along a row or column, from the middle on, of the blur of the stack's picture before it
    is compared; space: (4, 4) the factor of RGBA that gives the coordinates of the target, in which fills are too.
    leak_weight: of the squared share of the background that shows `inside` the target; a blur spreads that share, so it
    counts only without one. share_error: standard deviation of the shares of pixels that shapes cover in the target;
    error: that of pixels on edges, of full scale, beyond that of a clean picture. half: (H, W) of a target without
    anti-aliasing the weighted residual beyond which a pixel is on the wrong side of an edge, else None; steep: the
    weight of the square of what is beyond. banded: (H W,) bool, pixels of shading in bands of fills, or None."""

    target: np.ndarray
    channels: Sequence[float]
    bound: float
    grid: int = 0
    taps: np.ndarray = field(default_factory=lambda: np.ones(1))
    space: np.ndarray = field(default_factory=lambda: np.eye(4))
    leak_weight: float = 0.0
    share_error: float = 0.04
    error: float = 0.0
    half: np.ndarray | None = None
    steep: float = 0.0
    banded: np.ndarray | None = None

    @property
    def reach(self) -> int:
        """The px to either side that the blur reaches, 0 without one."""
        return len(self.taps) - 1

    @cached_property
    def inside(self) -> np.ndarray:
        """(H, W) bool: opaque pixels of the target with opaque neighbours alone, unlike those at its edges."""
        opaque = np.pad(self.target[..., 3] >= _OPAQUE, 1, mode="edge")
        wide = opaque[:, :-2] & opaque[:, 1:-1] & opaque[:, 2:]
        return np.ascontiguousarray(wide[:-2] & wide[1:-1] & wide[2:])

    def _pointers(self) -> _Goal:
        height, width, _ = self.target.shape
        return _Goal(
            width, height, self.grid, self.reach, work().threads, _at(self.target, "target", self.target.shape),
            _at(self.taps, "taps", self.taps.shape), None if self.reach else address_of(self.inside),
            _at(self.half, "half", (height, width)),
            (c_double * 4)(*self.channels), self.bound, self.leak_weight, self.steep,
        )  # fmt: skip


@record
class StackPieces:
    """S lines and cubics of L layers, back to front. ends: (L,) int32, the number of pieces up to and with each layer;
    cubics: (S, 4, 2) px, closed outlines; lines: (S,) bool; signs: (S,) 1, or -1 in an outline that runs the wrong way
    round; fills: (L, 4) premultiplied."""

    ends: np.ndarray
    cubics: np.ndarray
    lines: np.ndarray
    signs: np.ndarray
    fills: np.ndarray


@record
class CoverageJacobian:
    """m crossings of a piece and a pixel, in the order of the pieces: piece (m,) and pixel (m,) int32, row times width
    plus column; t (m,) the parameter; change (m, 8) of the pixel's coverage with the piece's control points; slope (m,
    4) of the sharp picture with that coverage."""

    piece: np.ndarray
    pixel: np.ndarray
    t: np.ndarray
    change: np.ndarray
    slope: np.ndarray


@record
class Step:
    """values: (variables,) of a damped Gauss-Newton step; gradient: (variables,) of half of the cost; moves:
    (outlines,) px by which control points move at most; misfits: (outlines,) of the pixels that each crosses."""

    values: np.ndarray
    gradient: np.ndarray
    moves: np.ndarray
    misfits: np.ndarray


class DrawnStack:
    """A stack as it is drawn for a goal: the exact coverages of its shapes, composited, and compared with the target.

    previous: a stack drawn for the same goal and over the same base, or None; only tiles that differ from it are drawn
    again. over: a base, a stack drawn for the same goal, whose layers this stack has too, beneath its own; and (L,)
    int32, ascending, the layer of the base right below each own layer, -1 for none. The pieces of the base have no
    numbers here. The same for any number of threads.
    """

    def __init__(
        self,
        pieces: StackPieces,
        goal: Goal,
        previous: DrawnStack | None = None,
        over: tuple[DrawnStack, np.ndarray] | None = None,
    ) -> None:
        self.goal, self._over = goal, over  # a base lives as long as what is drawn over it
        layers, count = len(pieces.ends), len(pieces.cubics)
        stack = _Stack(
            layers, _at(pieces.ends, "ends", (layers,), "int32"), _at(pieces.cubics, "cubics", (count, 4, 2)),
            _at(pieces.lines, "lines", (count,), "bool"), _at(pieces.signs, "signs", (count,)),
            _at(pieces.fills, "fills", (layers, 4)),
            over and over[0]._handle, over and _at(over[1], "layers of the base", (layers,), "int32"),
        )  # fmt: skip
        old = previous._handle if previous is not None and previous.goal is goal else None
        self._handle: int = _native("cs_stack_draw", byref(goal._pointers()), byref(stack), old, result=c_void_p)

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            _native("cs_stack_free", self._handle, result=None)

    @cached_property
    def cost(self) -> float:
        """The misfit of all pixels, and what the background adds where it shows through an opaque picture: where two
        edges meet, viewers let it through if the hidden edge of a third shape is there too."""
        return _native("cs_stack_cost", self._handle, result=c_double)

    @cached_property
    def picture(self) -> tuple[np.ndarray, np.ndarray]:
        """The picture (H, W, 4), blurred if the goal is, and the misfit (H, W) of its pixels."""
        shape = self.goal.target.shape
        return _native("cs_stack_picture", self._handle, Out(shape), Out(shape[:2]), result=None)

    def uppermost(self, rows: slice, columns: slice, least: float) -> np.ndarray:
        """Return (h, w) int32: the uppermost layer that covers so much, more than nothing, of each pixel of a window of
        the canvas; -1 for none."""
        height, width = rows.stop - rows.start, columns.stop - columns.start
        box = columns.start, rows.start, width, height, float(least)
        return _native("cs_stack_uppermost", self._handle, *box, Out((height, width), np.int32), result=None)

    @cached_property
    def crossings(self) -> CoverageJacobian:
        """The pixels that the pieces cross, and the changes of these as of exact areas, whatever the goal's grid."""
        m = _native("cs_stack_crossings", self._handle, None, result=c_int64)
        parts = np.empty(m, np.int32), np.empty(m, np.int32), np.empty(m), np.empty((m, 8)), np.empty((m, 4))
        _native("cs_stack_crossings", self._handle, byref(_Crossings(*map(address_of, parts))), result=c_int64)
        return CoverageJacobian(*parts)

    def growth(
        self, after: DrawnStack, group: np.ndarray, other: np.ndarray, count: int, spread: int = 0, leaks: bool = False
    ) -> np.ndarray:
        """Return (count,): the rise of the misfit, and with `leaks` of the cost, from this to another drawn stack on
        the pixels that the pieces of a group change in either: those that they cross and all within `spread` px.

        group, other: (pieces,) the group of each piece here and there, or -1.
        """
        given = self._handle, after._handle, int32s(group), int32s(other), count, spread, leaks
        return _native("cs_stack_growth", *given, Out(count))

    def changed(self, before: DrawnStack, group: np.ndarray, groups: int, least: float) -> np.ndarray:
        """Return (groups,) bool: true if the picture has changed by more than `least` at a pixel that a piece of the
        group crosses. group: (pieces,) of each piece, or -1."""
        given = before._handle, self._handle, int32s(group), float(least)
        return _native("cs_stack_changed", *given, Out(groups, bool), result=None)

    def step(
        self, first: np.ndarray, count: np.ndarray, start: np.ndarray, jacobians: Sequence[SparseRows],
        damping: np.ndarray, keep: float, chance: float = 0.0,
    ) -> Step:  # fmt: skip
        """Return the damped Gauss-Newton step of the variables of n outlines, which may share them; all else is fixed.

        first, count: (n,) the first of an outline's pieces, and their number; start: (n,) its first variable;
        jacobians: (n,) the derivatives of the control points of its pieces by its variables, (8 count, own variables);
        damping: (variables,) what is added to the diagonal of the Gram matrix, as a factor of that; keep: what is added
        besides; chance: added to the misfit of each pixel that an outline crosses.
        """
        ends = np.cumsum([0, *(part.starts[-1] for part in jacobians)])
        rows = np.concatenate([[0], *(part.starts[1:] + end for part, end in zip(jacobians, ends, strict=False))])
        columns = np.concatenate([part.columns for part in jacobians])
        values = np.concatenate([part.values for part in jacobians])
        variables, outlines = len(damping), len(first)
        numbers = *map(int32s, (first, count, start)), int64s(rows), int32s(columns)
        given = _Unknowns(
            outlines, variables, *map(address_of, numbers), _at(values, "values", values.shape),
            _at(damping, "damping", (variables,)), keep,
        )  # fmt: skip
        out = Out(variables), Out(variables), Out(outlines), Out(outlines)
        return Step(*_native("cs_stack_step", self._handle, byref(given), float(chance), *out))


class PolygonSteps:
    """Looks for steps of polygons over a ground, front to back, towards a picture.

    goal: (H, W, C) float32, and its weights (H, W) or None. scale: (2,) px per unit. most: vertices of a polygon.
    """

    def __init__(
        self, goal: np.ndarray, weights: np.ndarray | None, scale: np.ndarray, most: int, threads: int
    ) -> None:
        self.picture = goal, None if weights is None else floats(weights), *goal.shape, scale
        self.most, self.threads = most, threads

    def take(self, vertices: list[np.ndarray], levels: np.ndarray, ground: np.ndarray | None, opacity: float) -> None:
        """Take over the polygons, their colours (N, 3) in 0..15, the ground's (3,) in 0..1, and the opacity of all."""
        ends = np.cumsum([len(polygon) for polygon in vertices], dtype=np.int32)
        behind = np.zeros(4, np.float32)
        behind[:3] = 0.0 if ground is None else ground
        self._polygons = int32s(np.concatenate(vertices)), ends, int32s(levels), len(vertices), behind, opacity

    def best(self, index: int, price: float) -> Iterator[PolygonStep]:
        """Yield the steps of a polygon with the best scores, of loss + price x bytes; the bytes are guessed."""
        outlines, levels = Out((STEPS, self.most, 2), np.int32), Out((STEPS, 3), np.int32)
        out = Out(STEPS), Out(STEPS), outlines, Out(STEPS, np.int32), levels
        given = *self.picture, *self._polygons, index, self.most, price, SLACK, self.threads, STEPS
        steps = native("search", "cs_polygon_steps", *given, *out, result=c_int64)
        for score, rise, outline, corners, paint in zip(*steps, strict=True):
            yield float(score), float(rise), outline[:corners], paint

    def removals(self, index: int, corners: int) -> np.ndarray:
        """Return by how much the loss rises without each of a polygon's vertices, and last without all of it."""
        rises = Out(corners + 1 if corners > FEWEST else 1)
        return native("search", "cs_polygon_removals", *self.picture, *self._polygons, index, rises)
