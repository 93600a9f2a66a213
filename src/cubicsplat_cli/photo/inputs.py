"""What a fit is given beside its picture and its settings, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import FitSettings


@dataclass(frozen=True, eq=False)
class FitInputs:
    """weights: (H, W) float32, at least 0 and not all 0: how much each pixel matters; None: all alike.

    start: a scene, of any size, to begin with in place of discs; the fit gets as many curves as its settings say, by
    seeding more or by leaving out the least important. frozen: its curves stay as they are.
    """

    weights: np.ndarray | None = None
    start: Scene | None = None
    frozen: bool = False

    @property
    def frozen_curves(self) -> int:
        """How many of the last curves of the fit never change."""
        return self.start.curves if self.start is not None and self.frozen else 0


NO_INPUTS = FitInputs()


@dataclass
class FitResult:
    """The best scene of a fit, and how it came about.

    samples: edges per cubic of the exact finish (S*). replaced, dropped: curves re-seeded during the fit, and left out
    at its end since the picture is better, or not visibly worse, without them. notes: what the user should know.
    """

    scene: Scene
    steps: int
    fit_s: float
    ms_per_step: float
    history: list[dict[str, float]]
    interrupted: bool
    device: dict[str, Any]
    samples: int
    replaced: int
    dropped: int
    settings: FitSettings
    notes: list[str]
