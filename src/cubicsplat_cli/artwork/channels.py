"""Pictures' channels, the last axis of their arrays."""

from __future__ import annotations

from functools import reduce

import numpy as np


def largest(values: np.ndarray) -> np.ndarray:
    """(...) the largest of the channels of (..., C): numpy's own, of an axis so short, takes ten times as long."""
    return np.asarray(reduce(np.maximum, np.moveaxis(values, -1, 0)))
