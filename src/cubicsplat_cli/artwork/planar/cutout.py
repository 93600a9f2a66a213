"""A stacked drawing as abutting shapes without overlaps, for cutters and screen printing.

What shows of every shape, cut where outlines cross. Regions that touch share their edges: the same numbers in the file,
run through the other way.

Trapping: shapes may also reach beneath those drawn later, so that a misplaced print shows no gap.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import EXACT, Circle, Ellipse, Outline, Ring, level_box, signed_area
from cubicsplat_cli.artwork.geometry.steps import aligned, to_steps
from cubicsplat_cli.artwork.geometry.stroke import offset_ring
from cubicsplat_cli.artwork.planar.borders import Borders, Edges, Step, borders_of, edges_of_borders
from cubicsplat_cli.artwork.planar.faces import NOTHING, Faces, connected, faces_of, visible_regions
from cubicsplat_cli.artwork.planar.snapping import EIGHTHS, Sources, snapped_segments, sources_from, sources_of
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.scene.paint import Paint

# What a piece is of, when the shapes of one rank are looked at: the grown ones, those drawn later, the shapes
# themselves, whose numbers count along an edge of several, and the canvas.
GROWN, LATER, OWN, CANVAS = range(4)


def cut_out(drawing: Drawing, precision: int) -> Drawing:
    """The drawing with what shows of it only: one shape per visible region, none beyond the canvas.

    precision: decimals of the file, in px. All coordinates are whole steps of it, so edges stay shared in the text;
    regions narrower than 0.05 px go to a neighbour. Of translucent shapes the uppermost shows, and nothing through it.
    """
    if not drawing.shapes:
        return drawing
    sources = sources_of(drawing)
    faces = faces_of(snapped_segments(sources), sources.shape)
    region, shown = visible_regions(faces, _fills(drawing))
    outlines_of = outlines_of_regions(faces, region, shown != NOTHING, sources, precision)
    found = [(int(shown[number]), outlines) for number, outlines in outlines_of.items()]
    found.sort(key=lambda each: (each[0], -abs(signed_area(each[1][0].ring()))))
    shapes = tuple(replace(drawing.shapes[shape], outlines=outlines, stroke=None) for shape, outlines in found)
    return replace(drawing, shapes=shapes, abutting=True)


def outlines_of_regions(
    faces: Faces, region: np.ndarray, wanted: np.ndarray, sources: Sources, precision: int
) -> dict[int, tuple[Outline, ...]]:
    """The outlines of the wanted (R,) of the regions (F,) of a planar map by their numbers, the outer ones first."""
    borders = borders_of(faces, region, sources)
    edges = _on_grid(edges_of_borders(borders, faces, sources), precision)
    whole = _whole_outlines(borders, sources)
    found = {}
    for number, cycles in borders.cycles.items():
        if not wanted[number]:
            continue
        outlines = [outline for cycle in cycles if (outline := _outline(cycle, edges, borders, whole)) is not None]
        # The outer border is the largest, since it goes around the others.
        outlines.sort(key=lambda outline: -abs(signed_area(outline.ring())))
        if outlines:
            found[number] = tuple(outlines)
    return found


def _fills(drawing: Drawing) -> np.ndarray:
    """Return (shapes,) a number for each way to be painted."""
    numbers: dict[Shape, int] = {}
    alike = [replace(shape, outlines=(), name="", stroke=None) for shape in drawing.shapes]
    return np.array([numbers.setdefault(shape, len(numbers)) for shape in alike])


def _whole_outlines(borders: Borders, sources: Sources) -> dict[int, Outline]:
    """The circles and level ellipses that are a closed border without nodes, by its number."""
    pieces: dict[int, list[int]] = {}
    for run in borders.runs:
        if run.loop >= 0:
            pieces.setdefault(run.loop, []).append(run.piece)
    whole = {}
    for loop, own in pieces.items():
        numbers = np.unique(sources.outline[own])
        outline = sources.outlines[int(numbers[0])]
        level = isinstance(outline, Circle) or (isinstance(outline, Ellipse) and outline.angle == 0.0)
        if len(numbers) == 1 and level and sorted(own) == np.flatnonzero(sources.outline == numbers[0]).tolist():
            whole[loop] = outline
    return whole


def _outline(cycle: list[Step], edges: Edges, borders: Borders, whole: dict[int, Outline]) -> Outline | None:
    """The outline along a border; None where it has no extent."""
    loop = borders.runs[cycle[0][0]].loop
    if loop in whole:
        return whole[loop]
    cycle = [each for each in cycle if not edges.gone[each[0]]]
    if not cycle:
        return None
    cubics = np.stack([edges.cubics[n] if ahead else edges.cubics[n][::-1] for n, ahead in cycle])
    lines = np.array([edges.lines[n] for n, _ in cycle])
    pairs = {frozenset(pair) for pair in edges.smooth}
    arrivals = [(n, int(ahead)) for n, ahead in [cycle[-1], *cycle[:-1]]]
    leaves = [(n, int(not ahead)) for n, ahead in cycle]
    smooth = np.array([frozenset(joint) in pairs for joint in zip(arrivals, leaves, strict=True)])
    ring = Ring(cubics[:, 0].copy(), cubics[:, 1:3].copy(), lines, smooth)
    return level_box(ring) or (ring if abs(signed_area(ring)) > 0.0 else None)


def _on_grid(edges: Edges, precision: int) -> Edges:
    """The edges with all points on multiples of 10^-precision px; at smooth joints the shorter handle is moved by at
    most two steps towards the other's line. Edges of no extent are gone.
    """
    points = to_steps(edges.cubics, precision)
    for pair in edges.smooth:
        vectors = [_handle(points, edges.lines, number, end) for number, end in pair]
        movable = [k for k in (0, 1) if not edges.lines[pair[k][0]]]
        if not movable or int(vectors[0] @ vectors[1]) >= 0:
            continue
        k = min(movable, key=lambda k: int((vectors[k] ** 2).sum()))
        number, end = pair[k]
        points[number, 2 if end else 1] = points[number, 3 * end] + aligned(vectors[k][None], vectors[1 - k][None])[0]
    still = (points[:, 1:] == points[:, :1]).all(axis=(1, 2))
    return replace(edges, cubics=points / 10.0**precision, gone=edges.gone | still)


def _handle(points: np.ndarray, lines: np.ndarray, number: int, end: int) -> np.ndarray:
    """(2,) the handle at an end of an edge, of a line its other end, relative to that end."""
    here = points[number, 3 * end]
    return points[number, 3 * (1 - end)] - here if lines[number] else points[number, 2 if end else 1] - here


def overlapping(drawing: Drawing, reach: float, precision: int) -> Drawing:
    """A cutout in which each shape also covers what is within `reach` px of it and shows a shape of a later paint.

    These are drawn later, so the picture is the same. Where nothing is drawn, nothing is covered. Shapes of one paint,
    which follow one another, may become one. precision: decimals of the file, in px.
    """
    ranks = {paint: rank for rank, paint in enumerate(dict.fromkeys(shape.paint for shape in drawing.shapes))}
    pieces, rank_of, grown = _pieces(drawing, ranks, reach)
    across, canvas = _across(pieces, ~grown, rank_of), pieces.shape == CANVAS
    shapes: list[Shape] = []
    for paint, rank in ranks.items():
        own = [shape for shape in drawing.shapes if shape.paint == paint]
        if rank == len(ranks) - 1:
            shapes += own
            continue
        mine = rank_of == rank
        sources = replace(pieces, shape=np.select([canvas, mine & grown, mine], [CANVAS, GROWN, OWN], LATER))
        # An edge between two of the later shapes is none of them all.
        later = (rank_of > rank) & (across <= rank) & ~grown
        faces = faces_of(snapped_segments(sources, canvas | mine | later), sources.shape)
        # The shapes that reach beneath others.
        inside = np.array([OWN in covers or {GROWN, LATER} <= set(covers) for covers in faces.covers])
        region = connected(inside.astype(np.int64), faces.face[0::2], faces.face[1::2])
        wanted = np.isin(np.arange(region.max() + 1), region[inside])
        found = outlines_of_regions(faces, region, wanted, sources, precision)
        shapes += [replace(own[0], outlines=found[number]) for number in sorted(found)]
    return replace(drawing, shapes=tuple(shapes))


def _pieces(drawing: Drawing, ranks: dict[Paint, int], reach: float) -> tuple[Sources, np.ndarray, np.ndarray]:
    """The P pieces of all shapes, of the same grown, and of the canvas; (P,) the rank of the paint of each, and (P,)
    bool, whether it is of the grown one.
    """
    rings, outlines, kinds = list[Ring](), list[Outline](), list[tuple[int, bool]]()
    for shape in drawing.shapes:
        rank, own = ranks[shape.paint], shape.oriented(EIGHTHS)
        grown = [_grown(shape, index, ring, reach) for index, ring in enumerate(own)]
        rings += [*own, *(ring for ring, _ in grown)]
        outlines += [*shape.outlines, *(outline for _, outline in grown)]
        kinds += [(rank, False)] * len(own) + [(rank, True)] * len(own)
    sources = sources_from(drawing, rings, [OWN] * len(rings), outlines, CANVAS)
    rank_of, is_grown = np.array([*kinds, (-1, True)])[sources.outline].T
    return sources, rank_of, is_grown.astype(bool)


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
    ahead = np.rint(sources.cubics / EXACT).astype(np.int64)
    rank_of = {key.tobytes(): int(number) for key, number in zip(ahead[own], rank[own], strict=True)}
    return np.array([rank_of.get(key.tobytes(), -1) for key in ahead[:, ::-1]])
