"""Outlines of artwork in whole steps of the file's grid.

Equal coordinates stay equal on the grid: lines along an axis stay so, and anchors that shapes share stay shared. Smooth
joints stay smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.geometry.steps import aligned, to_steps

MIRROR_REACH = 1  # steps by which a handle may be off the mirror image of the one before it and be written as that
_TOGETHER = 20_000  # pieces of rings that are brought onto the grid at once


def form_of(ring: Ring) -> bytes:
    """A key that is equal for rings in whole steps that differ by a translation only."""
    anchors, controls = ring.anchors - ring.anchors[:1], ring.controls - ring.anchors[:1, None]
    return b"".join(part.tobytes() for part in (anchors, controls, ring.lines))


def grid_rings(rings: Sequence[Ring], precision: int, exact: bool = False) -> list[Ring]:
    """Rings in whole steps (int64), without pieces of no extent, so perhaps with none, and begun so that the closing
    line is the longest to write.

    exact: every point goes to the nearest step, as in the rings that share it; otherwise handles keep joints smooth.
    """
    found: list[Ring] = []
    first, pieces = 0, 0
    for number, ring in enumerate(rings, start=1):
        pieces += ring.pieces
        if pieces >= _TOGETHER or number == len(rings):
            found += _on_grid(rings[first:number], precision, exact)
            first, pieces = number, 0
    return found


def _on_grid(rings: Sequence[Ring], precision: int, exact: bool) -> list[Ring]:
    """The same of rings that are not too many for the memory."""
    parts = zip(*((ring.anchors, ring.controls, ring.lines, ring.smooth) for ring in rings), strict=True)
    anchors, controls, lines, smooth = (np.concatenate(part) for part in parts)
    all_pieces = Ring(
        to_steps(anchors, precision), to_steps(controls, precision), np.asarray(lines, bool), np.asarray(smooth, bool)
    )
    owner = np.repeat(np.arange(len(rings)), [ring.pieces for ring in rings])
    kept = _with_extent(all_pieces, _next_in_loops(owner))
    all_pieces, owner = _picked(all_pieces, kept), owner[kept]
    all_pieces = _picked(all_pieces, _started_after_a_line(all_pieces, owner))
    if not exact:
        all_pieces = replace(all_pieces, controls=smoothed(all_pieces, _next_in_loops(owner)))
    ends = np.cumsum(np.bincount(owner, minlength=len(rings)))
    return [_picked(all_pieces, slice(first, end)) for first, end in pairwise([0, *ends.tolist()])]


def _picked(ring: Ring, which: np.ndarray | slice) -> Ring:
    """The pieces of an index, a mask (A,) or a slice, each with the anchor that it begins at."""
    return Ring(ring.anchors[which], ring.controls[which], ring.lines[which], ring.smooth[which])


def _next_in_loops(owner: np.ndarray) -> np.ndarray:
    """(n,) the number of the piece after each one in its loop. owner: (n,) ascending, whose loop it is in."""
    following = np.arange(1, len(owner) + 1)
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    following[np.append(starts[1:], len(owner))[: len(starts)] - 1] = starts
    return following


def _with_extent(ring: Ring, following: np.ndarray) -> np.ndarray:
    """(A,) bool: the pieces that are no mere points."""
    moved = (ring.anchors[following] != ring.anchors).any(axis=1)
    bent = ~ring.lines & (ring.controls != ring.anchors[:, None]).any(axis=(1, 2))
    return np.asarray(moved | bent)


def _started_after_a_line(ring: Ring, owner: np.ndarray) -> np.ndarray:
    """(A,) the order in which the line of each loop with the most digits comes last, since closing it draws it for
    nothing. owner: (A,) ascending, whose loop each piece is in.
    """
    steps = np.abs(ring.anchors[_next_in_loops(owner)] - ring.anchors)
    digits = np.where(steps > 0, 1.0 + np.log10(np.maximum(steps, 1)), 0.0).sum(axis=1)
    digits = np.where(ring.lines, digits, -1.0)
    order = np.arange(len(owner))
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    if not len(starts):
        return order
    sizes = np.diff(np.append(starts, len(owner)))
    longest = np.repeat(np.maximum.reduceat(digits, starts), sizes)
    place, first = order - np.repeat(starts, sizes), np.repeat(starts, sizes)
    # Of each loop the first of its longest lines; of one without lines, its last piece.
    last = np.minimum.reduceat(np.where((digits == longest) & ring.lines, place, len(owner)), starts)
    last = np.repeat(np.minimum(last, sizes - 1), sizes)
    return np.asarray(first + (last + 1 + place) % np.repeat(sizes, sizes))


def smoothed(ring: Ring, following: np.ndarray, even: bool = True) -> np.ndarray:
    """Controls whose shorter handle at each smooth joint is moved by at most two steps towards the other's line.

    following: (A,) the piece after each one. even: whether handles that are then nearly equal become so.
    """
    controls = ring.controls.copy()
    if not ring.smooth.any():
        return controls
    previous = np.empty_like(following)
    previous[following] = np.arange(len(following))
    line_before = ring.lines[previous]
    # A line's handle is its other end, which is where it is.
    before = np.where(line_before[:, None], ring.anchors[previous], ring.controls[previous, 1])
    after = np.where(ring.lines[:, None], ring.anchors[following], ring.controls[:, 0])
    back, ahead = before - ring.anchors, after - ring.anchors
    longer_back = (back**2).sum(axis=1) >= (ahead**2).sum(axis=1)
    joint = ring.smooth & ((back * ahead).sum(axis=1) < 0)
    move_ahead = joint & ~ring.lines & (longer_back | line_before)
    move_back = joint & ~line_before & ~move_ahead
    controls[move_ahead, 0] = ring.anchors[move_ahead] + aligned(ahead[move_ahead], back[move_ahead])
    controls[previous[move_back], 1] = ring.anchors[move_back] + aligned(back[move_back], ahead[move_back])
    return _evened(ring, controls, previous, joint & ~ring.lines & ~line_before) if even else controls


def _evened(ring: Ring, controls: np.ndarray, previous: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Controls of which the two at a joint (A,) bool that are each other's mirror images but for a step are so: both
    are as the shorter one, whichever direction the ring runs in, so that what is symmetric stays so.
    """
    back, ahead = controls[previous, 1] - ring.anchors, controls[:, 0] - ring.anchors
    even = joint & (np.abs(back + ahead).max(axis=1) <= MIRROR_REACH)
    shorter = np.where(((back**2).sum(axis=1) < (ahead**2).sum(axis=1))[:, None], back, -ahead)
    controls = controls.copy()
    controls[even, 0] = (ring.anchors - shorter)[even]
    controls[previous[even], 1] = (ring.anchors + shorter)[even]
    return controls
