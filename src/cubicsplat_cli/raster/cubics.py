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


def _plain(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=np.float64)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    lib = library()
    lib.cs_nearer.restype = lib.cs_fit_cubics.restype = None
    lib.cs_nearer.argtypes = [c_int64, c_int64, *[c_void_p] * 4]
    lib.cs_fit_cubics.argtypes = [c_int64, c_int32, c_int32, *[c_void_p] * 10]
    return lib
