"""Convex hulls of pixel masks."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.geometry.coverage import coverage
from cubicsplat_cli.artwork.geometry.outlines import polygon


def hull_mask(mask: np.ndarray) -> np.ndarray:
    """(h, w) bool: the pixels that lie by half or more in the convex hull of a mask's pixels."""
    rows = np.flatnonzero(mask.any(axis=1))
    if len(rows) == 0:
        return mask.copy()
    left = mask[rows].argmax(axis=1)
    right = mask.shape[1] - mask[rows, ::-1].argmax(axis=1)
    # The corners of each row's first and last pixel; going down the right side and up the left one is a chain each.
    sides = [np.stack([np.repeat(x, 2), np.stack([rows, rows + 1], axis=1).ravel()], axis=1) for x in (right, left)]
    corners = np.array(_chain(sides[0].tolist()) + _chain(sides[1][::-1].tolist()), dtype=float)
    ring = polygon(corners)
    return mask | (coverage(ring.cubics, ring.lines, 0, 0, *mask.shape) >= 0.5)


def _chain(points: list[list[int]]) -> list[list[int]]:
    """One side of a convex hull, by the monotone chain."""
    out: list[list[int]] = []
    for p in points:
        while len(out) >= 2 and _turn(out[-2], out[-1], p) <= 0:
            out.pop()
        out.append(p)
    return out


def _turn(a: list[int], b: list[int], c: list[int]) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
