"""Equations between the variables of a ring, and which of them move freely."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import LEAST
from cubicsplat_cli.raster.sparse import SparseRows

EXACT = 1e-6  # px, or steps, by which what is tied may be off


def null_basis(count: int, equations: Iterable[Mapping[int, float]]) -> SparseRows:
    """Return (count, free) how `count` variables follow from the free ones, some of themselves, so that sums of
    variables times factors are zero; equations: the factors of each sum by the variable's number.

    By Gauss-Jordan elimination, so that factors of 1 and -1 mostly give such again; what follows from other equations
    changes nothing.
    """
    solved: dict[int, dict[int, float]] = {}
    for equation in equations:
        row: dict[int, float] = {}
        for number, factor in equation.items():
            for k, share in solved.get(number, {number: 1.0}).items():
                row[k] = row.get(k, 0.0) + factor * share
        row = {k: factor for k, factor in row.items() if abs(factor) > LEAST}
        if not row:
            continue
        # Divided by 1 whole numbers stay whole, which keeps places on whole steps of a grid there.
        pivot = max(row, key=lambda k: (abs(row[k]) == 1.0, round(abs(row[k]), 6), k))
        own = {k: -factor / row[pivot] for k, factor in row.items() if k != pivot}
        for other in solved.values():
            share = other.pop(pivot, 0.0)
            for k, factor in own.items() if share else ():
                other[k] = other.get(k, 0.0) + share * factor
        solved[pivot] = own
    free = np.array([k for k in range(count) if k not in solved], dtype=int)
    entries = [(k, f, share) for k, own in solved.items() for f, share in own.items() if abs(share) > LEAST]
    entries += [(int(k), int(k), 1.0) for k in free]
    rows, columns = (np.array([entry[i] for entry in entries], dtype=int) for i in (0, 1))
    values = np.array([entry[2] for entry in entries])
    return SparseRows.of(rows, np.searchsorted(free, columns), values, (count, len(free)))
