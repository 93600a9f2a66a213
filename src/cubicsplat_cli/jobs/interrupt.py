"""Ending on Ctrl-C where Python can be ended."""

from __future__ import annotations

import signal
import sys
import threading

AGAIN_S = 0.05


def interrupt() -> None:
    """Raise KeyboardInterrupt or, while torch is being imported, have the signal come again a moment later.

    For signal handlers. An exception that reaches torch's C++ code in the middle of its start aborts the process.
    """
    torch = sys.modules.get("torch")
    if torch is None or not getattr(torch.__spec__, "_initializing", False):
        raise KeyboardInterrupt
    threading.Timer(AGAIN_S, signal.raise_signal, (signal.SIGINT,)).start()
