"""Compiled kernels on disk. A convenience: a damaged file, or a folder that cannot be written, costs a compilation."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
from pathlib import Path

_MAGIC = b"cubicsplat cubin 1\n"


def cache_folder() -> Path | None:
    """Where the compiled kernels lie, by the custom of the platform; None where the user has no such place."""
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        base = Path(os.environ["LOCALAPPDATA"])
    elif os.environ.get("XDG_CACHE_HOME"):
        base = Path(os.environ["XDG_CACHE_HOME"])
    else:
        try:
            home = Path.home()
        except RuntimeError:  # neither HOME nor an entry in the user database, as in some containers
            return None
        base = home / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    return base / "cubicsplat" / "cuda"


def read(key: str) -> bytes | None:
    """The code kept under a key, or None where there is none that is whole."""
    folder = cache_folder()
    try:
        data = (folder / f"{key}.bin").read_bytes() if folder else b""
    except OSError:
        return None
    head = len(_MAGIC) + hashlib.sha256().digest_size
    code = data[head:]
    return code if code and data[:head] == _MAGIC + hashlib.sha256(code).digest() else None


def write(key: str, code: bytes) -> None:
    """Writes beside the place and moves, so that no reader ever sees half a file; gives up where it may not write."""
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = tempfile.mkstemp(dir=folder, prefix=".new-")
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(_MAGIC + hashlib.sha256(code).digest() + code)
            Path(temporary).replace(folder / f"{key}.bin")
        except OSError:
            Path(temporary).unlink(missing_ok=True)
