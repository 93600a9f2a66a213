"""Holes that an outline no longer goes around, once its hidden parts have been chosen."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Outline, Ring, coverage, polygon
from cubicsplat_cli.artwork.layers.extents import Extent
from cubicsplat_cli.artwork.tracing.fitting import few_lines

MOST_WRONG = 20  # px of holes that an outer outline may cut off or enclose


def enclosed(ring: Ring, top: int, left: int, size: tuple[int, ...]) -> np.ndarray:
    """(h, w) bool: the pixels of a window, by its corner and size in px, of which a ring encloses half or more."""
    return coverage(ring.cubics, ring.lines, top, left, *size) > 0.5


def without_stray_holes(fitted: tuple[Outline, ...], extent: Extent) -> tuple[Outline, ...]:
    """The outlines fitted to an extent's contours, the outer one first, less the holes that it no longer goes around.

    Where the outer one is hidden it may go another way than its contour; holes outside of it would be filled. Where it
    runs across what shows through a hole it follows its contour.
    """
    if len(fitted) == 1 or np.isfinite(extent.contours[0].sigma).all():
        return fitted
    size = extent.shown.shape
    inside = enclosed(fitted[0].ring(), extent.top, extent.left, size)
    kept, wrong = [fitted[0]], 0
    for outline, contour in zip(fitted[1:], extent.contours[1:], strict=True):
        own = enclosed(polygon(contour.points), extent.top, extent.left, size)
        around = bool(inside[own].mean() >= 0.5) if own.any() else True
        wrong += int((own & ~extent.allowed & (inside != around)).sum())
        if around:
            kept.append(outline)
    return (few_lines(extent.contours[0].points), *fitted[1:]) if wrong > MOST_WRONG else tuple(kept)
