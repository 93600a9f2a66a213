"""Path data of any SVG, command by command and as absolute pieces."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from cubicsplat_cli.errors import InputError

_TOKEN = re.compile(r"[\s,]*([MmLlHhVvCcSsQqTtAaZz]|[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)")
_FLAG = re.compile(r"[\s,]*([01])")
# How many numbers a command takes.
_NUMBERS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
_DECIMALS = 9
# Of one path, which takes some seconds and 200 MB; and of a subpath, for which each row of a scene has room.
MAX_COMMANDS, MAX_SEGMENTS = 500_000, 65_535
Point = tuple[float, float]


class TooLong(InputError):
    """Path data of more commands or segments than are read."""


@dataclass(frozen=True)
class Piece:
    """One command: its capital letter, where it starts and ends, and its handles (none, one or two), absolute.

    numbers: of an arc, its radii, the angle in degrees and the two flags.
    """

    command: str
    start: Point
    end: Point
    handles: tuple[Point, ...] = ()
    numbers: tuple[float, ...] = ()


def count_numbers(d: str) -> int:
    """Numbers in path data, but for the two flags of an arc."""
    return sum(_NUMBERS[letter.upper()] - 2 * (letter in "Aa") for letter, _ in commands(d))


def commands(d: str) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Each command with its numbers; a command that is left out where it repeats is given again."""
    position, letter, end = 0, "", len(d.rstrip())
    while position < end:
        found = _TOKEN.match(d, position)
        if found is None:
            raise InputError(f"path data cannot be read at {d[position : position + 12]!r}")
        if found[1].isalpha():
            letter, position = found[1], found.end()
        elif letter in ("", "Z", "z"):
            raise InputError(f"path data has a number without a command at {d[position : position + 12]!r}")
        numbers, position = _numbers(d, position, letter)
        yield letter, numbers
        letter = {"M": "L", "m": "l"}.get(letter, letter)


def _numbers(d: str, position: int, letter: str) -> tuple[tuple[float, ...], int]:
    numbers: list[float] = []
    for index in range(_NUMBERS[letter.upper()]):
        # Flags may stand without anything between them.
        flag = letter in "Aa" and index in (3, 4)
        found = (_FLAG if flag else _TOKEN).match(d, position)
        if found is None or found[1].isalpha():
            raise InputError(f"path data lacks a number of {letter} at {d[position : position + 12]!r}")
        numbers.append(float(found[1]))
        position = found.end()
    return tuple(numbers), position


def pieces(d: str) -> list[Piece]:
    """All commands but M as absolute pieces; of S and T the mirrored handle too. An arc has no handles."""
    return [piece for ring in subpaths(d) for piece in ring]


def subpaths(d: str) -> list[list[Piece]]:
    """The absolute pieces of each subpath, which ends with Z or before the next M.

    Raises InputError for bad path data, TooLong for too much of it.
    """
    found: list[list[Piece]] = []
    here = start = (0.0, 0.0)
    # What a glance shows need not be read first.
    if len(d) > MAX_COMMANDS and sum(map(d.count, "MmLlHhVvCcSsQqTtAaZz")) > MAX_COMMANDS:
        raise TooLong(f"path data of more than {MAX_COMMANDS} commands; simplify it")
    for count, (letter, numbers) in enumerate(commands(d)):
        command = letter.upper()
        if count == MAX_COMMANDS or (found and len(found[-1]) > MAX_SEGMENTS):
            raise TooLong(f"path data of more than {MAX_COMMANDS} commands, or {MAX_SEGMENTS} in a row; simplify it")
        if command == "M" or not found or (found[-1] and found[-1][-1].command == "Z"):
            found.append([])
        points = _points(letter, numbers, here) or [start]
        if command == "M":
            here = start = points[-1]
            continue
        found[-1].append(_piece(command, numbers, points, here, found[-1]))
        here = points[-1]
    return found


def _piece(command: str, numbers: tuple[float, ...], points: list[Point], here: Point, before: list[Piece]) -> Piece:
    handles = tuple(points[:-1])
    if command in "ST":
        handles = (_mirrored(before, here, command), *handles)
    return Piece(command, here, points[-1], handles, numbers[:5] if command == "A" else ())


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
    """Of decimals, without the noise of binary fractions, which would add up along a path."""
    return round(first + second, _DECIMALS)


def _mirrored(found: list[Piece], here: Point, command: str) -> Point:
    kin = "CS" if command == "S" else "QT"
    if not found or found[-1].command not in kin or found[-1].end != here:
        return here
    x, y = found[-1].handles[-1]
    return _sum(2.0 * here[0], -x), _sum(2.0 * here[1], -y)
