"""Where the work on a picture stands. Imports nothing heavy: the command shows it from the start."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
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


# When the command began that this process is; None in a worker, and in other programs.
COMMAND_BEGAN: ContextVar[float | None] = ContextVar("COMMAND_BEGAN", default=None)


def command_began() -> float:
    """When the command that this process is began, by `time.perf_counter`; now where it is none."""
    began = COMMAND_BEGAN.get()
    return time.perf_counter() if began is None else began


@dataclass
class Stages:
    """The stages of the work ("read", "fit", "write", "draw", "measure"): the seconds of each; whom to tell of them.

    started: when the work began; of a command that has one picture to do, its own beginning (`command_began`).
    """

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
        """Seconds since the work began."""
        return time.perf_counter() - self.started
