"""A pen stroke: a line or closed outline drawn with a pen of one width."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Rectangle, Ring, thirds
from cubicsplat_cli.record import record

BUTT, ROUND, SQUARE = "butt", "round", "square"
MITER, BEVEL = "miter", "bevel"
# A width is even where it is off the usual one by no more than a share of it and so many px.
EVEN_SHARE, EVEN_PX = 0.05, 0.2


@record
class Chain:
    """An open row of lines and cubics. anchors: (A, 2) px, A >= 2; controls: (A - 1, 2, 2) the inner control points of
    the piece from each anchor to the next, at its thirds for a line; lines: (A - 1,) bool; smooth: (A,) bool, at which
    anchors the tangent is continuous."""

    anchors: np.ndarray
    controls: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray

    @property
    def pieces(self) -> int:
        """A - 1, the number of lines and cubics."""
        return len(self.lines)

    @property
    def cubics(self) -> np.ndarray:
        """(A - 1, 4, 2) the control points of every piece."""
        return np.concatenate([self.anchors[:-1, None], self.controls, self.anchors[1:, None]], axis=1)

    @property
    def coordinates(self) -> int:
        """Numbers in its path data: 2 to start, 6 a cubic, 2 a line (1 along an axis)."""
        axis = (np.abs(np.diff(self.anchors, axis=0)) < 1e-9).any(axis=1)
        return 2 + int(np.where(self.lines, np.where(axis, 1, 2), 6).sum())


Path = Chain | Ring | Circle | Ellipse | Rectangle


@record
class Stroke:
    """path: the centre line, an outline where it is closed. width: px, > 0. cap: "butt", "round" or "square"; join:
    "miter", "round" or "bevel"."""

    path: Path
    width: float
    cap: str = BUTT
    join: str = MITER

    @property
    def closed(self) -> bool:
        """Whether it returns to its start."""
        return not isinstance(self.path, Chain)

    @property
    def coordinates(self) -> int:
        """Numbers of its path, and its width."""
        return self.path.coordinates + 1


def line_chain(points: np.ndarray) -> Chain:
    """The chain of straight lines through points (A, 2)."""
    controls = thirds(points[:-1], points[1:])
    return Chain(points, controls, np.ones(len(controls), dtype=bool), np.zeros(len(points), dtype=bool))


def pieces_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Control points (S, 4, 2) of a path's pieces, and which are lines (S,)."""
    ring = path if isinstance(path, Chain) else path.ring()
    return ring.cubics, ring.lines
