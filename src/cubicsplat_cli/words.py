"""The words of messages: foreign text on one line, times, sizes and counts as people say them. Imports nothing."""

from __future__ import annotations

from collections.abc import Iterable


def printable(text: str) -> str:
    """`text` with control characters, line ends and undecodable bytes escaped: a file name may hold any."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def one_line(text: object) -> str:
    """`str(text)`, such as an error's, with its line ends and runs of spaces as single spaces."""
    return " ".join(str(text).split())


def did_you_mean(given: object, known: Iterable[str]) -> str:
    """`; did you mean white?`, the nearest of the known names; empty where none is near."""
    import difflib

    close = difflib.get_close_matches(str(given), known, 1)
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


def counted(count: int, noun: str) -> str:
    """`1 curve`, `2 curves`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
