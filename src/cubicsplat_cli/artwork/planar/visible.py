"""The visible regions of a planar map: faces of one fill that touch along an edge, without slivers."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.planar.faces import NOTHING, Faces
from cubicsplat_cli.artwork.planar.snapping import GRID
from cubicsplat_cli.raster.graphs import linked_groups

# A region of less area or mean width is a gap between outlines that were meant to meet.
LEAST_AREA, LEAST_WIDTH = 0.02, 0.05  # px^2, px
PASSES = 4


def visible_regions(faces: Faces, fills: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F,) the region of each face, and (R,) the shape that each region shows, NOTHING where the ground does.

    fills: (shapes,) int, equal where two shapes look alike.
    """
    shown = faces.shown.copy()
    left, right = faces.face[0::2], faces.face[1::2]
    steps = faces.vertices[faces.head] - faces.vertices[faces.tail]
    lengths = np.hypot(*steps.T) / GRID
    areas = faces.areas / GRID**2
    for _ in range(PASSES):
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
    """Gives slivers, in place, what shows in the neighbour with which they share the longest border, in one that is
    drawn if there is such."""
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
