"""All anchors, tangents and handles of an outline together, fitted to its points by damped Gauss-Newton.

Only distances along the normal count. Joints stay as they are: smooth ones share a direction (that of the line, where
one side is a line), corners do not. Points pass to the neighbouring piece when their foot does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.tracing.variables import Pieces
from cubicsplat_cli.raster.cubics import Division, refined
from cubicsplat_cli.records import dataclass

ROUNDS = 8


@dataclass(frozen=True)
class Feet:
    """The places of n points: piece (n,) int and parameter (n,) in [0, 1]."""

    piece: np.ndarray
    u: np.ndarray


def feet_of(division: Division) -> Feet:
    """First parameters of the points of a division: evenly along its pieces."""
    sizes = division.sizes
    piece = np.repeat(np.arange(len(sizes)), sizes)
    place = np.arange(len(piece)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return Feet(piece, (place + 0.5) / sizes[piece])


def refine(
    pieces: Pieces, points: np.ndarray, weights: np.ndarray, feet: Feet, rounds: int = ROUNDS
) -> tuple[Pieces, Feet, float]:
    """The pieces nearest to the points, their feet, and chi^2 (with Huber's tails).

    points: (n, 2) px; weights: (n,) 1/px^2.
    """
    outline = (pieces.anchors, pieces.incoming, pieces.outgoing)
    (anchors, incoming, outgoing), (piece, u), chi = refined(
        pieces.joints, outline, points, weights, (feet.piece, feet.u), rounds
    )
    return replace(pieces, anchors=anchors, incoming=incoming, outgoing=outgoing), Feet(piece, u), chi
