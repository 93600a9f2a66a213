"""Steps of one polygon of a stack on a grid, natively: other outlines and colours that bring a picture nearer."""

from __future__ import annotations

from collections.abc import Iterator
from ctypes import c_int64
from functools import partial

import numpy as np

from cubicsplat_cli.raster.native import Out, floats, int32s, native

_native = partial(native, "search")
FEWEST = 3  # vertices of a polygon
STEPS = 5  # that may be proposed for a polygon at once
SLACK = 3.0  # bytes by which a file may turn out smaller than the guess from the length of a path
Step = tuple[float, float, np.ndarray, np.ndarray]  # score, rise of the loss, vertices (n, 2) and levels (3,)


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
        """Take over the polygons, their colours (N, 3) in 0..15, the ground's (3,) in 0..1, and the opacity of all."""
        ends = np.cumsum([len(polygon) for polygon in vertices], dtype=np.int32)
        behind = np.zeros(4, np.float32)
        behind[:3] = 0.0 if ground is None else ground
        self._polygons = int32s(np.concatenate(vertices)), ends, int32s(levels), len(vertices), behind, opacity

    def best(self, index: int, price: float) -> Iterator[Step]:
        """Yield the steps of a polygon with the best scores, of loss + price x bytes; the bytes are guessed."""
        outlines, levels = Out((STEPS, self.most, 2), np.int32), Out((STEPS, 3), np.int32)
        out = Out(STEPS), Out(STEPS), outlines, Out(STEPS, np.int32), levels
        given = *self.picture, *self._polygons, index, self.most, price, SLACK, self.threads, STEPS
        steps = _native("cs_polygon_steps", *given, *out, result=c_int64)
        for score, rise, outline, corners, paint in zip(*steps, strict=True):
            yield float(score), float(rise), outline[:corners], paint

    def removals(self, index: int, corners: int) -> np.ndarray:
        """Return by how much the loss rises without each of a polygon's vertices, and last without all of it."""
        rises = Out(corners + 1 if corners > FEWEST else 1)
        return _native("cs_polygon_removals", *self.picture, *self._polygons, index, rises)
