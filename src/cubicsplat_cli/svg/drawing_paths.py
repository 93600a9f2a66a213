"""Outlines and strokes of artwork in whole steps of the file's grid, as path data in its shortest form.

Coordinates that are equal stay equal on the grid, so lines along an axis keep their direction and shapes keep the
anchors that they share. Smooth joints stay smooth. Lines are H, V and L, cubics C and S, absolute or relative,
whichever is shorter.

Rectangles with round corners are lines and quarter circles. All viewers draw arcs alike, but cairosvg bends two corners
of `<rect rx>` wrongly, by 0.036 of the radius: it takes the distance of a handle from its end as that from the corner.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Rectangle, Ring, next_in_loops, places_within, thirds, turned_to
from cubicsplat_cli.artwork.geometry.steps import aligned, to_steps
from cubicsplat_cli.artwork.geometry.stroke import Chain, Path
from cubicsplat_cli.artwork.shapes import Shape
from cubicsplat_cli.svg.markup import format_number
from cubicsplat_cli.svg.paths import PathSegment, Point

# Commands of rectangles with half circles at the left and right, half circles at the top and bottom, and four corners.
LETTERS = ("HAHAZ", "VAVAZ", "HAVAHAVAZ", "VAHAVAHAZ")
MOST_ON_RECT = 3.0  # px, the radius up to which viewers agree about `<rect rx>` to a tenth of a px
_SMOOTH = math.radians(0.5)  # joints that turn by less are smooth
MIRROR_REACH = 1  # steps; a handle that is off the mirror image of the one before it by no more is written as that
Step = tuple[int, int]


def _form_of(ring: Ring) -> bytes:
    """Return a key that is equal for rings in whole steps that differ by a translation only."""
    anchors, controls = ring.anchors - ring.anchors[:1], ring.controls - ring.anchors[:1, None]
    return b"".join(part.tobytes() for part in (anchors, controls, ring.lines))


def grid_rings(rings: Sequence[Ring], precision: int, exact: bool = False) -> list[Ring]:
    """Return rings in whole steps (int64), without pieces of no extent, so perhaps with none.

    Each begins after its line that is the longest to write, since closing a ring draws that line. exact: every point
    goes to the nearest step, as in the rings that share it; otherwise handles keep joints smooth.
    """
    if not rings:
        return []
    # As pieces of one array.
    parts = zip(*((ring.anchors, ring.controls, ring.lines, ring.smooth) for ring in rings), strict=True)
    anchors, controls, lines, smooth = (np.concatenate(part) for part in parts)
    pieces = Ring(to_steps(anchors, precision), to_steps(controls, precision), lines.astype(bool), smooth.astype(bool))
    owner = np.repeat(np.arange(len(rings)), [ring.pieces for ring in rings])
    moved = (pieces.anchors[next_in_loops(owner)] != pieces.anchors).any(axis=1)
    bent = ~pieces.lines & (pieces.controls != pieces.anchors[:, None]).any(axis=(1, 2))
    pieces, owner = pieces.chosen(moved | bent), owner[moved | bent]
    pieces = pieces.chosen(_started_after_a_line(pieces, owner))
    if not exact:
        pieces = replace(pieces, controls=smoothed(pieces, next_in_loops(owner)))
    ends = np.cumsum(np.bincount(owner, minlength=len(rings)))
    return [pieces.chosen(np.arange(first, end)) for first, end in pairwise([0, *ends.tolist()])]


class GridRings:
    """The rings of a drawing in whole steps of the file's grid. exact: as of `grid_rings`."""

    def __init__(self, shapes: Sequence[Shape], precision: int, exact: bool) -> None:
        self._precision, self._exact = precision, exact
        placed = [
            (outline, index == 0)
            for shape in shapes
            if shape.stroke is None
            for index, outline in enumerate(shape.outlines)
            if isinstance(outline, Ring)
        ]
        turned = {(id(ring), clockwise): turned_to(ring, clockwise) for ring, clockwise in placed}
        self._grid = dict(zip(turned, grid_rings([*turned.values()], precision, exact), strict=True))
        forms = Counter(_form_of(self._of(*place)) for place in placed)
        self._repeated = {form for form, count in forms.items() if count > 1}

    def _of(self, ring: Ring, clockwise: bool) -> Ring:
        """Return a ring on the grid, as seen clockwise or not."""
        grid = self._grid.get((id(ring), clockwise))
        return grid or grid_rings([turned_to(ring, clockwise)], self._precision, self._exact)[0]

    def add(self, path: PathText, ring: Ring, clockwise: bool) -> None:
        """Append a ring, as seen clockwise or not; equal forms have equal texts."""
        grid = self._of(ring, clockwise)
        add_ring(path, grid, self._exact, relative=_form_of(grid) in self._repeated)


