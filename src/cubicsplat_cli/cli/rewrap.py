"""What is drawn again and again on a terminal, when the terminal is made narrower meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable

from rich.console import Console, ConsoleRenderable, RenderableType, RenderHook
from rich.control import Control
from rich.segment import ControlType, Segment


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
