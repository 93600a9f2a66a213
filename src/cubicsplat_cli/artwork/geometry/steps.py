"""Lengths in whole steps of a file's grid, and handles on it that go on smoothly."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.settings import PRECISION

# Steps of the grid across the longer side: 0.01 px at 512 px.
_STEPS_ACROSS = 51_200
# Differences below this are of the arithmetic; they must not decide to which step a coordinate is rounded.
_NOISE_DECIMALS = 7
# Steps that a handle may move for a smoother joint, and what its deviation weighs against that.
_REACH = 2
_STRAIGHTNESS = 6.0


def suggested_precision(width: int, height: int) -> int:
    """Decimals that a drawing of this size needs: 2 at 512 px, 3 at 64 px, 1 at 4,096 px; rounding is a step in 51,200
    of its longer side.
    """
    return int(min(PRECISION.most, max(0, round(math.log10(_STEPS_ACROSS / max(width, height))))))


def to_steps(values: np.ndarray | float, precision: int) -> np.ndarray:
    """Lengths in px as whole multiples of 10^-precision px."""
    return np.rint(np.round(np.asarray(values, np.float64), _NOISE_DECIMALS) * 10.0**precision).astype(np.int64)


def aligned(handles: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(A, 2) handles in steps, relative to their anchors, moved a little to where it continues the other best."""
    reach = np.arange(-_REACH, _REACH + 1)
    offsets = np.stack(np.meshgrid(reach, reach, indexing="ij"), axis=-1).reshape(-1, 2)
    places = handles[:, None] + offsets
    lengths = np.maximum(np.sqrt((others.astype(float) ** 2).sum(axis=1)), 1e-9)[:, None]
    deviation = np.abs(places[..., 0] * others[:, None, 1] - places[..., 1] * others[:, None, 0]) / lengths
    ahead = (places * others[:, None]).sum(axis=-1) < 0
    cost = np.where(ahead, (_STRAIGHTNESS * deviation) ** 2, np.inf) + (offsets**2).sum(axis=-1)
    best = np.where(np.isfinite(cost).any(axis=1), cost.argmin(axis=1), len(offsets) // 2)
    return handles + offsets[best]