def _started_after_a_line(ring: Ring, owner: np.ndarray) -> np.ndarray:
    """Return the order (A,) in which the first line of most digits, if any, ends its loop. owner: (A,) ascending."""
    steps = np.abs(ring.anchors[next_in_loops(owner)] - ring.anchors)
    digits = np.where(steps > 0, 1.0 + np.log10(np.maximum(steps, 1)), 0.0).sum(axis=1)
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    sizes = np.diff(starts, append=len(owner))
    longest = np.lexsort((np.where(ring.lines, -digits, 1.0), owner))[starts]
    last = np.where(ring.lines[longest], longest - starts, sizes - 1)
    loop, place = places_within(sizes)
    return np.asarray(starts[loop] + (place + last[loop] + 1) % sizes[loop])


def smoothed(ring: Ring, following: np.ndarray, even: bool = True) -> np.ndarray:
    """Return controls whose shorter handle at each smooth joint is at most two steps nearer to the other's line.

    following: (A,) the piece after each one. even: whether handles that are then nearly equal become equal.
    """
    controls = ring.controls.copy()
    if not ring.smooth.any():
        return controls
    previous = np.empty_like(following)
    previous[following] = np.arange(len(following))
    line_before = ring.lines[previous]
    # The handle of a line is its other end, which cannot move.
    before = np.where(line_before[:, None], ring.anchors[previous], ring.controls[previous, 1])
    after = np.where(ring.lines[:, None], ring.anchors[following], ring.controls[:, 0])
    back, ahead = before - ring.anchors, after - ring.anchors
    longer_back = (back**2).sum(axis=1) >= (ahead**2).sum(axis=1)
    joint = ring.smooth & ((back * ahead).sum(axis=1) < 0)
    move_ahead = joint & ~ring.lines & (longer_back | line_before)
    move_back = joint & ~line_before & ~move_ahead
    controls[move_ahead, 0] = ring.anchors[move_ahead] + aligned(ahead[move_ahead], back[move_ahead])
    controls[previous[move_back], 1] = ring.anchors[move_back] + aligned(back[move_back], ahead[move_back])
    if even:
        # Two handles that are mirror images within a step become as the shorter one. That does not depend on the
        # direction of the ring, so symmetric outlines stay symmetric.
        back, ahead = controls[previous, 1] - ring.anchors, controls[:, 0] - ring.anchors
        near = joint & ~ring.lines & ~line_before & (np.abs(back + ahead).max(axis=1) <= MIRROR_REACH)
        shorter = np.where(((back**2).sum(axis=1) < (ahead**2).sum(axis=1))[:, None], back, -ahead)
        controls[near, 0] = (ring.anchors - shorter)[near]
        controls[previous[near], 1] = (ring.anchors + shorter)[near]
    return controls


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


def add_stroke(path: PathText, line: Path) -> None:
    """Append the centre line of a stroke."""
    if not isinstance(line, Chain):
        add_ring(path, grid_rings([line.ring()], path.precision)[0])
        return
    anchors, controls = to_steps(line.anchors, path.precision), to_steps(line.controls, path.precision)
    # A line from the end back to the start, which is not drawn, makes it a ring.
    back = np.stack([anchors[-1:], anchors[:1]], axis=1)
    smooth = np.array([False, *line.smooth[1:-1], False])
    ring = Ring(anchors, np.concatenate([controls, back]), np.append(line.lines, True), smooth)
    following = (np.arange(ring.pieces) + 1) % ring.pieces
    ring = replace(ring, controls=smoothed(ring, following, even=False))
    add_pieces(path, ring, range(1, len(anchors)), MIRROR_REACH)


def add_rounded(path: PathText, box: Rectangle, *, clockwise: bool) -> None:
    """Append a level rectangle with round corners; its radius is at least half a step."""
    left, top, right, bottom, radius = _steps(box, path.precision)
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
    """Return the rectangle that `add_rounded` wrote as segments of LETTERS, and whether it runs clockwise, or None."""
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
    low, high = (to_steps(end + off / 10.0**precision, precision) - off for end, off in ((low, inset), (high, -inset)))
    return (*low.tolist(), *high.tolist(), float(radius))


def _joints(left: float, top: float, right: float, bottom: float, radius: float) -> list[Point]:
    """Return the points where lines and arcs meet, clockwise as seen, a line first; sides of no length are left out."""
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
    controls = thirds(np.array([piece.start for piece in subpath]), ends)
    for index, piece in enumerate(subpath):
        if piece.handles:
            controls[index] = piece.handles
    return controls, np.array([not piece.handles for piece in subpath])
