"""The `cubicsplat` command: errors of ours and of the parser become one line and an exit code, others a traceback."""

from __future__ import annotations

import atexit
import gc
import os
import sys
import time
from collections.abc import Callable
from typing import NoReturn

from cubicsplat_cli.errors import EXIT_INTERRUPTED, EXIT_USAGE, CubicSplatError, UsageError
from cubicsplat_cli.formatting import one_line, printable
from cubicsplat_cli.progress import COMMAND_BEGAN

MAX_MESSAGE = 1000  # characters: messages quote names from files, of any length


def main() -> NoReturn:
    """Run the command line. Raises SystemExit with the exit code: 0, 1, 2 or 130."""
    run(_command)


def run(program: Callable[[list[str]], int | None]) -> NoReturn:
    """Run a program with this process's arguments. Raises SystemExit with its exit code, 0 for None."""
    # Imports make most objects, which stay: a search for unreachable cycles among them takes a twentieth of the time of
    # a small drawing, which makes fewer new objects than this. Without the freeze there is such a search at the end.
    gc.set_threshold(1_000_000)
    atexit.register(gc.freeze)
    # Our products of matrices have a few columns: idle threads of numpy would only take time from others.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    began = COMMAND_BEGAN.set(time.perf_counter())
    try:
        _open_streams()
        _end(_exit_code(program, sys.argv[1:]))
    finally:
        COMMAND_BEGAN.reset(began)


def _command(arguments: list[str]) -> int | None:
    if arguments == ["--version"]:  # scripts ask often, so the command line is not built
        from cubicsplat_cli._version import __version__

        print(f"cubicsplat {__version__}", flush=True)
        return 0
    from cubicsplat_cli.cli.app import meant, run_command

    return run_command(meant(arguments))


def _exit_code(program: Callable[[list[str]], int | None], arguments: list[str]) -> int:
    try:
        return program(arguments) or 0
    except CubicSplatError as error:
        _say(error.as_option() if isinstance(error, UsageError) else str(error))
        return error.exit_code
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except (OSError, UnicodeError) as error:
        if "--install-completion" in arguments:
            _say(_not_installed(error))
            return 1
        if isinstance(error, UnicodeError) or error.filename is not None:
            raise
        if not isinstance(error, BrokenPipeError):  # whose reader knows that it is gone
            _say(f"standard output: cannot be written ({error.strerror or error}); free some space")
        return 1
    except MemoryError:
        _say("there is not enough memory for this; give a smaller picture, or ask for a smaller one")
        return 1
    except Exception as error:
        from cubicsplat_cli.cli.app import parser_error

        text = parser_error(error)
        if text is None:
            raise
        if text:
            _say(text)
        return EXIT_USAGE if text else EXIT_INTERRUPTED


def _not_installed(error: OSError | UnicodeError) -> str:
    """Return the reason why the completion of the shell could not be installed, and a remedy."""
    if isinstance(error, UnicodeError):
        return "--install-completion: the shell's start-up file is not UTF-8; add what --show-completion prints to it"
    where = printable(str(error.filename or "a file"))
    return f"--install-completion: {where} cannot be written ({error.strerror}); set HOME to your own folder"


def _say(text: str) -> None:
    print(f"cubicsplat: error: {one_line(text)[:MAX_MESSAGE]}", file=sys.stderr)


def _open_streams() -> None:
    """Open the standard streams that the parent process has closed: libraries fail on Python's None for these."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode)  # noqa: PTH123, SIM115
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)


def _end(code: int) -> NoReturn:
    """Flush and exit; a failure to flush is a failure too."""
    try:
        sys.stdout.flush()
    except OSError as error:
        # Python flushes once more when it ends, and would complain about the rest of the buffer.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            _say(f"standard output: cannot be written ({error.strerror}); free some space")
        code = code or 1
    sys.exit(code)


if __name__ == "__main__":
    main()
