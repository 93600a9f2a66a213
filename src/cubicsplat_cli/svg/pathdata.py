"""Compact path data: `M x y`, cubics absolute or relative whichever is shorter, `z` for closed curves."""

from __future__ import annotations

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


def format_numbers(values: np.ndarray, precision: int) -> np.ndarray:
    """Format an int64 array into str objects of the same shape; each distinct value is formatted once."""
    distinct, inverse = np.unique(values, return_inverse=True)
    texts = np.empty(len(distinct), dtype=object)
    texts[:] = [format_number(value, precision) for value in distinct.tolist()]
    return texts[inverse.reshape(values.shape)]


def path_strings(points: np.ndarray, precision: int, *, closed: bool) -> list[str]:
    """The `d` attribute of every curve.

    points: (N, K, 2) int64 on the grid of 10^-precision px, K = 3M (closed) or 3M + 1 (open). Relative
    coordinates are differences of grid points, so no rounding error builds up along a curve.
    """
    count, per_curve = points.shape[:2]
    segments = per_curve // 3
    ends = 3 * np.arange(segments)[:, None] + np.array([1, 2, 3])
    absolute = points[:, ends % per_curve if closed else ends]  # (N, M, 3, 2)
    relative = absolute - points[:, 3 * np.arange(segments)][:, :, None]
    starts = format_numbers(points[:, 0], precision).tolist()
    flat_shape = (count, segments, 6)
    absolute_texts = format_numbers(absolute.reshape(flat_shape), precision).tolist()
    relative_texts = format_numbers(relative.reshape(flat_shape), precision).tolist()
    end = "z" if closed else ""
    return [
        "M" + _join(start) + _cubics(curve_absolute, curve_relative) + end
        for start, curve_absolute, curve_relative in zip(starts, absolute_texts, relative_texts, strict=True)
    ]


def _cubics(absolute: Sequence[Sequence[str]], relative: Sequence[Sequence[str]]) -> str:
    """One curve's segments, each in its shorter form; the letter is left out where it repeats."""
    pieces: list[str] = []
    letter, last = "", ""
    for absolute_numbers, relative_numbers in zip(absolute, relative, strict=True):
        lower, upper = _join(relative_numbers), _join(absolute_numbers)
        lower = (_separator(last, lower) if letter == "c" else "c") + lower
        upper = (_separator(last, upper) if letter == "C" else "C") + upper
        take_lower = len(lower) < len(upper) or (len(lower) == len(upper) and letter != "C")
        letter, last = ("c", relative_numbers[-1]) if take_lower else ("C", absolute_numbers[-1])
        pieces.append(lower if take_lower else upper)
    return "".join(pieces)


def _separator(before: str, after: str) -> str:
    """What must stand between two numbers: a minus separates, so does a second point."""
    if after[0] == "-" or (after[0] == "." and "." in before):
        return ""
    return " "


def _join(numbers: Sequence[str]) -> str:
    pieces = [numbers[0]]
    before = numbers[0]
    for number in numbers[1:]:
        first = number[0]
        if first == "-" or (first == "." and "." in before):
            pieces.append(number)
        else:
            pieces.append(" " + number)
        before = number
    return "".join(pieces)
