"""Frames in groups: a scene cut begins a new one, and so does the limit of what is kept in memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import field

import numpy as np

from cubicsplat_cli.records import dataclass

BLOCKS = 12  # along the longer side: means of blocks move little where a camera pans
LEAST_JUMP = 0.06  # of the range of values, between the blocks of two frames: no cut is smaller
JUMP = 3.0  # times the largest difference of the frames before
REMEMBERED = 8  # differences


@dataclass
class FrameGroup:
    """pictures: (H, W, C) float32 each. times: when each begins, s. end: of the last, s. after_cut: whether its first
    frame has nothing to do with the one before.
    """

    after_cut: bool
    pictures: list[np.ndarray] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    end: float = 0.0

    def add(self, picture: np.ndarray, begin: float, end: float) -> None:
        self.pictures.append(picture)
        self.times.append(begin)
        self.end = end


def groups(frames: Iterable[tuple[np.ndarray, float, float]], most: int) -> Iterator[FrameGroup]:
    """Groups of at most so many frames. frames: pictures (H, W, C), and the seconds of their begin and end."""
    recent: deque[float] = deque(maxlen=REMEMBERED)
    group, before = FrameGroup(after_cut=True), None
    for picture, begin, end in frames:
        blocks = _blocks(picture)
        jump = 0.0 if before is None else float(np.abs(blocks - before).mean())
        cut = jump > max(LEAST_JUMP, JUMP * max(recent, default=0.0))
        if cut or len(group.pictures) == most:
            yield group
            group = FrameGroup(after_cut=cut)
        recent.append(jump)
        if cut:
            recent.clear()
        before = blocks
        group.add(picture, begin, end)
    if group.pictures:
        yield group


def _blocks(picture: np.ndarray) -> np.ndarray:
    """Means of about square blocks, `BLOCKS` along the longer side."""
    side = max(1, -(-max(picture.shape[:2]) // BLOCKS))
    for axis in (0, 1):
        edges = np.arange(0, picture.shape[axis], side)
        counts = np.diff(np.append(edges, picture.shape[axis])).astype(np.float32)
        means = np.add.reduceat(picture, edges, axis=axis)
        picture = means / counts.reshape([-1, 1, 1] if axis == 0 else [1, -1, 1])
    return picture
