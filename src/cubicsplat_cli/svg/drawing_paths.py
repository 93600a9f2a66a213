"""Outlines and strokes of artwork as path data in its shortest form.

Lines are H, V and L, cubics C and S, absolute or relative, whichever is shorter.

Rectangles with round corners are lines and quarter circles. All viewers draw arcs alike, but cairosvg bends two corners
of `<rect rx>` wrongly: the second handle of its cubic has the distance from the corner of the box that it should have
from its end, which is 0.036 of the radius off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Rectangle, Ring, thirds
from cubicsplat_cli.artwork.geometry.steps import to_steps
from cubicsplat_cli.artwork.geometry.stroke import Chain, Path
from cubicsplat_cli.svg.drawing_grid import MIRROR_REACH, grid_rings, smoothed
from cubicsplat_cli.svg.markup import format_number
from cubicsplat_cli.svg.paths import PathSegment, Point

# Commands of rectangles with half circles at the left and right, half circles at the top and bottom, and four corners.
LETTERS = ("HAHAZ", "VAVAZ", "HAVAHAVAZ", "VAHAVAHAZ")
MOST_ON_RECT = 3.0  # px, the radius up to which viewers agree about `<rect rx>` to a tenth of a px
_SMOOTH = math.radians(0.5)  # joints that turn by less are smooth
Step = tuple[int, int]


class PathText:
    """Path data under construction, in steps of 10^-precision px; each command has its shorter form."""

    def __init__(self, precision: int) -> None:
        self.precision = precision
        self.text = ""
        self._letter = ""  # of the command that further numbers would repeat
        self._last = ""  # the number at the end, if there is one
        self.here: Step = (0, 0)
        self._start: Step = (0, 0)
        self._relative = False

    def move(self, to: Step, *, relative: bool = False) -> None:
        """Begin a ring. relative: the text after its start does not depend on the start."""
        self._relative = False
        self._add("M", to, to)
        # Further pairs of numbers are lines.
        self._letter = "" if relative else "L" if self._letter == "M" else "l"
        self._relative = relative
        self._start = to

    def line(self, to: Step) -> None:
        """Add a straight line; horizontal and vertical ones have one number."""
        if to[1] == self.here[1]:
            self._add("H", (to[0],), to, axis=0)
        elif to[0] == self.here[0]:
            self._add("V", (to[1],), to, axis=1)
        else:
            self._add("L", to, to)

    def cubic(self, first: Step, second: Step, to: Step, *, mirrored: bool) -> None:
        """Add a cubic. mirrored: its first handle is the mirror image of the one before it."""
        self._add("S" if mirrored else "C", (*(() if mirrored else first), *second, *to), to)

    def arc(self, radii: tuple[float, float], angle: str, flags: tuple[int, int], to: Step) -> None:
        """Add an elliptical arc. radii: in steps, to a tenth. angle: degrees as text. flags: large, clockwise."""
        head = [*(format_number(round(10 * radius), self.precision + 1) for radius in radii), angle, *map(str, flags)]
        self._add("A", to, to, head)

    def close(self) -> None:
        """End the ring where it began."""
        self.text += "z"
        self._letter = self._last = ""
        self.here = self._start

    def _add(self, letter: str, numbers: Sequence[int], to: Step, head: Sequence[str] = (), axis: int = 0) -> None:
        """Add a command. numbers: absolute, x and y in turn from the axis on. head: what precedes them."""
        relative = [number - self.here[(index + axis) % 2] for index, number in enumerate(numbers)]
        forms = []
        for form, values in ((letter.lower(), relative), (letter, numbers)):
            parts = [*head, *(format_number(value, self.precision) for value in values)]
            forms.append((self._joined(form, parts), form, parts[-1]))
        # The relative form wins at equal length, except for the first point, where both mean the same.
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
    """Append a closed ring that is more than a point. exact: write no handle a step off. relative: as in `move`."""
    if ring.pieces == 0:
        return
    add_pieces(path, ring, [*range(1, ring.pieces), 0], 0 if exact else MIRROR_REACH, relative)
    path.close()


def add_pieces(path: PathText, ring: Ring, ends: Sequence[int], reach: int, relative: bool = False) -> None:
    """Append the pieces of a ring except the line that closes it.

    ends: the anchor at the end of each piece. reach: steps by which a handle may be off the mirror image of the one
    before it and be written as that.
    """
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
        near = mirror is not None and max(abs(first[0] - mirror[0]), abs(first[1] - mirror[1])) <= reach
        path.cubic(first, second, end, mirrored=near)
        mirror = (2 * end[0] - second[0], 2 * end[1] - second[1])


def add_stroke(path: PathText, line: Path, precision: int) -> None:
    """Append the centre line of a stroke."""
    if not isinstance(line, Chain):
        add_ring(path, grid_rings([line.ring()], precision)[0])
        return
    anchors, controls = to_steps(line.anchors, precision), to_steps(line.controls, precision)
    # A line from the end back to the start, which is not drawn, makes it a ring.
    back = np.stack([anchors[-1:], anchors[:1]], axis=1)
    smooth = np.array([False, *line.smooth[1:-1], False])
    ring = Ring(anchors, np.concatenate([controls, back]), np.append(line.lines, True), smooth)
    following = (np.arange(ring.pieces) + 1) % ring.pieces
    ring = replace(ring, controls=smoothed(ring, following, even=False))
    add_pieces(path, ring, range(1, len(anchors)), MIRROR_REACH)


def add_rounded(path: PathText, box: Rectangle, precision: int, *, clockwise: bool) -> None:
    """Append a level rectangle with round corners; its radius is at least half a step."""
    left, top, right, bottom, radius = _steps(box, precision)
    ends = [(int(x), int(y)) for x, y in _joints(left, top, right, bottom, radius)]
    if not clockwise:
        ends.reverse()
    path.move(ends[0])
    # Lines and arcs alternate. Closing the path would draw the last arc as a line.
    for k, end in enumerate([*ends[1:], ends[0]]):
        if k % 2:
            path.arc((radius, radius), "0", (0, int(clockwise)), end)
        else:
            path.line(end)
    path.close()


def rounded_of(subpath: Sequence[PathSegment]) -> tuple[Rectangle, bool] | None:
    """Return the rectangle that `add_rounded` wrote as these segments, and whether it runs clockwise as seen.

    Returns None for other segments.
    """
    if "".join(piece.command for piece in subpath) not in LETTERS:
        return None
    arcs = [piece for piece in subpath if piece.command == "A"]
    radius, sweep = arcs[0].numbers[0], arcs[0].numbers[4]
    numbers = (radius, radius, 0.0, 0.0, sweep)
    starts = np.array([piece.start for piece in subpath[:-1]])
    beyond = [radius if len(arcs) == 2 and subpath[0].command == letter else 0.0 for letter in "HV"]
    (left, top), (right, bottom) = (starts.min(axis=0) - beyond).tolist(), (starts.max(axis=0) + beyond).tolist()
    joints = _joints(left, top, right, bottom, radius)[:: 1 if sweep == 1.0 else -1]
    if any(arc.numbers != numbers for arc in arcs) or radius <= 0.0 or subpath[-1].start != subpath[0].start:
        return None
    if len(joints) != len(starts) or np.abs(starts - joints).max() > 1e-6:
        return None
    return Rectangle(left, top, right - left, bottom - top, radius), sweep == 1.0


def _steps(box: Rectangle, precision: int) -> tuple[float, float, float, float, float]:
    """Return left, top, right, bottom and radius in steps.

    A radius of about half the shorter side becomes exactly that. Then the middles of the round ends are on the grid,
    and the lines and arcs meet there.
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


