"""Path data: its commands, its absolute pieces, and those as cubics."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.record import record
from cubicsplat_cli.svg.values import NUMBER, NUMBERS

LETTERS = "MmLlHhVvCcSsQqTtAaZz"
_COMMAND = re.compile(rf"[{LETTERS}]")
# A number or any other character that is no separator, which `float` then refuses.
_TOKEN = re.compile(rf"{NUMBER}|[^\s,]")
# Nothing need stand between the two flags of an arc, nor after them.
_NUMBER, _FLAG = re.compile(rf"[\s,]*({NUMBER})"), re.compile(r"[\s,]*([01])")
_ARC = (_NUMBER, _NUMBER, _NUMBER, _FLAG, _FLAG, _NUMBER, _NUMBER)
_BLANK = re.compile(r"[\s,]*")
# How many numbers a command takes.
_NUMBERS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
_DECIMALS = 9
# Of one path, which takes some seconds and 200 MB; and of a subpath, for which each row of a scene has room.
MAX_COMMANDS, MAX_SEGMENTS = 500_000, 65_535
Point = tuple[float, float]


class TooLong(InputError):
    """Path data of more commands or segments than are read."""


class PathSegment(NamedTuple):
    """One command: its capital letter, where it starts and ends, and its handles (none, one or two), absolute.

    numbers: of an arc, its radii, the angle in degrees and the two flags.
    """

    command: str
    start: Point
    end: Point
    handles: tuple[Point, ...] = ()
    numbers: tuple[float, ...] = ()

    @property
    def is_arc(self) -> bool:
        """Whether it is an arc that is drawn as one, and not as a line."""
        return self.command == "A" and min(self.numbers[:2]) > 0.0 and self.start != self.end


def commands(d: str) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Each command with its numbers; a command that is left out where it repeats is given again.

    Raises InputError where the data cannot be read, TooLong for more than MAX_COMMANDS.
    """
    # What a glance shows need not be read first.
    if len(d) > MAX_COMMANDS and sum(map(d.count, LETTERS)) > MAX_COMMANDS:
        raise TooLong(f"path data of more than {MAX_COMMANDS} commands; simplify it")
    command = _COMMAND.search(d)
    begin = len(d) if command is None else command.start()
    if not _BLANK.fullmatch(d, 0, begin):
        raise InputError(f"path data that cannot be read at {d[:12]!r}")
    count = 0
    while command is not None:
        letter, begin = command[0], command.end()
        command = _COMMAND.search(d, begin)
        end = len(d) if command is None else command.start()
        for numbers in _grouped(letter, d, begin, end):
            if count == MAX_COMMANDS:
                raise TooLong(f"path data of more than {MAX_COMMANDS} commands; simplify it")
            count += 1
            yield letter, numbers
            letter = {"M": "L", "m": "l"}.get(letter, letter)


def _grouped(letter: str, d: str, begin: int, end: int) -> Iterator[tuple[float, ...]]:
    """The numbers in d[begin:end] as those of one command after the other, at least one."""
    size = _NUMBERS[letter.upper()]
    if size == 7:
        yield from _arcs(d, begin, end)
        return
    tokens = islice(_TOKEN.finditer(d, begin, end), (MAX_COMMANDS + 1) * max(size, 1))
    try:
        numbers = [float(match[0]) for match in tokens]
    except ValueError as error:
        bad = next(match.start() for match in _TOKEN.finditer(d, begin, end) if not NUMBERS.fullmatch(match[0]))
        raise InputError(f"path data that cannot be read at {d[bad : bad + 12]!r}") from error
    if size == 0:
        if numbers:
            raise InputError(f"path data with a number after {letter} at {d[begin : begin + 12]!r}")
        yield ()
        return
    if not numbers or len(numbers) % size:
        raise InputError(f"path data that lacks a number of {letter} at {d[end : end + 12]!r}")
    for first in range(0, len(numbers), size):
        yield tuple(numbers[first : first + size])


def _arcs(d: str, begin: int, end: int) -> Iterator[tuple[float, ...]]:
    while True:
        numbers = []
        for kind in _ARC:
            match = kind.match(d, begin, end)
            if match is None:
                raise InputError(f"path data that lacks a number of A at {d[begin : begin + 12]!r}")
            numbers.append(float(match[1]))
            begin = match.end()
        yield tuple(numbers)
        if _BLANK.fullmatch(d, begin, end):
            return


