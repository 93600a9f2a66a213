"""Exact coverage of pixels by shapes, and how it changes when their outlines move.

A pixel's coverage is its area within the outlines. Each outline is cut into edges shorter than a pixel, none of which
leaves its pixel; with the outer ring clockwise as seen, an edge (dx, dy) in a pixel adds the area to its left there and
-dy to all pixels to its right. Moving the edge by (u, v) changes its pixel's coverage by u dy - v dx.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# px between a cubic and its polyline.
FLATNESS = 0.001
MOST_EDGES = 256


@dataclass(frozen=True)
class Edges:
    """m edges that stay within a pixel each. cubic: (m,) int whose they are; t: (m,) parameter at their middle; row,
    column: (m,) their pixels, perhaps off the canvas; step: (m, 2) dx, dy; middle: (m,) x of their middle."""

    cubic: np.ndarray
    t: np.ndarray
    row: np.ndarray
    column: np.ndarray
    step: np.ndarray
    middle: np.ndarray


def edges_of(cubics: np.ndarray, lines: np.ndarray) -> Edges:
    """The edges of cubics (S, 4, 2) px, of which some are lines (S,) bool."""
    counts = _edge_counts(cubics, lines)
    owner = np.repeat(np.arange(len(cubics)), counts)
    local = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    t0, t1 = local / counts[owner], (local + 1) / counts[owner]
    p0, p1 = _points(cubics[owner], t0), _points(cubics[owner], t1)
    # Neighbours share their ends to the last bit, or coverage would leak along rows.
    p1[local + 1 == counts[owner]] = cubics[:, 3]
    p0[local == 0] = cubics[:, 0]
    return _cut(owner, t0, t1, p0, p1)


def _edge_counts(cubics: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """(S,) edges per cubic that keep within FLATNESS: sqrt(3/4 |second difference| / flatness)."""
    bend = np.abs(cubics[:, :2] - 2.0 * cubics[:, 1:3] + cubics[:, 2:]).max(axis=(1, 2))
    counts = np.ceil(np.sqrt(0.75 * np.minimum(bend, 1e6) / FLATNESS)).astype(np.int64)
    return np.where(lines, 1, np.clip(counts, 1, MOST_EDGES))


def _points(cubics: np.ndarray, t: np.ndarray) -> np.ndarray:
    t = t[:, None]
    s = 1.0 - t
    return s * s * (s * cubics[:, 0] + 3.0 * t * cubics[:, 1]) + t * t * (3.0 * s * cubics[:, 2] + t * cubics[:, 3])


def _cut(owner: np.ndarray, t0: np.ndarray, t1: np.ndarray, p0: np.ndarray, p1: np.ndarray) -> Edges:
    """Edges from p0 to p1, cut where they cross a line between pixels."""
    at = [(np.arange(len(owner)), np.zeros(len(owner))), (np.arange(len(owner)), np.ones(len(owner)))]
    for c in (0, 1):
        at.append(_grid_crossings(p0[:, c], p1[:, c]))
    index = np.concatenate([a[0] for a in at])
    u = np.concatenate([a[1] for a in at])
    order = np.argsort(index + 0.5 * u, kind="stable")
    index, u = index[order], u[order]
    pair = np.nonzero(index[1:] == index[:-1])[0]
    edge, u0, u1 = index[pair], u[pair], u[pair + 1]
    span = p1[edge] - p0[edge]
    start = p0[edge] + span * u0[:, None]
    step = span * (u1 - u0)[:, None]
    # The last part ends exactly where the next edge starts.
    last = u1 == 1.0
    step[last] = p1[edge[last]] - start[last]
    middle = start + 0.5 * step
    cell = np.floor(middle).astype(np.int64)
    t = t0[edge] + (t1 - t0)[edge] * 0.5 * (u0 + u1)
    return Edges(owner[edge], t, cell[:, 1], cell[:, 0], step, middle[:, 0])


def _grid_crossings(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(index, parameter) wherever a value running from a to b (n,) passes a whole number."""
    low, high = np.minimum(a, b), np.maximum(a, b)
    first = np.floor(low) + 1.0
    counts = np.maximum(np.ceil(high) - first, 0.0).astype(np.int64)
    index = np.repeat(np.arange(len(a)), counts)
    local = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
    return index, np.clip((first[index] + local - a[index]) / (b - a)[index], 0.0, 1.0)


def coverage(edges: Edges, top: int, left: int, height: int, width: int) -> np.ndarray:
    """(height, width) float64 coverage, in [0, 1], of the pixels of a window by the closed outlines of the edges."""
    row = edges.row - top
    column = edges.column - left
    share = np.clip(edges.middle - edges.column, 0.0, 1.0)
    share = np.where(column < 0, 0.0, share)
    column = np.clip(column, 0, width)
    inside = (row >= 0) & (row < height)
    flat = (row * (width + 2) + column)[inside]
    dy = edges.step[inside, 1]
    size = height * (width + 2)
    sums = np.bincount(flat, -dy * (1.0 - share[inside]), size) + np.bincount(flat + 1, -dy * share[inside], size)
    # A loop of an outline that crosses itself has less than nothing, but is filled as well.
    return np.clip(np.abs(np.cumsum(sums.reshape(height, width + 2), axis=1)[:, :width]), 0.0, 1.0)
