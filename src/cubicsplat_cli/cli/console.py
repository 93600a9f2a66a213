"""Output to stderr: notes, progress, summary lines and errors. stdout is for results alone."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cubicsplat_cli.formatting import duration, printable
from cubicsplat_cli.progress import Observer, Progress

# Plain lines: the first report, then one per tenth of the fit or five seconds.
_PLAIN_SHARE = 0.1
_PLAIN_SECONDS = 5.0
# Of one picture: before so much is done, nobody can tell how long the rest will take.
_LEAST_DONE = 0.05
STAGES = {
    "read": "reading",
    "fit": "fitting",
    "write": "writing",
    "start": "starting",
    "draw": "drawing",
    "measure": "measuring",
    "animation": "writing the animation",
    "html_report": "writing the page",
    "export": "writing the other formats",
}


class Reporter(Observer):
    """Writes to stderr: nothing but errors when quiet, settings and plain progress too when verbose.

    bars: whether progress bars may be drawn at all (where stderr is a terminal that can).
    """

    def __init__(self, *, quiet: bool, verbose: bool = False, bars: bool = True) -> None:
        self.quiet = quiet
        self.verbose = verbose
        self.bars = bars and not quiet and _can_hold_a_bar()
        self._display = Observer()
        self.raw = _print  # text as it is, such as a traceback

    def note(self, text: str, job: str = "") -> None:
        """Something the user should know that is no error."""
        if not self.quiet:
            self.raw(f"cubicsplat: note: {printable(text)}")

    def detail(self, text: str, job: str = "") -> None:
        """Something for `-v` only."""
        if self.verbose and not self.quiet:
            self.raw(printable(text))

    def summary(self, text: str) -> None:
        """The one line of a picture, or of the closing table."""
        if not self.quiet:
            self.raw(printable(text))

    def error(self, text: str) -> None:
        """An error, printed even when quiet."""
        self.raw(f"cubicsplat: error: {printable(text)}")

    def begin(self, job: str) -> None:
        self._display.begin(job)

    def stage(self, stage: str, job: str) -> None:
        self._display.stage(stage, job)

    def step(self, progress: Progress, job: str) -> None:
        self._display.step(progress, job)

    def end(self, job: str) -> None:
        self._display.end(job)

    @contextmanager
    def showing(self, pictures: int) -> Iterator[None]:
        """Within, the work on so many pictures is shown: by bars on a terminal, by lines with `-v`, else not at all."""
        try:
            if self.bars:
                from cubicsplat_cli.cli.display import LiveDisplay

                with LiveDisplay(pictures) as display:
                    self._display, self.raw = display, display.print
                    yield
            else:
                self._display = PlainDisplay(self.detail, pictures)
                yield
        finally:
            self._display, self.raw = Observer(), _print

    @contextmanager
    def progress(self, name: str) -> Iterator[Callable[[Progress], None]]:
        """The callback of one fit."""
        with self.showing(1):
            self.begin(name)
            yield lambda at: self.step(at, name)


def _print(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _can_hold_a_bar() -> bool:
    """A terminal that can move its cursor."""
    if sys.stderr is None or not sys.stderr.isatty():
        return False
    from rich.console import Console

    return Console(stderr=True).is_interactive


class Whole:
    """Progress of all pictures together. Unchanged pictures do not count for the time left."""

    def __init__(self, pictures: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.pictures, self._clock = pictures, clock
        self.ended = 0
        self._done = 0  # of those that were begun
        self._shares: dict[str, float] = {}  # of those under way
        self._started: float | None = None

    def begin(self, job: str) -> None:
        """A picture is begun, perhaps again."""
        self._started = self._started or self._clock()
        self._shares[job] = 0.0

    def step(self, job: str, share: float) -> None:
        """Record the progress of a fit, 0 to 1."""
        if job in self._shares:
            self._shares[job] = share

    def end(self, job: str) -> None:
        """It has ended."""
        self.ended += 1
        self._done += self._shares.pop(job, None) is not None

    def text(self) -> str:
        """`3/12 pictures`."""
        return f"{self.ended}/{self.pictures} pictures"

    def left(self) -> str:
        """`2 min 05 s left`, from what was done so far; empty while nobody can tell, and at the end."""
        under_way = sum(self._shares.values())
        done, rest = self._done + under_way, self.pictures - self.ended - under_way
        if self._started is None or done < _LEAST_DONE or rest <= 0:
            return ""
        return f"{duration((self._clock() - self._started) * rest / done)} left"


class PlainDisplay(Observer):
    """A line now and then, for `-v` where no bar can be drawn."""

    def __init__(self, print_line: Callable[[str], None], pictures: int) -> None:
        self._print = print_line
        self._whole = Whole(pictures)
        self._printed: dict[str, tuple[float, float]] = {}  # share and time of the last line of each fit

    def begin(self, job: str) -> None:
        self._whole.begin(job)
        self._printed[job] = (-1.0, -math.inf)
        self._print(f"{job}: begun")

    def stage(self, stage: str, job: str) -> None:
        if stage not in ("read", "fit", "write"):  # the first step says it, or nobody would see it
            self._print(f"{job}: {STAGES[stage]}")

    def end(self, job: str) -> None:
        self._whole.end(job)
        if self._whole.pictures > 1:
            self._print("  ".join(filter(None, (self._whole.text(), self._whole.left()))))

    def step(self, progress: Progress, job: str) -> None:
        self._whole.step(job, progress.share)
        share, at = self._printed.get(job, (-1.0, -math.inf))
        now = time.monotonic()
        if progress.share >= share + _PLAIN_SHARE or progress.share >= 1.0 or now - at >= _PLAIN_SECONDS:
            self._printed[job] = (progress.share, now)
            steps = f", step {progress.step}/{progress.steps}" if progress.steps else ""
            self._print(f"{job}: {progress_text(progress)}{steps}")


def progress_text(progress: Progress, room: int = 1000) -> str:
    """` 45 %  12 s left  31.2 dB  5.7 ms/step` of a fit, ` 45 %  12 s left  fitting outlines` of a drawing, as much of
    it from the front as there is room for.
    """
    parts = [f"{100 * progress.share:3.0f} %"]
    parts += [f"{duration(progress.seconds_left)} left"] if math.isfinite(progress.seconds_left) else []
    if progress.psnr_db is None or progress.ms_per_step is None:
        parts.append(progress.stage)
    else:
        parts += [f"{progress.psnr_db:.1f} dB", f"{progress.ms_per_step:.1f} ms/step"]
    parts += [f"{progress.replaced} replaced"] if progress.replaced else []
    text = parts[0]
    for part in parts[1:]:
        if len(text) + 2 + len(part) > room:
            break
        text += f"  {part}"
    return text
