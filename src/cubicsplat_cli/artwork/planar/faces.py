"""The faces of a planar map, which shape shows in each, and the visible regions: faces of one fill that touch along an
edge, without slivers.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from cubicsplat_cli.artwork.planar.snapping import GRID, Segments
from cubicsplat_cli.raster.sparse import linked_groups
from cubicsplat_cli.record import record

NOTHING = -1
# A region of less area or mean width is a gap between outlines that were meant to meet; a shorter run is part of a
# node.
LEAST_AREA, LEAST_WIDTH = 0.02, 0.05  # px^2, px


@record
class Faces:
    """A planar map. vertices: (V, 2) int64, steps of the grid; tail, head: (E,) the vertices of the edges; following:
    (2 E,) the half-edge after each along its face, half-edge 2 e running along edge e and 2 e + 1 back; face: (2 E,)
    the face beside each half-edge, where its direction has it if x grows to the right and y upwards on the left; face 0
    is all around. areas: (F,) square steps, infinite for face 0. runs: of each edge the (piece, t at tail, t at head)
    that lie on it, the uppermost shape's first; covers: of each face the shapes that cover it, none beyond the canvas;
    shown: (F,) the uppermost of these, NOTHING without.
    """

    vertices: np.ndarray
    tail: np.ndarray
    head: np.ndarray
    following: np.ndarray
    face: np.ndarray
    areas: np.ndarray
    runs: list[list[tuple[int, float, float]]]
    covers: list[list[int]]
    shown: np.ndarray


def faces_of(segments: Segments, shape: np.ndarray) -> Faces:
    """The planar map of segments that meet at their ends only. shape: (P,) the shape of each piece, the greatest that
    of the canvas, which bounds what shows.
    """
    vertices, tail, head, runs, changes = _edges(segments, shape)
    following = _following(vertices, tail, head)
    cycle, areas = _cycles(vertices, tail, head, following)
    face_of_cycle = _nested(vertices, tail, head, cycle, areas)
    face = face_of_cycle[cycle]
    sizes = np.bincount(face_of_cycle, 0.5 * areas, 1)
    sizes[0] = np.inf
    covers = _covers(face, changes, len(sizes), int(shape.max()))
    shown = np.array([max(shapes, default=NOTHING) for shapes in covers])
    return Faces(vertices, tail, head, following, face, sizes, runs, covers, shown)


def _edges(
    segments: Segments, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[list[tuple[int, float, float]]], list[dict[int, int]]]:
    """Vertices, tails, heads, runs, and of each edge by how much the winding numbers are greater on its left.

    Edges on either side of which everything is the same are left out.
    """
    ends, index = np.unique(np.concatenate([segments.start, segments.end]), axis=0, return_inverse=True)
    index = index.reshape(2, -1)
    forward = index[0] < index[1]
    low, high = np.minimum(*index), np.maximum(*index)
    key, edge = np.unique(low * len(ends) + high, return_inverse=True)
    runs: list[list[tuple[int, float, float]]] = [[] for _ in key]
    changes: list[dict[int, int]] = [{} for _ in key]
    owners = shape[segments.piece]
    for k in np.lexsort((segments.piece, -owners)).tolist():
        e, owner, ahead = int(edge.flat[k]), int(owners[k]), bool(forward[k])
        t = segments.t[k] if ahead else segments.t[k, ::-1]
        runs[e].append((int(segments.piece[k]), float(t[0]), float(t[1])))
        changes[e][owner] = changes[e].get(owner, 0) + (1 if ahead else -1)
    live = [e for e in range(len(key)) if any(changes[e].values())]
    tail, head = np.divmod(key[live], len(ends))
    return ends, tail, head, [runs[e] for e in live], [{s: n for s, n in changes[e].items() if n} for e in live]


def _following(vertices: np.ndarray, tail: np.ndarray, head: np.ndarray) -> np.ndarray:
    """(2 E,) the half-edge that follows each along the face on its left: the last one before its way back."""
    origin = np.stack([tail, head], axis=1).ravel()
    way = (vertices[head] - vertices[tail]).astype(float)
    angle = np.arctan2(*np.stack([way, -way], axis=1).reshape(-1, 2).T[::-1])
    order = np.lexsort((angle, origin))
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    first = np.searchsorted(origin[order], origin)
    last = np.searchsorted(origin[order], origin, side="right") - 1
    before = order[np.where(place > first, place - 1, last)]
    return before[np.arange(len(order)) ^ 1]


def _cycles(
    vertices: np.ndarray, tail: np.ndarray, head: np.ndarray, following: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(2 E,) the cycle of each half-edge, and (C,) twice their areas, negative around a component."""
    count, cycle = linked_groups(len(following), np.arange(len(following)), following)
    a, b = vertices[tail], vertices[head]
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    areas = np.zeros(count, dtype=np.int64)
    np.add.at(areas, cycle[0::2], cross)
    np.add.at(areas, cycle[1::2], -cross)
    return cycle, areas


