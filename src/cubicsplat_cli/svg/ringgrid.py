"""Rings of artwork in whole steps of the file's grid, with their smooth joints kept smooth.

Equal coordinates stay equal: lines along an axis stay so, and anchors that shapes share stay shared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.geometry.steps import aligned, to_steps

# Steps by which a handle may be off the mirror image of the one before it and be written as that.
MIRROR_REACH = 1


@dataclass(frozen=True)
class GridRing:
    """anchors: (A, 2) int64 in steps. controls: (A, 2, 2) int64, of piece i from anchor i to i + 1. lines: (A,) bool.
    smooth: (A,) bool, at which anchors the tangent is meant to be continuous.
    """

    anchors: np.ndarray
    controls: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray

    @property
    def pieces(self) -> int:
        """A, the number of lines and cubics; 0 where the ring has shrunk to a point."""
        return len(self.anchors)

    @property
    def form(self) -> bytes:
        """The same for rings that are alike but for where they lie."""
        anchors, controls = self.anchors - self.anchors[:1], self.controls - self.anchors[:1, None]
        return b"".join(part.tobytes() for part in (anchors, controls, self.lines))


def grid_ring(ring: Ring, precision: int, exact: bool = False) -> GridRing:
    """The ring on the grid, without pieces of no extent, begun so that its closing line is the longest to write.

    exact: every point goes to the nearest step, as in the rings that share it; otherwise handles keep joints smooth.
    """
    anchors, controls = to_steps(ring.anchors, precision), to_steps(ring.controls, precision)
    found = GridRing(anchors, controls, np.asarray(ring.lines, bool), np.asarray(ring.smooth, bool))
    found = _begun_after_a_line(_without_points(found))
    return found if exact else GridRing(found.anchors, _smoothed(found), found.lines, found.smooth)


def _without_points(ring: GridRing) -> GridRing:
    after = np.roll(ring.anchors, -1, axis=0)
    moved = (after != ring.anchors).any(axis=1)
    bent = ~ring.lines & (ring.controls != ring.anchors[:, None]).any(axis=(1, 2))
    kept = moved | bent
    return GridRing(ring.anchors[kept], ring.controls[kept], ring.lines[kept], ring.smooth[kept])


def _begun_after_a_line(ring: GridRing) -> GridRing:
    """The line with the most digits comes last, since closing the path draws it for nothing."""
    if not ring.lines.any():
        return ring
    steps = np.abs(np.roll(ring.anchors, -1, axis=0) - ring.anchors)
    digits = np.where(steps > 0, 1.0 + np.log10(np.maximum(steps, 1)), 0.0).sum(axis=1)
    last = int(np.argmax(np.where(ring.lines, digits, -1.0)))
    order = (last + 1 + np.arange(ring.pieces)) % ring.pieces
    return GridRing(ring.anchors[order], ring.controls[order], ring.lines[order], ring.smooth[order])


def _smoothed(ring: GridRing) -> np.ndarray:
    """Controls whose shorter handle at each smooth joint is moved by at most two steps towards the other's line."""
    controls = ring.controls.copy()
    if not ring.smooth.any():
        return controls
    before, after = np.roll(ring.controls[:, 1], 1, axis=0), ring.controls[:, 0]
    line_before = np.roll(ring.lines, 1)
    # A line's handle is its other end, which is where it is.
    before = np.where(line_before[:, None], np.roll(ring.anchors, 1, axis=0), before)
    after = np.where(ring.lines[:, None], np.roll(ring.anchors, -1, axis=0), after)
    back, ahead = before - ring.anchors, after - ring.anchors
    longer_back = (back**2).sum(axis=1) >= (ahead**2).sum(axis=1)
    joint = ring.smooth & ((back * ahead).sum(axis=1) < 0)
    move_ahead = joint & ~ring.lines & (longer_back | line_before)
    move_back = joint & ~line_before & ~move_ahead
    controls[move_ahead, 0] = (ring.anchors + aligned(ahead, back))[move_ahead]
    controls[np.roll(move_back, -1), 1] = np.roll(ring.anchors + aligned(back, ahead), -1, axis=0)[
        np.roll(move_back, -1)
    ]
    return _evened(ring, controls, joint & ~ring.lines & ~line_before)


def _evened(ring: GridRing, controls: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Controls of which the two at a joint (A,) bool that are each other's mirror images but for a step are so: both
    are as the shorter one, whichever way round the ring runs, so that what is symmetric stays so.
    """
    back, ahead = np.roll(controls[:, 1], 1, axis=0) - ring.anchors, controls[:, 0] - ring.anchors
    even = joint & (np.abs(back + ahead).max(axis=1) <= MIRROR_REACH)
    shorter = np.where(((back**2).sum(axis=1) < (ahead**2).sum(axis=1))[:, None], back, -ahead)
    controls = controls.copy()
    controls[even, 0] = (ring.anchors - shorter)[even]
    after = np.roll(even, -1)
    controls[after, 1] = np.roll(ring.anchors + shorter, -1, axis=0)[after]
    return controls
