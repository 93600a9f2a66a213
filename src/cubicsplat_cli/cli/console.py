"""What goes to stderr: the live progress, notes, and the summary line. stdout is for results alone."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from cubicsplat_cli.fit import Progress

# Lines of `-v` when no bar can be drawn: the first report, then one per tenth of the steps or five seconds.
_PLAIN_SHARE = 0.1
_PLAIN_SECONDS = 5.0


class Reporter:
    """Writes to stderr: nothing but errors when quiet, settings and plain progress too when verbose."""

    def __init__(self, *, quiet: bool, verbose: bool) -> None:
        self.quiet = quiet
        self.verbose = verbose

    def note(self, text: str) -> None:
        """Something the user should know that is no error."""
        if not self.quiet:
            self._print(f"cubicsplat: note: {_one_line(text)}")

    def detail(self, text: str) -> None:
        """Something for `-v` only."""
        if self.verbose and not self.quiet:
            self._print(_one_line(text))

    def summary(self, text: str) -> None:
        """The one line per file at the end."""
        if not self.quiet:
            self._print(_one_line(text))

    @contextmanager
    def progress(self, name: str) -> Iterator[Callable[[Progress], None] | None]:
        """A callback for `fit`: a live bar on a terminal, plain lines with `-v` elsewhere, else None."""
        if self.quiet or not (sys.stderr.isatty() or self.verbose):
            yield None
        elif sys.stderr.isatty():
            with _live_bar(name) as callback:
                yield callback
        else:
            yield self._plain_lines()

    def _plain_lines(self) -> Callable[[Progress], None]:
        printed_step, printed_at = 0, -math.inf

        def show(progress: Progress) -> None:
            nonlocal printed_step, printed_at
            now = time.monotonic()
            due = (
                progress.step >= printed_step + _PLAIN_SHARE * progress.steps
                or progress.step == progress.steps
            )
            if due or now - printed_at >= _PLAIN_SECONDS:
                printed_step, printed_at = progress.step, now
                self._print(f"step {progress.step}/{progress.steps}  {progress_text(progress)}")

        return show

    def _print(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)


def progress_text(progress: Progress) -> str:
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


@contextmanager
def _live_bar(name: str) -> Iterator[Callable[[Progress], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    # Rich honours NO_COLOR. File names may hold square brackets, which must not be read as markup.
    console = Console(stderr=True, highlight=False)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TextColumn("{task.completed:.0f}/{task.total:.0f}", markup=False),
        TextColumn("{task.fields[text]}", markup=False),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(_one_line(name), total=1, text="starting")

        def show(progress: object) -> None:
            bar.update(task, completed=progress.step, total=progress.steps, text=progress_text(progress))

        yield show


def _one_line(text: str) -> str:
    """Control characters (a file name may hold any) escaped, so that a message stays one line."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
