"""Questions about paths that the user named. A path that cannot be looked at (no permission, a name too long, a null
byte) is no folder and no file; whoever uses it finds out why, and says so.
"""

from __future__ import annotations

import stat
from pathlib import Path


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


def _kind(path: Path) -> int:
    try:
        return path.stat().st_mode
    except (OSError, ValueError):
        return 0
