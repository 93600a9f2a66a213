"""What the machine offers this process."""

from __future__ import annotations

import os


def cores() -> int:
    """The CPU cores that the process may use: its affinity, not the machine's count."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
