"""Outlines of artwork in whole steps of the file's grid.

Coordinates that are equal stay equal on the grid, so lines along an axis keep their direction and shapes keep the
anchors that they share. Smooth joints stay smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.geometry.steps import aligned, to_steps

MIRROR_REACH = 1  # steps; a handle that is off the mirror image of the one before it by no more is written as that
_TOGETHER = 20_000  # pieces of rings that are rounded at once, which limits the memory


def form_of(ring: Ring) -> bytes:
    """Return a key that is equal for rings in whole steps that differ by a translation only."""
    anchors, controls = ring.anchors - ring.anchors[:1], ring.controls - ring.anchors[:1, None]
    return b"".join(part.tobytes() for part in (anchors, controls, ring.lines))


def grid_rings(rings: Sequence[Ring], precision: int, exact: bool = False) -> list[Ring]:
    """Return rings in whole steps (int64), without pieces of no extent, so perhaps with none.

    Each begins after its line that is the longest to write, since closing a ring draws that line. exact: every point
    goes to the nearest step, as in the rings that share it; otherwise handles keep joints smooth.
    """
    grid: list[Ring] = []
    first, pieces = 0, 0
    for number, ring in enumerate(rings, start=1):
        pieces += ring.pieces
        if pieces >= _TOGETHER or number == len(rings):
            grid += _on_grid(rings[first:number], precision, exact)
            first, pieces = number, 0
    return grid


def _on_grid(rings: Sequence[Ring], precision: int, exact: bool) -> list[Ring]:
    """Return the rings of `grid_rings`; they are pieces of one array on the way."""
    parts = zip(*((ring.anchors, ring.controls, ring.lines, ring.smooth) for ring in rings), strict=True)
    anchors, controls, lines, smooth = (np.concatenate(part) for part in parts)
    pieces = Ring(to_steps(anchors, precision), to_steps(controls, precision), lines.astype(bool), smooth.astype(bool))
    owner = np.repeat(np.arange(len(rings)), [ring.pieces for ring in rings])
    moved = (pieces.anchors[_next_in_loops(owner)] != pieces.anchors).any(axis=1)
    bent = ~pieces.lines & (pieces.controls != pieces.anchors[:, None]).any(axis=(1, 2))
    pieces, owner = pieces.chosen(moved | bent), owner[moved | bent]
    pieces = pieces.chosen(_started_after_a_line(pieces, owner))
    if not exact:
        pieces = replace(pieces, controls=smoothed(pieces, _next_in_loops(owner)))
    ends = np.cumsum(np.bincount(owner, minlength=len(rings)))
    return [pieces.chosen(np.arange(first, end)) for first, end in pairwise([0, *ends.tolist()])]


def _next_in_loops(owner: np.ndarray) -> np.ndarray:
    """Return the number (n,) of the piece after each one in its loop. owner: (n,) ascending, the loop of each piece."""
    following = np.arange(1, len(owner) + 1)
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    following[np.append(starts[1:], len(owner))[: len(starts)] - 1] = starts
    return following


def _started_after_a_line(ring: Ring, owner: np.ndarray) -> np.ndarray:
    """Return the order (A,) in which the first of the lines with the most digits comes last in its loop.

    A loop without lines keeps its order. owner: (A,) ascending, the loop of each piece.
    """
    steps = np.abs(ring.anchors[_next_in_loops(owner)] - ring.anchors)
    digits = np.where(steps > 0, 1.0 + np.log10(np.maximum(steps, 1)), 0.0).sum(axis=1)
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    sizes = np.diff(np.append(starts, len(owner)))
    longest = np.lexsort((np.where(ring.lines, -digits, 1.0), owner))[starts]
    last = np.where(ring.lines[longest], longest - starts, sizes - 1)
    first, size, shift = (np.repeat(values, sizes) for values in (starts, sizes, last + 1))
    return np.asarray(first + (np.arange(len(owner)) - first + shift) % size)


def smoothed(ring: Ring, following: np.ndarray, even: bool = True) -> np.ndarray:
    """Return controls whose shorter handle at each smooth joint is at most two steps nearer to the other's line.

    following: (A,) the piece after each one. even: whether handles that are then nearly equal become equal.
    """
    controls = ring.controls.copy()
    if not ring.smooth.any():
        return controls
    previous = np.empty_like(following)
    previous[following] = np.arange(len(following))
    line_before = ring.lines[previous]
    # The handle of a line is its other end, which cannot move.
    before = np.where(line_before[:, None], ring.anchors[previous], ring.controls[previous, 1])
    after = np.where(ring.lines[:, None], ring.anchors[following], ring.controls[:, 0])
    back, ahead = before - ring.anchors, after - ring.anchors
    longer_back = (back**2).sum(axis=1) >= (ahead**2).sum(axis=1)
    joint = ring.smooth & ((back * ahead).sum(axis=1) < 0)
    move_ahead = joint & ~ring.lines & (longer_back | line_before)
    move_back = joint & ~line_before & ~move_ahead
    controls[move_ahead, 0] = ring.anchors[move_ahead] + aligned(ahead[move_ahead], back[move_ahead])
    controls[previous[move_back], 1] = ring.anchors[move_back] + aligned(back[move_back], ahead[move_back])
    if even:
        # Two handles that are mirror images within a step become as the shorter one. That does not depend on the
        # direction of the ring, so symmetric outlines stay symmetric.
        back, ahead = controls[previous, 1] - ring.anchors, controls[:, 0] - ring.anchors
        near = joint & ~ring.lines & ~line_before & (np.abs(back + ahead).max(axis=1) <= MIRROR_REACH)
        shorter = np.where(((back**2).sum(axis=1) < (ahead**2).sum(axis=1))[:, None], back, -ahead)
        controls[near, 0] = (ring.anchors - shorter)[near]
        controls[previous[near], 1] = (ring.anchors + shorter)[near]
    return controls
