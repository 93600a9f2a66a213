"""The bytes of files: of those the user named never a pipe, which would block, nor what is absurdly large."""

from __future__ import annotations

import gzip
import stat
import zlib
from pathlib import Path

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.marks import GZIP

MAX_FILE_BYTES = 1 << 30
MAX_UNPACKED_BYTES = 1 << 28


def read_file(path: Path) -> bytes:
    """The bytes of a regular file of at most 1 GiB, a compressed SVG (.svgz) unpacked.

    Raises InputError, naming the file, for anything else.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: is no regular file; give a file")
        if status.st_size > MAX_FILE_BYTES:
            raise InputError(f"{path}: has {status.st_size} bytes; files of at most {MAX_FILE_BYTES} bytes are read")
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; check the path") from error
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read ({reason}); check the path and its permissions") from error
    return unpacked(data, str(path))


def unpacked(data: bytes, name: str) -> bytes:
    """The content of a gzip file, or `data` where it is none.

    Raises InputError, naming the file, where it is damaged or holds more than a limit: a small file can hold any
    number of zeros.
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
    """The bytes of an SVG file: UTF-8, or gzip of it without a time stamp: the same SVG gives the same bytes."""
    data = svg.encode()
    return gzip.compress(data, mtime=0) if compressed else data


def looks_like_svg(path: Path, data: bytes) -> bool:
    """By name, or because the file starts like XML, which no raster format does."""
    return path.suffix.lower() in (".svg", ".svgz") or data[:256].lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")
