"""Memory of this process, now and at its peak."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from cubicsplat_cli.records import dataclass

STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class Memory:
    """Bytes of this process in physical memory: `resident` now, `peak` the most so far; None where unknown."""

    resident: int | None
    peak: int | None


def memory(status: Path = STATUS) -> Memory:
    """Read Linux's process status, or elsewhere the peak of `getrusage`; Windows has neither."""
    try:
        return from_status(status.read_text(encoding="ascii"))
    except OSError:
        return Memory(None, _peak_of_getrusage())


def from_status(text: str) -> Memory:
    """The figures in the text of /proc/self/status."""
    sizes = {name: 1024 * int(kilobytes) for name, kilobytes in re.findall(r"^(Vm\w+):\s*(\d+) kB$", text, re.M)}
    return Memory(sizes.get("VmRSS"), sizes.get("VmHWM"))


def _peak_of_getrusage() -> int | None:
    try:
        import resource
    except ImportError:
        return None
    # Kilobytes everywhere but on macOS.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
