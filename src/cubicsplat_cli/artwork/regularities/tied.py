"""Rings whose variables follow from fewer free ones, so that they stay as regular as they are."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import Parameters, RingParameters
from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring
from cubicsplat_cli.artwork.tracing.variables import Pieces, Variables
from cubicsplat_cli.raster.sparse import SparseRows

ON_STEP = 1e-6  # steps by which a coordinate may be off a whole one


class TiedRing:
    """A ring that moves as its free variables say. ties: (variables, free), see `Variables`."""

    def __init__(self, pieces: Pieces, ties: SparseRows) -> None:
        self.pieces, self.ties = pieces, ties
        self.variables = Variables(pieces)
        self.cubics, self.lines = pieces.cubics, pieces.lines

    @cached_property
    def jacobian(self) -> SparseRows:
        return self.variables.jacobian().after(self.ties)

    def moved(self, step: np.ndarray) -> TiedRing:
        return TiedRing(self.variables.moved(np.append(self.ties.times(step), 0.0)), self.ties)

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
            columns, values = self.ties.row(max(number, 0))
            if number >= 0 and len(columns) == 1 and values[0] == 1.0:
                free[columns[0]] = round(place / step) * step - place
        moved = self.moved(free)
        steps = moved.pieces.anchors / step
        return moved if bool((np.abs(steps - np.rint(steps)) < ON_STEP).all()) else self


def tied_ring(parameters: Parameters) -> TiedRing | None:
    """A ring with nothing tied that it has not been already; None for what is no ring of its own."""
    if isinstance(parameters, TiedRing):
        return parameters
    if isinstance(parameters, RingParameters) and parameters.origin is None:
        total = Variables(parameters.pieces).total
        return TiedRing(parameters.pieces, SparseRows.identity(total))
    return None
