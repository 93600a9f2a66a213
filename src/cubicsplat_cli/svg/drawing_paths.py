"""Outlines and strokes of artwork in whole steps of the file's grid, and as path data in its shortest form.

Equal coordinates stay equal on the grid: lines along an axis stay so, and anchors that shapes share stay shared. Smooth
joints stay smooth. Path data is as an artist's exporter writes it: lines as H, V and L, cubics as C and S, absolute or
relative, whichever is shorter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.geometry.steps import aligned, to_steps
from cubicsplat_cli.artwork.geometry.stroke import Chain, Path
from cubicsplat_cli.svg.markup import format_number

# Steps by which a handle may be off the mirror image of the one before it and be written as that.
MIRROR_REACH = 1
Point = tuple[int, int]


@dataclass(frozen=True)
class GridRing:
    """anchors: (A, 2) int64 in steps. controls: (A, 2, 2) int64, of piece i from anchor i to i + 1. lines: (A,) bool.
    smooth: (A,) bool, at which anchors the tangent is meant to be continuous.
    """

    anchors: np.ndarray
    controls: np.ndarray
    lines: np.ndarray
    smooth: np.ndarray

    @property
    def pieces(self) -> int:
        """A, the number of lines and cubics; 0 where the ring has shrunk to a point."""
        return len(self.anchors)

    @property
    def form(self) -> bytes:
        """A key that is equal for rings that differ by a translation only."""
        anchors, controls = self.anchors - self.anchors[:1], self.controls - self.anchors[:1, None]
        return b"".join(part.tobytes() for part in (anchors, controls, self.lines))


def grid_ring(ring: Ring, precision: int, exact: bool = False) -> GridRing:
    """The ring on the grid, without pieces of no extent, begun so that its closing line is the longest to write.

    exact: every point goes to the nearest step, as in the rings that share it; otherwise handles keep joints smooth.
    """
    anchors, controls = to_steps(ring.anchors, precision), to_steps(ring.controls, precision)
    on_grid = GridRing(anchors, controls, np.asarray(ring.lines, bool), np.asarray(ring.smooth, bool))
    on_grid = _begun_after_a_line(_without_points(on_grid))
    return on_grid if exact else GridRing(on_grid.anchors, _smoothed(on_grid), on_grid.lines, on_grid.smooth)


def _without_points(ring: GridRing) -> GridRing:
    after = np.roll(ring.anchors, -1, axis=0)
    moved = (after != ring.anchors).any(axis=1)
    bent = ~ring.lines & (ring.controls != ring.anchors[:, None]).any(axis=(1, 2))
    kept = moved | bent
    return GridRing(ring.anchors[kept], ring.controls[kept], ring.lines[kept], ring.smooth[kept])


def _begun_after_a_line(ring: GridRing) -> GridRing:
    """The line with the most digits comes last, since closing the path draws it for nothing."""
    if not ring.lines.any():
        return ring
    steps = np.abs(np.roll(ring.anchors, -1, axis=0) - ring.anchors)
    digits = np.where(steps > 0, 1.0 + np.log10(np.maximum(steps, 1)), 0.0).sum(axis=1)
    last = int(np.argmax(np.where(ring.lines, digits, -1.0)))
    order = (last + 1 + np.arange(ring.pieces)) % ring.pieces
    return GridRing(ring.anchors[order], ring.controls[order], ring.lines[order], ring.smooth[order])


def _smoothed(ring: GridRing, even: bool = True) -> np.ndarray:
    """Controls whose shorter handle at each smooth joint is moved by at most two steps towards the other's line.

    even: whether handles that are then nearly equal become so.
    """
    controls = ring.controls.copy()
    if not ring.smooth.any():
        return controls
    before, after = np.roll(ring.controls[:, 1], 1, axis=0), ring.controls[:, 0]
    line_before = np.roll(ring.lines, 1)
    # A line's handle is its other end, which is where it is.
    before = np.where(line_before[:, None], np.roll(ring.anchors, 1, axis=0), before)
    after = np.where(ring.lines[:, None], np.roll(ring.anchors, -1, axis=0), after)
    back, ahead = before - ring.anchors, after - ring.anchors
    longer_back = (back**2).sum(axis=1) >= (ahead**2).sum(axis=1)
    joint = ring.smooth & ((back * ahead).sum(axis=1) < 0)
    move_ahead = joint & ~ring.lines & (longer_back | line_before)
    move_back = joint & ~line_before & ~move_ahead
    controls[move_ahead, 0] = (ring.anchors + aligned(ahead, back))[move_ahead]
    controls[np.roll(move_back, -1), 1] = np.roll(ring.anchors + aligned(back, ahead), -1, axis=0)[
        np.roll(move_back, -1)
    ]
    return _evened(ring, controls, joint & ~ring.lines & ~line_before) if even else controls


def _evened(ring: GridRing, controls: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Controls of which the two at a joint (A,) bool that are each other's mirror images but for a step are so: both
    are as the shorter one, whichever direction the ring runs in, so that what is symmetric stays so.
    """
    back, ahead = np.roll(controls[:, 1], 1, axis=0) - ring.anchors, controls[:, 0] - ring.anchors
    even = joint & (np.abs(back + ahead).max(axis=1) <= MIRROR_REACH)
    shorter = np.where(((back**2).sum(axis=1) < (ahead**2).sum(axis=1))[:, None], back, -ahead)
    controls = controls.copy()
    controls[even, 0] = (ring.anchors - shorter)[even]
    after = np.roll(even, -1)
    controls[after, 1] = np.roll(ring.anchors + shorter, -1, axis=0)[after]
    return controls


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


def add_ring(path: PathText, ring: GridRing, exact: bool = False, relative: bool = False) -> None:
    """Appends a closed ring; nothing where it is only a point. exact: no handle is written a step off. relative: all
    but the first point, so that rings of one form are the same text.
    """
    if ring.pieces == 0:
        return
    _add_pieces(path, ring, [*range(1, ring.pieces), 0], 0 if exact else MIRROR_REACH, relative)
    path.close()


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


def add_stroke(path: PathText, line: Path, precision: int) -> None:
    """Appends the centre line of a stroke."""
    if not isinstance(line, Chain):
        add_ring(path, grid_ring(line.ring(), precision))
        return
    anchors, controls = to_steps(line.anchors, precision), to_steps(line.controls, precision)
    # A line from the end back to the start, of which nothing is drawn, makes it a ring.
    back = np.stack([anchors[-1:], anchors[:1]], axis=1)
    smooth = np.array([False, *line.smooth[1:-1], False])
    ring = GridRing(anchors, np.concatenate([controls, back]), np.append(line.lines, True), smooth)
    smoothed = GridRing(anchors, _smoothed(ring, even=False), ring.lines, smooth)
    _add_pieces(path, smoothed, range(1, len(anchors)), MIRROR_REACH)
