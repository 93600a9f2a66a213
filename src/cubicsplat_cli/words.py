"""Foreign text (file names, other programs' errors) as part of a message that stays one line. Imports nothing."""

from __future__ import annotations


def printable(text: str) -> str:
    """`text` with control characters, line ends and undecodable bytes escaped: a file name may hold any."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def one_line(text: object) -> str:
    """`str(text)`, such as an error's, with its line ends and runs of spaces as single spaces."""
    return " ".join(str(text).split())
