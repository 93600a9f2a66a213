"""What takes long to make and is the same each time, kept in the user's folder for such things.

It is a convenience: a damaged file, or a folder that cannot be written, costs the time to make it again.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from pathlib import Path

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.write import write_atomically

_MAGIC = b"cubicsplat cache 1\n"  # at the start of each file


def cache_folder(kind: str) -> Path | None:
    """The folder of what is kept of a kind, by the custom of the platform; None where the user has no such place."""
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
    return base / "cubicsplat" / kind


def read_cache(kind: str, key: str) -> bytes | None:
    """What is kept under a key, or None where there is nothing that is whole."""
    folder = cache_folder(kind)
    try:
        data = (folder / f"{key}.bin").read_bytes() if folder else b""
    except OSError:
        return None
    head = len(_MAGIC) + hashlib.sha256().digest_size
    kept = data[head:]
    return kept if kept and data[:head] == _MAGIC + hashlib.sha256(kept).digest() else None


def write_cache(kind: str, key: str, data: bytes) -> None:
    """Keeps data under a key; gives up where it may not write."""
    folder = cache_folder(kind)
    if folder is None:
        return
    with contextlib.suppress(OSError, InputError):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / f"{key}.bin", _MAGIC + hashlib.sha256(data).digest() + data)
