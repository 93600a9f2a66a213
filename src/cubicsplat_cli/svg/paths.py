"""Path data: its commands, its absolute segments, and these as cubics."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import arc
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.record import record
from cubicsplat_cli.svg.values import NUMBER

LETTERS = "MmLlHhVvCcSsQqTtAaZz"
_START, _COMMAND = re.compile(rf"[\s,]*(?:[{LETTERS}]|\Z)"), re.compile(rf"([{LETTERS}])([^{LETTERS}]*)")
# The flags of an arc need no separator between or after them.
_NUMBER, _FLAG, _BLANK = re.compile(rf"[\s,]*({NUMBER})"), re.compile(r"[\s,]*([01])"), re.compile(r"[\s,]*")
_COUNTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "Z": 0}
_ARGUMENTS = {letter: (_NUMBER,) * count for letter, count in _COUNTS.items()}
_ARGUMENTS["A"] = (_NUMBER, _NUMBER, _NUMBER, _FLAG, _FLAG, _NUMBER, _NUMBER)
_DECIMALS = 9
# Limits of a path, which takes some seconds and 200 MB, and of a subpath, for which each row of a scene has room.
MAX_COMMANDS, MAX_SEGMENTS = 500_000, 65_535
Point = tuple[float, float]


class TooLong(InputError):
    """Path data has more commands or segments than may be read."""


class PathSegment(NamedTuple):
    """An absolute command, by its capital letter, with up to two handles. numbers: of an arc, radii, degrees, flags."""

    command: str
    start: Point
    end: Point
    handles: tuple[Point, ...] = ()
    numbers: tuple[float, ...] = ()

    @property
    def is_arc(self) -> bool:
        """True if it is drawn as an arc, not as a line."""
        return self.command == "A" and min(self.numbers[:2]) > 0.0 and self.start != self.end


def commands(d: str) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Yield the letter and the numbers of each command; a letter that is written once for several is repeated.

    Raises InputError where the data cannot be read, TooLong for more than MAX_COMMANDS.
    """
    # The letters alone show most data that is too long.
    if len(d) > MAX_COMMANDS and sum(map(d.count, LETTERS)) > MAX_COMMANDS:
        raise TooLong(f"path data of more than {MAX_COMMANDS} commands; simplify it")
    if not _START.match(d):
        raise InputError(f"path data that cannot be read at {d[:12]!r}")
    count = 0
    for command in _COMMAND.finditer(d):
        letter = command[1]
        for numbers in _grouped(letter, d, *command.span(2)):
            if count == MAX_COMMANDS:
                raise TooLong(f"path data of more than {MAX_COMMANDS} commands; simplify it")
            count += 1
            yield letter, numbers
            letter = {"M": "L", "m": "l"}.get(letter, letter)


def _grouped(letter: str, d: str, begin: int, end: int) -> Iterator[tuple[float, ...]]:
    """Yield the numbers in d[begin:end] in groups, one for each command, at least one group."""
    while True:
        numbers = []
        for argument in _ARGUMENTS[letter.upper()]:
            match = argument.match(d, begin, end)
            if match is None:
                raise _unreadable(letter, d, begin, end)
            numbers.append(float(match[1]))
            begin = match.end()
        yield tuple(numbers)
        if _BLANK.fullmatch(d, begin, end):
            return
        if not numbers:
            raise _unreadable(letter, d, begin, end)


def _unreadable(letter: str, d: str, begin: int, end: int) -> InputError:
    """Return the error for d[begin:end], in which the next argument of a command cannot be read."""
    if letter in "Aa":
        return InputError(f"path data that lacks a number of A at {d[begin : begin + 12]!r}")
    if _NUMBER.match(d, begin, end):
        return InputError(f"path data with a number after {letter} at {d[begin : begin + 12]!r}")
    start = _BLANK.match(d, begin, end).end()  # type: ignore[union-attr]
    if start < end:
        return InputError(f"path data that cannot be read at {d[start : start + 12]!r}")
    return InputError(f"path data that lacks a number of {letter} at {d[end : end + 12]!r}")


def subpaths(d: str) -> list[list[PathSegment]]:
    """Return the segments of each subpath, which ends with Z or before the next M.

    The segments are all commands but M. Those of S and T have their mirrored handle too; arcs have no handles. Raises
    InputError for bad path data, TooLong for too much of it.
    """
    result: list[list[PathSegment]] = []
    here = start = (0.0, 0.0)
    for letter, numbers in commands(d):
        command = letter.upper()
        if not result and command != "M":
            raise InputError(f"path data that does not begin with M at {d[:12]!r}")
        if command == "M":
            here = start = _points(letter, numbers, here)[0]
            result.append([])
            continue
        if len(result[-1]) > MAX_SEGMENTS:
            raise TooLong(f"path data of more than {MAX_SEGMENTS} commands in a row; simplify it")
        if result[-1] and result[-1][-1].command == "Z":
            result.append([])
        points = _points(letter, numbers, here) or [start]
        handles = tuple(points[:-1])
        if command in "ST":
            handles = (_mirrored(result[-1], here, command), *handles)
        result[-1].append(PathSegment(command, here, points[-1], handles, numbers[:5] if command == "A" else ()))
        here = points[-1]
    return result


