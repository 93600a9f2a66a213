"""Write results: files, of which any reader sees either the old or the whole new one; PNGs with our mark; and standard
output, with an error instead of a traceback. Also keep, in the user's cache folder, data that take long to make.

A process that is killed while it writes leaves its temporary file behind. The writer holds a lock on that file, which
ends with the process. So the next writer of the same target can tell the file of a dead writer, and remove it.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
import re
import stat
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if sys.platform != "win32":
    import fcntl

from cubicsplat_cli._version import __version__
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.marks import PROGRAM
from cubicsplat_cli.formatting import one_line, printable

if TYPE_CHECKING:
    import numpy as np
    from PIL import Image

STDOUT = "standard output"  # as messages call it
_CREATE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
_CACHED = b"cubicsplat cache 1\n"  # at the start of each file of the cache
_NAME_PART = 40  # characters of the target's name in that of its temporary file


def write_atomically(path: Path, data: bytes) -> None:
    """Write `data` to `path` through a temporary file in the same folder, flushed to disk, then renamed.

    A symbolic link stays, and its target is replaced. An existing file keeps its permissions. On any failure, Ctrl-C
    included, the temporary file is removed and the old file stays. Raises InputError if the folder is missing or not
    writable, the disk is full, or `path` is a folder, write-protected or no regular file.
    """
    target, mode = _check_target(path)
    temporary = _temporary_name(target)
    _remove_left_behind(target)
    try:
        with os.fdopen(_create_locked(temporary), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if mode is not None and stat.S_IMODE(temporary.stat().st_mode) != mode:
            temporary.chmod(mode)
        temporary.replace(target)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(_explain(error, path)) from error
        raise


@contextlib.contextmanager
def folder_locked(folder: Path) -> Iterator[None]:
    """Within, other processes that lock the same folder wait. The lock ends with its process, and leaves no file. On
    Windows, and on some network file systems, folders cannot be locked; there nobody waits.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, descriptor)
            _lock(descriptor)
        yield


def check_writable(path: Path) -> None:
    """Find out before a long fit whether `write_atomically(path, ...)` can work.

    Creates and removes an empty temporary file in the folder, which also tests read-only mounts and access lists.
    Raises the InputError that writing would raise, unless the disk fills up later.
    """
    temporary = _temporary_name(_check_target(path)[0])
    try:
        os.close(os.open(temporary, _CREATE, 0o600))
        temporary.unlink()
    except OSError as error:
        raise InputError(_explain(error, path)) from error


def _temporary_name(target: Path) -> Path:
    return target.with_name(f".{target.name[:_NAME_PART]}.{os.urandom(6).hex()}.tmp")


def _create_locked(temporary: Path) -> int:
    """Return a descriptor of the new file, locked while it is open."""
    while True:
        descriptor = os.open(temporary, _CREATE, 0o666)
        if not _lock(descriptor) or os.fstat(descriptor).st_nlink > 0:
            return descriptor
        os.close(descriptor)  # another writer has removed it before it was locked


def _lock(descriptor: int) -> bool:
    """Lock a file or a folder; return False where locks do not exist (Windows, some network file systems)."""
    if sys.platform == "win32":  # where a file that is open elsewhere cannot be removed anyway
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    except OSError:
        return False
    return True


def _remove_left_behind(target: Path) -> None:
    """Remove temporary files of writers of `target` that were killed."""
    pattern = re.compile(re.escape(f".{target.name[:_NAME_PART]}.") + r"[0-9a-f]{12}\.tmp")
    try:
        temporaries = [path for path in target.parent.iterdir() if pattern.fullmatch(path.name)]
    except OSError:  # the folder can be written but not listed
        return
    for path in temporaries:
        with contextlib.suppress(OSError):  # the file is in use, gone, or not ours
            _remove_if_dead(path)


def _remove_if_dead(temporary: Path) -> None:
    """Remove a temporary file that nobody is writing. Raises OSError if somebody is."""
    if sys.platform == "win32":
        temporary.unlink()
        return
    descriptor = os.open(temporary, os.O_RDWR)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        temporary.unlink()
    finally:
        os.close(descriptor)


