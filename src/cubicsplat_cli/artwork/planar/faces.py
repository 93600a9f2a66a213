"""The faces of a planar map, which shape shows in each, and the visible regions: faces of one fill that touch along an
edge, without slivers.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import crossed
from cubicsplat_cli.artwork.planar.snapping import GRID, Segments
from cubicsplat_cli.raster.sparse import linked_groups
from cubicsplat_cli.record import record

NOTHING = -1
# A region of less area or mean width is a gap between outlines that were meant to meet; a shorter run is part of a
# node.
LEAST_AREA, LEAST_WIDTH = 0.02, 0.05  # px^2, px


@record
class Faces:
    """A planar map. vertices: (V, 2) int64, steps of the grid; ends: (E, 2) the vertices of the edges; following: (2
    E,) the half-edge after each along its face, half-edge 2 e running along edge e and 2 e + 1 back; face: (2 E,) the
    face beside each half-edge, where its direction has it if x grows to the right and y upwards on the left; face 0 is
    all around. areas: (F,) square steps, infinite for face 0. runs: of each edge the (piece, t at tail, t at head) that
    lie on it, the uppermost shape's first; covers: of each face the shapes that cover it, none beyond the canvas."""

    vertices: np.ndarray
    ends: np.ndarray
    following: np.ndarray
    face: np.ndarray
    areas: np.ndarray
    runs: list[list[tuple[int, float, float]]]
    covers: list[list[int]]

    @cached_property
    def lengths(self) -> np.ndarray:
        """(E,) px of the edges."""
        return np.asarray(np.hypot(*np.diff(self.vertices[self.ends], axis=1)[:, 0].T) / GRID)


def faces_of(segments: Segments, shape: np.ndarray) -> Faces:
    """The planar map of segments that meet at their ends only. shape: (P,) the shape of each piece, the greatest that
    of the canvas, which bounds what shows.
    """
    vertices, ends, runs, changes = _edges(segments, shape)
    following = _following(vertices, ends)
    cycle, areas = _cycles(vertices, ends, following)
    face_of_cycle = _nested(vertices, ends, cycle, areas)
    face = face_of_cycle[cycle]
    sizes = np.bincount(face_of_cycle, 0.5 * areas, 1)
    sizes[0] = np.inf
    covers = _covers(face, changes, len(sizes), int(shape.max()))
    return Faces(vertices, ends, following, face, sizes, runs, covers)


def _edges(
    segments: Segments, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[list[tuple[int, float, float]]], list[dict[int, int]]]:
    """Vertices, ends, runs, and of each edge by how much the winding numbers are greater on its left.

    Edges on either side of which everything is the same are left out.
    """
    vertices, index = np.unique(np.concatenate([segments.start, segments.end]), axis=0, return_inverse=True)
    index = index.reshape(2, -1)
    forward = index[0] < index[1]
    low, high = np.minimum(*index), np.maximum(*index)
    key, edge = np.unique(low * len(vertices) + high, return_inverse=True)
    runs: list[list[tuple[int, float, float]]] = [[] for _ in key]
    changes: list[dict[int, int]] = [{} for _ in key]
    owners = shape[segments.piece]
    for k in np.lexsort((segments.piece, -owners)).tolist():
        e, owner, ahead = int(edge[k]), int(owners[k]), bool(forward[k])
        t = segments.t[k] if ahead else segments.t[k, ::-1]
        runs[e].append((int(segments.piece[k]), float(t[0]), float(t[1])))
        changes[e][owner] = changes[e].get(owner, 0) + (1 if ahead else -1)
    live = [e for e in range(len(key)) if any(changes[e].values())]
    ends = np.stack(np.divmod(key[live], len(vertices)), axis=1)
    return vertices, ends, [runs[e] for e in live], [{s: n for s, n in changes[e].items() if n} for e in live]


