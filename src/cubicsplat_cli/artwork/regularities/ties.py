"""Variables that are the same, or opposite: fewer that move freely; and rings that move with them and stay regular."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import Parameters, RingParameters
from cubicsplat_cli.artwork.geometry.outlines import Outline
from cubicsplat_cli.artwork.geometry.variables import Pieces
from cubicsplat_cli.raster.sparse import SparseRows

EXACT = 1e-6  # px, or steps, by which what is tied may be off
LEAST = 1e-9  # px, and coefficients, below this are of the arithmetic


# One variable's number, another's, and the sign, 1 or -1, times which that is the first; below 0 for what is fixed.
Tie = tuple[int, int, float]


def tie_matrix(count: int, ties: Sequence[Tie]) -> SparseRows:
    """(count, free): how `count` variables follow from the free ones. What is tied to something fixed, or is its own
    opposite, is fixed: its row is empty.
    """
    # The last root stands for all that is fixed.
    root, sign = list(range(count + 1)), [1.0] * (count + 1)

    def find(i: int) -> tuple[int, float]:
        factor = 1.0
        while root[i] != i:
            factor *= sign[i]
            i = root[i]
        return i, factor

    for *numbers, factor in ties:
        (a, own), (b, other) = (find(k if k >= 0 else count) for k in numbers)
        if a == b:
            if a != count and own != factor * other:
                root[a] = count
            continue
        low, high = (a, b) if b == count else (b, a)
        root[low], sign[low] = high, own * factor * other
    found = [find(i) for i in range(count)]
    free = np.unique([r for r, _ in found if r != count])
    rows = np.array([i for i, (r, _) in enumerate(found) if r != count], dtype=int)
    columns = np.searchsorted(free, [found[i][0] for i in rows])
    return SparseRows.of(rows, columns, np.array([found[i][1] for i in rows]), (count, len(free)))


def null_basis(count: int, equations: Iterable[Mapping[int, float]]) -> SparseRows:
    """(count, free): how `count` variables follow from the free ones, some of themselves, so that sums of variables
    times factors are zero; equations: the factors of each sum by the variable's number.

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


class TiedRing:
    """A ring that moves as its free variables say. ties: (variables, free), of the pieces."""

    def __init__(self, pieces: Pieces, ties: SparseRows) -> None:
        self.pieces, self.ties = pieces, ties
        self.cubics, self.lines = pieces.cubics, pieces.lines

    @cached_property
    def jacobian(self) -> SparseRows:
        return self.pieces.jacobian.after(self.ties)

    def moved(self, step: np.ndarray) -> TiedRing:
        return TiedRing(self.pieces.moved(self.ties.times(step)), self.ties)

    def outline(self) -> Outline:
        return self.pieces.ring()

    def on_steps(self, step: float) -> TiedRing:
        """The ring with its anchors on whole steps of a file's grid, px, so that rounding leaves it as regular; itself
        where what is fixed lies on none."""
        free = np.zeros(self.ties.shape[1])
        for place, number in zip(self.pieces.anchors.ravel().tolist(), self.pieces.tied.ravel().tolist(), strict=True):
            columns, values = self.ties.row(max(number, 0))
            if number >= 0 and len(columns) == 1 and values[0] == 1.0:
                free[columns[0]] = round(place / step) * step - place
        moved = self.moved(free)
        steps = moved.pieces.anchors / step
        return moved if bool((np.abs(steps - np.rint(steps)) < EXACT).all()) else self


def tied_ring(parameters: Parameters) -> TiedRing | None:
    """A ring with nothing tied that it has not been already; None for what is no ring of its own."""
    if isinstance(parameters, TiedRing):
        return parameters
    if isinstance(parameters, RingParameters) and parameters.origin is None:
        return TiedRing(parameters.pieces, SparseRows.identity(parameters.pieces.joints.variables))
    return None
