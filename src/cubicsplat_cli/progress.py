"""Progress of the work on a picture, and ways to stop it. Imports nothing heavy."""

from __future__ import annotations

import logging
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cubicsplat_cli.record import record
from cubicsplat_cli.settings import cpu_count

if TYPE_CHECKING:
    from cubicsplat_cli.scene import Scene

REPORT_SECONDS = 0.1  # between two calls of `on_progress`
log = logging.getLogger("cubicsplat")  # of warnings to whoever uses the library


@record
class Progress:
    """Progress of a fit or a drawing.

    share: of the work or, under a time limit, of the time, 0..1. stage: what is being done. Of the fit of a photo only:
    step of steps (else 0), psnr_db of the engine's own picture and ms_per_step (else None), replaced: curves re-seeded
    so far.
    """

    share: float
    step: int
    steps: int
    psnr_db: float | None
    ms_per_step: float | None
    replaced: int
    seconds_left: float
    stage: str = "fitting"


class Stopped(Exception):
    """Ends the work with the result so far: the time is up, or the user interrupted."""


@dataclass(eq=False)
class Work:
    """Work in stages that can be stopped between any two steps, and still has a result.

    on_progress: called at the start of every stage, and about ten times a second within. deadline: by
    `time.perf_counter`. threads: on how many native code may run. stopped: no further step starts; interrupted: by a
    KeyboardInterrupt, not by the deadline.
    """

    on_progress: Callable[[Progress], None] | None = None
    deadline: float = math.inf
    threads: int = field(default_factory=cpu_count)
    stopped: bool = False
    interrupted: bool = False
    started: float = field(default_factory=time.perf_counter)
    _stage: str = ""
    _share: float = 0.0
    _told: float = -math.inf

    def at(self, stage: str = "", share: float = 0.0) -> None:
        """Report the stage and the share done, 0..1; by default the last ones. Raises Stopped if the work must end, and
        what `on_progress` raises.
        """
        now = time.perf_counter()
        if self.stopped or now >= self.deadline:
            self.stopped = True
            raise Stopped
        begins = stage not in ("", self._stage)
        if stage:
            self._stage, self._share = stage, max(self._share, share)
        if self.on_progress is not None and (begins or now >= self._told + REPORT_SECONDS):
            self._told = now
            share, elapsed = self._share, now - self.started
            left = elapsed * (1.0 - share) / share if share > 0.0 else math.inf
            self.on_progress(Progress(share, 0, 0, None, None, 0, min(left, self.deadline - now), self._stage))

    @contextmanager
    def stoppable(self) -> Iterator[None]:
        """Within, a stop ends only the block: its state so far is the result.

        A KeyboardInterrupt also stops the rest of the current work. A second one, or one outside of it, is raised.
        """
        try:
            yield
        except Stopped:
            pass
        except KeyboardInterrupt:
            if self.interrupted or _WORK.get() is not self:
                raise
            self.stopped = self.interrupted = True


_WORK: ContextVar[Work | None] = ContextVar("_WORK", default=None)


def work() -> Work:
    """The current work; without one, work that nobody watches or stops."""
    return _WORK.get() or Work()


@contextmanager
def under_way(one: Work) -> Iterator[Work]:
    """Within, this is the current work."""
    token = _WORK.set(one)
    try:
        yield one
    finally:
        _WORK.reset(token)


def nothing(*_: object) -> None:
    """A callback that ignores what it is told."""


