"""How the work goes on, as it goes on: bars on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from cubicsplat_cli.formatting import duration, printable
from cubicsplat_cli.jobs.events import Events

if TYPE_CHECKING:
    from rich.progress import TaskID

    from cubicsplat_cli.progress import Progress

# Plain lines: the first report, then one per tenth of the fit or five seconds.
_PLAIN_SHARE = 0.1
_PLAIN_SECONDS = 5.0
# Of one picture: before so much is done, nobody can tell how long the rest will take.
_LEAST_DONE = 0.05
_BAR = 24  # columns
_NAME = 24
# In a terminal narrower than this there is no bar, and in one narrower than that no picture's name is shown in full.
_WIDE, _NARROW = 72, 48
_DOING = {
    "read": "reading",
    "fit": "fitting",
    "write": "writing",
    "start": "starting",
    "draw": "drawing",
    "measure": "measuring",
    "animation": "writing the animation",
    "report": "writing the page",
}


class Display(Events):
    """Shows events. `end` is told of every picture, whether its work began or not."""

    def end(self, job: str) -> None:
        """A picture is done, in whatever way."""

    def print(self, text: str) -> bool:
        """Print a line without disturbing what is shown; False where whoever asks can do that as well."""
        return False


class Whole:
    """How far all pictures are together; of those that had nothing to do, nobody learns how long the others take."""

    def __init__(self, pictures: int) -> None:
        self.pictures = pictures
        self.ended = 0
        self._done = 0  # of those that were begun
        self._shares: dict[str, float] = {}  # of those under way
        self._started: float | None = None

    def begin(self, job: str) -> None:
        """A picture is begun, perhaps again."""
        self._started = self._started or time.monotonic()
        self._shares[job] = 0.0

    def step(self, job: str, share: float) -> None:
        """How far its fit is, 0 to 1."""
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
        return f"{duration((time.monotonic() - self._started) * rest / done)} left"


class PlainDisplay(Display):
    """A line now and then, for `-v` where no bar can be drawn."""

    def __init__(self, tell: Callable[[str], None], pictures: int) -> None:
        self._tell = tell
        self._whole = Whole(pictures)
        self._told: dict[str, tuple[float, float]] = {}  # share and time of the last line of each fit

    def begin(self, job: str) -> None:
        self._whole.begin(job)
        self._told[job] = (-1.0, -math.inf)
        self._tell(f"{job}: begun")

    def stage(self, job: str, stage: str) -> None:
        if stage not in ("read", "fit", "write"):  # the first step says it, or nobody would see it
            self._tell(f"{job}: {_DOING[stage]}")

    def end(self, job: str) -> None:
        self._whole.end(job)
        if self._whole.pictures > 1:
            self._tell("  ".join(filter(None, (self._whole.text(), self._whole.left()))))

    def step(self, job: str, progress: Progress) -> None:
        self._whole.step(job, progress.share)
        share, at = self._told.get(job, (-1.0, -math.inf))
        now = time.monotonic()
        if progress.share >= share + _PLAIN_SHARE or progress.share >= 1.0 or now - at >= _PLAIN_SECONDS:
            self._told[job] = (progress.share, now)
            steps = f", step {progress.step}/{progress.steps}" if progress.steps else ""
            self._tell(f"{job}: {progress_text(progress)}{steps}")


class LiveDisplay(Display):
    """A bar for each picture under way and, where there are several, one for all."""

    def __init__(self, pictures: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        from cubicsplat_cli.cli.rewrap import Rewrapped

        # Rich honours NO_COLOR. File names may hold square brackets, which must not be read as markup.
        self._console = Console(stderr=True, highlight=False)
        wide = self._console.width >= _WIDE
        columns = [TextColumn("{task.description}", markup=False), *([BarColumn(_BAR)] if wide else [])]
        columns.append(TextColumn("{task.fields[text]}", markup=False))
        self._bars = Progress(
            *columns, console=self._console, transient=True, redirect_stdout=False, redirect_stderr=False
        )
        self._rewrapped = Rewrapped(self._console, self._bars.get_renderable)
        self._whole = Whole(pictures)
        self._shown: dict[str, TaskID] = {}
        self._all = self._bars.add_task(self._whole.text(), total=pictures, text="") if pictures > 1 else None

    def __enter__(self) -> LiveDisplay:
        # Before the bars', which take their own hook off as the last one.
        self._console.push_render_hook(self._rewrapped)
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()
        self._console.pop_render_hook()

    def begin(self, job: str) -> None:
        self._drop(job)
        self._whole.begin(job)
        # Its folders would leave no room for the rest.
        name = printable(Path(job).name or job)
        most = self._name_width()
        shown = name if len(name) <= most else f"{name[: most - 3]}..."
        self._shown[job] = self._bars.add_task(shown, total=1.0, text="starting")

    def stage(self, job: str, stage: str) -> None:
        if job in self._shown:
            self._bars.update(self._shown[job], text=_DOING[stage])

    def step(self, job: str, progress: Progress) -> None:
        if job in self._shown:
            room = self._console.width - self._name_width() - (_BAR if self._console.width >= _WIDE else 0) - 4
            text = progress_text(progress, room)
            self._bars.update(self._shown[job], completed=progress.share, text=text)
            self._whole.step(job, progress.share)
            self._show_whole()

    def end(self, job: str) -> None:
        self._drop(job)
        self._whole.end(job)
        self._show_whole()

    def _show_whole(self) -> None:
        if self._all is not None:
            whole = self._whole
            self._bars.update(self._all, completed=whole.ended, description=whole.text(), text=whole.left())

    def _name_width(self) -> int:
        """The most columns of a picture's name."""
        return _NAME if self._console.width >= _NARROW else self._console.width // 3

    def print(self, text: str) -> bool:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)
        return True

    def _drop(self, job: str) -> None:
        if job in self._shown:
            self._bars.remove_task(self._shown.pop(job))


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