def _following(vertices: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(2 E,) the half-edge that follows each along the face on its left: the last one before its way back."""
    origin, way = ends.ravel(), np.diff(vertices[ends], axis=1).astype(float)
    angle = np.arctan2(*np.concatenate([way, -way], axis=1).reshape(-1, 2).T[::-1])
    order = np.lexsort((angle, origin))
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    first = np.searchsorted(origin[order], origin)
    last = np.searchsorted(origin[order], origin, side="right") - 1
    before = order[np.where(place > first, place - 1, last)]
    return before[np.arange(len(order)) ^ 1]


def _cycles(vertices: np.ndarray, ends: np.ndarray, following: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(2 E,) the cycle of each half-edge, and (C,) twice their exact areas, negative around a component."""
    count, cycle = linked_groups(len(following), np.arange(len(following)), following)
    cross = crossed(*vertices[ends].swapaxes(0, 1))
    return cycle, np.bincount(cycle, np.stack([cross, -cross], axis=1).ravel(), count)


def _nested(vertices: np.ndarray, ends: np.ndarray, cycle: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """(C,) the face of each cycle: of those around a component the face that it lies in."""
    face = np.where(areas > 0, np.cumsum(areas > 0), -1)
    spots = vertices[ends.ravel()]
    order = np.lexsort((spots[:, 1], spots[:, 0], cycle))
    leftmost = spots[order[np.searchsorted(cycle[order], np.arange(len(areas)))]]
    (x0, y0), (x1, y1) = vertices[ends].transpose(1, 2, 0)
    parent: dict[int, int] = {}
    for c in np.flatnonzero(areas <= 0).tolist():
        # Just above its leftmost vertex: the nearest edge to the left.
        x, y = leftmost[c]
        spans = np.flatnonzero((np.minimum(y0, y1) <= y) & (y < np.maximum(y0, y1)))
        at = x0[spans] + (x1 - x0)[spans] * ((y - y0[spans]) / (y1 - y0)[spans])
        left = spans[at < x]
        if not len(left):
            face[c] = 0
            continue
        # The rightmost; of those that start in one point the one that leans most to the right.
        lean = (x1 - x0)[left] / (y1 - y0)[left]
        nearest = int(left[np.lexsort((lean, np.round(at[at < x], 9)))[-1]])
        parent[c] = int(cycle[2 * nearest + (y1[nearest] > y0[nearest])])
    for c in parent:
        trail = c
        while face[trail] < 0:
            trail = parent[trail]
        face[c] = face[trail]
    return face


def _covers(face: np.ndarray, changes: list[dict[int, int]], count: int, canvas: int) -> list[list[int]]:
    """The shapes that cover each of `count` faces within the canvas."""
    beside: list[list[tuple[int, dict[int, int], int]]] = [[] for _ in range(count)]
    for (left, right), change in zip(face.reshape(-1, 2).tolist(), changes, strict=True):
        beside[right].append((left, change, 1))
        beside[left].append((right, change, -1))
    windings: dict[int, dict[int, int]] = {0: {}}
    reached = [0]
    for here in reached:
        own = windings[here]
        for other, change, sign in beside[here]:
            if other not in windings:
                there = own | {shape: own.get(shape, 0) + sign * more for shape, more in change.items()}
                windings[other] = {shape: total for shape, total in there.items() if total}
                reached.append(other)
    within = [windings.get(number, {}) for number in range(count)]
    return [[shape for shape in own if shape != canvas] if canvas in own else [] for own in within]


def visible_regions(faces: Faces, fills: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F,) the region of each face, and (R,) the shape that each region shows, NOTHING where the ground does.

    fills: (shapes,) int, equal where two shapes look alike.
    """
    shown = np.array([max(shapes, default=NOTHING) for shapes in faces.covers])
    # The last one is what NOTHING, -1, picks.
    classes = np.append(fills, NOTHING)
    left, right, lengths = faces.face[0::2], faces.face[1::2], faces.lengths
    areas = faces.areas / GRID**2
    for _ in range(4):  # passes
        region = connected(classes[shown], left, right)
        size = np.bincount(region, areas)
        apart = region[left] != region[right]
        around = np.bincount(region[left[apart]], lengths[apart], len(size))
        around += np.bincount(region[right[apart]], lengths[apart], len(size))
        slivers = (size < LEAST_AREA) | (2.0 * size < LEAST_WIDTH * around)
        if not slivers.any():
            break
        _absorbed(shown, region, slivers, faces)
    region = connected(classes[shown], left, right)
    return region, _shapes(shown, region, areas)


def connected(classes: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(F,) numbers of the groups of faces of one class that touch along edges. left, right: (E,) the faces of each."""
    same = classes[left] == classes[right]
    return linked_groups(len(classes), left[same], right[same])[1].astype(np.int64)


def _absorbed(shown: np.ndarray, region: np.ndarray, slivers: np.ndarray, faces: Faces) -> None:
    """Gives slivers, in place, what shows in the neighbour of the longest shared border, a drawn one if there is."""
    count, a, b = len(slivers), region[faces.face[0::2]], region[faces.face[1::2]]
    pairs, place = np.unique(np.concatenate([a * count + b, b * count + a]), return_inverse=True)
    borders = np.bincount(place, np.tile(faces.lengths, 2), len(pairs)).tolist()
    starts, others = np.searchsorted(pairs, np.arange(count + 1) * count).tolist(), (pairs % count).tolist()
    largest = _shapes(shown, region, np.ones(len(shown)))
    for s in np.flatnonzero(slivers):
        beside = [
            (largest[k] != NOTHING, length, k)
            for k, length in zip(others[starts[s] : starts[s + 1]], borders[starts[s] : starts[s + 1]], strict=True)
            if not slivers[k]
        ]
        if beside:
            shown[region == s] = largest[max(beside)[2]]


def _shapes(shown: np.ndarray, region: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(R,) the shape on the largest part of each region."""
    count = int(region.max()) + 1
    values, index = np.unique(shown, return_inverse=True)
    finite = np.where(np.isfinite(weights), weights, 0.0)
    total = np.bincount(region * len(values) + index, finite + 1e-12, count * len(values))
    return values[total.reshape(count, -1).argmax(axis=1)]
