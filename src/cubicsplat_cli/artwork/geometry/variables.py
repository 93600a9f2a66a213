"""The free parameters of an outline: anchors, directions of smooth joints, handle lengths, handles at corners.

Which there are follows from what its joints are, and how its control points move with them from where they lie.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring, places_within
from cubicsplat_cli.artwork.geometry.stroke import Chain
from cubicsplat_cli.raster.cubics import (
    Joints,
    moved_outline,
    outline_cubics,
    outline_jacobian,
    refined,
    tied_coordinates,
)
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.record import record

ROUNDS = 8


@record
class Pieces:
    """An outline being fitted: A anchors, S pieces (S = A when closed, else A - 1), piece i from anchor i on.

    anchors: (A, 2) px. incoming, outgoing: (A, 2) px, the handles of the piece before and after each anchor, relative
    to it. lines: (S,) bool. smooth: (A,) bool. level: (A,) bool, smooth anchors whose direction stays as it is.
    tied: (A, 2) int, the variable of each anchor coordinate, -1 for a fixed one.
    """

    anchors: np.ndarray
    incoming: np.ndarray
    outgoing: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray
    level: np.ndarray
    tied: np.ndarray

    @cached_property
    def joints(self) -> Joints:
        """Joints of pieces that move."""
        return Joints(self.lines, self.smooth, self.level, self.tied)

    @cached_property
    def cubics(self) -> np.ndarray:
        """(S, 4, 2) control points, not to be written to; those of a line lie at its thirds."""
        found = outline_cubics(self.lines, self.outline)
        found.flags.writeable = False
        return found

    @property
    def outline(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The anchors, and the handles before and after them."""
        return self.anchors, self.incoming, self.outgoing

    @cached_property
    def jacobian(self) -> SparseRows:
        """(8 S, variables): how the control points move with the variables."""
        values, columns, starts = outline_jacobian(self.joints, self.outline)
        return SparseRows(starts, columns, values, self.joints.variables)

    @classmethod
    def of_chain(cls, chain: Chain) -> Pieces:
        """Return the pieces of a chain; lines that are exactly level or upright stay so."""
        nothing = np.zeros((1, 2))
        outgoing = np.concatenate([chain.controls[:, 0] - chain.anchors[:-1], nothing])
        incoming = np.concatenate([nothing, chain.controls[:, 1] - chain.anchors[1:]])
        tied, level = tied_coordinates(chain.anchors, chain.lines), np.zeros(len(chain.anchors), dtype=bool)
        pieces = cls(chain.anchors, incoming, outgoing, chain.lines, chain.smooth, level, tied)
        return pieces.moved(np.zeros(pieces.joints.variables))

    def ring(self) -> Ring:
        """Return a closed outline as it stands."""
        return Ring(self.anchors, self.cubics[:, 1:3].copy(), self.lines.copy(), self.smooth.copy())

    def chain(self) -> Chain:
        """Return an open outline as it stands."""
        return Chain(self.anchors, self.cubics[:, 1:3].copy(), self.lines.copy(), self.smooth.copy())

    def moved(self, step: np.ndarray) -> Pieces:
        """The pieces after a step of their variables."""
        (anchors, incoming, outgoing), cubics = moved_outline(self.joints, self.outline, step)
        cubics.flags.writeable = False
        found = Pieces(anchors, incoming, outgoing, self.lines, self.smooth, self.level, self.tied)
        vars(found).update(joints=self.joints, cubics=cubics)
        return found


Feet = tuple[np.ndarray, np.ndarray]  # places of n points: piece (n,) int and parameter (n,) in [0, 1]


def feet_of(sizes: np.ndarray) -> Feet:
    """Places evenly along pieces, so many on each (S,)."""
    piece, place = places_within(sizes)
    return piece, (place + 0.5) / sizes[piece]


def refine(
    pieces: Pieces, points: np.ndarray, weights: np.ndarray, feet: Feet, rounds: int = ROUNDS
) -> tuple[Pieces, Feet, float]:
    """The pieces nearest to the points, their feet, and chi^2 (with Huber's tails).

    points: (n, 2) px; weights: (n,) 1/px^2.
    """
    (anchors, incoming, outgoing), feet, chi = refined(pieces.joints, pieces.outline, points, weights, feet, rounds)
    return replace(pieces, anchors=anchors, incoming=incoming, outgoing=outgoing), feet, chi
