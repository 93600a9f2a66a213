"""The lines and cubics of a drawing's outlines, and of its canvas, as one list: what a planar map is made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.geometry.fine import fine_ring
from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring, oriented, pieces_of_rings, points_at, polygon
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.record import record

EIGHTHS = 8  # of a circle, one cubic each, which are true to 5e-6 of a radius


@record
class Sources:
    """P pieces. cubics: (P, 4, 2) px; lines: (P,) bool; shape: (P,) int, whose they are, the number of shapes for those
    of the canvas; after: (P,) int, the piece that follows in its ring; smooth: (P,) bool, whether it goes on smoothly;
    outline: (P,) int, numbered through; outlines: those as they stand, the canvas' last.
    """

    cubics: np.ndarray
    lines: np.ndarray
    shape: np.ndarray
    after: np.ndarray
    smooth: np.ndarray
    outline: np.ndarray
    outlines: tuple[Outline, ...]

    def at(self, piece: np.ndarray, t: np.ndarray) -> np.ndarray:
        """(n, 2) points of pieces (n,) at parameters (n,)."""
        return points_at(self.cubics[piece], np.asarray(t)[:, None])[:, 0]


def sources_of(drawing: Drawing) -> Sources:
    """The pieces of a drawing, outer rings clockwise as seen and holes the other way; arcs in eighths of a turn."""
    shapes = drawing.shapes
    rings = [ring for shape in shapes for ring in rings_of(shape)]
    owners = [number for number, shape in enumerate(shapes) for _ in shape.outlines]
    outlines = [outline for shape in shapes for outline in shape.outlines]
    return sources_from(rings, owners, outlines, canvas_ring(drawing), len(shapes))


def rings_of(shape: Shape) -> list[Ring]:
    """The rings of a shape, the outer one clockwise as seen, holes the other way; arcs in eighths of a turn."""
    return list(oriented([fine_ring(outline, EIGHTHS) for outline in shape.outlines]))


def canvas_ring(drawing: Drawing) -> Ring:
    """The edge of a drawing's canvas."""
    return polygon(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * [drawing.width, drawing.height])


def sources_from(
    rings: Sequence[Ring], owners: Sequence[int], outlines: Sequence[Outline], canvas: Ring, count: int
) -> Sources:
    """The pieces of rings, whose windings count, each of one of so many shapes and of an outline, and of a canvas."""
    rings, owners, outlines = [*rings, canvas], [*owners, count], [*outlines, canvas]
    sizes = np.array([ring.pieces for ring in rings])
    starts = np.cumsum(sizes) - sizes
    after = np.concatenate([start + (np.arange(size) + 1) % size for start, size in zip(starts, sizes, strict=True)])
    return Sources(
        *pieces_of_rings(rings),
        np.repeat(np.array(owners), sizes),
        after,
        np.concatenate([np.roll(ring.smooth, -1) for ring in rings]),
        np.repeat(np.arange(len(rings)), sizes),
        tuple(outlines),
    )