class _Telling(logging.Handler):
    def __init__(self, tell: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._tell = tell

    def emit(self, record: logging.LogRecord) -> None:
        self._tell(record.getMessage())


@contextmanager
def warnings_to(tell: Callable[[str], None]) -> Iterator[None]:
    """Within, `tell` gets the text of each warning that the library logs."""
    handler = _Telling(tell)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


# When the command began that this process is; None in a worker, and in other programs.
COMMAND_BEGAN: ContextVar[float | None] = ContextVar("COMMAND_BEGAN", default=None)


def command_began() -> float:
    """The time at which this process's command began, by `time.perf_counter`; now where it is none."""
    began = COMMAND_BEGAN.get()
    return time.perf_counter() if began is None else began


class Observer:
    """Is told how the work on pictures goes on; these methods do nothing. job: the name of a picture's job."""

    def begin(self, job: str) -> None:
        """Its work begins; or begins again."""

    def stage(self, stage: str, job: str) -> None:
        """A stage begins: read, start (the engine is loaded), fit, write, draw, measure, animation or html_report."""

    def step(self, progress: Progress, job: str) -> None:
        """Its fit or drawing has come this far."""

    def note(self, text: str, job: str = "") -> None:
        """Something the user should know that is no error."""

    def detail(self, text: str, job: str = "") -> None:
        """Something for those who want to know everything."""

    def end(self, job: str) -> None:
        """Its work has ended, in whatever way; also of a picture that needed no work."""


@dataclass(eq=False)
class StageTimer:
    """Times the stages of the work on one picture ("read", "fit", "write", "draw", "measure"), and tells an observer.

    job: the picture's name for the observer. started: when the work began; of a command that has one picture to do,
    when the command began (`command_began`).
    """

    observer: Observer = field(default_factory=Observer)
    job: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    started: float = field(default_factory=time.perf_counter)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Within, the work is in this stage; entered twice, the seconds add up."""
        self.observer.stage(name, self.job)
        before = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - before

    def step(self, progress: Progress) -> None:
        """Tell how far the fit or the drawing is."""
        self.observer.step(progress, self.job)

    def note(self, text: str) -> None:
        """Tell the user something that is no error."""
        self.observer.note(text, self.job)

    def total(self) -> float:
        """Seconds since the work began."""
        return time.perf_counter() - self.started


AGAIN_S = 0.05


def interrupt() -> None:
    """Raise KeyboardInterrupt or, while torch is being imported, have the signal come again a moment later.

    For signal handlers. An exception that reaches torch's C++ code in the middle of its start aborts the process.
    """
    torch = sys.modules.get("torch")
    if torch is None or not getattr(torch.__spec__, "_initializing", False):
        raise KeyboardInterrupt
    threading.Timer(AGAIN_S, signal.raise_signal, (signal.SIGINT,)).start()


# Scenes that are kept take at most so much memory, or are as few as FEWEST_FRAMES.
MOST_FRAME_BYTES = 1 << 26
FEWEST_FRAMES = 8
FIRST_STEP_DB = 0.02
FRAMES = 48


class FrameRecorder:
    """Keeps a scene whenever the picture has become better by a step, and doubles the step when there are too many.

    frames: how many are wanted at the end; four times as many are kept at most, and no more than most_bytes hold.
    """

    def __init__(self, frames: int, most_bytes: int = MOST_FRAME_BYTES) -> None:
        self.frames, self._most_bytes = frames, most_bytes
        self._step_db = FIRST_STEP_DB
        self._kept: list[tuple[float, Scene]] = []

    def due(self, psnr_db: float) -> bool:
        """Whether to keep a scene of this quality."""
        return not self._kept or psnr_db >= self._kept[-1][0] + self._step_db

    def keep(self, psnr_db: float, scene: Scene) -> None:
        """Keeps a scene that is due; it must not change afterwards."""
        self._kept.append((psnr_db, scene))
        values = sum(
            math.prod(array.shape) for array in (scene.points, scene.colours, scene.opacities, scene.half_widths)
        )
        most = max(FEWEST_FRAMES, min(4 * self.frames, self._most_bytes // (4 * values)))
        while len(self._kept) > most:
            self._step_db *= 2.0
            thinned = self._kept[:1]
            for level, kept in self._kept[1:]:
                if level >= thinned[-1][0] + self._step_db:
                    thinned.append((level, kept))
            self._kept = thinned

    def scenes(self, last: Scene) -> list[Scene]:
        """At most `frames` of the kept scenes, evenly by their quality, and after them `last`."""
        chosen = list(range(len(self._kept)))
        if len(chosen) >= self.frames:
            levels = [level for level, _ in self._kept]
            span = (levels[-1] - levels[0]) / max(1, self.frames - 2)
            wanted = [levels[0] + span * index for index in range(self.frames - 1)]
            nearest = [min(chosen, key=lambda index: abs(levels[index] - level)) for level in wanted]
            chosen = list(dict.fromkeys(nearest))
        return [*(self._kept[index][1] for index in chosen), last]
