"""Stacks of shapes in double precision: their picture, and steps that bring it nearer to another one.

The structures mirror kernels/cpu/stack.h field by field. Pictures are (H, W, 4) float64, premultiplied, in [0, 1].
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref, c_double, c_int32, c_int64, c_void_p
from dataclasses import field
from functools import cached_property, partial

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.cpu import address_of, int32s, members, native
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.record import record

_native = partial(native, "finish")
_OPAQUE = 254.5 / 255.0


class _Goal(ctypes.Structure):
    _fields_ = [
        *members(c_int32, "width height grid reach threads"), *members(c_void_p, "target taps opaque"),
        ("channels", c_double * 4), *members(c_double, "bound leak_weight"),
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
    taps: (reach + 1,) weights along a row or column, from the middle on, of what blurs the stack's picture before it is
    compared; space: (4, 4) what RGBA was multiplied by to give the coordinates of the target, in which fills are too.
    leak_weight: of the squared share of the background that shows `inside` the target; a blur spreads that, so it
    counts without one. share_error: standard deviation of the shares of pixels that shapes cover in the target; error:
    that of pixels on edges beyond that of a clean picture, of full scale."""

    target: np.ndarray
    channels: Sequence[float]
    bound: float
    grid: int = 0
    taps: np.ndarray = field(default_factory=lambda: np.ones(1))
    space: np.ndarray = field(default_factory=lambda: np.eye(4))
    leak_weight: float = 0.0
    share_error: float = 0.04
    error: float = 0.0

    @property
    def reach(self) -> int:
        """Px to either side that a blur carries, 0 without one."""
        return len(self.taps) - 1

    @cached_property
    def inside(self) -> np.ndarray:
        """(H, W) bool: pixels of the target that are opaque and lie next to no others, as at the edge of a drawing."""
        opaque = np.pad(self.target[..., 3] >= _OPAQUE, 1, mode="edge")
        wide = opaque[:, :-2] & opaque[:, 1:-1] & opaque[:, 2:]
        return np.ascontiguousarray(wide[:-2] & wide[1:-1] & wide[2:])

    def _pointers(self) -> _Goal:
        height, width, _ = self.target.shape
        return _Goal(
            width, height, self.grid, self.reach, work().threads, _at(self.target, np.float64, self.target.shape),
            _at(self.taps, np.float64, self.taps.shape), None if self.reach else address_of(self.inside),
            (c_double * 4)(*self.channels), self.bound, self.leak_weight,
        )  # fmt: skip


@record
class StackPieces:
    """S lines and cubics of L layers, back to front. ends: (L,) int32, how many pieces there are up to and with each
    layer; cubics: (S, 4, 2) px, closed outlines; lines: (S,) bool; signs: (S,) 1, or -1 where an outline runs the wrong
    way round; fills: (L, 4) premultiplied."""

    ends: np.ndarray
    cubics: np.ndarray
    lines: np.ndarray
    signs: np.ndarray
    fills: np.ndarray


@record
class CoverageJacobian:
    """Of m crossings of a piece and a pixel: piece (m,) and pixel (m,) int32, row times width plus column; t (m,) the
    parameter; change (m, 8) of the pixel's coverage with the piece's control points; slope (m, 4) of the sharp picture
    with that coverage. In the order of the pieces."""

    piece: np.ndarray
    pixel: np.ndarray
    t: np.ndarray
    change: np.ndarray
    slope: np.ndarray


@record
class Unknowns:
    """The variables of n outlines, which may share them. first, count: (n,) the first of an outline's pieces, and how
    many it has; start: (n,) its first variable; jacobians: (n,) how the control points of its pieces move with them,
    (8 count, own variables); damping: (variables,) what is added to the diagonal
    of the Gram matrix, times that; keep: what is added besides."""

    first: np.ndarray
    count: np.ndarray
    start: np.ndarray
    jacobians: Sequence[SparseRows]
    damping: np.ndarray
    keep: float


@record
class Step:
    """values: (variables,) of a damped Gauss-Newton step; gradient: (variables,) of half of the cost; moves:
    (outlines,) px that the control points of each move at most; misfits: (outlines,) of the pixels that they cross."""

    values: np.ndarray
    gradient: np.ndarray
    moves: np.ndarray
    misfits: np.ndarray


