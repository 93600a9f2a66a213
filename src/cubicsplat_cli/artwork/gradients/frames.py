"""Geometries of gradients to begin with, from the directions in which colours change.

A linear gradient changes in one direction. The direction in which a radial one changes points away from its middle; if
it spreads as an ellipse |A (p - c)| = t, it is that of A^T A (p - c). Either is a linear condition on the unknowns.
"""

from __future__ import annotations

import math

import numpy as np

# Blocks, each of which gives a direction, px of one and pixels that it needs.
BLOCKS, LEAST_BLOCK, FULL = 300, 3, 5
LONGEST, FARTHEST = 12.0, 8.0  # of an ellipse's axes; of its middle from the area, in lengths of that


def first_frames(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> list[tuple[np.ndarray, bool, int]]:
    """Geometries for pixels, x, y (n,) px and values (n, 4) levels: frame (2, 3), whether radial, and how many numbers
    it takes; the first is linear.
    """
    places, slopes = _slopes(x, y, values)
    tensor = np.einsum("bki,bkj->ij", slopes, slopes)
    direction = np.linalg.eigh(tensor)[1][:, 1] if len(places) else np.array([1.0, 0.0])
    frames: list[tuple[np.ndarray, bool, int]] = [(np.array([[*direction, 0.0], [0.0, 0.0, 0.0]]), False, 2)]
    if len(places) < 6:
        return frames
    middle = places.mean(axis=0)
    reach = max(float(np.abs(places - middle).max()), 1.0)
    at = (places - middle) / reach
    gx, gy = slopes[..., 0], slopes[..., 1]
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


def _slopes(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles of blocks (b, 2) px and how the colours change there (b, 4, 2), levels per px times the root of the
    pixels, so that each block counts as its errors allow."""
    size = max(LEAST_BLOCK, math.ceil(math.sqrt(len(x) / BLOCKS)))
    left, top = float(x.min()), float(y.min())
    columns = int((float(x.max()) - left) // size) + 1
    index = ((y - top) // size).astype(int) * columns + ((x - left) // size).astype(int)
    names, index = np.unique(index, return_inverse=True)
    count = np.bincount(index).astype(float)

    def mean(v: np.ndarray) -> np.ndarray:
        return np.bincount(index, v, len(names)) / count

    mx, my = mean(x), mean(y)
    dx, dy = x - mx[index], y - my[index]
    xx, xy, yy = mean(dx * dx), mean(dx * dy), mean(dy * dy)
    det = xx * yy - xy * xy
    good = (count >= FULL) & (det > 0.02)
    det = np.where(good, det, 1.0)
    slopes = np.empty((len(names), 4, 2))
    for k in range(4):
        vx, vy = mean(dx * values[:, k]), mean(dy * values[:, k])
        slopes[:, k, 0] = (vx * yy - vy * xy) / det
        slopes[:, k, 1] = (vy * xx - vx * xy) / det
    slopes *= np.sqrt(count * np.minimum(xx, yy))[:, None, None]
    return np.stack([mx, my], axis=1)[good], slopes[good]


def _frame(turn: np.ndarray, centre: np.ndarray, middle: np.ndarray, reach: float) -> np.ndarray:
    place = middle + centre * reach
    return np.column_stack([turn, -turn @ place])
