"""Sparse matrices by rows, of numbers that move with few others; and groups of linked things, natively:
scipy.sparse.csgraph takes a third of a second to import.
"""

from __future__ import annotations

from ctypes import c_int64
from functools import cached_property

import numpy as np

from cubicsplat_cli.raster.native import int64s, native
from cubicsplat_cli.record import record


@record
class SparseRows:
    """A matrix of `count` columns. starts: (rows + 1,) the beginning of the entries of each row; columns, values: (n,)
    of the entries; several in one place are summed."""

    starts: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    count: int

    @classmethod
    def of(cls, rows: np.ndarray, columns: np.ndarray, values: np.ndarray, shape: tuple[int, int]) -> SparseRows:
        """Return the matrix of entries (n,) in any order, those in one place summed, without zeros."""
        places, number = np.unique(np.asarray(rows, dtype=np.int64) * shape[1] + columns, return_inverse=True)
        sums = np.bincount(number, values, len(places))
        places, sums = places[sums != 0.0], sums[sums != 0.0]
        row, column = np.divmod(places, max(shape[1], 1))
        return cls(np.searchsorted(row, np.arange(shape[0] + 1)), column, sums, shape[1])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.starts) - 1, self.count

    @cached_property
    def rows(self) -> np.ndarray:
        """(n,) the row of each entry."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))

    def times(self, vector: np.ndarray) -> np.ndarray:
        """Return the product (rows,) with a vector (columns,)."""
        return np.bincount(self.rows, self.values * vector[self.columns], len(self.starts) - 1)

    def after(self, other: SparseRows) -> SparseRows:
        """Return the product with another matrix, which has a row for each column of this one."""
        sizes = np.diff(other.starts)[self.columns]
        place = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        place += np.repeat(other.starts[self.columns], sizes)
        values = np.repeat(self.values, sizes) * other.values[place]
        return SparseRows.of(np.repeat(self.rows, sizes), other.columns[place], values, (self.shape[0], other.count))


def linked_groups(
    count: int, first: np.ndarray, second: np.ndarray, *, directed: bool = False
) -> tuple[int, np.ndarray]:
    """Return the number of groups that links make of `count` things, and the number (count,) int32 of each thing's
    group, in the order of their first things.

    first, second: (k,) the things that links join, from 0 on. directed: links lead from first to second, the things of
    a group lead to each other, and groups come in any order. Raises ValueError for other things.
    """
    ends = [int64s(things) for things in (first, second)]
    if len(ends[0]) != len(ends[1]) or any(len(e) and not 0 <= e.min() <= e.max() < count for e in ends):
        raise ValueError(f"links lead from and to things 0 to {count - 1}")
    groups = np.empty(count, np.int32)
    name = "cs_linked_both_ways" if directed else "cs_linked"
    return native("parts", name, count, len(ends[0]), *ends, groups, result=c_int64), groups
