"""Cubics fitted to runs of points, and the feet of points on cubics, by the native library."""

from __future__ import annotations

import ctypes
from ctypes import c_int32, c_int64, c_void_p
from functools import lru_cache

import numpy as np

from cubicsplat_cli.raster.cpu import library


def newton_steps(cubics: np.ndarray, points: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The parameters u (P, K) after one Newton step towards the feet of points (P, K, 2) on cubics (P, 4, 2).

    Raises EngineError where the library is missing.
    """
    cubics, points, u = _plain(cubics), _plain(points), _plain(u)
    out = np.empty_like(u)
    _library().cs_nearer(*u.shape, *(array.ctypes.data for array in (cubics, points, u, out)))
    return out


def gauss_newton(
    base: np.ndarray,
    directions: np.ndarray,
    expected: np.ndarray,
    stiffness: np.ndarray,
    limits: np.ndarray,
    points: np.ndarray,
    weights: np.ndarray,
    u: np.ndarray,
    rounds: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (P, 6), cubics (P, 4, 2) and parameters (P, K) of P cubics, each nearest to its K points along the normal.

    A cubic is base (P, 4, 2) + its values times directions (P, 6, 4, 2); values are pulled towards those expected
    (P, 6) with a stiffness (P, 6), the first two keep within limits (P, 2). points: (P, K, 2). weights: (P, K). u:
    (P, K) to start from. Raises EngineError where the library is missing.
    """
    given = [_plain(array) for array in (base, directions, expected, stiffness, limits, points, weights)]
    u, values, cubics = _plain(u).copy(), np.empty((len(base), 6)), np.empty((len(base), 4, 2))
    arrays = (array.ctypes.data for array in (*given, u, values, cubics))
    _library().cs_fit_cubics(*u.shape, rounds, *arrays)
    return values, cubics, u


def settled(
    cubics: np.ndarray,
    ends: np.ndarray,
    smooth: np.ndarray,
    points: np.ndarray,
    piece: np.ndarray,
    u: np.ndarray,
    rounds: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The pieces (n,) and parameters (n,) of the feet of points (n, 2) on an outline, nearer by `rounds` Newton steps,
    and of each how far it is off its point along the normal (n,), px, and that (n, 2).

    cubics: (S, 4, 2) px; ends: (S,) the anchor at which each piece ends; smooth: (A,) bool, at which anchors feet pass
    to the neighbouring piece. Raises EngineError where the library is missing.
    """
    piece, u = np.array(piece, dtype=np.int64), np.array(u, dtype=np.float64)
    given = [_plain(cubics), np.ascontiguousarray(ends, np.int64), np.ascontiguousarray(smooth, bool), _plain(points)]
    rest, normals = np.empty(len(u)), np.empty((len(u), 2))
    arrays = (array.ctypes.data for array in (*given, piece, u, rest, normals))
    _library().cs_settle(len(u), len(cubics), rounds, *arrays)
    return piece, u, rest, normals


def piece_equations(
    count: int, piece: np.ndarray, u: np.ndarray, rest: np.ndarray, normals: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gram matrices (count, 8, 8) and gradients (count, 8) over the control points of each piece, of the weighted
    squares of the distances `rest` (n,) along the normals (n, 2) at the feet of n points.

    Raises EngineError where the library is missing.
    """
    gram, slope = np.zeros((count, 8, 8)), np.zeros((count, 8))
    given = [np.ascontiguousarray(piece, np.int64), *(_plain(array) for array in (u, rest, normals, weights))]
    _library().cs_piece_equations(len(u), *(array.ctypes.data for array in (*given, gram, slope)))
    return gram, slope


def _plain(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=np.float64)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    lib = library()
    lib.cs_nearer.restype = lib.cs_fit_cubics.restype = None
    lib.cs_settle.restype = lib.cs_piece_equations.restype = None
    lib.cs_settle.argtypes = [c_int64, c_int64, c_int32, *[c_void_p] * 8]
    lib.cs_piece_equations.argtypes = [c_int64, *[c_void_p] * 7]
    lib.cs_nearer.argtypes = [c_int64, c_int64, *[c_void_p] * 4]
    lib.cs_fit_cubics.argtypes = [c_int64, c_int32, c_int32, *[c_void_p] * 10]
    return lib
