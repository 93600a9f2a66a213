"""The outlines of masks along the cracks between pixels, as closed loops.

A crack is the unit edge between two neighbouring pixels. Loops run with the mask on their right, so that outer loops
are clockwise as seen (y grows downwards) and holes the other way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Directions of a crack: east, south, west, north.
STEP = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
# Pixel to the right and to the left of a crack from vertex (x, y) in each direction, relative to (x, y).
RIGHT = np.array([[0, 0], [-1, 0], [-1, -1], [0, -1]])
LEFT = np.array([[0, -1], [0, 0], [-1, 0], [-1, -1]])


@dataclass(frozen=True)
class Loop:
    """A closed loop of cracks. x, y: (n,) start vertices; direction: (n,) 0..3, east, south, west, north."""

    x: np.ndarray
    y: np.ndarray
    direction: np.ndarray

    @property
    def inside(self) -> tuple[np.ndarray, np.ndarray]:
        """(rows, columns) of the pixels on the right, within the mask."""
        offset = RIGHT[self.direction]
        return self.y + offset[:, 1], self.x + offset[:, 0]

    @property
    def outside(self) -> tuple[np.ndarray, np.ndarray]:
        """(rows, columns) of the pixels on the left, outside the mask and perhaps off the canvas."""
        offset = LEFT[self.direction]
        return self.y + offset[:, 1], self.x + offset[:, 0]

    @property
    def middles(self) -> np.ndarray:
        """(n, 2) midpoints of the cracks, x and y."""
        return np.stack([self.x, self.y], axis=1) + 0.5 * STEP[self.direction]

    @property
    def area(self) -> float:
        """Enclosed px^2, negative for a hole."""
        ends = np.stack([self.x, self.y], axis=1) + STEP[self.direction]
        return 0.5 * float((self.x * ends[:, 1] - self.y * ends[:, 0]).sum())


def trace(mask: np.ndarray) -> list[Loop]:
    """The loops around a mask (H, W) bool, the longest first; its pixels connect along edges, not corners."""
    padded = np.pad(mask, 1)
    starts = _starts(padded)
    if len(starts) == 0:
        return []
    after = _successors(padded, starts)
    return sorted(_chased(starts, after), key=lambda loop: -len(loop.x))


def _starts(padded: np.ndarray) -> np.ndarray:
    """(n, 3) x, y, direction of every crack with the mask on its right, in the mask's own coordinates."""
    found = []
    height, width = padded.shape
    y, x = np.mgrid[1:height, 1:width]
    for d in range(4):
        right = padded[y + RIGHT[d][1], x + RIGHT[d][0]]
        left = padded[y + LEFT[d][1], x + LEFT[d][0]]
        yy, xx = np.nonzero(right & ~left)
        found.append(np.stack([xx, yy, np.full(len(xx), d)], axis=1))
    return np.concatenate(found)


def _successors(padded: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """(n,) index of the crack that follows each one: right where the mask ends ahead, else straight, else left."""
    direction = starts[:, 2]
    ends = starts[:, :2] + STEP[direction]
    ahead = ends + 1
    right = padded[ahead[:, 1] + RIGHT[direction][:, 1], ahead[:, 0] + RIGHT[direction][:, 0]]
    left = padded[ahead[:, 1] + LEFT[direction][:, 1], ahead[:, 0] + LEFT[direction][:, 0]]
    turn = np.where(~right, 1, np.where(~left, 0, -1))
    following = (direction + turn) % 4
    width = padded.shape[1]
    table = np.full(4 * padded.size, -1, dtype=np.int64)
    table[(starts[:, 1] * width + starts[:, 0]) * 4 + direction] = np.arange(len(starts))
    return table[(ends[:, 1] * width + ends[:, 0]) * 4 + following]


def _chased(starts: np.ndarray, after: np.ndarray) -> list[Loop]:
    following = after.tolist()
    seen = bytearray(len(following))
    loops = []
    for first in range(len(following)):
        if seen[first]:
            continue
        chain = []
        at = first
        while not seen[at]:
            seen[at] = 1
            chain.append(at)
            at = following[at]
        x, y, direction = starts[chain].T
        loops.append(Loop(x, y, direction))
    return loops
