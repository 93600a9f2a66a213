"""The command as users start it: in this process, which is quick, or in one of its own."""

from __future__ import annotations

import io
import logging
import os
import re
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, NoReturn

import typer.main

from cubicsplat_cli.__main__ import main

# Typer builds its commands at each call, which users see once a process: a quarter of a short run.
typer.main.get_command = cache(typer.main.get_command)

Done = subprocess.CompletedProcess[bytes]
STREAMS = ("stdin", "stdout", "stderr")


def cli_command() -> list[str]:
    """The console script beside this Python where the package is installed, else the module."""
    for name in ("cubicsplat", "cubicsplat.exe"):
        script = Path(sys.executable).parent / name
        if script.is_file():
            return [str(script)]
    return [sys.executable, "-m", "cubicsplat_cli"]


def run_process(*arguments: object, data: bytes | None = None, timeout: float = 180) -> Done:
    """`cubicsplat` in a process of its own, for what only a process has: signals, limits, a start."""
    return subprocess.run(
        [*cli_command(), *map(str, arguments)],
        input=data,
        stdin=subprocess.DEVNULL if data is None else None,
        capture_output=True,
        timeout=timeout,
        check=False,
    )


def run_here(
    *arguments: object,
    data: bytes | None = None,
    stdin: IO[bytes] | None = None,
    stderr: IO[bytes] | None = None,
    program: Callable[[], NoReturn] = main,
    code: int | None = 0,
    error: str | None = None,
) -> Done:
    """`cubicsplat` in this process: the same entry point, exit code and bytes, without starting Python and torch.

    What the command changes of the process is put back. An exception that users would see as a traceback is raised.
    data, stdin: what standard input holds, or is. stderr: where standard error goes instead of into the result.
    program: in place of `cubicsplat`. code: the exit code that it must have, if any. error: what the one line of its
    error must hold, if it is to fail.
    """
    with ExitStack() as stack:
        given, stdout, errors = (stack.enter_context(tempfile.TemporaryFile()) for _ in range(3))
        given.write(data or b"")
        given.seek(0)
        command = ["cubicsplat", *map(str, arguments)]
        with _process_state(), _streams(stdin or given, stdout, stderr or errors), _plain_warnings():
            sys.argv = command
            ended = _exit_code(program)
        done = Done(command, ended, _content(stdout), _content(errors))
        assert code in (None, ended), done
        if error is not None:
            one_error(done, error)
        return done


def one_error(done: Done, said: str) -> None:
    """Nothing was printed but the one line of an error, which holds what is `said`; and JSON where it was asked for."""
    assert done.stdout == b"" or "--json" in done.args, done
    assert re.fullmatch(r"cubicsplat: error: [^\n]+\n", done.stderr.decode()), done
    assert said in done.stderr.decode(), done


def run_as_process(command: list[str], streams: list[int]) -> NoReturn:
    """`cubicsplat` as the rest of this process' life, with these descriptors as its standard streams."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    _open_streams()
    warnings.resetwarnings()
    sys.argv = command
    code = _exit_code()
    _flush()
    os._exit(code)


def _exit_code(program: Callable[[], NoReturn] = main) -> int:
    """What a shell would see of the end of a program."""
    try:
        program()
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return end.code or 0
        print(end.code, file=sys.stderr)
        return 1
    raise AssertionError("the program came back without SystemExit")


def _content(file: IO[bytes]) -> bytes:
    file.seek(0)
    return file.read()


@contextmanager
def _process_state() -> Iterator[None]:
    """Within, arguments, folder, environment, signal handlers and loggers may change."""
    arguments, folder, environment = sys.argv, Path.cwd(), dict(os.environ)
    interrupt = signal.getsignal(signal.SIGINT)
    loggers = {name: _logger_state(name) for name in ("", "cubicsplat_cli")}
    try:
        yield
    finally:
        sys.argv = arguments
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        signal.signal(signal.SIGINT, interrupt)
        for name, (level, propagate, outputs) in loggers.items():
            logger = logging.getLogger(name)
            logger.setLevel(level)
            logger.propagate, logger.handlers[:] = propagate, outputs


def _logger_state(name: str) -> tuple[int, bool, list[logging.Handler]]:
    logger = logging.getLogger(name)
    return logger.level, logger.propagate, logger.handlers[:]


@contextmanager
def _streams(*files: IO[bytes]) -> Iterator[None]:
    """Within, standard input, output and error are these files: for Python, for C code and for child processes."""
    before = {name: (getattr(sys, name), getattr(sys, f"__{name}__")) for name in STREAMS}
    kept = [os.dup(number) for number in range(3)]
    _flush()
    for number, file in enumerate(files):
        os.dup2(file.fileno(), number)
    try:
        _open_streams()
        yield
    finally:
        _flush()
        for name, (stream, original) in before.items():
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", original)
        for number, copy in enumerate(kept):
            os.dup2(copy, number)
            os.close(copy)


def _open_streams() -> None:
    """As Python makes them: stderr never refuses a character and is flushed at the end of each line."""
    for number, name in enumerate(STREAMS):
        raw = io.FileIO(number, "rb" if number == 0 else "wb", closefd=False)
        buffered = io.BufferedReader(raw) if number == 0 else io.BufferedWriter(raw)
        errors = "backslashreplace" if name == "stderr" else "strict"
        stream = io.TextIOWrapper(buffered, "utf-8", errors, line_buffering=name == "stderr")
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with suppress(ValueError):  # closed
            stream.flush()


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Within, warnings go to standard error as in a process of its own, not into the test's collection of them."""

    def show(message, category, filename, lineno, file=None, line=None) -> None:
        sys.stderr.write(warnings.formatwarning(message, category, filename, lineno, line))

    with warnings.catch_warnings():
        warnings.resetwarnings()
        for category in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", category)
        warnings.showwarning = show
        yield