def _joints(left: float, top: float, right: float, bottom: float, radius: float) -> list[Point]:
    """Return the points where lines and arcs meet, clockwise as seen, a line first.

    Sides shorter than a point are left out, and the corners beside them are one arc.
    """
    x1, x2, y1, y2 = left + radius, right - radius, top + radius, bottom - radius
    joints = ((x1, top), (x2, top), (right, y1), (right, y2), (x2, bottom), (x1, bottom), (left, y2), (left, y1))
    kept = (right - left > 2 * radius + 1e-9, bottom - top > 2 * radius + 1e-9)
    return [joint for number, joint in enumerate(joints) if kept[number // 2 % 2]]


def ring_of(subpath: Sequence[PathSegment]) -> Ring:
    """Return the ring of a closed subpath; its closing segment is a line of its own if it has a length."""
    if math.dist(subpath[-1].start, subpath[-1].end) < 1e-9 and len(subpath) > 1:
        subpath = subpath[:-1]
    anchors = np.array([piece.start for piece in subpath])
    controls, lines = controls_of(subpath, np.roll(anchors, -1, axis=0))
    back, ahead = anchors - np.roll(controls[:, 1], 1, axis=0), controls[:, 0] - anchors
    cross = back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0]
    dot = (back * ahead).sum(axis=1)
    return Ring(anchors, controls, lines, (dot > 0.0) & (np.abs(np.arctan2(cross, dot)) < _SMOOTH))


def controls_of(subpath: Sequence[PathSegment], ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both control points (n, 2, 2) of each segment, at the thirds of lines, and which (n,) are lines."""
    starts = np.array([piece.start for piece in subpath])
    controls = thirds(starts, ends)
    for index, piece in enumerate(subpath):
        if piece.handles:
            controls[index] = piece.handles
    return controls, np.array([not piece.handles for piece in subpath])
