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
log = logging.getLogger("cubicsplat")  # of warnings to users of the library


@record
class Progress:
    """Progress of a fit or a drawing.

    share: of the work or, under a time limit, of the time, 0..1. stage: its name. For the fit of a photo only: step of
    steps (else 0), psnr_db of the engine's own picture and ms_per_step (else None), replaced: curves re-seeded so far.
    """

    share: float
    step: int
    steps: int
    psnr_db: float | None
    ms_per_step: float | None
    replaced: int
    seconds_left: float
    stage: str = "fitting"


OnProgress = Callable[[Progress], None]


class Stopped(Exception):
    """Ends the work with the result so far: the time is up, or the user has interrupted."""


@dataclass(eq=False)
class Work:
    """Work in stages that can be stopped between any two steps, and still has a result.

    on_progress: called at the start of every stage, and about ten times a second within. deadline: by
    `time.perf_counter`. threads: of native code. stopped: no further step starts; interrupted: because of a
    KeyboardInterrupt, not of the deadline.
    """

    on_progress: OnProgress | None = None
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
    """Return the current work; without one, work that nobody watches or stops."""
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
    """Do nothing: a callback that ignores its arguments."""


@contextmanager
def warnings_to(tell: Callable[[str], None]) -> Iterator[None]:
    """Within, call `tell` with the text of each warning that the library logs in this thread."""
    handler, thread = logging.Handler(logging.WARNING), threading.get_ident()
    handler.addFilter(lambda record: record.thread == thread)
    handler.emit = lambda record: tell(record.getMessage())  # type: ignore[method-assign]
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


# The time at which this process's command began; None in a worker, and in other programs.
COMMAND_BEGAN: ContextVar[float | None] = ContextVar("COMMAND_BEGAN", default=None)


def command_began() -> float:
    """Return the time at which this process's command began, by `time.perf_counter`; now if it is no command."""
    return COMMAND_BEGAN.get() or time.perf_counter()


class Observer:
    """Gets the events of the work on pictures, and ignores them. job: the name of a picture's job."""

    def begin(self, job: str) -> None:
        """The work begins, or begins again."""

    def stage(self, stage: str, job: str) -> None:
        """A stage begins: read, start (of the engine), fit, write, draw, measure, animation, html_report, export."""

    def step(self, progress: Progress, job: str) -> None:
        """The fit or the drawing makes progress."""

    def note(self, text: str, job: str = "") -> None:
        """There is a note for the user, which is no error."""

    def detail(self, text: str, job: str = "") -> None:
        """There is a note for users who want all details."""

    def end(self, job: str) -> None:
        """The work ends, with any result; also that on a picture that needed none."""


@dataclass(eq=False)
class StageTimer:
    """Times the stages of the work on one picture ("read", "fit", "write", "draw", "measure"), and tells an observer.

    job: the picture's name for the observer. started: the start of the work; of a command with one picture, the start
    of the command (`command_began`).
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
        """Report the progress of the fit or the drawing."""
        self.observer.step(progress, self.job)

    def note(self, text: str) -> None:
        """Report a note for the user, which is no error."""
        self.observer.note(text, self.job)

    def total(self) -> float:
        """Return the seconds since the work began."""
        return time.perf_counter() - self.started


def interrupt() -> None:
    """Raise KeyboardInterrupt, in a signal handler; during the import of torch, repeat the signal a moment later.

    An exception within the start of torch's C++ code would abort the process.
    """
    torch = sys.modules.get("torch")
    if torch is None or not getattr(torch.__spec__, "_initializing", False):
        raise KeyboardInterrupt
    threading.Timer(0.05, signal.raise_signal, (signal.SIGINT,)).start()


FRAMES = 48  # of an animation
FEWEST_FRAMES = 8  # that are kept, even if they need more memory


class FrameRecorder:
    """Keeps a scene whenever the picture has become better by a step, and doubles the step if there are too many.

    frames: at the end; up to four times as many are kept before, and no more than `most_bytes` hold.
    """

    def __init__(self, frames: int, most_bytes: int = 1 << 26) -> None:
        self.frames, self._most_bytes = frames, most_bytes
        self._step_db = 0.02
        self._kept: list[tuple[float, Scene]] = []

    def due(self, psnr_db: float) -> bool:
        """Return whether to keep a scene of this quality."""
        return not self._kept or psnr_db >= self._kept[-1][0] + self._step_db

    def keep(self, psnr_db: float, scene: Scene) -> None:
        """Keep a scene that is due, which must not change afterwards."""
        self._kept.append((psnr_db, scene))
        arrays = scene.points, scene.colours, scene.opacities, scene.half_widths
        values = sum(math.prod(array.shape) for array in arrays)
        most = max(FEWEST_FRAMES, min(4 * self.frames, self._most_bytes // (4 * values)))
        while len(self._kept) > most:
            self._step_db *= 2.0
            frames, self._kept = self._kept, []
            for frame in frames:
                if self.due(frame[0]):
                    self._kept.append(frame)

    def scenes(self, last: Scene) -> list[Scene]:
        """Return at most `frames` scenes: kept ones, evenly by their quality, and `last`."""
        chosen = list(range(len(self._kept)))
        if len(chosen) >= self.frames:
            levels = [level for level, _ in self._kept]
            span = (levels[-1] - levels[0]) / max(1, self.frames - 2)
            even = [levels[0] + span * index for index in range(self.frames - 1)]
            nearest = [min(chosen, key=lambda index: abs(levels[index] - level)) for level in even]
            chosen = list(dict.fromkeys(nearest))
        return [*(self._kept[index][1] for index in chosen), last]
