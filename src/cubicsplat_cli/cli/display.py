"""How the work goes on, as it goes on: bars on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from cubicsplat_cli.jobs.events import Events
from cubicsplat_cli.words import duration, printable

if TYPE_CHECKING:
    from rich.progress import TaskID

    from cubicsplat_cli.progress import Progress

# Plain lines: the first report, then one per tenth of the fit or five seconds.
_PLAIN_SHARE = 0.1
_PLAIN_SECONDS = 5.0
_BAR = 24  # columns
_NAME = 24
# In a terminal narrower than this there is no bar, and in one narrower than that no picture's name is shown in full.
_WIDE, _NARROW = 72, 48
_DOING = {"read": "reading", "fit": "fitting", "write": "writing", "draw": "drawing", "measure": "measuring"}


class Display(Events):
    """Shows events. `end` is told of every picture, whether its work began or not."""

    def end(self, job: str) -> None:
        """A picture is done, in whatever way."""

    def print(self, text: str) -> bool:
        """Print a line without disturbing what is shown; False where whoever asks can do that as well."""
        return False


class PlainDisplay(Display):
    """A line now and then, for `-v` where no bar can be drawn."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._told: dict[str, tuple[float, float]] = {}  # share and time of the last line of each fit

    def begin(self, job: str) -> None:
        self._told[job] = (-1.0, -math.inf)
        self._tell(f"{job}: begun")

    def stage(self, job: str, stage: str) -> None:
        if stage in ("draw", "measure"):
            self._tell(f"{job}: {_DOING[stage]}")

    def step(self, job: str, progress: Progress) -> None:
        share, at = self._told.get(job, (-1.0, -math.inf))
        now = time.monotonic()
        if progress.share >= share + _PLAIN_SHARE or progress.share >= 1.0 or now - at >= _PLAIN_SECONDS:
            self._told[job] = (progress.share, now)
            self._tell(f"{job}: {progress_text(progress)}, step {progress.step}/{progress.steps}")


class LiveDisplay(Display):
    """A bar for each picture under way and, where there are several, one for all."""

    def __init__(self, pictures: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        # Rich honours NO_COLOR. File names may hold square brackets, which must not be read as markup.
        self._console = Console(stderr=True, highlight=False)
        wide = self._console.width >= _WIDE
        columns = [TextColumn("{task.description}", markup=False), *([BarColumn(_BAR)] if wide else [])]
        columns.append(TextColumn("{task.fields[text]}", markup=False))
        self._bars = Progress(
            *columns, console=self._console, transient=True, redirect_stdout=False, redirect_stderr=False
        )
        self._pictures = pictures
        self._ended = 0
        self._started = time.monotonic()
        self._shown: dict[str, TaskID] = {}
        self._all = self._bars.add_task(f"0/{pictures} pictures", total=pictures, text="") if pictures > 1 else None

    def __enter__(self) -> LiveDisplay:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def begin(self, job: str) -> None:
        self._drop(job)
        # Its folders would leave no room for the rest.
        name = printable(Path(job).name or job)
        most = _NAME if self._console.width >= _NARROW else self._console.width // 3
        shown = name if len(name) <= most else f"{name[: most - 3]}..."
        self._shown[job] = self._bars.add_task(shown, total=1.0, text="starting")

    def stage(self, job: str, stage: str) -> None:
        if job in self._shown:
            self._bars.update(self._shown[job], text=_DOING[stage])

    def step(self, job: str, progress: Progress) -> None:
        if job in self._shown:
            room = self._console.width - _NAME - (_BAR if self._console.width >= _WIDE else 0) - 4
            text = progress_text(progress, room)
            self._bars.update(self._shown[job], completed=progress.share, text=text)

    def end(self, job: str) -> None:
        self._drop(job)
        self._ended += 1
        if self._all is not None:
            elapsed = time.monotonic() - self._started
            left = elapsed / self._ended * (self._pictures - self._ended)
            text = f"{duration(left)} left" if left else ""
            name = f"{self._ended}/{self._pictures} pictures"
            self._bars.update(self._all, completed=self._ended, description=name, text=text)

    def print(self, text: str) -> bool:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)
        return True

    def _drop(self, job: str) -> None:
        if job in self._shown:
            self._bars.remove_task(self._shown.pop(job))


def progress_text(progress: Progress, room: int = 1000) -> str:
    """` 45 %  12 s left  31.2 dB  5.7 ms/step`, as much of it from the front as there is room for."""
    parts = [
        f"{100 * progress.share:3.0f} %",
        f"{duration(progress.seconds_left)} left",
        f"{progress.psnr_db:.1f} dB",
        f"{progress.ms_per_step:.1f} ms/step",
    ]
    parts += [f"{progress.replaced} replaced"] if progress.replaced else []
    text = parts[0]
    for part in parts[1:]:
        if len(text) + 2 + len(part) > room:
            break
        text += f"  {part}"
    return text
