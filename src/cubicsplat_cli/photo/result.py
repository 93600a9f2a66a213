"""What a fit gives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import FitSettings


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


def db_ratio(db: float) -> float:
    """The factor of a loss that is so many dB worse."""
    return 10.0 ** (db / 10.0)


def psnr(loss: float, values: int) -> float:
    """dB of a sum of squared errors over so many values in [0, 1]; at most 100."""
    return min(100.0, 10.0 * math.log10(values / max(loss, 1e-300)))
