"""The lines and cubics of a drawing, and as segments that meet at points of a grid only, in whole numbers throughout.

Method: iterated snap rounding, Halperin and Packer, "Iterated snap rounding", 2002. Every segment that crosses another
is cut at the grid point nearest to the crossing, and every one that passes a vertex closely is led through it, until
nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.artwork.finish.parameters import LEAST
from cubicsplat_cli.artwork.geometry.outlines import (
    Outline,
    Rectangle,
    Ring,
    crossed,
    next_in_loops,
    pieces_of_rings,
    places_within,
    points_at,
    polygon_lengths,
)
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.record import record

EIGHTHS = 8  # cubics of a whole turn, which are true to 5e-6 of its radius
GRID = 64  # steps a px
FLAT, LONGEST = 0.004, 2.0  # px: a chord off its cubic, and its length
# A vertex nearer than 3/4 of a step to a segment is on it: a crossing is at most sqrt(1/2) off its grid point.
_NEAR = (9, 16)
_Cuts = tuple[np.ndarray, np.ndarray, np.ndarray]  # segments (k,), the grid points (k, 2), and shares (k,) of lengths


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
    rings = [ring for shape in shapes for ring in shape.oriented(EIGHTHS)]
    owners = [number for number, shape in enumerate(shapes) for _ in shape.outlines]
    outlines = [outline for shape in shapes for outline in shape.outlines]
    return sources_from(drawing, rings, owners, outlines, len(shapes))


def sources_from(
    drawing: Drawing, rings: Sequence[Ring], owners: Sequence[int], outlines: Sequence[Outline], count: int
) -> Sources:
    """The pieces of rings, whose windings count, each of one of so many shapes and of an outline, and of the canvas."""
    canvas = Rectangle(0.0, 0.0, drawing.width, drawing.height).ring()
    rings, owners, outlines = [*rings, canvas], [*owners, count], [*outlines, canvas]
    outline = np.repeat(np.arange(len(rings)), [ring.pieces for ring in rings])
    after = next_in_loops(outline)
    smooth = np.concatenate([ring.smooth for ring in rings])[after]
    return Sources(*pieces_of_rings(rings), np.array(owners)[outline], after, smooth, outline, tuple(outlines))


@record
class Segments:
    """n segments. start, end: (n, 2) int64, grid steps; piece: (n,) int, whose they are; t: (n, 2) parameters there."""

    start: np.ndarray
    end: np.ndarray
    piece: np.ndarray
    t: np.ndarray

    def chosen(self, which: np.ndarray) -> Segments:
        """Some of them."""
        return Segments(self.start[which], self.end[which], self.piece[which], self.t[which])


def snapped_segments(sources: Sources, live: np.ndarray | bool = True) -> Segments:
    """The pieces as chords that meet at their ends only; those that lie on each other are all there. live: (P,) bool,
    which pieces are taken, or of all.
    """
    segments = _chords(sources, live)
    fresh = np.ones(len(segments.piece), dtype=bool)
    for _ in range(200):  # rounds
        which, points, at = _cuts(segments, fresh)
        if not len(which):
            return segments
        segments, fresh = _cut(segments, which, points, at)
    raise EngineError("the outlines of this drawing cannot be told apart; use --stacking stacked")


def _chords(sources: Sources, live: np.ndarray | bool) -> Segments:
    cubics = sources.cubics
    bend = np.abs(cubics[:, :2] - 2.0 * cubics[:, 1:3] + cubics[:, 2:]).max(axis=(1, 2))
    counts = np.where(sources.lines, 0.0, np.sqrt(0.75 * bend / FLAT))
    counts = np.ceil(np.maximum(counts, polygon_lengths(cubics) / LONGEST)).clip(1).astype(np.int64) * live
    piece, local = places_within(counts)
    t = np.stack([local, local + 1], axis=1) / counts[piece, None]
    start, end = (np.rint(sources.at(piece, at) * GRID).astype(np.int64) for at in t.T)
    found = Segments(start, end, piece, t)
    return found.chosen((found.start != found.end).any(axis=1))


def _cuts(segments: Segments, fresh: np.ndarray) -> _Cuts:
    """Segments (k,) that are to be cut, the grid points (k, 2) there, and shares (k,) of their length."""
    a, b = segments.start, segments.end
    reach = float(np.hypot(*(b - a).T).max()) + 4.0
    pairs = PointTree(0.5 * (a + b)).query_pairs(reach)
    i, j = pairs[fresh[pairs].any(axis=1)].T
    out = [_near_vertices(a, b, seg, ends[other]) for seg, other in ((i, j), (j, i)) for ends in (a, b)]
    out += _crossings(a, b, i, j)
    return tuple(np.concatenate(part) for part in zip(*out, strict=True))  # type: ignore[return-value]


def _near_vertices(a: np.ndarray, b: np.ndarray, seg: np.ndarray, vertex: np.ndarray) -> _Cuts:
    way, off = b[seg] - a[seg], vertex - a[seg]
    dot, square = (way * off).sum(axis=1), (way * way).sum(axis=1)
    near = (dot > 0) & (dot < square) & (_NEAR[1] * crossed(way, off) ** 2 < _NEAR[0] * square)
    return seg[near], vertex[near], dot[near] / square[near]


def _crossings(a: np.ndarray, b: np.ndarray, i: np.ndarray, j: np.ndarray) -> list[_Cuts]:
    """Proper crossings, as cuts of both segments but where the grid point is an end."""
    ab, cd, ac = b[i] - a[i], b[j] - a[j], a[j] - a[i]
    turn, u, v = crossed(ab, cd), crossed(ac, cd), crossed(ac, ab)
    sign, size = np.sign(turn), np.abs(turn)
    proper = (turn != 0) & (u * sign > 0) & (u * sign < size) & (v * sign > 0) & (v * sign < size)
    i, j = i[proper], j[proper]
    at = np.rint(a[i] + (u[proper] / turn[proper])[:, None] * ab[proper]).astype(np.int64)
    out = []
    for seg in (i, j):
        inner = (at != a[seg]).any(axis=1) & (at != b[seg]).any(axis=1)
        own, point = seg[inner], at[inner]
        way = b[own] - a[own]
        # Where the grid point lies along the segment: in another order a chain would run to and fro.
        share = (way * (point - a[own])).sum(axis=1) / (way * way).sum(axis=1)
        out.append((own, point, share))
    return out


def _cut(segments: Segments, which: np.ndarray, points: np.ndarray, at: np.ndarray) -> tuple[Segments, np.ndarray]:
    """The segments with some cut, and which of them are new."""
    order = np.lexsort((*points.T, at, which))
    # A segment goes to one of two points that face each other across it: between these it would be cut again, for ever.
    which, points, at = which[order], points[order], at[order]
    apart = np.append(True, (which[1:] != which[:-1]) | (np.diff(at) > LEAST))
    which, points, at = which[apart], points[apart], at[apart]
    # Chains of points, each segment's own ends around its cuts.
    own = np.unique(which)
    index = np.concatenate([own, which, own])
    share = np.concatenate([np.full(len(own), -1.0), at, np.full(len(own), 2.0)])
    place = np.concatenate([segments.start[own], points, segments.end[own]])
    order = np.lexsort((share, index))
    index, place, share = index[order], place[order], np.clip(share[order], 0.0, 1.0)
    pair = np.flatnonzero((index[1:] == index[:-1]) & (place[1:] != place[:-1]).any(axis=1))
    owner = index[pair]
    t0, t1 = segments.t[owner].T
    t = np.stack([t0 + share[pair] * (t1 - t0), t0 + share[pair + 1] * (t1 - t0)], axis=1)
    new = Segments(place[pair], place[pair + 1], segments.piece[owner], t)
    old = segments.chosen(np.delete(np.arange(len(segments.piece)), own))
    joined = Segments(*(np.concatenate(parts) for parts in zip(vars(old).values(), vars(new).values(), strict=True)))
    return joined, np.arange(len(joined.piece)) >= len(old.piece)
