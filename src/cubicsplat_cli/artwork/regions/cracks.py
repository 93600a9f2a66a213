"""The outlines of masks along the cracks between pixels, as closed loops.

A crack is the unit edge between two neighbouring pixels. Loops run with the mask on their right, so that outer loops
are clockwise as seen (y grows downwards) and holes the other way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.raster.outlines import traced

# Directions of a crack: east, south, west, north.
STEP = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
# Pixel to the right and to the left of a crack from vertex (x, y) in each direction, relative to (x, y).
RIGHT = np.array([[0, 0], [-1, 0], [-1, -1], [0, -1]])
LEFT = np.array([[0, -1], [0, 0], [-1, 0], [-1, -1]])


@dataclass(frozen=True)
class CrackLoop:
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
    def area(self) -> float:
        """Enclosed px^2, negative for a hole."""
        ends = np.stack([self.x, self.y], axis=1) + STEP[self.direction]
        return 0.5 * float((self.x * ends[:, 1] - self.y * ends[:, 0]).sum())


def trace(mask: np.ndarray) -> list[CrackLoop]:
    """The loops around a mask (H, W) bool, the longest first; its pixels connect along edges, not corners."""
    return [CrackLoop(*cracks.T) for cracks in sorted(traced(mask), key=lambda cracks: -len(cracks))]
