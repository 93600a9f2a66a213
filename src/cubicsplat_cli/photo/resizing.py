"""A fit that changes its number of curves on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.scene import Scene

# Of the scene and (N,) what each of its curves is worth, by how much the loss would rise without it: the numbers of
# those that stay, at least one, and how many there shall be then, at least as many.
Choose = Callable[[Scene, np.ndarray], tuple[np.ndarray, int]]


@dataclass(frozen=True)
class Resizing:
    """at: the share in [0, 1] of the steps before the exact finish after which the number of curves is chosen."""

    at: float
    choose: Choose
