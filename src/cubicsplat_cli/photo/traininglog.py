"""How a fit goes: its history for the metrics file, and what is told on the way."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from cubicsplat_cli.progress import REPORT_SECONDS, Progress

HISTORY_ENTRIES = 50


@dataclass
class TrainingLog:
    """history: a few entries over the whole fit. replaced: curves so far. inequality: of their importance, when last
    measured, 0 to 1. notes: what the user should know. started, reported: by the clock of `time.perf_counter`.
    """

    on_progress: Callable[[Progress], None] | None
    history: list[dict[str, float]] = field(default_factory=list)
    replaced: int = 0
    inequality: float | None = None
    notes: list[str] = field(default_factory=list)
    interrupted: bool = False
    started: float = field(default_factory=time.perf_counter)
    reported: float = field(default_factory=time.perf_counter)

    @property
    def elapsed(self) -> float:
        """Seconds since the fit began."""
        return time.perf_counter() - self.started

    def record(self, step: int, steps: int, progress: float, psnr_db: Callable[[], float]) -> bool:
        """After a step: adds an entry where the next is due, and tells whoever waits. Returns whether it did add one.

        psnr_db: measures the picture, which takes a while.
        """
        now = time.perf_counter()
        elapsed = now - self.started
        due = progress * HISTORY_ENTRIES >= len(self.history) + 1 or progress >= 1.0
        if due:
            entry = {
                "step": step, "psnr_db": round(psnr_db(), 3), "seconds": round(elapsed, 3), "replaced": self.replaced,
            }  # fmt: skip
            self.history.append(entry if self.inequality is None else {**entry, "gini": round(self.inequality, 4)})
        if self.on_progress and (now - self.reported >= REPORT_SECONDS or progress >= 1.0):
            self.reported = now
            left = elapsed / max(progress, 1e-9) * max(0.0, 1.0 - progress)
            per_step = 1e3 * elapsed / step
            self.on_progress(Progress(min(progress, 1.0), step, steps, psnr_db(), per_step, self.replaced, left))
        return due
