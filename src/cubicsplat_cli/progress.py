"""Where the work on a picture stands. Imports nothing heavy: the command shows it without torch."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """Where a fit stands. share: of the steps or, under a time limit, of the time, 0..1. psnr_db: of the engine's own
    picture. replaced: curves re-seeded so far.
    """

    share: float
    step: int
    steps: int
    psnr_db: float
    ms_per_step: float
    replaced: int
    seconds_left: float


def nothing(*_: object) -> None:
    """A callback that ignores what it is told."""


@dataclass
class Stages:
    """The stages of the work ("read", "fit", "write", "draw", "measure"): the seconds of each; whom to tell of them."""

    begin: Callable[[str], None] = nothing
    seconds: dict[str, float] = field(default_factory=dict)
    started: float = field(default_factory=time.perf_counter)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Within, the work is in this stage; entered twice, the seconds add up."""
        self.begin(name)
        before = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - before

    def total(self) -> float:
        """Seconds since the first stage could begin."""
        return time.perf_counter() - self.started
