"""Where a fit stands: a module of its own, since the command shows it without importing torch."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """Where a fit stands. psnr_db: of the engine's own picture. replaced: curves re-seeded so far."""

    step: int
    steps: int
    psnr_db: float
    ms_per_step: float
    replaced: int
    seconds_left: float
