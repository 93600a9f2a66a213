"""What goes to stderr: notes, summary lines and errors. stdout is for results alone."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from cubicsplat_cli.cli.display import Display, LiveDisplay, PlainDisplay
from cubicsplat_cli.formatting import printable

if TYPE_CHECKING:
    from cubicsplat_cli.progress import Progress


class Reporter:
    """Writes to stderr: nothing but errors when quiet, settings and plain progress too when verbose.

    bars: whether live progress may be drawn at all (where stderr is a terminal that can).
    """

    def __init__(self, *, quiet: bool, verbose: bool = False, bars: bool = True) -> None:
        self.quiet = quiet
        self.verbose = verbose
        self.bars = bars and not quiet and _can_hold_a_bar()
        self._display: Display | None = None

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

    def raw(self, text: str) -> None:
        """Text as it is, such as a traceback."""
        self._print(text)

    @contextmanager
    def showing(self, pictures: int) -> Iterator[Display]:
        """A display of the work on so many pictures: live on a terminal, plain lines with `-v`, else nothing."""
        if self.bars:
            with LiveDisplay(pictures) as display:
                yield from self._with(display)
        else:
            yield from self._with(PlainDisplay(self.detail, pictures))

    @contextmanager
    def progress(self, name: str) -> Iterator[Callable[[Progress], None]]:
        """The callback of one fit."""
        with self.showing(1) as display:
            display.begin(name)
            yield lambda at: display.step(name, at)

    def _with(self, display: Display) -> Iterator[Display]:
        self._display = display
        try:
            yield display
        finally:
            self._display = None

    def _print(self, text: str) -> None:
        if self._display is None or not self._display.print(text):
            print(text, file=sys.stderr, flush=True)


def _can_hold_a_bar() -> bool:
    """A terminal that can move its cursor."""
    if sys.stderr is None or not sys.stderr.isatty():
        return False
    from rich.console import Console

    return Console(stderr=True).is_interactive
