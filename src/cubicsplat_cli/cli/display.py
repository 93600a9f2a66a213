"""Progress bars on a terminal."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

import rich.progress
from rich.console import Console, ConsoleRenderable, RenderableType, RenderHook
from rich.control import Control
from rich.segment import ControlType, Segment

from cubicsplat_cli.cli.console import STAGES, Whole, progress_text
from cubicsplat_cli.formatting import printable
from cubicsplat_cli.progress import Observer, Progress

_BAR = 24  # columns
_NAME = 24
# In a terminal narrower than this there is no bar, and in one narrower than that no picture's name is shown in full.
_WIDE, _NARROW = 72, 48


class LiveDisplay(Observer):
    """A bar for each picture under way and, where there are several, one for all."""

    def __init__(self, pictures: int) -> None:
        # Rich honours NO_COLOR. File names may hold square brackets, which must not be read as markup.
        self._console = Console(stderr=True, highlight=False)
        bar = [rich.progress.BarColumn(_BAR)] if self._console.width >= _WIDE else []
        name, text = (
            rich.progress.TextColumn(f"{{task.{of}}}", markup=False) for of in ("description", "fields[text]")
        )
        columns: list[rich.progress.ProgressColumn] = [name, *bar, text]
        self._bars = rich.progress.Progress(
            *columns, console=self._console, transient=True, redirect_stdout=False, redirect_stderr=False
        )
        self._rewrapped = Rewrapped(self._console, self._bars.get_renderable)
        self._whole = Whole(pictures)
        self._shown: dict[str, rich.progress.TaskID] = {}
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

    def stage(self, stage: str, job: str) -> None:
        if job in self._shown:
            self._bars.update(self._shown[job], text=STAGES[stage])

    def step(self, progress: Progress, job: str) -> None:
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

    def print(self, text: str) -> None:
        """Print a line above the bars."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _drop(self, job: str) -> None:
        if job in self._shown:
            self._bars.remove_task(self._shown.pop(job))


class Rewrapped(RenderHook):
    """Has rich, which counts the lines that it drew, take away those too that the terminal has made of them since.

    Terminals lay lines that have become too long out anew, as several rows. A few old ones cut them off instead; there
    as many rows above are taken away too.
    """

    def __init__(self, console: Console, drawn: Callable[[], RenderableType]) -> None:
        self._console = console
        self._drawn = drawn
        self._columns: list[int] = []  # of each line when it was last drawn

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        """Called by rich with what it is about to write, before which it goes back over the lines that it knows of."""
        width = self._console.width
        more = sum(max(0, math.ceil(columns / width) - 1) for columns in self._columns)
        lines = self._console.render_lines(self._drawn(), pad=False)
        self._columns = [Segment.get_line_length(line) for line in lines]
        row = ((ControlType.CURSOR_UP, 1), (ControlType.ERASE_IN_LINE, 2))
        return [Control(*row * more), *renderables]
