"""Elliptical arcs of path data by their middle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.svg.pathparse import Piece


@dataclass(frozen=True, eq=False)
class Arc:
    """A part of a unit circle, and where the drawing has it. first: radians at which it begins; span: radians that it
    runs over, negative against the clock as seen.
    """

    first: float
    span: float
    middle: np.ndarray
    radii: np.ndarray
    turn: np.ndarray
    halfway: np.ndarray

    def placed(self, points: np.ndarray) -> np.ndarray:
        """(n, 2) in the drawing, of points seen from the unit circle's middle."""
        return ((self.middle + points) * self.radii) @ self.turn.T + self.halfway


def arc_of(piece: Piece, start: np.ndarray, end: np.ndarray) -> Arc:
    """The arc of a piece with the command A, both of whose radii are above 0, between two different points (2,).

    Radii that are too short to reach are made as long as they must be. Source: SVG 2, appendix B.2.4.
    """
    rx, ry, degrees, large, sweep = piece.numbers
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn, radii = np.array([[cos, -sin], [sin, cos]]), np.array([rx, ry])
    half = turn.T @ (start - end) / 2.0 / radii
    size = float(half @ half)
    if size > 1.0:
        radii, half, size = radii * math.sqrt(size), half / math.sqrt(size), 1.0
    reach = (1.0 if large != sweep else -1.0) * math.sqrt(max(1.0 / max(size, 1e-12) - 1.0, 0.0))
    middle = reach * np.array([half[1], -half[0]])
    first = math.atan2(half[1] - middle[1], half[0] - middle[0])
    last = math.atan2(-half[1] - middle[1], -half[0] - middle[0])
    span = (last - first) % (2.0 * math.pi)
    return Arc(first, span if sweep else span - 2.0 * math.pi, middle, radii, turn, (start + end) / 2.0)