def _check_target(path: Path) -> tuple[Path, int | None]:
    """Return the path with links followed, and the permission bits of an existing file, else None.

    Raises InputError for anything that a file cannot or may not replace.
    """
    shown = printable(str(path))
    try:
        target = path.resolve()
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a null byte
        raise InputError(f"{shown}: is no usable path ({one_line(error)}); choose another output") from error
    try:
        status = target.stat()
    except FileNotFoundError:
        return target, None
    except OSError as error:
        raise InputError(_explain(error, path)) from error
    if stat.S_ISDIR(status.st_mode):
        raise InputError(f"{shown}: is a folder; give the name of a file in it")
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{shown}: is a pipe, socket or device; give a regular file, or - for standard output")
    if not os.access(target, os.W_OK):
        raise InputError(f"{shown}: is write-protected; change its permissions or choose another output")
    return target, stat.S_IMODE(status.st_mode)


def _explain(error: OSError, path: Path) -> str:
    """Return the message for an error of writing a path."""
    shown, folder = printable(str(path)), printable(str(path.parent))
    if isinstance(error, FileNotFoundError) and not path.parent.is_dir():
        return f"{shown}: the folder {folder} does not exist; create it first"
    if isinstance(error, NotADirectoryError):
        return f"{shown}: {folder} is not a folder; choose another output"
    if isinstance(error, PermissionError):
        return f"{shown}: no permission to write in {folder}; change its permissions or choose another output"
    reason = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)):
        return f"{shown}: cannot be written ({reason}); free some space or choose another output"
    return f"{shown}: cannot be written ({reason}); choose another output"


def write_stdout(data: bytes) -> None:
    """Write and flush. Raises InputError if the disk is full, SystemExit(1) if the reader has closed the pipe."""
    stdout = sys.__stdout__  # of the process: `sys.stdout` may be redirected
    if stdout is None:
        raise InputError(f"{STDOUT}: there is none; use -o")
    try:
        stdout.flush()
        stdout.buffer.write(data)
        stdout.buffer.flush()
    except OSError as error:
        # Python flushes once more when it ends, and would complain about the rest of the buffer.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise SystemExit(1) from error
        reason = error.strerror or str(error)
        raise InputError(f"{STDOUT}: cannot be written ({reason}); free some space or use -o") from error


def encoded(image: Image.Image, file_format: str, **options: object) -> bytes:
    """Return the file of an image in a format of Pillow, written with the format's options."""
    buffer = io.BytesIO()
    image.save(buffer, file_format, **options)
    return buffer.getvalue()


def encode_png(pixels: np.ndarray) -> bytes:
    """Return the PNG of (H, W, 4) uint8 straight RGBA, stored as RGB if every pixel is opaque."""
    import numpy as np
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    image = Image.fromarray(np.ascontiguousarray(pixels))
    if int(pixels[..., 3].min()) == 255:
        image = image.convert("RGB")
    info = PngInfo()
    info.add_text("Software", f"{PROGRAM} {__version__}")
    # Drawings are runs of one colour. Searching for runs alone takes two thirds of the time, and makes smaller files.
    return encoded(image, "PNG", pnginfo=info, compress_type=zlib.Z_RLE)


def cache_folder(kind: str) -> Path | None:
    """Return the folder of the data of a kind, by the custom of the platform; None if the user has no home."""
    windows = os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else None
    base = windows or os.environ.get("XDG_CACHE_HOME")
    try:
        folder = Path(base) if base else Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    except RuntimeError:  # neither HOME nor an entry in the user database, as in some containers
        return None
    return folder / "cubicsplat" / kind


def read_cache(kind: str, key: str) -> bytes | None:
    """Return the data under a key; None if there are none, or they are damaged: they are made again."""
    folder = cache_folder(kind)
    try:
        data = (folder / f"{key}.bin").read_bytes() if folder else b""
    except OSError:
        return None
    head = len(_CACHED) + hashlib.sha256().digest_size
    kept = data[head:]
    return kept if kept and data[:head] == _CACHED + hashlib.sha256(kept).digest() else None


def write_cache(kind: str, key: str, data: bytes) -> None:
    """Keep data under a key, if the folder can be written."""
    folder = cache_folder(kind)
    if folder is None:
        return
    with contextlib.suppress(OSError, InputError):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / f"{key}.bin", _CACHED + hashlib.sha256(data).digest() + data)
