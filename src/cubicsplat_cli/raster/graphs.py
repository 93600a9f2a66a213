"""Groups of things that are linked, natively: scipy.sparse.csgraph takes a third of a second to import."""

from __future__ import annotations

from ctypes import c_int64

import numpy as np

from cubicsplat_cli.raster.cpu import int64s, native


def linked_groups(count: int, first: np.ndarray, second: np.ndarray) -> tuple[int, np.ndarray]:
    """The number of groups that links make of `count` things, and the number (count,) int32 of each thing's group: in
    the order of their first things.

    first, second: (k,) the things that links join, from 0 on. Raises ValueError for others, and EngineError where the
    library or the memory is missing.
    """
    return _groups("cs_linked", count, first, second)


def strong_groups(count: int, start: np.ndarray, end: np.ndarray) -> tuple[int, np.ndarray]:
    """The same for links that lead one way: the things of a group lead to each other. In any order."""
    return _groups("cs_linked_both_ways", count, start, end)


def _groups(name: str, count: int, first: np.ndarray, second: np.ndarray) -> tuple[int, np.ndarray]:
    ends = [int64s(each) for each in (first, second)]
    if len(ends[0]) != len(ends[1]) or any(len(each) and not 0 <= each.min() <= each.max() < count for each in ends):
        raise ValueError(f"links lead from and to things 0 to {count - 1}")
    found = np.empty(count, np.int32)
    return native("parts", name, count, len(ends[0]), *ends, found, result=c_int64), found