def subpaths(d: str) -> list[list[PathSegment]]:
    """The absolute pieces of each subpath, which ends with Z or before the next M: all commands but M, of S and T the
    mirrored handle too. An arc has no handles.

    Raises InputError for bad path data, TooLong for too much of it.
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
    """The sum of two decimals without the noise of binary fractions, which would add up along a path."""
    total = first + second
    return total if total.is_integer() else round(total, _DECIMALS)


def _mirrored(before: list[PathSegment], here: Point, command: str) -> Point:
    """The first handle of S or T: the last one of a curve of the same kind before it, mirrored at the joint."""
    kin = "CS" if command == "S" else "QT"
    if not before or before[-1].command not in kin or before[-1].end != here:
        return here
    x, y = before[-1].handles[-1]
    return _sum(2.0 * here[0], -x), _sum(2.0 * here[1], -y)


@record
class Subpath:
    """cubics: (M, 4, 2), each of which starts where the one before ends. closed: whether it ends with Z."""

    cubics: np.ndarray
    closed: bool

    def mapped(self, matrix: np.ndarray) -> Subpath:
        """Through an affine map (3, 3)."""
        return Subpath(self.cubics @ matrix[:2, :2].T + matrix[:2, 2], self.closed)

    def ring(self) -> np.ndarray:
        """Its cubics, the line back to its start included where it is not there."""
        start, end = self.cubics[0, 0], self.cubics[-1, 3]
        if np.array_equal(start, end):
            return self.cubics
        return np.concatenate([self.cubics, line_as_cubic(end, start)[None]])


def cubic_subpaths(d: str) -> list[Subpath]:
    """The subpaths that have a length. Raises InputError for path data that cannot be read."""
    result = []
    for subpath in subpaths(d):
        with np.errstate(invalid="ignore", over="ignore"):  # infinite coordinates are refused below
            cubics = [cubic for segment in subpath for cubic in cubics_of(segment) if np.ptp(cubic, axis=0).any()]
        if not np.isfinite(cubics).all():
            raise InputError("path data with a point that is infinitely far away")
        if cubics:
            result.append(Subpath(np.stack(cubics), subpath[-1].command == "Z"))
    return result


def line_as_cubic(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """A line as a cubic (4, 2)."""
    return start + (end - start) * np.array([0.0, 1.0, 2.0, 3.0])[:, None] / 3.0


def halves(cubics: np.ndarray) -> np.ndarray:
    """(2 n, 4, 2): each of n cubics as two, by de Casteljau's algorithm."""
    a, b, c, d = cubics.transpose(1, 0, 2)
    ab, bc, cd = (a + b) / 2.0, (b + c) / 2.0, (c + d) / 2.0
    abc, bcd = (ab + bc) / 2.0, (bc + cd) / 2.0
    middle = (abc + bcd) / 2.0
    parts = np.stack([np.stack([a, ab, abc, middle], 1), np.stack([middle, bcd, cd, d], 1)], 1)
    return parts.reshape(-1, 4, 2)


def apart(rings: list[np.ndarray]) -> list[list[np.ndarray]]:
    """Rings (M, 4, 2) in groups whose boxes do not meet, so that each group can be filled without the others."""
    if len(rings) < 2:
        return [rings] if rings else []
    low = np.array([ring.min((0, 1)) for ring in rings])
    high = np.array([ring.max((0, 1)) for ring in rings])
    group = np.arange(len(rings))
    for index in range(len(rings)):
        meets = ((low <= high[index]) & (high >= low[index])).all(axis=1)
        joined = np.unique(group[meets])
        group[np.isin(group, joined)] = joined[0]
    return [[rings[index] for index in np.flatnonzero(group == number)] for number in np.unique(group)]


def cubics_of(segment: PathSegment) -> list[np.ndarray]:
    """A piece of a path as cubics (4, 2), lines and arcs too."""
    start, end = np.array(segment.start), np.array(segment.end)
    if len(segment.handles) == 2:
        return [np.array([start, *segment.handles, end])]
    if len(segment.handles) == 1:
        middle = np.array(segment.handles[0])
        return [np.stack([start, (start + 2.0 * middle) / 3.0, (end + 2.0 * middle) / 3.0, end])]
    return _arc_cubics(segment) if segment.is_arc else [line_as_cubic(start, end)]


def _arc_cubics(piece: PathSegment) -> list[np.ndarray]:
    """An arc in quarters or less. Radii that are too short are scaled up. Source: SVG 2, appendix B.2.4."""
    start, end = np.array(piece.start), np.array(piece.end)
    rx, ry, degrees, large, sweep = piece.numbers
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn, radii = np.array([[cos, -sin], [sin, cos]]), np.array([rx, ry])
    # As a part of a unit circle, the middle between its ends at the origin.
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
    step = span / count
    handle = 4.0 / 3.0 * math.tan(step / 4.0)
    angles = first + step * np.arange(count + 1)
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ahead = handle * np.stack([-rim[:, 1], rim[:, 0]], axis=1)
    quarters = np.stack([rim[:-1], rim[:-1] + ahead[:-1], rim[1:] - ahead[1:], rim[1:]], axis=1)
    cubics = ((centre + quarters) * radii) @ turn.T + (start + end) / 2.0
    cubics[0, 0], cubics[-1, 3] = piece.start, piece.end
    return [*cubics]
