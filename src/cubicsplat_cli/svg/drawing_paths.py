"""Outlines and strokes of artwork as path data in its shortest form.

It is as an artist's exporter writes it: lines as H, V and L, cubics as C and S, absolute or relative, whichever is
shorter.

Rectangles with round corners are lines and quarter circles, and read back from these. cairosvg, and whatever is made of
it, bends two corners of `<rect rx>` wrongly: the second handle of its cubic is as far from the corner of the box as it
should be from its end, which is 0.036 of the radius off. Arcs all viewers draw alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Rectangle, Ring, thirds
from cubicsplat_cli.artwork.geometry.steps import to_steps
from cubicsplat_cli.artwork.geometry.stroke import Chain, Path
from cubicsplat_cli.svg.drawing_grid import MIRROR_REACH, grid_rings, smoothed
from cubicsplat_cli.svg.markup import format_number
from cubicsplat_cli.svg.paths import PathSegment, Point

# Letters of rounded rectangles: round at the left and right ends, at upper and lower ones, at all corners in either
# direction.
LETTERS = ("HAHAZ", "VAVAZ", "HAVAHAVAZ", "VAHAVAHAZ")
MOST_ON_RECT = 3.0  # px, the radius up to which viewers agree about `<rect rx>` to a tenth of a px
# A joint that turns by less is meant to be smooth.
_SMOOTH = math.radians(0.5)
Step = tuple[int, int]


class PathText:
    """Path data under construction, in steps of 10^-precision px; each command is written in its shorter form."""

    def __init__(self, precision: int) -> None:
        self.precision = precision
        self.text = ""
        self._letter = ""  # of the command that a further number would repeat
        self._last = ""  # the last number, where one stands at the end
        self.here: Step = (0, 0)
        self._start: Step = (0, 0)
        self._relative = False

    def move(self, to: Step, *, relative: bool = False) -> None:
        """Begin a ring; relative: what follows is the same text wherever it begins."""
        self._relative = False
        self._add("M", to, to)
        # Further pairs of numbers are lines.
        self._letter = "" if relative else "L" if self._letter == "M" else "l"
        self._relative = relative
        self._start = to

    def line(self, to: Step) -> None:
        """A straight line, horizontal and vertical ones with one number."""
        if to[1] == self.here[1]:
            self._add("H", (to[0],), to, axis=0)
        elif to[0] == self.here[0]:
            self._add("V", (to[1],), to, axis=1)
        else:
            self._add("L", to, to)

    def cubic(self, first: Step, second: Step, to: Step, *, mirrored: bool) -> None:
        """A cubic; mirrored: its first handle is the one before it, turned round."""
        self._add("S" if mirrored else "C", (*(() if mirrored else first), *second, *to), to)

    def arc(self, radii: tuple[float, float], angle: str, flags: tuple[int, int], to: Step) -> None:
        """An elliptical arc. radii: in steps, to a tenth; angle: degrees as text; flags: whether it is the larger one,
        whether clockwise as seen."""
        head = [*(format_number(round(10 * radius), self.precision + 1) for radius in radii), angle, *map(str, flags)]
        self._add("A", to, to, head)

    def close(self) -> None:
        """End the ring where it began."""
        self.text += "z"
        self._letter = self._last = ""
        self.here = self._start

    def _add(self, letter: str, numbers: Sequence[int], to: Step, head: Sequence[str] = (), axis: int = 0) -> None:
        """numbers: absolute, x and y in turn from the axis on. head: what comes before them in either form."""
        relative = [number - self.here[(index + axis) % 2] for index, number in enumerate(numbers)]
        forms = []
        for form, values in ((letter.lower(), relative), (letter, numbers)):
            parts = [*head, *(format_number(value, self.precision) for value in values)]
            forms.append((self._joined(form, parts), form, parts[-1]))
        # At equal length the relative form, but for the first point, where both mean the same.
        if not self.text:
            forms.reverse()
        text, self._letter, self._last = forms[0] if self._relative else min(forms, key=lambda form: len(form[0]))
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


def add_ring(path: PathText, ring: Ring, exact: bool = False, relative: bool = False) -> None:
    """Appends a closed ring; nothing where it is only a point. exact: no handle is written a step off. relative: all
    but the first point, so that rings of one form are the same text.
    """
    if ring.pieces == 0:
        return
    add_pieces(path, ring, [*range(1, ring.pieces), 0], 0 if exact else MIRROR_REACH, relative)
    path.close()


def add_pieces(path: PathText, ring: Ring, ends: Sequence[int], reach: int, relative: bool = False) -> None:
    """The pieces from one anchor to the next; the line that closes a ring is drawn by closing it."""
    anchors, controls = ring.anchors.tolist(), ring.controls.tolist()
    path.move(tuple(anchors[0]), relative=relative)
    mirror: Step | None = None
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


def _near(first: Step, mirror: Step | None, reach: int) -> bool:
    return mirror is not None and max(abs(first[0] - mirror[0]), abs(first[1] - mirror[1])) <= reach


def add_stroke(path: PathText, line: Path, precision: int) -> None:
    """Appends the centre line of a stroke."""
    if not isinstance(line, Chain):
        add_ring(path, grid_rings([line.ring()], precision)[0])
        return
    anchors, controls = to_steps(line.anchors, precision), to_steps(line.controls, precision)
    # A line from the end back to the start, of which nothing is drawn, makes it a ring.
    back = np.stack([anchors[-1:], anchors[:1]], axis=1)
    smooth = np.array([False, *line.smooth[1:-1], False])
    ring = Ring(anchors, np.concatenate([controls, back]), np.append(line.lines, True), smooth)
    following = (np.arange(ring.pieces) + 1) % ring.pieces
    ring = replace(ring, controls=smoothed(ring, following, even=False))
    add_pieces(path, ring, range(1, len(anchors)), MIRROR_REACH)


def add_rounded(path: PathText, box: Rectangle, precision: int, *, clockwise: bool) -> None:
    """Appends a level rectangle with round corners; nothing where it has no extent."""
    left, top, right, bottom, radius = _steps(box, precision)
    if radius <= 0:
        return
    ends = [(int(x), int(y)) for x, y in _ends(left, top, right, bottom, radius)]
    if not clockwise:
        ends.reverse()
    path.move(ends[0])
    # Lines and arcs in turn; closing the path would draw the last arc as a line.
    for k, end in enumerate([*ends[1:], ends[0]]):
        if k % 2:
            path.arc((radius, radius), "0", (0, int(clockwise)), end)
        else:
            path.line(end)
    path.close()


def rounded_of(subpath: Sequence[PathSegment]) -> tuple[Rectangle, bool] | None:
    """The rectangle that `add_rounded` wrote as these pieces, and whether clockwise as seen; None for other pieces."""
    if "".join(piece.command for piece in subpath) not in LETTERS:
        return None
    arcs = [piece for piece in subpath if piece.command == "A"]
    radius, sweep = arcs[0].numbers[0], arcs[0].numbers[4]
    numbers = (radius, radius, 0.0, 0.0, sweep)
    starts = [piece.start for piece in subpath[:-1]]
    x, y = zip(*starts, strict=True)
    across, down = (radius if len(arcs) == 2 and subpath[0].command == letter else 0.0 for letter in "HV")
    left, right, top, bottom = min(x) - across, max(x) + across, min(y) - down, max(y) + down
    expected = list(_ends(left, top, right, bottom, radius))
    expected = expected if sweep == 1.0 else expected[::-1]
    off = max(max(abs(a[0] - b[0]), abs(a[1] - b[1])) for a, b in zip(starts, expected, strict=True))
    if any(arc.numbers != numbers for arc in arcs) or radius <= 0.0 or off > 1e-6 or subpath[-1].start != starts[0]:
        return None
    return Rectangle(left, top, right - left, bottom - top, radius), sweep == 1.0


def _steps(box: Rectangle, precision: int) -> tuple[float, float, float, float, float]:
    """Left, top, right, bottom and radius in steps, the radius half of the shorter side where it is about that: then
    the middles of the round ends are on the grid, and the lines and arcs meet there.
    """
    low = np.array([box.x, box.y])
    high = low + np.array([box.width, box.height])
    sides = to_steps(high, precision) - to_steps(low, precision)
    radius, most = float(to_steps(box.radius, precision)), sides.min() / 2.0
    radius = radius if radius < most - 0.5 else most
    inset = np.where((radius == most) & (sides > 2.0 * most), radius, 0.0)
    ends = [
        to_steps(end + sign * inset / 10.0**precision, precision) - sign * inset for end, sign in ((low, 1), (high, -1))
    ]
    return (*ends[0].tolist(), *ends[1].tolist(), float(radius))


def _ends(left: float, top: float, right: float, bottom: float, radius: float) -> Iterator[Point]:
    """The points where lines and arcs meet, clockwise as seen, a line first; sides shorter than a point are left out,
    and the corners beside them are one arc.
    """
    across, down = right - left > 2 * radius + 1e-9, bottom - top > 2 * radius + 1e-9
    if across:
        yield left + radius, top
        yield right - radius, top
    if down:
        yield right, top + radius
        yield right, bottom - radius
    if across:
        yield right - radius, bottom
        yield left + radius, bottom
    if down:
        yield left, bottom - radius
        yield left, top + radius


def ring_of(subpath: Sequence[PathSegment]) -> Ring:
    """The ring of a closed subpath; its closing segment is a line of its own if it has a length."""
    if math.dist(subpath[-1].start, subpath[-1].end) < 1e-9 and len(subpath) > 1:
        subpath = subpath[:-1]
    anchors = np.array([piece.start for piece in subpath])
    controls, lines = controls_of(subpath, np.roll(anchors, -1, axis=0))
    return Ring(anchors, controls, lines, _smooth(anchors, controls))


def controls_of(subpath: Sequence[PathSegment], ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both control points (n, 2, 2) of each piece, of lines at their thirds, and which of them (n,) are lines."""
    starts = np.array([piece.start for piece in subpath])
    controls = thirds(starts, ends)
    for index, piece in enumerate(subpath):
        if piece.handles:
            controls[index] = piece.handles
    return controls, np.array([not piece.handles for piece in subpath])


def _smooth(anchors: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """(A,) bool: where the two handles of an anchor are opposite to each other."""
    back, ahead = anchors - np.roll(controls[:, 1], 1, axis=0), controls[:, 0] - anchors
    cross = back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0]
    dot = (back * ahead).sum(axis=1)
    return (dot > 0.0) & (np.abs(np.arctan2(cross, dot)) < _SMOOTH)
