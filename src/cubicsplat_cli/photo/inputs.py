"""Inputs of a fit beside picture and settings, its result, and its notes on the way."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cubicsplat_cli.progress import REPORT_SECONDS, OnProgress, Progress
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene


@record
class FitInputs:
    """weights: (H, W) float32, at least 0 and not all 0: how much each pixel matters; None: all alike.

    start: a scene, of any size, to begin with in place of discs; the fit gets as many curves as its settings say, by
    seeding more or by leaving out the least important. frozen: the curves of the start stay as they are. ground: (H, W,
    3) float32, a picture behind the curves in place of a colour; only for pictures without transparency, on the CPU.
    metric: (2, H, W, 3) float32, the costs of errors there in place of the loss, see `Engine`. rough: a smaller copy of
    the picture, for all steps but the exact finish, and its inputs; not for fits with a start.
    """

    weights: np.ndarray | None = None
    start: Scene | None = None
    frozen: bool = False
    ground: np.ndarray | None = None
    metric: np.ndarray | None = None
    rough: tuple[np.ndarray, FitInputs] | None = None

    @property
    def frozen_curves(self) -> int:
        """The number of curves, the last of the fit, that never change."""
        return self.start.curves if self.start is not None and self.frozen else 0


NO_INPUTS = FitInputs()


@dataclass(eq=False)
class FitResult:
    """The best scene of a fit, and how it came about.

    samples: edges per cubic of the exact finish (S*). replaced, dropped: curves re-seeded during the fit, and left out
    at its end since the picture is better, or not visibly worse, without them. notes: for the user.
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
    notes: list[str]


@dataclass(eq=False)
class TrainingLog:
    """history: a few entries over the whole fit. replaced: curves so far. inequality: of their importance, when last
    measured, 0 to 1. notes: for the user. started, reported: by the clock of `time.perf_counter`.
    """

    on_progress: OnProgress | None
    history: list[dict[str, float]] = field(default_factory=list)
    replaced: int = 0
    inequality: float | None = None
    notes: list[str] = field(default_factory=list)
    interrupted: bool = False
    started: float = field(default_factory=time.perf_counter)
    reported: float = field(default_factory=time.perf_counter)

    @property
    def elapsed(self) -> float:
        """The seconds since the fit began."""
        return time.perf_counter() - self.started

    def due(self, progress: float) -> bool:
        """Return whether the next of about 50 entries is due at this progress."""
        return progress * 50 >= len(self.history) + 1 or progress >= 1.0

    def record(self, step: int, steps: int, progress: float, psnr_db: Callable[[], float]) -> bool:
        """Add an entry after a step, if the next is due, and call `on_progress`. Return whether an entry was added.
        psnr_db: measures the picture, which takes a while.
        """
        now = time.perf_counter()
        elapsed, due = now - self.started, self.due(progress)
        if due:
            level, seconds = round(psnr_db(), 3), round(elapsed, 3)
            entry = {"step": step, "psnr_db": level, "seconds": seconds, "replaced": self.replaced}
            self.history.append(entry if self.inequality is None else {**entry, "gini": round(self.inequality, 4)})
        if self.on_progress and (now - self.reported >= REPORT_SECONDS or progress >= 1.0):
            self.reported = now
            left = elapsed / max(progress, 1e-9) * max(0.0, 1.0 - progress)
            per_step = 1e3 * elapsed / step
            self.on_progress(Progress(min(progress, 1.0), step, steps, psnr_db(), per_step, self.replaced, left))
        return due
