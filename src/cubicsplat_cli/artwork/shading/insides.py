"""Where the shapes of a drawing show, and polygons a little inside their outlines, which clip shading.

A group that is clipped at its shape's own outline would count the coverage of edge pixels twice, and renderers differ
there by tens of levels. So the clip lies INSET px inside, and pixels at an edge show the base paint alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.geometry.coverage import coverage
from cubicsplat_cli.artwork.geometry.outlines import Ring, pieces_of_rings, polygon
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.outlines import fewer_points

INSET = 0.5  # px
FINE = 4  # samples per px of the distance to an outline
TOLERANCE = 0.1  # px by which the polygons may be off
FULL = 0.995  # of a pixel that a shape covers: all of it


def coverage_of(rings: Sequence[Ring], width: int, height: int) -> np.ndarray:
    """(H, W) float64 the share of each pixel that rings cover by the nonzero rule."""
    return coverage(*pieces_of_rings(rings), 0, 0, height, width)


def shown(drawing: Drawing) -> list[np.ndarray]:
    """For each shape, all opaque, (H, W) the share of each pixel that it covers and no shape above it does."""
    clear = np.ones((drawing.height, drawing.width))
    shares = []
    for shape in reversed(drawing.shapes):
        own = coverage_of(shape.oriented(), drawing.width, drawing.height)
        shares.append(own * clear)
        clear = clear * (1.0 - own)
    return shares[::-1]


def inside_of(shape: Shape, width: int, height: int) -> tuple[Ring, ...]:
    """Polygons INSET px inside a shape's outlines, or up to twice TOLERANCE more, but not inside the edges of the
    canvas, of width x height px; none where the shape is nowhere as wide.
    """
    from skimage.measure import find_contours  # which few pictures need

    cubics, lines = pieces_of_rings(shape.oriented())
    low, high = cubics.min(axis=(0, 1)), cubics.max(axis=(0, 1))
    left, top = (max(0, math.floor(v) - 1) for v in low)
    right, bottom = (min(most, math.ceil(v) + 1) for v, most in zip(high, (width, height), strict=True))
    if right <= left or bottom <= top:
        return ()
    fine = coverage(FINE * (cubics - (left, top)), lines, 0, 0, FINE * (bottom - top), FINE * (right - left))
    beyond = math.ceil(2.0 * INSET)  # px, by which what ends at an edge of the canvas goes on
    distance = ndimage.distance_transform_edt(np.pad(fine >= 0.5, FINE * beyond, mode="edge")) / FINE
    rings = []
    # From a sample's middle the nearest one outside is half a sample farther than the outline.
    for contour in find_contours(np.pad(distance, 1), INSET + TOLERANCE + 0.5 / FINE):
        points = fewer_points(contour[:, ::-1] - 1.0, FINE * TOLERANCE)
        if len(points) > 3:
            rings.append(polygon((points[:-1] + 0.5) / FINE - beyond + (left, top)))
    return tuple(rings)