def _points(letter: str, numbers: tuple[float, ...], here: Point) -> list[Point]:
    """Return the handles and the end of a command as absolute points."""
    x, y = here if letter.islower() else (0.0, 0.0)
    command = letter.upper()
    if command == "H":
        return [(_sum(x, numbers[0]), here[1])]
    if command == "V":
        return [(here[0], _sum(y, numbers[0]))]
    if command == "A":
        numbers = numbers[5:]
    return [(_sum(x, a), _sum(y, b)) for a, b in zip(numbers[::2], numbers[1::2], strict=True)]


def _sum(first: float, second: float) -> float:
    """Return the sum of two decimals without the noise of binary fractions, which would add up along a path."""
    total = first + second
    return total if total.is_integer() else round(total, _DECIMALS)


def _mirrored(before: list[PathSegment], here: Point, command: str) -> Point:
    """Return the first handle of S or T: the last handle of the same kind of curve before it, mirrored at the joint."""
    kin = "CS" if command == "S" else "QT"
    if not before or before[-1].command not in kin or before[-1].end != here:
        return here
    x, y = before[-1].handles[-1]
    return _sum(2.0 * here[0], -x), _sum(2.0 * here[1], -y)


@record
class Subpath:
    """cubics: (M, 4, 2), each starts where the one before ends. closed: whether the subpath ends with Z."""

    cubics: np.ndarray
    closed: bool

    def mapped(self, matrix: np.ndarray) -> Subpath:
        """Return the image under an affine map (3, 3)."""
        return Subpath(self.cubics @ matrix[:2, :2].T + matrix[:2, 2], self.closed)

    def ring(self) -> np.ndarray:
        """Return the cubics, with a line back to the start where they do not return to it."""
        start, end = self.cubics[0, 0], self.cubics[-1, 3]
        if np.array_equal(start, end):
            return self.cubics
        return np.concatenate([self.cubics, _line_as_cubic(end, start)[None]])


def cubic_subpaths(d: str) -> list[Subpath]:
    """Return the subpaths that have a length. Raises InputError for path data that cannot be read."""
    result = []
    for subpath in subpaths(d):
        with np.errstate(invalid="ignore", over="ignore"):  # infinite coordinates are refused below
            cubics = [cubic for segment in subpath for cubic in cubics_of(segment) if np.ptp(cubic, axis=0).any()]
        if not np.isfinite(cubics).all():
            raise InputError("path data with a point that is infinitely far away")
        if cubics:
            result.append(Subpath(np.stack(cubics), subpath[-1].command == "Z"))
    return result


def groups_apart(rings: list[np.ndarray]) -> list[np.ndarray]:
    """Return the indices of rings (M, 4, 2) in groups whose boxes do not meet; each group can be filled alone."""
    low, high = (np.array([limit(ring, axis=(0, 1)) for ring in rings]) for limit in (np.min, np.max))
    group = np.arange(len(rings))
    for index in range(len(rings)):
        meets = ((low <= high[index]) & (high >= low[index])).all(axis=1)
        joined = np.unique(group[meets])
        group[np.isin(group, joined)] = joined[0]
    return [np.flatnonzero(group == number) for number in np.unique(group)]


def _line_as_cubic(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    return start + (end - start) * np.array([0.0, 1.0, 2.0, 3.0])[:, None] / 3.0


def cubics_of(segment: PathSegment) -> list[np.ndarray]:
    """Return a segment of a path, perhaps a line or an arc, as cubics (4, 2)."""
    start, end = np.array(segment.start), np.array(segment.end)
    if len(segment.handles) == 2:
        return [np.array([start, *segment.handles, end])]
    if len(segment.handles) == 1:
        middle = np.array(segment.handles[0])
        return [np.stack([start, (start + 2.0 * middle) / 3.0, (end + 2.0 * middle) / 3.0, end])]
    return _arc_cubics(segment, start, end) if segment.is_arc else [_line_as_cubic(start, end)]


def _arc_cubics(segment: PathSegment, start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
    """Return an arc as cubics of a quarter turn or less; too short radii are scaled up (SVG 2, appendix B.2.4)."""
    rx, ry, degrees, large, sweep = segment.numbers
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn, radii = np.array([[cos, -sin], [sin, cos]]), np.array([rx, ry])
    # The frame of a unit circle, in which the middle between both ends is the origin.
    half = turn.T @ (start - end) / 2.0 / radii
    size = float(half @ half)
    if size > 1.0:
        radii, half, size = radii * math.sqrt(size), half / math.sqrt(size), 1.0
    reach = (1.0 if large != sweep else -1.0) * math.sqrt(max(1.0 / max(size, 1e-12) - 1.0, 0.0))
    centre = reach * np.array([half[1], -half[0]])
    first = math.atan2(half[1] - centre[1], half[0] - centre[0])
    last = math.atan2(-half[1] - centre[1], -half[0] - centre[0])
    span = (last - first) % (2.0 * math.pi) - (0.0 if sweep else 2.0 * math.pi)
    count = max(1, math.ceil(abs(span) / (math.pi / 2.0) - 1e-9))
    cubics = ((centre + arc(first, first + span, count)) * radii) @ turn.T + (start + end) / 2.0
    cubics[0, 0], cubics[-1, 3] = start, end
    return [*cubics]
