"""Sparse matrices by rows: how many numbers move with few of them; and groups of things that are linked, natively:
scipy.sparse.csgraph takes a third of a second to import.
"""

from __future__ import annotations

from ctypes import c_int64
from functools import cached_property

import numpy as np

from cubicsplat_cli.raster.cpu import int64s, native
from cubicsplat_cli.record import record


@record
class SparseRows:
    """A matrix of `count` columns. starts: (rows + 1,) where the entries of each row begin; columns, values: (n,) of
    the entries, of which several in one place are summed."""

    starts: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    count: int

    @classmethod
    def of(cls, rows: np.ndarray, columns: np.ndarray, values: np.ndarray, shape: tuple[int, int]) -> SparseRows:
        """That of entries in any order; rows, columns, values: (n,); those in one place become one, zeros none."""
        places, number = np.unique(np.asarray(rows, dtype=np.int64) * shape[1] + columns, return_inverse=True)
        sums = np.bincount(number, values, len(places))
        places, sums = places[sums != 0.0], sums[sums != 0.0]
        row, column = np.divmod(places, max(shape[1], 1))
        return cls(np.searchsorted(row, np.arange(shape[0] + 1)), column, sums, shape[1])

    @classmethod
    def identity(cls, count: int) -> SparseRows:
        """The matrix that changes nothing."""
        return cls(np.arange(count + 1), np.arange(count), np.ones(count), count)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.starts) - 1, self.count

    @cached_property
    def rows(self) -> np.ndarray:
        """(n,) the row of each entry."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))

    def toarray(self) -> np.ndarray:
        """(rows, columns) all values."""
        out = np.zeros(self.shape)
        np.add.at(out, (self.rows, self.columns), self.values)
        return out

    def row(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """The columns and the values of the entries of a row."""
        own = slice(self.starts[number], self.starts[number + 1])
        return self.columns[own], self.values[own]

    def times(self, vector: np.ndarray) -> np.ndarray:
        """(rows,) the product with a vector (columns,)."""
        return np.bincount(self.rows, self.values * vector[self.columns], len(self.starts) - 1)

    def after(self, other: SparseRows) -> SparseRows:
        """The product with another matrix, which has a row for each column of this one."""
        sizes = np.diff(other.starts)[self.columns]
        place = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        place += np.repeat(other.starts[self.columns], sizes)
        values = np.repeat(self.values, sizes) * other.values[place]
        return SparseRows.of(np.repeat(self.rows, sizes), other.columns[place], values, (self.shape[0], other.count))


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
