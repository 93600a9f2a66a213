"""Cutouts whose shapes reach beneath those drawn later, so that a misplaced print shows no gap: trapping."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Outline, Ring
from cubicsplat_cli.artwork.planar.cutout import outlines_of_regions
from cubicsplat_cli.artwork.planar.faces import Faces, faces_of
from cubicsplat_cli.artwork.planar.snapping import snapped_segments
from cubicsplat_cli.artwork.planar.sources import Sources, canvas_ring, rings_of, sources_from
from cubicsplat_cli.artwork.planar.visible import connected
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.strokes.offset import offset_ring
from cubicsplat_cli.records import dataclass, replace

# What a piece is of, when the shapes of one rank are looked at: the grown ones, those drawn later, the shapes
# themselves, whose numbers count along an edge of several, and the canvas.
GROWN, LATER, OWN, CANVAS = range(4)
STEPS = 1e6  # of a px: numbers that differ by less are the same


def overlapping(drawing: Drawing, ranks: np.ndarray, reach: float, precision: int) -> Drawing:
    """A cutout in which each shape also covers what is within `reach` px of it and shows a shape of a higher rank.

    Shapes of higher ranks are drawn later, so the picture is the same. Where nothing is drawn, nothing is covered.
    ranks: (shapes,) int >= 0, ascending; shapes of one rank have one paint, and may become one. precision: decimals of
    the file, in px.
    """
    pieces = _pieces(drawing, ranks, reach)
    shapes: list[Shape] = []
    for rank in np.unique(ranks).tolist():
        own = [shape for shape, number in zip(drawing.shapes, ranks.tolist(), strict=True) if number == rank]
        if rank == ranks.max():
            shapes += own
            continue
        sources, live = pieces.seen_from(rank)
        faces = faces_of(snapped_segments(sources, live), sources.shape)
        region, wanted = _regions(faces)
        found = outlines_of_regions(faces, region, wanted, sources, precision)
        shapes += [replace(own[0], outlines=found[number]) for number in sorted(found)]
    return replace(drawing, shapes=tuple(shapes))


@dataclass(frozen=True)
class _Pieces:
    """The pieces of all shapes, of the same grown, and of the canvas. rank: (P,) of the shape of each; grown: (P,)
    bool, whether it is of the grown one; across: (P,) the rank on the other side of the cutout's edges, -1 for none.
    """

    sources: Sources
    rank: np.ndarray
    grown: np.ndarray
    across: np.ndarray

    def seen_from(self, rank: int) -> tuple[Sources, np.ndarray]:
        """The pieces by what they are for the shapes of a rank, and which count."""
        canvas, mine = self.sources.shape == CANVAS, self.rank == rank
        owner = np.select([canvas, mine & self.grown, mine], [CANVAS, GROWN, OWN], LATER)
        # An edge between two of the later shapes is none of them all.
        later = (self.rank > rank) & (self.across <= rank) & ~self.grown
        return replace(self.sources, shape=owner), canvas | mine | later


def _pieces(drawing: Drawing, ranks: np.ndarray, reach: float) -> _Pieces:
    rings: list[Ring] = []
    outlines: list[Outline] = []
    kinds: list[tuple[int, bool]] = []
    for shape, rank in zip(drawing.shapes, ranks.tolist(), strict=True):
        own = rings_of(shape)
        rings += own
        outlines += shape.outlines
        for index, ring in enumerate(own):
            grown, around = _grown(shape, index, ring, reach)
            rings.append(grown)
            outlines.append(around)
        kinds += [(rank, False)] * len(own) + [(rank, True)] * len(own)
    sources = sources_from(rings, [OWN] * len(rings), outlines, canvas_ring(drawing), CANVAS)
    rank_of, is_grown = np.array([*kinds, (-1, True)])[sources.outline].T
    return _Pieces(sources, rank_of, is_grown.astype(bool), _across(sources, is_grown == 0, rank_of))


def _grown(shape: Shape, index: int, ring: Ring, reach: float) -> tuple[Ring, Outline]:
    """The ring at `reach` px around a ring of a shape, and the outline that it is."""
    outline = shape.outlines[index]
    if isinstance(outline, Circle) and (radius := outline.r + (-reach if index else reach)) > 0.0:
        middle = np.array([outline.cx, outline.cy])
        scale = radius / outline.r
        anchors, controls = (middle + scale * (points - middle) for points in (ring.anchors, ring.controls))
        return replace(ring, anchors=anchors, controls=controls), replace(outline, r=radius)
    grown = offset_ring(ring, reach)
    return grown, grown


def _across(sources: Sources, own: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """(P,) the rank of the shape on the other side of each piece of a cutout, -1 where there is none.

    own: (P,) bool, which pieces are the cutout's: those of two shapes are the same but for their direction.
    """
    ahead = np.rint(sources.cubics * STEPS).astype(np.int64)
    rank_of = {key.tobytes(): int(number) for key, number in zip(ahead[own], rank[own], strict=True)}
    return np.array([rank_of.get(np.ascontiguousarray(key).tobytes(), -1) for key in ahead[:, ::-1]])


def _regions(faces: Faces) -> tuple[np.ndarray, np.ndarray]:
    """(F,) regions of the faces of a planar map, and which (R,) of them the shapes are that reach beneath others."""
    inside = np.array([OWN in covers or {GROWN, LATER} <= set(covers) for covers in faces.covers])
    region = connected(inside.astype(np.int64), faces.face[0::2], faces.face[1::2])
    wanted = np.zeros(int(region.max()) + 1, dtype=bool)
    wanted[region[inside]] = True
    return region, wanted
