"""Geometries of gradients to begin with, from the directions in which colours change.

A linear gradient changes in one direction. The direction in which a radial one changes points away from its middle; if
it spreads as an ellipse |A (p - c)| = t, it is that of A^T A (p - c). Either is a linear condition on the unknowns.
"""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.raster.shades import Pixels, slopes

# Blocks, each of which gives a direction, px of one and pixels that it needs.
BLOCKS, LEAST_BLOCK, FULL = 300, 3, 5
LONGEST, FARTHEST = 12.0, 8.0  # of an ellipse's axes; of its middle from the area, in lengths of that


def first_frames(pixels: Pixels) -> list[tuple[np.ndarray, bool, int]]:
    """Geometries for pixels: frame (2, 3), whether radial, and how many numbers it takes; the first is linear."""
    size = max(LEAST_BLOCK, math.ceil(math.sqrt(len(pixels.x) / BLOCKS)))
    places, changes = slopes(pixels, size, FULL)
    tensor = np.einsum("bki,bkj->ij", changes, changes)
    direction = np.linalg.eigh(tensor)[1][:, 1] if len(places) else np.array([1.0, 0.0])
    frames: list[tuple[np.ndarray, bool, int]] = [(np.array([[*direction, 0.0], [0.0, 0.0, 0.0]]), False, 2)]
    if len(places) < 6:
        return frames
    middle = places.mean(axis=0)
    reach = max(float(np.abs(places - middle).max()), 1.0)
    at = (places - middle) / reach
    gx, gy = changes[..., 0], changes[..., 1]
    px, py = at[:, :1] + np.zeros_like(gx), at[:, 1:] + np.zeros_like(gx)
    # A circle: slope x (place - c) = 0; an ellipse: slope x (M place - m) = 0.
    square = np.stack([-gy, gx], axis=-1).reshape(-1, 2)
    centre = np.linalg.lstsq(square, (gx * py - gy * px).ravel(), rcond=None)[0]
    if np.abs(centre).max() < FARTHEST:
        frames.append((_frame(np.eye(2), centre, middle, reach), True, 3))
    rows = np.stack([-gy * px, gx * px - gy * py, gx * py, gy, -gx], axis=-1).reshape(-1, 5)
    solution = np.linalg.eigh(rows.T @ rows)[1][:, 0]
    form = np.array([[solution[0], solution[1]], [solution[1], solution[2]]])
    form = form if np.trace(form) > 0 else -form
    values, axes = np.linalg.eigh(form)
    if values[0] > values[1] / LONGEST**2:
        centre = np.linalg.solve(np.array([[solution[0], solution[1]], [solution[1], solution[2]]]), solution[3:])
        if np.abs(centre).max() < FARTHEST:
            frames.append((_frame((axes * np.sqrt(values / values[1])).T, centre, middle, reach), True, 5))
    return frames


def _frame(turn: np.ndarray, centre: np.ndarray, middle: np.ndarray, reach: float) -> np.ndarray:
    place = middle + centre * reach
    return np.column_stack([turn, -turn @ place])
