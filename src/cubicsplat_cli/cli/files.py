"""Reading the bytes of a file the user named: never a pipe, which would block, nor what is absurdly large."""

from __future__ import annotations

import stat
from pathlib import Path

from cubicsplat_cli.errors import InputError

MAX_FILE_BYTES = 1 << 30


def read_file(path: Path) -> bytes:
    """The bytes of a regular file of at most 1 GiB; InputError, naming the file, for anything else."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: is no regular file; give a file")
        if status.st_size > MAX_FILE_BYTES:
            raise InputError(
                f"{path}: has {status.st_size} bytes; files of at most {MAX_FILE_BYTES} bytes are read"
            )
        return path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; check the path") from error
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read ({reason}); check the path and its permissions") from error


def looks_like_svg(path: Path, data: bytes) -> bool:
    """By name, or because the file starts like XML, which no raster format does."""
    return path.suffix.lower() in (".svg", ".svgz") or data[:256].lstrip(b"\xef\xbb\xbf \t\r\n").startswith(
        b"<"
    )