def _nested(
    vertices: np.ndarray, tail: np.ndarray, head: np.ndarray, cycle: np.ndarray, areas: np.ndarray
) -> np.ndarray:
    """(C,) the face of each cycle: of those around a component the face that it lies in."""
    origin = np.stack([tail, head], axis=1).ravel()
    inner = np.flatnonzero(areas > 0)
    face = np.full(len(areas), -1)
    face[inner] = np.arange(1, len(inner) + 1)
    outer = np.flatnonzero(areas <= 0)
    y0, y1 = vertices[tail, 1], vertices[head, 1]
    x0, x1 = vertices[tail, 0].astype(float), vertices[head, 0].astype(float)
    parent: dict[int, int] = {}
    by_cycle = np.argsort(cycle, kind="stable")
    bounds = np.searchsorted(cycle[by_cycle], np.arange(len(areas) + 1))
    for c in outer.tolist():
        own = by_cycle[bounds[c] : bounds[c + 1]]
        spots = vertices[origin[own]]
        x, y = spots[np.lexsort((spots[:, 1], spots[:, 0]))[0]]
        # Just above its leftmost vertex: the nearest edge to the left.
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
    beside: list[list[tuple[int, int, int]]] = [[] for _ in range(count)]
    for e in range(len(changes)):
        left, right = int(face[2 * e]), int(face[2 * e + 1])
        beside[right].append((left, e, 1))
        beside[left].append((right, e, -1))
    windings: list[dict[int, int] | None] = [None] * count
    windings[0] = {}
    queue = deque([0])
    covers: list[list[int]] = [[] for _ in range(count)]
    while queue:
        here = queue.popleft()
        own = windings[here] or {}
        if canvas in own:
            covers[here] = [shape for shape in own if shape != canvas]
        for other, e, sign in beside[here]:
            if windings[other] is not None:
                continue
            there = own | {shape: own.get(shape, 0) + sign * change for shape, change in changes[e].items()}
            windings[other] = {shape: total for shape, total in there.items() if total}
            queue.append(other)
    return covers


def visible_regions(faces: Faces, fills: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F,) the region of each face, and (R,) the shape that each region shows, NOTHING where the ground does.

    fills: (shapes,) int, equal where two shapes look alike.
    """
    shown = faces.shown.copy()
    left, right = faces.face[0::2], faces.face[1::2]
    steps = faces.vertices[faces.head] - faces.vertices[faces.tail]
    lengths = np.hypot(*steps.T) / GRID
    areas = faces.areas / GRID**2
    for _ in range(4):  # passes
        region = connected(_classes(shown, fills), left, right)
        size = np.bincount(region, areas)
        apart = region[left] != region[right]
        around = np.bincount(region[left[apart]], lengths[apart], len(size))
        around += np.bincount(region[right[apart]], lengths[apart], len(size))
        slivers = (size < LEAST_AREA) | (2.0 * size < LEAST_WIDTH * around)
        if not slivers.any():
            break
        _absorbed(shown, region, slivers, (left, right, lengths))
    region = connected(_classes(shown, fills), left, right)
    return region, _shapes(shown, region, areas)


def _classes(shown: np.ndarray, fills: np.ndarray) -> np.ndarray:
    return np.where(shown >= 0, np.append(fills, 0)[shown], NOTHING)


def connected(classes: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(F,) numbers of the groups of faces of one class that touch along edges. left, right: (E,) the faces of each."""
    same = classes[left] == classes[right]
    return linked_groups(len(classes), left[same], right[same])[1].astype(np.int64)


def _absorbed(
    shown: np.ndarray, region: np.ndarray, slivers: np.ndarray, edges: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    """Gives slivers, in place, what shows in the neighbour of the longest shared border, a drawn one if there is."""
    left, right, lengths = edges
    count = len(slivers)
    a, b = region[left], region[right]
    pairs, place = np.unique(np.concatenate([a * count + b, b * count + a]), return_inverse=True)
    borders = np.bincount(place, np.tile(lengths, 2), len(pairs)).tolist()
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
    index = index.reshape(-1)
    finite = np.where(np.isfinite(weights), weights, 0.0)
    total = np.bincount(region * len(values) + index, finite + 1e-12, count * len(values))
    return values[total.reshape(count, -1).argmax(axis=1)]
