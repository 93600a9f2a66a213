"""What the truth shows about an outline: its areas of one colour there, and where its edges run."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from skimage.draw import polygon2mask
from skimage.measure import find_contours

from cubicsplat_cli.bench.artwork.document import Document
from cubicsplat_cli.bench.artwork.shapes import NEAR_SHARE, kind_of

# An even area of the truth is looked at in so many times the size, at most so many px across; its edge is known to so
# many of those px.
FINEST, WIDEST, STEP = 8, 2048, 0.75
MARGIN = 3  # px around an outline in which the truth is looked at
WITHIN = 0.5  # px from an outline at which its area is sought


class View:
    """The truth about an outline, enlarged and without smoothing. colours: (h, w) uint32, empty off the canvas."""

    def __init__(self, truth: Document, points: np.ndarray) -> None:
        """points: (n, 2) px along the outline."""
        size = np.array([truth.width, truth.height], dtype=float)
        self.low = np.clip(np.floor(points.min(axis=0)) - MARGIN, 0.0, size)
        extent = (np.clip(np.ceil(points.max(axis=0)) + MARGIN, 0.0, size) - self.low).astype(int)
        self.colours = np.zeros((0, 0), dtype=np.uint32)
        if (extent > 0).all():
            self.scale = max(1, min(FINEST, WIDEST // int(extent.max())))
            window = (int(self.low[0]), int(self.low[1]), int(extent[0]), int(extent[1]))
            pixels = truth.draw(self.scale, window=window, smooth=False)
            self.colours = np.ascontiguousarray(pixels).view(np.uint32)[..., 0]

    def areas(self, points: np.ndarray, inwards: np.ndarray) -> list[tuple[str, np.ndarray]]:
        """The kind of, and the points (n, 2) px around, the areas of one colour that fill most of an outline's middle
        and most of its rim, as a ring does; holes count as filled. inwards: (n, 2) unit.
        """
        if not self.colours.size:
            return []
        middle = polygon2mask(self.colours.shape, (points - self.low)[:, ::-1] * self.scale - 0.5)
        rim = np.zeros_like(middle)
        rim[self._places(points + WITHIN * inwards)] = True
        return [self._area(inside) for inside in (middle, rim) if inside.any()]

    def edges(self, points: np.ndarray, inwards: np.ndarray, off: float) -> np.ndarray:
        """(n,) bool: whether colours differ between `off` px within and without points of an outline."""
        if not self.colours.size:
            return np.zeros(len(points), dtype=bool)
        inner, outer = (self.colours[self._places(points + way * inwards)] for way in (off, -off))
        return inner != outer

    def _places(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place = np.floor((points - self.low) * self.scale).astype(int)
        height, width = self.colours.shape
        return np.clip(place[:, 1], 0, height - 1), np.clip(place[:, 0], 0, width - 1)

    def _area(self, inside: np.ndarray) -> tuple[str, np.ndarray]:
        values, counts = np.unique(self.colours[inside], return_counts=True)
        labels, _ = ndimage.label(self.colours == values[counts.argmax()])
        area = labels == np.bincount(labels[inside & (labels > 0)]).argmax()
        # The outermost contour; a ring of px of other colour makes it closed along the window.
        edges = find_contours(np.pad(ndimage.binary_fill_holes(area), 1).astype(float), 0.5)
        points = (max(edges, key=len)[:-1, ::-1] - 0.5) / self.scale + self.low
        return kind_of(points, NEAR_SHARE, STEP / self.scale), points
