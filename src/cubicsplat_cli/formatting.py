"""Text for people and programs: names, durations, sizes and counts in messages, and tables of figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def printable(text: str) -> str:
    """Return `text` with control characters, line ends and undecodable bytes escaped: a file name may hold any."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def one_line(text: object) -> str:
    """Return `str(text)`, for example of an error, in one line with single spaces."""
    return " ".join(str(text).split())


def did_you_mean(given: object, names: Iterable[str]) -> str:
    """Return `; did you mean white?` with the most similar name, or "" if none is similar."""
    import difflib

    close = difflib.get_close_matches(str(given), names, 1)
    return f"; did you mean {close[0]}?" if close else ""


def duration(seconds: float) -> str:
    """Return seconds as people say them: `0.8 s`, `47 s`, `2 min 05 s`, `1 h 03 min`."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def file_size(count: int) -> str:
    """Return bytes in decimal units: `612 B`, `61 kB`, `6.4 MB`."""
    if count < 1000:
        return f"{count} B"
    if count < 9_950:
        return f"{count / 1000:.1f} kB"
    if count < 999_500:
        return f"{count / 1000:.0f} kB"
    return f"{count / 1e6:.1f} MB"


def hex_text(colour: Iterable[int]) -> str:
    """Return `#rrggbb`, or `#rrggbbaa`, of channels of 8 bits."""
    return "#" + bytes(colour).hex()


def counted(count: int, noun: str) -> str:
    """Return `1 curve`, `2 curves`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def level_text(psnr_db: float | None, decimals: int = 2) -> str:
    """Return `31.92 dB`, or `identical` for None, the PSNR of pictures that do not differ."""
    return "identical" if psnr_db is None else f"{psnr_db:.{decimals}f} dB"


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of the same members as CSV with a header; None is an empty field, floats have up to six decimals."""
    import csv
    import io

    buffer = io.StringIO()
    header = [rows[0].keys()] if rows else []
    fields = ([_csv_field(value) for value in row.values()] for row in rows)
    csv.writer(buffer, lineterminator="\n").writerows([*header, *fields])
    return buffer.getvalue()


def _csv_field(value: Any) -> Any:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6f}".rstrip("0").rstrip(".") if isinstance(value, float) else value


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], *, markdown: bool = False) -> str:
    """Return cells as lines of columns, the first one left-aligned, the others right-aligned."""
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
    """Return a table below its title."""
    return f"### {title}\n\n{table}" if markdown else f"{title}\n{table}"


def number(value: float | None, decimals: int, *, sign: bool = False) -> str:
    """Return a figure with so many decimals; a dash for None."""
    return "-" if value is None else f"{value:{'+' if sign else ''}.{decimals}f}"


def mean(values: Iterable[float | None]) -> float | None:
    """Return the mean of the values that are not None; None if there are none."""
    numbers = [value for value in values if value is not None]
    return sum(numbers) / len(numbers) if numbers else None
