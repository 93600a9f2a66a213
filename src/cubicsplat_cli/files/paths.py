"""Kinds of paths: a file, a folder, an SVG; whether cubicsplat wrote it and may replace it. Imports nothing heavy.

A path that cannot be looked at (no permission, a name too long, a null byte) is no folder and no file; whoever uses it
finds out why, and says so.
"""

from __future__ import annotations

import html
import re
import stat
import zlib
from pathlib import Path

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.marks import GZIP, HEAD_BYTES, PROGRAM, holds_made_mark, sha256_of, svg_is_ours

MOVING = (".webp", ".gif")
EXPORTS = ("pdf", "ps", "eps", "dxf", "xml")  # formats of other programs, by the suffixes of their files
_TITLE = re.compile(rb"<title>(.*?)</title>", re.DOTALL)
_PROGRAM = re.compile(rb'"program": ?"' + PROGRAM.encode() + b'"')  # in a JSON, spaced out or not
_REPORT = f'{{\n  "schema": 1,\n  "program": "{PROGRAM}"'.encode()  # how every report of ours begins


def format_of(path: Path) -> str | None:
    """The format of other programs that a path names by its suffix, None for any other."""
    form = path.suffix[1:].lower()
    return form if form in EXPORTS else None


def is_folder(path: Path) -> bool:
    """Whether there is a folder, links followed."""
    return stat.S_ISDIR(_kind(path))


def is_file(path: Path) -> bool:
    """Whether there is a regular file, links followed."""
    return stat.S_ISREG(_kind(path))


def is_there(path: Path) -> bool:
    """Whether there is anything, links followed."""
    return _kind(path) != 0


def same_file(first: Path, second: Path) -> bool:
    """Whether two paths lead to the same existing file, links and letter case considered."""
    try:
        return first.samefile(second)
    except (OSError, ValueError):
        # One of them does not exist (or cannot be looked at), so writing the one cannot harm the other.
        return False


def make_folder_of(path: Path) -> None:
    """Make the folder that a file is to lie in, where it is missing. Raises InputError where that cannot be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise InputError(f"{path.parent}: is a file, but {path.name} needs a folder; choose another with -o") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path.parent}: folder cannot be created ({reason}); choose another with -o") from error


def _kind(path: Path) -> int:
    try:
        return path.stat().st_mode
    except (OSError, ValueError):
        return 0


def check_outputs(paths: list[Path], *, force: bool) -> None:
    """Find out before the work whether every file can be written and may be replaced.

    Raises InputError where a file cannot be written, UsageError where one exists that cubicsplat did not
    write and `force` is not given.
    """
    from cubicsplat_cli.files.write import check_writable

    for path in paths:
        check_writable(path)
    check_ownership(paths, force=force)


def check_ownership(paths: list[Path], *, force: bool) -> None:
    """Raise UsageError where a file exists that cubicsplat did not write and `force` is not given."""
    for path in paths:
        if not force and not is_replaceable(path):
            raise UsageError(f"{path} exists and was not written by cubicsplat; use --force or choose another output")


def is_replaceable(path: Path) -> bool:
    """Whether writing `path` destroys nobody's work: there is nothing, a file of ours, or a file of 0 bytes, as a
    crashed disk leaves them.
    """
    return not is_there(path) or is_ours(path) or (is_file(path) and path.stat().st_size == 0)


def is_ours(path: Path) -> bool:
    """Whether an existing regular file carries the mark that cubicsplat leaves in what it writes.

    A file that cannot be read is not ours, as far as we can tell.
    """
    if not is_file(path):
        return False
    try:
        head = read_head(path)
    except OSError:
        return False
    if path.suffix.lower() == ".png":
        return f"tEXtSoftware\0{PROGRAM} ".encode() in head
    if path.suffix.lower() in MOVING:
        return f"{PROGRAM} ".encode() in read_ends(path)
    if format_of(path) is not None:
        return holds_made_mark(read_ends(path))
    if path.suffix.lower() == ".json":
        # A report that was cut short is ours too.
        return _PROGRAM.search(head) is not None or (head != b"" and _REPORT.startswith(head))
    return svg_is_ours(head) or _is_in_report(path)


def _is_in_report(path: Path) -> bool:
    """Whether the JSON beside an SVG is ours and names its SHA-256: the smallest files carry no mark."""
    report = path.with_suffix(".json")
    try:
        return is_ours(report) and f'"svg_sha256": "{sha256_of(path.read_bytes())}"'.encode() in report.read_bytes()
    except OSError:
        return False


def pictured_name(path: Path) -> str | None:
    """The name of the picture that an SVG of ours was made of, which is its title; None where there is no such file."""
    try:
        head = read_head(path) if is_file(path) else b""
    except OSError:
        return None
    title = _TITLE.search(head) if svg_is_ours(head) else None
    return None if title is None else html.unescape(title[1].decode(errors="replace"))


def is_svg(path: Path) -> bool:
    """Whether a regular file begins like an SVG or any XML; not where it cannot be read."""
    try:
        return is_file(path) and read_head(path).lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith((b"<svg", b"<?xml"))
    except OSError:
        return False


def read_ends(path: Path) -> bytes:
    """The first and the last bytes of a file: a GIF has its comment in front, a WebP its texts at the end."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        file.seek(max(len(head), path.stat().st_size - HEAD_BYTES))
        return head + file.read()


def read_head(path: Path) -> bytes:
    """The first bytes of a file, unpacked where it is compressed; marks of ours are in them."""
    with path.open("rb") as file:
        return head_of(file.read(HEAD_BYTES))


def head_of(data: bytes) -> bytes:
    """`read_head` of a file's bytes."""
    head = data[:HEAD_BYTES]
    if not head.startswith(GZIP):
        return head
    try:
        return zlib.decompressobj(16 + zlib.MAX_WBITS).decompress(head, HEAD_BYTES)
    except zlib.error:
        return head
