"""Cubics and outlines fitted to points, and the feet of points on cubics, by the native library."""

from __future__ import annotations

import ctypes
from ctypes import byref, c_double, c_int32, c_int64, c_void_p
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import library

_T = TypeVar("_T", int, float)
Outline = tuple[np.ndarray, np.ndarray, np.ndarray]


def newton_steps(cubics: np.ndarray, points: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The parameters u (P, K) after one Newton step towards the feet of points (P, K, 2) on cubics (P, 4, 2).

    Raises EngineError where the library is missing.
    """
    cubics, points, u = _plain(cubics), _plain(points), _plain(u)
    out = np.empty_like(u)
    _library().cs_nearer(*u.shape, *(array.ctypes.data for array in (cubics, points, u, out)))
    return out


def piece_misfits(
    first: np.ndarray,
    last: np.ndarray,
    nodes: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    points: np.ndarray,
    weights: np.ndarray,
    price: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of pieces that join P pairs of nodes of a run, first and last (P,): the best cubics (P, 4, 2) px, the misfits of
    those and of the best lines (P,), Huber's chi^2 of 20 points each, and what the angles of lines cost at either end
    (P, 2), nats.

    nodes: of N nodes how many points come before each, positions (N, 2) px, unit tangents (N, 2), and standard errors
    (N, 2), in px across the run and radians, within which cubics choose their ends. points: (n, 2) px, n >= 1, that
    tell something; weights: (n,) 1/px^2. price: of a parameter, nats; cubics that are far off for it are only roughly
    fitted. Raises EngineError where the library is missing.
    """
    count = len(first)
    pairs = [np.ascontiguousarray(array, np.int64) for array in (first, last, nodes[0])]
    given = [_plain(array) for array in (*nodes[1:], points, weights)]
    found = np.empty((count, 4, 2)), np.empty(count), np.empty(count), np.empty((count, 2))
    at = [array.ctypes.data for array in (*pairs, *given[:3])]
    told = (array.ctypes.data for array in given[3:])
    _library().cs_piece_misfits(count, *at, len(weights), *told, price, *(array.ctypes.data for array in found))
    return found


def cheapest_path(
    count: int, first: np.ndarray, last: np.ndarray, costs: np.ndarray, bend: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """The cheapest path from node 0 to node count - 1: its pairs in order, their kinds, and its cost.

    first, last: (P,) of pairs, in the order of their first nodes. costs: (P, 2) of each pair as a line (kind 0) and as
    a cubic (kind 1). bend: of a line after a line. Raises EngineError where the library or the memory is missing.
    """
    given = [np.ascontiguousarray(array, np.int64) for array in (first, last)]
    costs, cost = _plain(costs), c_double()
    path, kinds = np.empty(count, np.int64), np.empty(count, np.int64)
    arrays = (array.ctypes.data for array in (*given, costs))
    out = (array.ctypes.data for array in (path, kinds))
    found = _library().cs_cheapest(count, len(first), *arrays, bend, *out, byref(cost))
    if not found:
        raise EngineError("there is no memory for the outlines of the drawing; make the picture smaller")
    return path[:found][::-1], kinds[:found][::-1], cost.value


@dataclass(frozen=True)
class Joints:
    """What an outline of A anchors and S pieces (A when closed, else A - 1) keeps while it is fitted. lines: (S,) bool.
    smooth: (A,) bool, whether feet pass from piece to piece there, and handles lie in line. level: (A,) bool, smooth
    ones whose direction stays. tied: (A, 2) int, the variable of each coordinate of an anchor, -1 for none."""

    lines: np.ndarray
    smooth: np.ndarray
    level: np.ndarray
    tied: np.ndarray

    def _given(self) -> list[np.ndarray]:
        flags = [np.ascontiguousarray(array, bool) for array in (self.lines, self.smooth, self.level)]
        return [*flags, np.ascontiguousarray(self.tied, np.int64)]

    def variables(self) -> int:
        """How many variables move the outline. Raises EngineError where the library or the memory is missing."""
        given = self._given()
        total = _library().cs_count_variables(len(self.smooth), len(self.lines), *(a.ctypes.data for a in given))
        return _checked(int(total))


def moved_outline(joints: Joints, outline: Outline, step: np.ndarray) -> Outline:
    """An outline after a step of its variables (at least as many numbers), of at most 3 px or half a radian each.

    outline: anchors, and handles before and after them, relative to them, (A, 2) px each. Raises EngineError where the
    library or the memory is missing.
    """
    parts = [np.array(part, dtype=np.float64, order="C") for part in outline]
    arrays = (a.ctypes.data for a in (*joints._given(), _plain(step), *parts))
    _checked(-_library().cs_move_outline(len(joints.smooth), len(joints.lines), *arrays))
    return parts[0], parts[1], parts[2]


def outline_jacobian(joints: Joints, outline: Outline) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How the 8 coordinates of the control points of each piece move with the variables: the values, columns and row
    starts of a sparse matrix. outline: as for `moved_outline`. Raises EngineError where the library or the memory is
    missing.
    """
    rows = 8 * len(joints.lines)
    values, columns, starts = np.empty(8 * rows), np.empty(8 * rows, np.int32), np.empty(rows + 1, np.int32)
    parts = (_plain(part) for part in outline)
    arrays = [a.ctypes.data for a in (*joints._given(), *parts, starts, columns, values)]
    count = _checked(int(_library().cs_outline_jacobian(len(joints.smooth), len(joints.lines), *arrays)))
    return values[:count].copy(), columns[:count].copy(), starts


def refined(
    joints: Joints,
    outline: Outline,
    points: np.ndarray,
    weights: np.ndarray,
    feet: tuple[np.ndarray, np.ndarray],
    rounds: int,
) -> tuple[Outline, tuple[np.ndarray, np.ndarray], float]:
    """An outline nearest to points (n, 2) along its normals, by at most `rounds` damped Gauss-Newton steps, their feet,
    and chi^2: Huber's, of distances in standard errors, linear beyond 3.

    outline: anchors, and handles before and after them, relative to them, (A, 2) px each; those at smooth joints are
    turned into one direction first. weights: (n,) 1/px^2. feet: piece (n,) and parameter (n,) to start from. Raises
    EngineError where the library or the memory is missing.
    """
    given = joints._given()
    parts = tuple(np.array(part, dtype=np.float64, order="C") for part in outline)
    points, weights = _plain(points), _plain(weights)
    piece, u = np.array(feet[0], dtype=np.int64), np.array(feet[1], dtype=np.float64)
    arrays = (a.ctypes.data for a in (*given, *parts))
    places = (a.ctypes.data for a in (points, weights, piece, u))
    chi = _library().cs_refine(len(joints.smooth), len(joints.lines), *arrays, len(u), *places, rounds)
    return (parts[0], parts[1], parts[2]), (piece, u), _checked(float(chi))


def _checked(result: _T) -> _T:
    if result < 0:
        raise EngineError("there is no memory for the outlines of the drawing; make the picture smaller")
    return result


def _plain(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=np.float64)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    lib = library()
    lib.cs_nearer.restype = lib.cs_piece_misfits.restype = None
    lib.cs_count_variables.restype, lib.cs_refine.restype = c_int64, c_double
    lib.cs_count_variables.argtypes = [c_int64, c_int64, *[c_void_p] * 4]
    lib.cs_move_outline.argtypes, lib.cs_outline_jacobian.restype = [c_int64, c_int64, *[c_void_p] * 8], c_int64
    lib.cs_outline_jacobian.argtypes = [c_int64, c_int64, *[c_void_p] * 10]
    lib.cs_refine.argtypes = [c_int64, c_int64, *[c_void_p] * 7, c_int64, *[c_void_p] * 4, c_int32]
    lib.cs_nearer.argtypes = [c_int64, c_int64, *[c_void_p] * 4]
    lib.cs_piece_misfits.argtypes = [c_int64, *[c_void_p] * 6, c_int64, *[c_void_p] * 2, c_double, *[c_void_p] * 4]
    lib.cs_cheapest.argtypes = [c_int64, c_int64, *[c_void_p] * 3, c_double, *[c_void_p] * 3]
    lib.cs_cheapest.restype = c_int64
    return lib
