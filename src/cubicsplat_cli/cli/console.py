"""What goes to stderr: the live progress, notes, and the summary lines. stdout is for results alone."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.words import printable

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.progress import Progress as Bars

# Lines of `-v` when no bar can be drawn: the first report, then one per tenth of the steps or five seconds.
_PLAIN_SHARE = 0.1
_PLAIN_SECONDS = 5.0


class Reporter:
    """Writes to stderr: nothing but errors when quiet, settings and plain progress too when verbose.

    bars: whether live progress may be drawn at all (where stderr is a terminal that can).
    """

    def __init__(self, *, quiet: bool, verbose: bool, bars: bool = True) -> None:
        self.quiet = quiet
        self.verbose = verbose
        self.bars = bars
        self._live: Bars | None = None

    def note(self, text: str) -> None:
        """Something the user should know that is no error."""
        if not self.quiet:
            self._print(f"cubicsplat: note: {printable(text)}")

    def detail(self, text: str) -> None:
        """Something for `-v` only."""
        if self.verbose and not self.quiet:
            self._print(printable(text))

    def summary(self, text: str) -> None:
        """The one line of a picture, or of the closing table."""
        if not self.quiet:
            self._print(printable(text))

    def error(self, text: str) -> None:
        """What went wrong, said to the quiet too."""
        self._print(f"cubicsplat: error: {printable(text)}")

    @contextmanager
    def progress(self, name: str) -> Iterator[Callable[[Any], None] | None]:
        """A callback for `fit`: a live bar on a terminal, plain lines with `-v` elsewhere, else None."""
        if self.quiet:
            yield None
        elif self.bars and _can_hold_a_bar():
            with self._live_bars() as bars:
                task = bars.add_task(printable(name), total=1, text="starting")
                yield lambda at: bars.update(task, completed=at.step, total=at.steps, text=progress_text(at))
        else:
            yield self._plain_lines() if self.verbose else None

    @contextmanager
    def progress_of_many(self, pictures: int) -> Iterator[ManyBars | None]:
        """One bar for all pictures and one for each under way, on a terminal; else None."""
        if self.quiet or not self.bars or not _can_hold_a_bar():
            yield None
            return
        with self._live_bars() as bars:
            yield ManyBars(bars, pictures)

    @contextmanager
    def _live_bars(self) -> Iterator[Bars]:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        # Rich honours NO_COLOR. File names may hold square brackets, which must not be read as markup.
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.completed:.0f}/{task.total:.0f}", markup=False),
            TextColumn("{task.fields[text]}", markup=False),
        )
        console = Console(stderr=True, highlight=False)
        with Progress(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False) as bars:
            self._live = bars
            try:
                yield bars
            finally:
                self._live = None

    def _plain_lines(self) -> Callable[[Any], None]:
        printed_step, printed_at = 0, -math.inf

        def show(progress: Any) -> None:
            nonlocal printed_step, printed_at
            now = time.monotonic()
            due = progress.step >= printed_step + _PLAIN_SHARE * progress.steps or progress.step == progress.steps
            if due or now - printed_at >= _PLAIN_SECONDS:
                printed_step, printed_at = progress.step, now
                self._print(f"step {progress.step}/{progress.steps}  {progress_text(progress)}")

        return show

    def _print(self, text: str) -> None:
        if self._live is not None:
            self._live.console.print(text, markup=False, highlight=False, soft_wrap=True)
        else:
            print(text, file=sys.stderr, flush=True)


class ManyBars:
    """The display of a run over many pictures."""

    def __init__(self, bars: Bars, pictures: int) -> None:
        self._bars = bars
        self._all = bars.add_task("pictures", total=max(1, pictures), text="")
        self._under_way: dict[str, Any] = {}

    def begin(self, name: str) -> None:
        """A picture is begun; or begun again."""
        self._drop(name)
        # Its folders would leave no room for the rest.
        shown = printable(Path(name).name or name)
        self._under_way[name] = self._bars.add_task(shown, total=1, text="starting")

    def step(self, name: str, at: Any) -> None:
        """How far its fit is."""
        if name in self._under_way:
            self._bars.update(self._under_way[name], completed=at.step, total=at.steps, text=progress_text(at))

    def end(self, name: str) -> None:
        """It is done, in whatever way."""
        self._drop(name)
        self._bars.advance(self._all)

    def _drop(self, name: str) -> None:
        if name in self._under_way:
            self._bars.remove_task(self._under_way.pop(name))


def progress_text(progress: Any) -> str:
    """PSNR, milliseconds a step, curves replaced and time left; what is not known yet is left out."""
    parts = []
    if progress.psnr_db is not None and math.isfinite(progress.psnr_db):
        parts.append(f"{progress.psnr_db:.2f} dB")
    if progress.ms_per_step is not None:
        parts.append(f"{progress.ms_per_step:.3g} ms/step")
    parts.append(f"{progress.replaced} replaced")
    if progress.seconds_left is not None and math.isfinite(progress.seconds_left):
        parts.append(f"{duration(progress.seconds_left)} left")
    return "  ".join(parts)


def duration(seconds: float) -> str:
    """Seconds as people say them: `0.8 s`, `47 s`, `2 min 05 s`, `1 h 03 min`."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def file_size(count: int) -> str:
    """Bytes in decimal units: `612 B`, `61 kB`, `6.4 MB`."""
    if count < 1000:
        return f"{count} B"
    if count < 9_950:
        return f"{count / 1000:.1f} kB"
    if count < 999_500:
        return f"{count / 1000:.0f} kB"
    return f"{count / 1e6:.1f} MB"


def _can_hold_a_bar() -> bool:
    """A terminal that can move its cursor."""
    if not sys.stderr.isatty():
        return False
    from rich.console import Console

    return Console(stderr=True).is_interactive
