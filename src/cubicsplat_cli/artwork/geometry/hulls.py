"""Holes of pixel masks."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def holes_of(mask: np.ndarray) -> np.ndarray:
    """(h, w) bool: what a mask's pixels enclose without being it."""
    parts, count = ndimage.label(~mask)
    if count == 0:
        return np.zeros_like(mask)
    closed = np.ones(count + 1, dtype=bool)
    closed[0] = False
    closed[np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]])] = False
    return closed[parts]
