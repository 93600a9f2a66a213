"""Rings whose variables follow from fewer free ones, so that they stay as regular as they are."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse

from cubicsplat_cli.artwork.finish.freedom import Freedom, RingFreedom
from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring
from cubicsplat_cli.artwork.tracing.variables import Pieces, Variables

ON_STEP = 1e-6  # steps by which a coordinate may be off a whole one


class TiedRing:
    """A ring that moves as its free variables say. ties: (variables, free), see `Variables`."""

    def __init__(self, pieces: Pieces, ties: sparse.csr_matrix) -> None:
        self.pieces, self.ties = pieces, ties
        self.variables = Variables(pieces)
        self.cubics, self.lines = pieces.cubics, pieces.lines

    @cached_property
    def jacobian(self) -> sparse.csr_matrix:
        return (self.variables.jacobian() @ self.ties).tocsr().sorted_indices()

    def moved(self, step: np.ndarray) -> TiedRing:
        return TiedRing(self.variables.moved(np.append(self.ties @ step, 0.0)), self.ties)

    def trimmed(self) -> TiedRing:
        return self

    def outline(self) -> Outline:
        p = self.pieces
        return Ring(p.anchors, self.cubics[:, 1:3].copy(), p.lines.copy(), p.smooth.copy())

    def on_steps(self, step: float) -> TiedRing:
        """The ring with its anchors on whole steps of a file's grid, px, so that rounding leaves it as regular; itself
        where what is fixed lies on none."""
        free = np.zeros(self.ties.shape[1])
        for place, number in zip(self.pieces.anchors.ravel().tolist(), self.pieces.tied.ravel().tolist(), strict=True):
            row = self.ties[number] if number >= 0 else None
            if row is not None and row.nnz == 1 and row.data[0] == 1.0:
                free[row.indices[0]] = round(place / step) * step - place
        moved = self.moved(free)
        steps = moved.pieces.anchors / step
        return moved if bool((np.abs(steps - np.rint(steps)) < ON_STEP).all()) else self


def tied_ring(freedom: Freedom) -> TiedRing | None:
    """A ring with nothing tied that it has not been already; None for what is no ring of its own."""
    if isinstance(freedom, TiedRing):
        return freedom
    if isinstance(freedom, RingFreedom) and freedom.origin is None:
        total = Variables(freedom.pieces).total
        return TiedRing(freedom.pieces, sparse.identity(total, format="csr"))
    return None
