"""Results on standard output: whole, flushed, and with an error instead of a traceback where that fails."""

from __future__ import annotations

import os
import sys

from cubicsplat_cli.errors import InputError

STDOUT = "standard output"  # as messages call it


def write_stdout(data: bytes) -> None:
    """Write and flush. Raises InputError where the disk behind it is full, SystemExit(1) where its reader has gone
    (which is no news to whoever cut the pipe).
    """
    # The one this process was started with, whatever else prints to `sys.stdout` meanwhile.
    stdout = sys.__stdout__
    if stdout is None:
        raise InputError("standard output: there is none; use -o")
    try:
        stdout.flush()
        stdout.buffer.write(data)
        stdout.buffer.flush()
    except OSError as error:
        # Python flushes once more when it ends, and would complain about what is still in the buffer.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise SystemExit(1) from error
        reason = error.strerror or str(error)
        raise InputError(f"{STDOUT}: cannot be written ({reason}); free some space or use -o") from error
