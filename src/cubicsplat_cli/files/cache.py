"""A cache of data that take long to make, in the user's cache folder. Damaged files and folders that cannot be written
are no errors: the data are made again.
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
    """Return the folder of the data of a kind, by the custom of the platform; None if the user has no home."""
    windows = os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else None
    base = windows or os.environ.get("XDG_CACHE_HOME")
    try:
        folder = Path(base) if base else Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    except RuntimeError:  # neither HOME nor an entry in the user database, as in some containers
        return None
    return folder / "cubicsplat" / kind


def read_cache(kind: str, key: str) -> bytes | None:
    """Return the data under a key; None if there are none, or they are damaged."""
    folder = cache_folder(kind)
    try:
        data = (folder / f"{key}.bin").read_bytes() if folder else b""
    except OSError:
        return None
    head = len(_MAGIC) + hashlib.sha256().digest_size
    kept = data[head:]
    return kept if kept and data[:head] == _MAGIC + hashlib.sha256(kept).digest() else None


def write_cache(kind: str, key: str, data: bytes) -> None:
    """Keep data under a key, if the folder can be written."""
    folder = cache_folder(kind)
    if folder is None:
        return
    with contextlib.suppress(OSError, InputError):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / f"{key}.bin", _MAGIC + hashlib.sha256(data).digest() + data)
