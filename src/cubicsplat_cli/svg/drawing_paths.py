"""Outlines and strokes of artwork in whole steps of the file's grid, and as path data in its shortest form.

Equal coordinates stay equal on the grid: lines along an axis stay so, and anchors that shapes share stay shared. Smooth
joints stay smooth. Path data is as an artist's exporter writes it: lines as H, V and L, cubics as C and S, absolute or
relative, whichever is shorter.

Rectangles with round corners are lines and quarter circles, and read back from these. cairosvg, and whatever is made of
it, bends two corners of `<rect rx>` wrongly: the second handle of its cubic is as far from the corner of the box as it
should be from its end, which is 0.036 of the radius off. Arcs all viewers draw alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Rectangle, Ring
from cubicsplat_cli.artwork.geometry.steps import aligned, to_steps
from cubicsplat_cli.artwork.geometry.stroke import Chain, Path
from cubicsplat_cli.svg.markup import format_number
from cubicsplat_cli.svg.paths import PathSegment, Point

# Steps by which a handle may be off the mirror image of the one before it and be written as that.
MIRROR_REACH = 1
# Letters of rounded rectangles: round at the left and right ends, at upper and lower ones, at all corners in either
# direction.
LETTERS = ("HAHAZ", "VAVAZ", "HAVAHAVAZ", "VAHAVAHAZ")
MOST_ON_RECT = 3.0  # px, the radius up to which viewers agree about `<rect rx>` to a tenth of a px
_TOGETHER = 20_000  # pieces of rings that are brought onto the grid at once
Step = tuple[int, int]


def form_of(ring: Ring) -> bytes:
    """A key that is equal for rings in whole steps that differ by a translation only."""
    anchors, controls = ring.anchors - ring.anchors[:1], ring.controls - ring.anchors[:1, None]
    return b"".join(part.tobytes() for part in (anchors, controls, ring.lines))


def grid_rings(rings: Sequence[Ring], precision: int, exact: bool = False) -> list[Ring]:
    """Rings in whole steps (int64), without pieces of no extent, so perhaps with none, and begun so that the closing
    line is the longest to write.

    exact: every point goes to the nearest step, as in the rings that share it; otherwise handles keep joints smooth.
    """
    found: list[Ring] = []
    first, pieces = 0, 0
    for number, ring in enumerate(rings, start=1):
        pieces += ring.pieces
        if pieces >= _TOGETHER or number == len(rings):
            found += _on_grid(rings[first:number], precision, exact)
            first, pieces = number, 0
    return found


def _on_grid(rings: Sequence[Ring], precision: int, exact: bool) -> list[Ring]:
    """The same of rings that are not too many for the memory."""
    parts = zip(*((ring.anchors, ring.controls, ring.lines, ring.smooth) for ring in rings), strict=True)
    anchors, controls, lines, smooth = (np.concatenate(part) for part in parts)
    all_pieces = Ring(
        to_steps(anchors, precision), to_steps(controls, precision), np.asarray(lines, bool), np.asarray(smooth, bool)
    )
    owner = np.repeat(np.arange(len(rings)), [ring.pieces for ring in rings])
    kept = _with_extent(all_pieces, _next_in_loops(owner))
    all_pieces, owner = _picked(all_pieces, kept), owner[kept]
    all_pieces = _picked(all_pieces, _begun_after_a_line(all_pieces, owner))
    if not exact:
        all_pieces = replace(all_pieces, controls=_smoothed(all_pieces, _next_in_loops(owner)))
    ends = np.cumsum(np.bincount(owner, minlength=len(rings)))
    return [_picked(all_pieces, slice(first, end)) for first, end in pairwise([0, *ends.tolist()])]


def _picked(ring: Ring, which: np.ndarray | slice) -> Ring:
    """The pieces of an index, a mask (A,) or a slice, each with the anchor that it begins at."""
    return Ring(ring.anchors[which], ring.controls[which], ring.lines[which], ring.smooth[which])


def _next_in_loops(owner: np.ndarray) -> np.ndarray:
    """(n,) the number of the piece after each one in its loop. owner: (n,) ascending, whose loop it is in."""
    following = np.arange(1, len(owner) + 1)
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    following[np.append(starts[1:], len(owner))[: len(starts)] - 1] = starts
    return following


def _with_extent(ring: Ring, following: np.ndarray) -> np.ndarray:
    """(A,) bool: the pieces that are no mere points."""
    moved = (ring.anchors[following] != ring.anchors).any(axis=1)
    bent = ~ring.lines & (ring.controls != ring.anchors[:, None]).any(axis=(1, 2))
    return np.asarray(moved | bent)


def _begun_after_a_line(ring: Ring, owner: np.ndarray) -> np.ndarray:
    """(A,) the order in which the line of each loop with the most digits comes last, since closing it draws it for
    nothing. owner: (A,) ascending, whose loop each piece is in.
    """
    steps = np.abs(ring.anchors[_next_in_loops(owner)] - ring.anchors)
    digits = np.where(steps > 0, 1.0 + np.log10(np.maximum(steps, 1)), 0.0).sum(axis=1)
    digits = np.where(ring.lines, digits, -1.0)
    order = np.arange(len(owner))
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    if not len(starts):
        return order
    sizes = np.diff(np.append(starts, len(owner)))
    longest = np.repeat(np.maximum.reduceat(digits, starts), sizes)
    place, first = order - np.repeat(starts, sizes), np.repeat(starts, sizes)
    # Of each loop the first of its longest lines; of one without lines, its last piece.
    last = np.minimum.reduceat(np.where((digits == longest) & ring.lines, place, len(owner)), starts)
    last = np.repeat(np.minimum(last, sizes - 1), sizes)
    return np.asarray(first + (last + 1 + place) % np.repeat(sizes, sizes))


def _smoothed(ring: Ring, following: np.ndarray, even: bool = True) -> np.ndarray:
    """Controls whose shorter handle at each smooth joint is moved by at most two steps towards the other's line.

    following: (A,) the piece after each one. even: whether handles that are then nearly equal become so.
    """
    controls = ring.controls.copy()
    if not ring.smooth.any():
        return controls
    previous = np.empty_like(following)
    previous[following] = np.arange(len(following))
    line_before = ring.lines[previous]
    # A line's handle is its other end, which is where it is.
    before = np.where(line_before[:, None], ring.anchors[previous], ring.controls[previous, 1])
    after = np.where(ring.lines[:, None], ring.anchors[following], ring.controls[:, 0])
    back, ahead = before - ring.anchors, after - ring.anchors
    longer_back = (back**2).sum(axis=1) >= (ahead**2).sum(axis=1)
    joint = ring.smooth & ((back * ahead).sum(axis=1) < 0)
    move_ahead = joint & ~ring.lines & (longer_back | line_before)
    move_back = joint & ~line_before & ~move_ahead
    controls[move_ahead, 0] = ring.anchors[move_ahead] + aligned(ahead[move_ahead], back[move_ahead])
    controls[previous[move_back], 1] = ring.anchors[move_back] + aligned(back[move_back], ahead[move_back])
    return _evened(ring, controls, previous, joint & ~ring.lines & ~line_before) if even else controls


def _evened(ring: Ring, controls: np.ndarray, previous: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """Controls of which the two at a joint (A,) bool that are each other's mirror images but for a step are so: both
    are as the shorter one, whichever direction the ring runs in, so that what is symmetric stays so.
    """
    back, ahead = controls[previous, 1] - ring.anchors, controls[:, 0] - ring.anchors
    even = joint & (np.abs(back + ahead).max(axis=1) <= MIRROR_REACH)
    shorter = np.where(((back**2).sum(axis=1) < (ahead**2).sum(axis=1))[:, None], back, -ahead)
    controls = controls.copy()
    controls[even, 0] = (ring.anchors - shorter)[even]
    controls[previous[even], 1] = (ring.anchors + shorter)[even]
    return controls


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

    def arc(self, radii: Step, angle: str, flags: tuple[int, int], to: Step) -> None:
        """An elliptical arc; angle: degrees as text. flags: whether it is the larger one, whether clockwise as seen."""
        head = [*(format_number(radius, self.precision) for radius in radii), angle, *map(str, flags)]
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
    _add_pieces(path, ring, [*range(1, ring.pieces), 0], 0 if exact else MIRROR_REACH, relative)
    path.close()


def _add_pieces(path: PathText, ring: Ring, ends: Sequence[int], reach: int, relative: bool = False) -> None:
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
    smoothed = replace(ring, controls=_smoothed(ring, following, even=False))
    _add_pieces(path, smoothed, range(1, len(anchors)), MIRROR_REACH)


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


def _steps(box: Rectangle, precision: int) -> tuple[int, int, int, int, int]:
    """Left, top, right, bottom and radius in steps, the radius at most half of the shorter side."""
    left, right, top, bottom = (
        int(to_steps(v, precision)) for v in (box.x, box.x + box.width, box.y, box.y + box.height)
    )
    radius = min(int(to_steps(box.radius, precision)), (right - left) // 2, (bottom - top) // 2)
    return left, top, right, bottom, radius


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
