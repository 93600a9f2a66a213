"""What a fit is told beside its picture and its settings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import Array, namespace


@dataclass(frozen=True, eq=False)
class Guide:
    """weights: (H, W) float32, at least 0 and not all 0: how much each pixel matters; None: all alike.

    start: a scene, of any size, to begin with in place of discs; the fit gets as many curves as its settings say, by
    seeding more or by leaving out those of the least use. frozen: its curves stay as they are.
    """

    weights: np.ndarray | None = None
    start: Scene | None = None
    frozen: bool = False


UNGUIDED = Guide()


def spread_of(weights: Array | None) -> float:
    """Share of the picture over which curves will spread: 1 for even weights, that of the region where only one counts.

    It is the square of the weights' mean over the mean of their squares.
    """
    if weights is None:
        return 1.0
    values = namespace(weights).astype(weights, namespace(weights).float64)
    return float(values.mean()) ** 2 / float((values * values).mean())
