"""Output to stderr: notes, progress, summary lines and errors. stdout is for results alone."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cubicsplat_cli.formatting import duration, printable
from cubicsplat_cli.progress import Observer, OnProgress, Progress

# Plain lines: the first report, then one per tenth of the fit or five seconds.
_PLAIN_SHARE, _PLAIN_SECONDS = 0.1, 5.0
_LEAST_DONE = 0.05  # of one picture: earlier than that, nobody can tell how long the rest takes
_BAR = _NAME = 24  # columns of a bar, and of the name of a picture
# Columns: narrower terminals show no bar, and the narrowest ones shorten the names of pictures further.
_WIDE, _NARROW = 72, 48
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


def progress_text(progress: Progress, room: int = 1000) -> str:
    """Return ` 45 %  12 s left  31.2 dB  5.7 ms/step` for a fit, ` 45 %  12 s left  fitting outlines` for a drawing.

    room: characters; parts at the end that do not fit are left out.
    """
    parts = [f"{100 * progress.share:3.0f} %"]
    parts += [f"{duration(progress.seconds_left)} left"] if math.isfinite(progress.seconds_left) else []
    if progress.psnr_db is None or progress.ms_per_step is None:
        parts.append(progress.stage)
    else:
        parts += [f"{progress.psnr_db:.1f} dB", f"{progress.ms_per_step:.1f} ms/step"]
    parts += [f"{progress.replaced} replaced"] if progress.replaced else []
    while len(parts) > 1 and len("  ".join(parts)) > room:
        del parts[-1]
    return "  ".join(parts)


class Display(Observer):
    """The progress of all pictures together. Pictures that needed no work do not count for the time left."""

    def __init__(self, pictures: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.pictures, self._clock = pictures, clock
        self.ended = 0
        self._done = 0  # pictures that were begun and have ended
        self._shares: dict[str, float] = {}  # done of each picture under way
        self._started: float | None = None

    def begin(self, job: str) -> None:
        self._started = self._started or self._clock()
        self._shares[job] = 0.0

    def step(self, progress: Progress, job: str) -> None:
        if job in self._shares:
            self._shares[job] = progress.share

    def end(self, job: str) -> None:
        self.ended += 1
        self._done += self._shares.pop(job, None) is not None

    def text(self) -> str:
        """Return `3/12 pictures`."""
        return f"{self.ended}/{self.pictures} pictures"

    def left(self) -> str:
        """Return `2 min 05 s left`, from the work done so far; "" while nobody can tell, and at the end."""
        under_way = sum(self._shares.values())
        done, rest = self._done + under_way, self.pictures - self.ended - under_way
        if self._started is None or done < _LEAST_DONE or rest <= 0:
            return ""
        return f"{duration((self._clock() - self._started) * rest / done)} left"


class PlainDisplay(Display):
    """Writes a line now and then, for `-v` where no bar can be drawn."""

    def __init__(self, print_line: Callable[[str], None], pictures: int) -> None:
        super().__init__(pictures)
        self._print = print_line
        self._printed: dict[str, tuple[float, float]] = {}  # share and time of the last line of each fit

    def begin(self, job: str) -> None:
        super().begin(job)
        self._printed[job] = (-1.0, -math.inf)
        self._print(f"{job}: begun")

    def stage(self, stage: str, job: str) -> None:
        if stage not in ("read", "fit", "write"):  # the first step says it, or nobody would see it
            self._print(f"{job}: {STAGES[stage]}")

    def step(self, progress: Progress, job: str) -> None:
        super().step(progress, job)
        share, at = self._printed.get(job, (-1.0, -math.inf))
        now = time.monotonic()
        if progress.share >= share + _PLAIN_SHARE or progress.share >= 1.0 or now - at >= _PLAIN_SECONDS:
            self._printed[job] = (progress.share, now)
            steps = f", step {progress.step}/{progress.steps}" if progress.steps else ""
            self._print(f"{job}: {progress_text(progress)}{steps}")

    def end(self, job: str) -> None:
        super().end(job)
        if self.pictures > 1:
            self._print("  ".join(filter(None, (self.text(), self.left()))))


class LiveDisplay(Display):
    """Draws a bar for each picture under way and, if there are several pictures, one for all."""

    def __init__(self, pictures: int) -> None:
        import rich.progress
        from rich.console import Console

        super().__init__(pictures)
        # Rich honours NO_COLOR. File names may hold square brackets, which must not be read as markup.
        self._console = Console(stderr=True, highlight=False)
        name = rich.progress.TextColumn("{task.description}", markup=False)
        text = rich.progress.TextColumn("{task.fields[text]}", markup=False)
        bar = [rich.progress.BarColumn(_BAR)] if self._console.width >= _WIDE else []
        self._bars = rich.progress.Progress(
            name, *bar, text, console=self._console, transient=True, redirect_stdout=False, redirect_stderr=False
        )
        self._columns: list[int] = []  # of each line when it was last drawn
        self._shown: dict[str, rich.progress.TaskID] = {}
        self._all = self._bars.add_task(self.text(), total=pictures, text="") if pictures > 1 else None

    def __enter__(self) -> LiveDisplay:
        # Before the bars' own hook: rich takes off the hook that was added last.
        self._console.push_render_hook(self)  # type: ignore[arg-type]
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()
        self._console.pop_render_hook()

    def begin(self, job: str) -> None:
        self._drop(job)
        super().begin(job)
        # The folders of a picture would leave no room for the rest.
        name, most = printable(Path(job).name or job), self._name_width()
        shown = name if len(name) <= most else f"{name[: most - 3]}..."
        self._shown[job] = self._bars.add_task(shown, total=1.0, text="starting")

    def stage(self, stage: str, job: str) -> None:
        if job in self._shown:
            self._bars.update(self._shown[job], text=STAGES[stage])

    def step(self, progress: Progress, job: str) -> None:
        if job in self._shown:
            room = self._console.width - self._name_width() - (_BAR if self._console.width >= _WIDE else 0) - 4
            self._bars.update(self._shown[job], completed=progress.share, text=progress_text(progress, room))
            super().step(progress, job)
            self._show_all()

    def end(self, job: str) -> None:
        self._drop(job)
        super().end(job)
        self._show_all()

    def _show_all(self) -> None:
        if self._all is not None:
            self._bars.update(self._all, completed=self.ended, description=self.text(), text=self.left())

    def _drop(self, job: str) -> None:
        if job in self._shown:
            self._bars.remove_task(self._shown.pop(job))

    def _name_width(self) -> int:
        """Return the most columns that a picture's name takes."""
        return _NAME if self._console.width >= _NARROW else self._console.width // 3

    def print(self, text: str) -> None:
        """Print a line above the bars."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def process_renderables(self, renderables: list[Any]) -> list[Any]:
        """Have rich also erase the rows that a terminal, made narrower, has added to the lines drawn before.

        Rich calls this with everything that it is about to write. Terminals fold lines that have become too long into
        several rows. A few old ones cut them off instead; there as many rows above the bars are erased.
        """
        from rich.control import Control
        from rich.segment import ControlType, Segment

        width = self._console.width
        more = sum(max(0, math.ceil(columns / width) - 1) for columns in self._columns)
        lines = self._console.render_lines(self._bars.get_renderable(), pad=False)
        self._columns = [Segment.get_line_length(line) for line in lines]
        row = ((ControlType.CURSOR_UP, 1), (ControlType.ERASE_IN_LINE, 2))
        return [Control(*row * more), *renderables]


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
        """Print something that the user should know and that is no error."""
        self.summary(f"cubicsplat: note: {text}")

    def detail(self, text: str, job: str = "") -> None:
        """Print something for `-v` only."""
        if self.verbose:
            self.summary(text)

    def summary(self, text: str) -> None:
        """Print the one line of a picture, or of the closing table."""
        if not self.quiet:
            self.raw(printable(text))

    def error(self, text: str) -> None:
        """Print an error, even when quiet."""
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
        """Within, show the work on so many pictures: by bars on a terminal, by lines with `-v`, else not at all."""
        try:
            if self.bars:
                with LiveDisplay(pictures) as display:
                    self._display, self.raw = display, display.print
                    yield
            else:
                self._display = PlainDisplay(self.detail, pictures)
                yield
        finally:
            self._display, self.raw = Observer(), _print

    @contextmanager
    def progress(self, name: str) -> Iterator[OnProgress]:
        """Give the progress callback of one fit."""
        with self.showing(1):
            self.begin(name)
            yield lambda at: self.step(at, name)


def _print(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _can_hold_a_bar() -> bool:
    """Return whether stderr is a terminal that can move its cursor."""
    if sys.stderr is None or not sys.stderr.isatty():
        return False
    from rich.console import Console

    return Console(stderr=True).is_interactive
