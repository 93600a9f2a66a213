"""Edges in whole steps of a file's grid, whose smooth joints stay smooth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.steps import aligned, to_steps
from cubicsplat_cli.artwork.planar.edges import Edges


def on_grid(edges: Edges, precision: int) -> Edges:
    """The edges with all points on multiples of 10^-precision px; at smooth joints the shorter handle is moved by at
    most two steps towards the other's line. Edges of no extent are gone.
    """
    points = to_steps(edges.cubics, precision)
    for pair in edges.smooth:
        vectors = [_handle(points, edges.lines, number, end) for number, end in pair]
        lengths = [int((vector**2).sum()) for vector in vectors]
        movable = [k for k in (0, 1) if not edges.lines[pair[k][0]]]
        if len(movable) == 0 or int(vectors[0] @ vectors[1]) >= 0:
            continue
        k = min(movable, key=lambda k: lengths[k])
        number, end = pair[k]
        points[number, 2 if end else 1] = points[number, 3 * end] + aligned(vectors[k][None], vectors[1 - k][None])[0]
    still = (points[:, 1:] == points[:, :1]).all(axis=(1, 2))
    return replace(edges, cubics=points / 10.0**precision, gone=edges.gone | still)


def _handle(points: np.ndarray, lines: np.ndarray, number: int, end: int) -> np.ndarray:
    """(2,) the handle at an end of an edge, of a line its other end, relative to that end."""
    here = points[number, 3 * end]
    return points[number, 3 * (1 - end)] - here if lines[number] else points[number, 2 if end else 1] - here
