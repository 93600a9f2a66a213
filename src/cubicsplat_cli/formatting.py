"""Text for people and programs: names, durations, sizes and counts in messages, and tables of figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def printable(text: str) -> str:
    """`text` with control characters, line ends and undecodable bytes escaped: a file name may hold any."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def one_line(text: object) -> str:
    """`str(text)`, such as an error's, with its line ends and runs of spaces as single spaces."""
    return " ".join(str(text).split())


def did_you_mean(given: object, names: Iterable[str]) -> str:
    """`; did you mean white?`, the nearest of the names; empty where none is near."""
    import difflib

    close = difflib.get_close_matches(str(given), names, 1)
    return f"; did you mean {close[0]}?" if close else ""


def duration(seconds: float) -> str:
    """Seconds as people say them: `0.8 s`, `47 s`, `2 min 05 s`, `1 h 03 min`."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def file_size(count: int) -> str:
    """Bytes in decimal units: `612 B`, `61 kB`, `6.4 MB`."""
    if count < 1000:
        return f"{count} B"
    if count < 9_950:
        return f"{count / 1000:.1f} kB"
    if count < 999_500:
        return f"{count / 1000:.0f} kB"
    return f"{count / 1e6:.1f} MB"


def hex_text(colour: Iterable[int]) -> str:
    """`#rrggbb`, or `#rrggbbaa`, of channels of 8 bits."""
    return "#" + bytes(colour).hex()


def counted(count: int, noun: str) -> str:
    """`1 curve`, `2 curves`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows with the same members as CSV with a header; None is an empty field, a float has at most six decimals."""
    import csv
    import io

    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    if rows:
        writer.writerow(rows[0].keys())
    for row in rows:
        writer.writerow(_csv_field(value) for value in row.values())
    return buffer.getvalue()


def _csv_field(value: Any) -> Any:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6f}".rstrip("0").rstrip(".") if isinstance(value, float) else value


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], *, markdown: bool = False) -> str:
    """Cells as lines of equally wide columns, the first to the left and the others to the right; ends in a newline."""
    cells = [[cell.replace("|", "\\|") if markdown else cell for cell in row] for row in (header, *rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(header))]
    lines = [
        [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        for row in cells
    ]
    if not markdown:
        return "".join("  ".join(line).rstrip() + "\n" for line in lines)
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    return "".join("| " + " | ".join(line) + " |\n" for line in (lines[0], rule, *lines[1:]))


def titled(title: str, table: str, *, markdown: bool = False) -> str:
    """A table below its title."""
    return f"### {title}\n\n{table}" if markdown else f"{title}\n{table}"


def number(value: float | None, decimals: int, *, sign: bool = False) -> str:
    """A figure with so many decimals, or a dash where there is none."""
    if value is None:
        return "-"
    return f"{value:{'+' if sign else ''}.{decimals}f}"


def mean(values: Iterable[float | None]) -> float | None:
    """Mean of the values that there are; None where there is none."""
    numbers = [value for value in values if value is not None]
    return sum(numbers) / len(numbers) if numbers else None
