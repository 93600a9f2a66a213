"""Path data of rings as an artist's exporter writes it: lines as H, V and L, cubics as C and S, all in their shortest
form, absolute or relative.
"""

from __future__ import annotations

from collections.abc import Sequence

from cubicsplat_cli.svg.pathdata import format_number
from cubicsplat_cli.svg.ringgrid import MIRROR_REACH, GridRing

Point = tuple[int, int]


class PathText:
    """Path data under construction, in steps of 10^-precision px; each command is written in its shorter form."""

    def __init__(self, precision: int) -> None:
        self.precision = precision
        self.text = ""
        self._letter = ""  # of the command that a further number would repeat
        self._last = ""  # the last number, where one stands at the end
        self.here: Point = (0, 0)
        self._start: Point = (0, 0)
        self._relative = False

    def move(self, to: Point, *, relative: bool = False) -> None:
        """Begin a ring; relative: what follows is the same text wherever it begins."""
        self._relative = False
        self._add("M", to, to)
        # Further pairs of numbers are lines.
        self._letter = "" if relative else "L" if self._letter == "M" else "l"
        self._relative = relative
        self._start = to

    def line(self, to: Point) -> None:
        """A straight line, horizontal and vertical ones with one number."""
        if to[1] == self.here[1]:
            self._add("H", (to[0],), to, axis=0)
        elif to[0] == self.here[0]:
            self._add("V", (to[1],), to, axis=1)
        else:
            self._add("L", to, to)

    def cubic(self, first: Point, second: Point, to: Point, *, mirrored: bool) -> None:
        """A cubic; mirrored: its first handle is the one before it, turned round."""
        self._add("S" if mirrored else "C", (*(() if mirrored else first), *second, *to), to)

    def arc(self, radii: Point, angle: str, flags: tuple[int, int], to: Point) -> None:
        """An elliptical arc; angle: degrees as text. flags: whether it is the larger one, whether clockwise as seen."""
        head = [*(format_number(radius, self.precision) for radius in radii), angle, *map(str, flags)]
        self._add("A", to, to, head)

    def close(self) -> None:
        """End the ring where it began."""
        self.text += "z"
        self._letter = self._last = ""
        self.here = self._start

    def _add(self, letter: str, numbers: Sequence[int], to: Point, head: Sequence[str] = (), axis: int = 0) -> None:
        """numbers: absolute, x and y in turn from the axis on. head: what comes before them in either form."""
        relative = [number - self.here[(index + axis) % 2] for index, number in enumerate(numbers)]
        forms = []
        for form, values in ((letter.lower(), relative), (letter, numbers)):
            parts = [*head, *(format_number(value, self.precision) for value in values)]
            forms.append((self._joined(form, parts), form, parts[-1]))
        # At equal length the relative form, but for the first point, where both mean the same.
        if not self.text:
            forms.reverse()
        text, self._letter, self._last = forms[0] if self._relative else min(forms, key=lambda found: len(found[0]))
        self.text += text
        self.here = to

    def _joined(self, letter: str, parts: Sequence[str]) -> str:
        repeats = letter == self._letter
        text, last = ("", self._last) if repeats else (letter, "")
        for part in parts:
            glued = not last or part[0] == "-" or (part[0] == "." and "." in last)
            text += part if glued else f" {part}"
            last = part
        return text


def add_ring(path: PathText, ring: GridRing, exact: bool = False, relative: bool = False) -> None:
    """Appends a closed ring; nothing where it is only a point. exact: no handle is written a step off. relative: all
    but the first point, so that rings of one form are the same text.
    """
    if ring.pieces == 0:
        return
    _add_pieces(path, ring, [*range(1, ring.pieces), 0], 0 if exact else MIRROR_REACH, relative)
    path.close()


def add_chain(path: PathText, chain: GridRing) -> None:
    """Appends an open row of lines and cubics, of which there is one less than anchors."""
    _add_pieces(path, chain, list(range(1, len(chain.anchors))), MIRROR_REACH)


def _add_pieces(path: PathText, ring: GridRing, ends: Sequence[int], reach: int, relative: bool = False) -> None:
    """The pieces from one anchor to the next; the line that closes a ring is drawn by closing it."""
    anchors, controls = ring.anchors.tolist(), ring.controls.tolist()
    path.move(tuple(anchors[0]), relative=relative)
    mirror: Point | None = None
    for index, following in enumerate(ends):
        end = tuple(anchors[following])
        if ring.lines[index]:
            if following:
                path.line(end)
            mirror = None
            continue
        first, second = (tuple(control) for control in controls[index])
        path.cubic(first, second, end, mirrored=_near(first, mirror, reach))
        mirror = (2 * end[0] - second[0], 2 * end[1] - second[1])


def _near(first: Point, mirror: Point | None, reach: int) -> bool:
    return mirror is not None and max(abs(first[0] - mirror[0]), abs(first[1] - mirror[1])) <= reach
