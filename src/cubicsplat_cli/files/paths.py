"""Questions about paths that the user named. A path that cannot be looked at (no permission, a name too long, a null
byte) is no folder and no file; whoever uses it finds out why, and says so.
"""

from __future__ import annotations

import stat
from pathlib import Path

from cubicsplat_cli.errors import InputError


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
        raise InputError(f"{path.parent}: is a file, and no folder for {path.name}; choose another with -o") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path.parent}: folder cannot be created ({reason}); choose another with -o") from error


def _kind(path: Path) -> int:
    try:
        return path.stat().st_mode
    except (OSError, ValueError):
        return 0
