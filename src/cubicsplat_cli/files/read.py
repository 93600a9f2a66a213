"""Read files: never a pipe that the user named, which would block, and nothing absurdly large."""

from __future__ import annotations

import gzip
import io
import stat
import sys
import zlib
from pathlib import Path

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.marks import GZIP
from cubicsplat_cli.formatting import printable

MAX_FILE_BYTES = 1 << 30
MAX_UNPACKED_BYTES = 1 << 28
MAX_SVG_BYTES = 1 << 26  # of an SVG that is drawn or measured


def read_whole(path: Path, name: str | None = None) -> bytes:
    """Return the bytes of a regular file of at most 1 GiB; open nothing else.

    name: replaces the path in messages. Raises InputError for anything else, and for a file that cannot be read.
    """
    shown = printable(name or str(path))
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{shown}: is a folder; give a file in it")
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{shown}: is a pipe, socket or device; give a regular file")
        check_size(status.st_size, shown)
        return path.read_bytes()
    except FileNotFoundError as error:
        advice = "download it first" if shown.startswith(("http:", "https:")) else "check the path"
        raise InputError(f"{shown}: no such file; {advice}") from error
    except PermissionError as error:
        raise InputError(f"{shown}: no permission to read it; change its permissions") from error
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{shown}: cannot be read ({reason}); check the path and the disk") from error


def read_stdin(max_pixels: int = 0) -> bytes:
    """Return standard input, which may be endless: at most the bytes of an SVG, and those of a picture of `max_pixels`
    pixels. Raises InputError if there are more bytes, or if it cannot be read.
    """
    pixel_bytes = 16  # at most, in a file: four channels of 32 bits, not compressed
    limit, gathered = min(MAX_SVG_BYTES + pixel_bytes * max_pixels, MAX_FILE_BYTES), io.BytesIO()
    try:
        while chunk := sys.stdin.buffer.read(1 << 20):
            gathered.write(chunk)
            if gathered.tell() > limit:
                plain = limit == MAX_FILE_BYTES or not max_pixels
                reason = "the limit" if plain else f"what --max-pixels {max_pixels} needs"
                raise InputError(f"stdin: is larger than {limit >> 20} MiB, {reason}; give a smaller file")
    except OSError as error:
        raise InputError(f"stdin: cannot be read ({error.strerror}); give a file") from error
    except MemoryError as error:
        raise InputError("stdin: is larger than the memory that there is; give a smaller file") from error
    return gathered.getvalue()


def check_size(size: int, shown: str) -> None:
    """Raise InputError for a file of too many bytes."""
    if size > MAX_FILE_BYTES:
        raise InputError(f"{shown}: is {size >> 20} MiB, the limit is {MAX_FILE_BYTES >> 20} MiB; give a smaller file")


def read_file(path: Path) -> bytes:
    """Return the bytes of a file (`read_whole`), unpacked if it is a compressed SVG (.svgz)."""
    return unpacked(read_whole(path), str(path))


def unpacked(data: bytes, name: str) -> bytes:
    """Return the content of a gzip file, or `data` if it is none.

    Raises InputError, naming the file, if it is damaged, or if its content, perhaps mere zeros, is over a limit.
    """
    if not data.startswith(GZIP):
        return data
    unpacker = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        content = unpacker.decompress(data, MAX_UNPACKED_BYTES)
    except zlib.error as error:
        raise InputError(f"{name}: is compressed, but damaged ({error}); save or download it again") from error
    if unpacker.unconsumed_tail:
        raise InputError(f"{name}: holds more than {MAX_UNPACKED_BYTES >> 20} MiB when unpacked; give a smaller file")
    if not unpacker.eof:
        raise InputError(f"{name}: is compressed, but cut short; save or download it again")
    return content


def packed(svg: str, *, compressed: bool) -> bytes:
    """Return the bytes of an SVG file: UTF-8, or its gzip without a time stamp, so that equal SVGs give equal bytes."""
    data = svg.encode()
    return gzip.compress(data, mtime=0) if compressed else data


def gzip_size(svg: str) -> int:
    """Return the bytes of an SVG file that `packed` compresses; gzip adds 12 bytes more to a stream than zlib."""
    return len(zlib.compress(svg.encode(), 9)) + 12


def looks_like_svg(path: Path, data: bytes) -> bool:
    """Return whether a file is an SVG by its name, or begins like XML, which no raster format does."""
    return path.suffix.lower() in (".svg", ".svgz") or data[:256].lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")
