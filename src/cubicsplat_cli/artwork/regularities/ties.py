"""Equations between the variables of a ring: which of them move freely, and rings that move with these alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import LEAST, Parameters, RingParameters
from cubicsplat_cli.artwork.geometry.variables import Pieces
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


def tied_ring(parameters: Parameters) -> RingParameters | None:
    """Return a ring with ties, if only each variable to itself; None for copies, primitives and level rectangles."""
    if not isinstance(parameters, RingParameters) or parameters.is_box:
        return None
    if parameters.ties is not None:
        return parameters
    return RingParameters(parameters.pieces, ties=SparseRows.identity(parameters.pieces.joints.variables))


def constrained(
    ring: RingParameters, rows: np.ndarray, missed: Callable[[Pieces, np.ndarray], np.ndarray], others: np.ndarray
) -> RingParameters | None:
    """Return a ring with ties brought to where equations hold, and tied by them too; None where nothing fulfils them.

    rows: (equations, variables + others), the derivatives by the variables of its pieces and by other numbers, which
    begin at `others`; missed: by how much, about px, pieces and such numbers miss the equations.
    """
    assert ring.ties is not None
    inner = ring.ties.shape[0]
    matrix = np.hstack([rows[:, :inner] @ ring.ties.toarray(), rows[:, inner:]])
    step = np.linalg.lstsq(matrix, -missed(ring.pieces, others), rcond=None)[0]
    brought = ring.moved(step[: ring.ties.count])
    if np.abs(missed(brought.pieces, others + step[ring.ties.count :])).max() > EXACT:
        return None
    equations = [{int(k): float(row[k]) for k in np.flatnonzero(np.abs(row) > LEAST)} for row in matrix]
    return RingParameters(brought.pieces, ties=ring.ties.after(null_basis(matrix.shape[1], equations)))


def on_steps(ring: RingParameters, step: float) -> RingParameters:
    """Return a ring with ties with its anchors on whole steps of a file's grid, px, so that rounding leaves it as
    regular; itself where what is fixed lies on none.
    """
    assert ring.ties is not None
    free = np.zeros(ring.ties.count)
    for place, number in zip(ring.pieces.anchors.ravel().tolist(), ring.pieces.tied.ravel().tolist(), strict=True):
        columns, values = ring.ties.row(max(number, 0))
        if number >= 0 and len(columns) == 1 and values[0] == 1.0:
            free[columns[0]] = round(place / step) * step - place
    moved = ring.moved(free)
    steps = moved.pieces.anchors / step
    return moved if bool((np.abs(steps - np.rint(steps)) < EXACT).all()) else ring
