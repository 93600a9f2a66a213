"""Compact path data in whole units: `M x y`, cubics absolute or relative, whichever is shorter, `z` where closed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np


def format_number(value: int, precision: int) -> str:
    """`value` * 10^-precision as short decimal text: no leading zero, no trailing zeros, no exponent.

    >>> format_number(-50, 2), format_number(1234, 2), format_number(300, 2)
    ('-.5', '12.34', '3')
    """
    sign = "-" if value < 0 else ""
    digits = str(abs(value))
    if precision == 0:
        return sign + digits
    digits = digits.rjust(precision + 1, "0")
    whole, fraction = digits[:-precision], digits[-precision:].rstrip("0")
    if not fraction:
        return "0" if whole == "0" else sign + whole
    return f"{sign}{'' if whole == '0' else whole}.{fraction}"


def ring_slices(ring_ends: np.ndarray, *, closed: bool) -> list[list[slice]]:
    """Which of its control points each ring of each curve has: ring_ends (N, R) as in `Scene`."""
    shared = 0 if closed else 1
    rows = [[0, *row] for row in ring_ends.tolist()]
    return [[slice(3 * a, 3 * b + shared) for a, b in itertools.pairwise(row) if a < b] for row in rows]


def path_strings(points: np.ndarray, ring_ends: np.ndarray | None = None, *, closed: bool) -> list[str]:
    """The `d` attribute of every curve, with a subpath for each of its rings.

    points: (N, K, 2) int64, K = 3M (closed) or 3M + 1 (open). ring_ends: as in `Scene`. Whole numbers need no decimal
    point, so the unit of the path is the step of the grid, and a transform brings it to pixels. Relative coordinates
    are differences of grid points, so no rounding error builds up along a curve.
    """
    if ring_ends is None:
        return _chains(points, closed)
    return [
        "".join(_chains(curve[None, ring], closed)[0] for ring in rings)
        for curve, rings in zip(points, ring_slices(ring_ends, closed=closed), strict=True)
    ]


def _chains(points: np.ndarray, closed: bool) -> list[str]:
    """Path data of curves of one ring and equal length (N, K, 2)."""
    count, per_curve = points.shape[:2]
    segments = per_curve // 3
    ends = 3 * np.arange(segments)[:, None] + np.array([1, 2, 3])
    absolute = points[:, ends % per_curve if closed else ends]  # (N, M, 3, 2)
    relative = absolute - points[:, 3 * np.arange(segments)][:, :, None]
    flat_shape = (count, segments, 6)
    end = "z" if closed else ""
    return [
        "M" + _join(start) + _cubics(curve_absolute, curve_relative) + end
        for start, curve_absolute, curve_relative in zip(
            points[:, 0].tolist(),
            absolute.reshape(flat_shape).tolist(),
            relative.reshape(flat_shape).tolist(),
            strict=True,
        )
    ]


def _cubics(absolute: Sequence[Sequence[int]], relative: Sequence[Sequence[int]]) -> str:
    """One curve's segments, each in its shorter form; the letter is left out where it repeats."""
    pieces: list[str] = []
    letter = ""
    for absolute_numbers, relative_numbers in zip(absolute, relative, strict=True):
        lower, upper = _join(relative_numbers), _join(absolute_numbers)
        lower = (_separator(lower) if letter == "c" else "c") + lower
        upper = (_separator(upper) if letter == "C" else "C") + upper
        take_lower = len(lower) < len(upper) or (len(lower) == len(upper) and letter != "C")
        letter = "c" if take_lower else "C"
        pieces.append(lower if take_lower else upper)
    return "".join(pieces)


def _separator(number: str) -> str:
    """What must stand before a number that follows another: nothing before a minus."""
    return "" if number[0] == "-" else " "


def _join(numbers: Sequence[int]) -> str:
    # A minus separates numbers as well as a space does.
    return " ".join(map(str, numbers)).replace(" -", "-")
