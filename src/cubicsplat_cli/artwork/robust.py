"""Huber's loss: squares up to a knee, a straight line of the same slope from there on (P. J. Huber, 1964)."""

from __future__ import annotations

import numpy as np


def huber(sizes: np.ndarray, knee: float) -> np.ndarray:
    """Huber's loss of residuals >= 0, of the same shape: size^2 up to the knee, linear beyond."""
    return np.where(sizes <= knee, sizes * sizes, knee * (2.0 * sizes - knee))


def huber_weights(sizes: np.ndarray, knee: float) -> np.ndarray:
    """Weights of squares, 1 up to the knee, with which least squares have the slope of Huber's loss."""
    return np.minimum(1.0, knee / np.maximum(sizes, 1e-12))
