"""The drawing of a picture of cells: along the cells' edges, exactly.

An ink reaches one cell beneath the opaque inks above it, so that no ground shines through where they meet.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.geometry.outlines import Outline, Rectangle, polygon
from cubicsplat_cli.artwork.input.cells import Cells
from cubicsplat_cli.artwork.names import shape_name
from cubicsplat_cli.artwork.regions.cracks import Loop, trace
from cubicsplat_cli.artwork.regions.inks import eight_bit
from cubicsplat_cli.artwork.shapes import Drawing, Shape

OPAQUE = 255.0  # levels
MANY = 3  # regions of one ink
_AROUND = np.ones((3, 3), dtype=bool)


def mosaic(cells: Cells, *, abutting: bool = False) -> Drawing:
    """The drawing of cells, the ink of most cells at the back. abutting: nothing lies beneath anything else."""
    width, height = int(cells.x[-1]), int(cells.y[-1])
    order = np.argsort(-np.bincount(cells.numbers.ravel(), minlength=len(cells.colours)), kind="stable")
    # Later inks have higher ranks; of those that are not opaque what lies beneath would show.
    rank = np.argsort(order)[cells.numbers]
    opaque = (cells.colours[:, 3] >= OPAQUE)[cells.numbers]
    shapes: list[Shape] = []
    for place, number in enumerate(order):
        ink = eight_bit(cells.colours[number])
        if ink[3] == 0:
            continue
        mask = rank == place
        if not abutting:
            near = ndimage.binary_dilation(mask, _AROUND) if shapes else True
            mask = mask | (near & opaque & (rank > place))
        found = [*_regions(mask, cells)]
        # So many are one path in the file, where they need no names of their own.
        if len(found) >= MANY and not abutting:
            found = [tuple(outline.ring() for outline in outlines) for outlines in found]
        for outlines in found:
            shapes.append(Shape(ink, outlines, shape_name(ink, outlines, width, height)))
    return Drawing(width, height, tuple(shapes), abutting)


def _regions(mask: np.ndarray, cells: Cells) -> Iterator[tuple[Outline, ...]]:
    """The outlines of every connected part of a mask of cells (R, C), the outer one and its holes."""
    parts, _ = ndimage.label(mask)
    for number, place in enumerate(ndimage.find_objects(parts), start=1):
        loops = sorted(trace(parts[place] == number), key=lambda loop: -loop.area)
        yield tuple(_outline(loop, place, cells) for loop in loops)


def _outline(loop: Loop, place: tuple[slice, slice], cells: Cells) -> Outline:
    """The outline along a loop of cracks between cells, counted from a place on."""
    corners = loop.direction != np.roll(loop.direction, 1)
    points = np.stack([cells.x[loop.x[corners] + place[1].start], cells.y[loop.y[corners] + place[0].start]], axis=1)
    if len(points) == 4:
        low, high = points.min(axis=0), points.max(axis=0)
        return Rectangle(*low.tolist(), *(high - low).tolist())
    return polygon(points)