class DrawnStack:
    """A stack as it is drawn for a goal: the exact coverages of its shapes, composited, and compared with the target.

    previous: a stack drawn for the same goal and over the same base, or None; only the tiles are drawn in which
    something differs from that. over: a stack drawn for the same goal, the base, whose layers are in this one too, and
    (L,) int32 the layer of that right above which each lies, ascending, -1 for none; only the pieces of the L count.
    The same for any number of threads. Raises EngineError where the library or the memory is missing.
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
            layers, _at(pieces.ends, np.int32, (layers,)), _at(pieces.cubics, np.float64, (count, 4, 2)),
            _at(pieces.lines, np.bool_, (count,)), _at(pieces.signs, np.float64, (count,)),
            _at(pieces.fills, np.float64, (layers, 4)),
            None if over is None else over[0]._handle, None if over is None else _at(over[1], np.int32, (layers,)),
        )  # fmt: skip
        old: int | None = previous._handle if previous is not None and previous.goal is goal else None
        self._handle: int = _native("cs_stack_draw", byref(goal._pointers()), byref(stack), old, result=c_void_p)

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            _native("cs_stack_free", self._handle, result=None)

    @cached_property
    def cost(self) -> float:
        """The sum of the misfit of all pixels, and of the leaks."""
        return float(_native("cs_stack_cost", self._handle, result=c_double))

    @cached_property
    def picture(self) -> tuple[np.ndarray, np.ndarray]:
        """The picture (H, W, 4), blurred where the goal is, and the misfit (H, W) of its pixels."""
        height, width, _ = self.goal.target.shape
        image, misfit = np.empty((height, width, 4)), np.empty((height, width))
        _native("cs_stack_picture", self._handle, image, misfit, result=None)
        return image, misfit

    def uppermost(self, rows: slice, columns: slice, least: float) -> np.ndarray:
        """(h, w) int32 the uppermost layer that covers so much, more than nothing, of each pixel of a window of the
        canvas; -1 for none."""
        out = np.empty((rows.stop - rows.start, columns.stop - columns.start), np.int32)
        box = columns.start, rows.start, *out.shape[::-1]
        _native("cs_stack_uppermost", self._handle, *box, float(least), out, result=None)
        return out

    @cached_property
    def crossings(self) -> CoverageJacobian:
        """The pixels that the pieces cross, and how these change with them: as exact areas do in any case."""
        m = _native("cs_stack_crossings", self._handle, None, result=c_int64)
        parts = np.empty(m, np.int32), np.empty(m, np.int32), np.empty(m), np.empty((m, 8)), np.empty((m, 4))
        out = _Crossings(*(address_of(part) for part in parts))
        _native("cs_stack_crossings", self._handle, byref(out), result=c_int64)
        return CoverageJacobian(*parts)

    def growth(
        self, after: DrawnStack, group: np.ndarray, other: np.ndarray, count: int, spread: int = 0, leaks: bool = False
    ) -> np.ndarray:
        """(count,) by how much the misfit, and with `leaks` the cost, is more in another drawn stack on the pixels
        that the pieces of a group change in either: those that they cross and all within `spread` px.

        group, other: (pieces,) the group of each piece here and there, or -1.
        """
        group, other, found = int32s(group), int32s(other), np.empty(count)
        _native("cs_stack_growth", self._handle, after._handle, group, other, count, spread, leaks, found)
        return found

    def changed(self, before: DrawnStack, group: np.ndarray, groups: int, least: float) -> np.ndarray:
        """(groups,) bool: whether the picture has changed by more than `least` at a pixel that a piece of the group
        crosses. group: (pieces,) of each piece, or -1."""
        group, found = int32s(group), np.zeros(groups, dtype=bool)
        _native("cs_stack_changed", before._handle, self._handle, group, float(least), found, result=None)
        return found

    def step(self, unknowns: Unknowns, chance: float = 0.0) -> Step:
        """The damped Gauss-Newton step of some variables, all others as they are. chance: what is added to the misfit
        of each pixel that an outline crosses."""
        parts = unknowns.jacobians
        ends = np.cumsum([0, *(part.starts[-1] for part in parts)])
        row = np.concatenate([[0], *(part.starts[1:] + end for part, end in zip(parts, ends, strict=False))])
        row, column = row.astype(np.int64), int32s(np.concatenate([part.columns for part in parts]))
        value = np.concatenate([part.values for part in parts])
        first, count, start = (int32s(each) for each in (unknowns.first, unknowns.count, unknowns.start))
        variables, outlines = len(unknowns.damping), len(first)
        found = Step(np.empty(variables), np.empty(variables), np.empty(outlines), np.empty(outlines))
        given = _Unknowns(
            outlines, variables, address_of(first), address_of(count), address_of(start), address_of(row),
            address_of(column), _at(value, np.float64, value.shape),
            _at(unknowns.damping, np.float64, (variables,)), unknowns.keep,
        )  # fmt: skip
        _native("cs_stack_step", self._handle, byref(given), float(chance), *vars(found).values())
        return found


def _at(array: np.ndarray, kind: type, shape: tuple[int, ...]) -> int:
    """The address of an array, which must be contiguous, of this type and shape."""
    if array.dtype != kind or array.shape != shape or not array.flags.c_contiguous:
        raise EngineError(f"expected a contiguous {np.dtype(kind)} array {shape}, not {array.dtype} {array.shape}")
    return address_of(array)
