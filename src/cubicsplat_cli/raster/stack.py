"""Stacks of shapes in double precision: their picture, and the normal equations of its fit to another one.

The structures mirror kernels/cpu/stack.h field by field. Pictures are (H, W, 4) float64, premultiplied, in [0, 1].
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import POINTER, c_double, c_int32, c_int64, c_void_p
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from scipy import sparse

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import library

_OPAQUE = 254.5 / 255.0
_ROOM = 8  # crossings and pairs a piece beyond those that its length asks for


class _Stack(ctypes.Structure):
    _fields_ = [
        ("width", c_int32), ("height", c_int32), ("layers", c_int32), ("grid", c_int32), ("ends", c_void_p),
        ("cubics", c_void_p), ("lines", c_void_p), ("signs", c_void_p), ("inks", c_void_p),
    ]  # fmt: skip


class _Fit(ctypes.Structure):
    _fields_ = [
        ("target", c_void_p), ("channels", c_double * 4), ("bound", c_double), ("reach", c_int32), ("taps", c_void_p),
    ]  # fmt: skip


class _Crossings(ctypes.Structure):
    _fields_ = [
        ("room", c_int64), ("count", c_int64), ("piece", c_void_p), ("pixel", c_void_p), ("t", c_void_p),
        ("change", c_void_p), ("slope", c_void_p),
    ]  # fmt: skip


class _Equations(ctypes.Structure):
    _fields_ = [
        ("pieces", c_int32), ("width", c_int32), ("height", c_int32), ("room", c_int64), ("count", c_int64),
        ("first", c_void_p), ("second", c_void_p), ("blocks", c_void_p), ("gradient", c_void_p),
    ]  # fmt: skip


@dataclass(frozen=True)
class Goal:
    """What a stack is compared with. target: (H, W, 4); channels: the weights of the four; bound: of a pixel's weighted
    residual, beyond which it counts linearly; grid: 0 for exact areas, g for g x g samples a pixel; taps: (reach + 1,)
    weights along a row or column, from the middle on, of what blurs the stack's picture before it is compared; space:
    (4, 4) what RGBA was multiplied by to give the coordinates of the target, in which inks are too."""

    target: np.ndarray
    channels: Sequence[float]
    bound: float
    grid: int = 0
    taps: np.ndarray = field(default_factory=lambda: np.ones(1))
    space: np.ndarray = field(default_factory=lambda: np.eye(4))

    @property
    def reach(self) -> int:
        """Px to either side that a blur carries, 0 without one."""
        return len(self.taps) - 1

    @cached_property
    def inside(self) -> np.ndarray:
        """(H, W) bool: pixels of the target that are opaque and lie next to no others, as at the edge of a drawing."""
        opaque = np.pad(self.target[..., 3] >= _OPAQUE, 1, mode="edge")
        wide = opaque[:, :-2] & opaque[:, 1:-1] & opaque[:, 2:]
        return np.asarray(wide[:-2] & wide[1:-1] & wide[2:])

    def _pointers(self) -> _Fit:
        return _Fit(
            _at(self.target, np.float64, self.target.shape), (c_double * 4)(*self.channels), self.bound, self.reach,
            _at(self.taps, np.float64, self.taps.shape),
        )  # fmt: skip


@dataclass(frozen=True)
class StackPieces:
    """S lines and cubics of L layers, back to front. ends: (L,) int32, how many pieces there are up to and with each
    layer; cubics: (S, 4, 2) px, closed outlines; lines: (S,) bool; signs: (S,) 1, or -1 where an outline runs the wrong
    way round; inks: (L, 4) premultiplied."""

    ends: np.ndarray
    cubics: np.ndarray
    lines: np.ndarray
    signs: np.ndarray
    inks: np.ndarray


@dataclass(frozen=True)
class CoverageJacobian:
    """Of m crossings of a piece and a pixel: piece (m,) and pixel (m,) int32, row times width plus column; t (m,) the
    parameter; change (m, 8) of the pixel's coverage with the piece's control points; slope (m, 4) of the picture with
    that coverage. In the order of the pieces."""

    piece: np.ndarray
    pixel: np.ndarray
    t: np.ndarray
    change: np.ndarray
    slope: np.ndarray


def draw_stack(pieces: StackPieces, goal: Goal) -> tuple[np.ndarray, np.ndarray, CoverageJacobian]:
    """The picture (H, W, 4) of a stack, blurred where the goal is, the misfit (H, W) of its pixels, and its crossings,
    whose changes are those of exact areas and of the sharp picture in any case.
    """
    height, width, _ = goal.target.shape
    count = len(pieces.cubics)
    stack = _Stack(
        width, height, len(pieces.ends), goal.grid,
        _at(pieces.ends, np.int32, (len(pieces.inks),)), _at(pieces.cubics, np.float64, (count, 4, 2)),
        _at(pieces.lines, np.bool_, (count,)), _at(pieces.signs, np.float64, (count,)),
        _at(pieces.inks, np.float64, (len(pieces.ends), 4)),
    )  # fmt: skip
    image, misfit = np.empty((height, width, 4)), np.empty((height, width))
    room = int(np.abs(np.diff(pieces.cubics, axis=1)).sum()) + _ROOM * count
    while True:
        found = CoverageJacobian(
            np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room), np.empty((room, 8)), np.empty((room, 4))
        )
        out = _pointers_to(found, room)
        _check(_library().cs_stack_draw(stack, goal._pointers(), image.ctypes.data, misfit.ctypes.data, out))
        if out.count <= room:
            break
        room = out.count
    n = out.count
    parts = (found.piece, found.pixel, found.t, found.change, found.slope)
    return image, misfit, CoverageJacobian(*(part[:n].copy() for part in parts))


def normal_equations(
    goal: Goal, image: np.ndarray, crossings: CoverageJacobian, count: int
) -> tuple[sparse.bsr_matrix, np.ndarray]:
    """The Gram matrix (8 S, 8 S) and the gradient (8 S,) over the control points of `count` pieces, S."""
    gradient = np.empty(8 * count)
    room = 2 * _ROOM * count
    n = len(crossings.piece)
    while True:
        first, second, blocks = np.empty(room, np.int32), np.empty(room, np.int32), np.empty((room, 8, 8))
        out = _Equations(
            count, goal.target.shape[1], goal.target.shape[0], room, 0,
            first.ctypes.data, second.ctypes.data, blocks.ctypes.data, gradient.ctypes.data,
        )  # fmt: skip
        found = _pointers_to(crossings, n)
        _check(_library().cs_stack_equations(goal._pointers(), image.ctypes.data, found, out))
        if out.count <= room:
            break
        room = out.count
    first, second, blocks = first[: out.count], second[: out.count], blocks[: out.count]
    apart = first != second
    rows, columns = np.concatenate([first, second[apart]]), np.concatenate([second, first[apart]])
    values = np.concatenate([blocks, blocks[apart].transpose(0, 2, 1)])
    order = np.lexsort((columns, rows))
    starts = np.searchsorted(rows[order], np.arange(count + 1))
    gram = sparse.bsr_matrix((values[order], columns[order], starts), shape=(8 * count, 8 * count))
    return gram, gradient


def _pointers_to(crossings: CoverageJacobian, room: int) -> _Crossings:
    n = len(crossings.piece)
    return _Crossings(
        room, n,
        _at(crossings.piece, np.int32, (n,)), _at(crossings.pixel, np.int32, (n,)), _at(crossings.t, np.float64, (n,)),
        _at(crossings.change, np.float64, (n, 8)), _at(crossings.slope, np.float64, (n, 4)),
    )  # fmt: skip


def _at(array: np.ndarray, kind: type, shape: tuple[int, ...]) -> int:
    """Where an array lies, which must be contiguous, of this type and shape."""
    if array.dtype != kind or array.shape != shape or not array.flags.c_contiguous:
        raise EngineError(f"expected a contiguous {np.dtype(kind)} array {shape}, not {array.dtype} {array.shape}")
    return int(array.ctypes.data)


def _check(result: int) -> None:
    if result:
        raise EngineError("there is no memory for the finish of the drawing; make the picture smaller")


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    lib = library()
    lib.cs_stack_draw.argtypes = [POINTER(_Stack), POINTER(_Fit), c_void_p, c_void_p, POINTER(_Crossings)]
    lib.cs_stack_equations.argtypes = [POINTER(_Fit), c_void_p, POINTER(_Crossings), POINTER(_Equations)]
    return lib
