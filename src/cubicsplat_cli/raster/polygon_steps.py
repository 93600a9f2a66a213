"""Steps of one polygon of a stack on a grid, natively: which other outlines and colours bring a picture nearer."""

from __future__ import annotations

from collections.abc import Iterator
from ctypes import c_int64

import numpy as np

from cubicsplat_cli.raster.cpu import floats, int32s, native

FEWEST = 3  # vertices of a polygon
STEPS = 5  # that may be found for a polygon at once
SLACK = 3.0  # bytes that a file may turn out to be smaller than is guessed from the length of a path
Found = tuple[float, float, np.ndarray, np.ndarray]  # score, rise of the loss, vertices (n, 2) and levels (3,)


class PolygonSteps:
    """Looks for steps of polygons over a ground, front to back, towards a picture.

    goal: (H, W, C) float32, and its weights (H, W) or None. scale: (2,) px per unit. most: vertices of a polygon.
    """

    def __init__(
        self, goal: np.ndarray, weights: np.ndarray | None, scale: np.ndarray, most: int, threads: int
    ) -> None:
        self.picture = goal, None if weights is None else floats(weights), *goal.shape, scale
        self.most, self.threads = most, threads

    def take(self, vertices: list[np.ndarray], levels: np.ndarray, ground: np.ndarray | None, opacity: float) -> None:
        """Takes over the polygons, their colours (N, 3) in 0..15, the ground's (3,) in 0..1, and the opacity of all."""
        ends = np.cumsum([len(each) for each in vertices], dtype=np.int32)
        behind = np.zeros(4, np.float32)
        behind[:3] = 0.0 if ground is None else ground
        self._polygons = int32s(np.concatenate(vertices)), ends, int32s(levels), len(vertices), behind, opacity

    def best(self, index: int, price: float) -> Iterator[Found]:
        """The steps of a polygon that promise most of loss + price x bytes, where the bytes are guessed."""
        scores, rises, corners = np.empty(STEPS), np.empty(STEPS), np.empty(STEPS, np.int32)
        outlines, paints = np.empty((STEPS, self.most, 2), np.int32), np.empty((STEPS, 3), np.int32)
        count = native(
            "search", "cs_polygon_steps", *self.picture, *self._polygons, index, self.most, price, SLACK, self.threads,
            STEPS, scores, rises, outlines, corners, paints, result=c_int64,
        )  # fmt: skip
        for k in range(count):
            yield float(scores[k]), float(rises[k]), outlines[k, : corners[k]], paints[k]

    def removals(self, index: int, corners: int) -> np.ndarray:
        """By how much the loss rises without each of a polygon's vertices, and last without all of it."""
        rises = np.empty(corners + 1 if corners > FEWEST else 1)
        native("search", "cs_polygon_removals", *self.picture, *self._polygons, index, rises)
        return rises
