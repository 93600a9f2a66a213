"""Kinds of paths: a file, a folder, an SVG; whether cubicsplat wrote it and may replace it. Imports nothing heavy.

A path that cannot be examined (no permission, a name too long, a null byte) is no folder and no file; the code that
uses it reports the reason.
"""

from __future__ import annotations

import html
import os
import re
import zlib
from pathlib import Path

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.marks import GZIP, HEAD_BYTES, MADE, PROGRAM, sha256_of, svg_is_ours
from cubicsplat_cli.files.write import check_writable

MOVING = (".webp", ".gif")
EXPORTS = ("pdf", "ps", "eps", "dxf", "xml")  # formats of other programs, by the suffixes of their files
_PROGRAM = re.compile(rb'"program": ?"' + PROGRAM.encode() + b'"')  # in a JSON, spaced out or not
_TINY = b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 '  # how placeholders begin, which have no comment
_REPORT = f'{{\n  "schema": 1,\n  "program": "{PROGRAM}"'.encode()  # how every report of ours begins
# Through links; False for a path that cannot be examined. Path's own methods raise an error for some of these.
is_folder, is_file, is_there = os.path.isdir, os.path.isfile, os.path.exists


def format_of(path: Path) -> str | None:
    """Return the format of other programs that a path's suffix names, None for other suffixes."""
    form = path.suffix[1:].lower()
    return form if form in EXPORTS else None


def same_file(first: Path, second: Path) -> bool:
    """Return whether two paths lead to the same existing file, links and letter case considered."""
    try:
        return first.samefile(second)
    except (OSError, ValueError):  # one does not exist or cannot be examined: writing one cannot harm the other
        return False


def make_folder_of(path: Path) -> None:
    """Make the folder of a file if it is missing. Raises InputError if that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise InputError(f"{path.parent}: is a file, but {path.name} needs a folder; choose another with -o") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path.parent}: folder cannot be created ({reason}); choose another with -o") from error


def check_outputs(paths: list[Path], *, force: bool) -> None:
    """Raise InputError where a file cannot be written, UsageError where it may not be (`check_ownership`)."""
    for path in paths:
        check_writable(path)
    check_ownership(paths, force=force)


def check_ownership(paths: list[Path], *, force: bool, source: Path | None = None) -> None:
    """Raise UsageError where a file is the source, or exists, cubicsplat did not write it and `force` is not given."""
    for path in paths:
        if source is not None and same_file(path, source):
            raise UsageError(f"{path} is the input and would be overwritten; choose another output with -o")
    for path in paths:
        if not force and not is_replaceable(path):
            tiny = _head(path).startswith(_TINY)
            other = ", or is a placeholder whose JSON is gone" if tiny else ""
            text = f"{path} exists and was not written by cubicsplat{other}; use --force or choose another output"
            raise UsageError(text)


def is_replaceable(path: Path) -> bool:
    """Return whether writing `path` destroys nobody's work: there is nothing, a file that cubicsplat wrote, or a file
    of 0 bytes, as a crashed disk leaves them.
    """
    return not is_there(path) or is_ours(path) or (is_file(path) and path.stat().st_size == 0)


def is_ours(path: Path) -> bool:
    """Return whether a regular file carries the mark of a file that cubicsplat wrote; False if it cannot be read."""
    head, suffix = _head(path), path.suffix.lower()
    if not head:
        return False
    if suffix == ".png":
        return f"tEXtSoftware\0{PROGRAM} ".encode() in head
    if suffix in MOVING:
        return f"{PROGRAM} ".encode() in read_ends(path)
    if format_of(path) is not None:
        return MADE.search(read_ends(path)) is not None
    if suffix == ".json":
        # A report that was cut short counts too.
        return _PROGRAM.search(head) is not None or _REPORT.startswith(head)
    return svg_is_ours(head) or _is_in_report(path)


def is_lottie(path: Path) -> bool:
    """Return whether a file is a Lottie animation that cubicsplat wrote."""
    return _head(path).startswith(b'{"meta":{"program":')


def _is_in_report(path: Path) -> bool:
    """Return whether the JSON beside an SVG is ours and names its SHA-256: the smallest files carry no mark."""
    report = path.with_suffix(".json")
    try:
        return is_ours(report) and f'"svg_sha256": "{sha256_of(path.read_bytes())}"'.encode() in report.read_bytes()
    except OSError:
        return False


def pictured_name(path: Path) -> str | None:
    """Return the title of an SVG of ours, which is the name of its picture; None if there is no such SVG."""
    head = _head(path)
    title = re.search(rb"<title>(.*?)</title>", head, re.DOTALL) if svg_is_ours(head) else None
    return None if title is None else html.unescape(title[1].decode(errors="replace"))


def is_svg(path: Path) -> bool:
    """Return whether a regular file begins like an SVG or any XML; False if it cannot be read."""
    return _head(path).lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith((b"<svg", b"<?xml"))


def is_marked(path: Path, mark: str) -> bool:
    """Return whether there is a file whose first or last bytes hold a mark. Raises OSError if it cannot be read."""
    return is_file(path) and mark.encode() in read_ends(path)


def _head(path: Path) -> bytes:
    """Return `read_head` of a regular file; nothing if there is none, or it cannot be read."""
    try:
        return read_head(path) if is_file(path) else b""
    except OSError:
        return b""


def read_ends(path: Path) -> bytes:
    """Return the first and the last bytes of a file: a GIF has its comment in front, a WebP its texts at the end."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        file.seek(max(len(head), path.stat().st_size - HEAD_BYTES))
        return head + file.read()


def read_head(path: Path) -> bytes:
    """Return the first bytes of a file, unpacked if it is compressed; they contain the mark of our files."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    if not head.startswith(GZIP):
        return head
    try:
        return zlib.decompressobj(16 + zlib.MAX_WBITS).decompress(head, HEAD_BYTES)
    except zlib.error:
        return head
