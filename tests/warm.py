"""The command in a process of its own that has torch already: signals, limits and streams without seconds of waiting.

It is forked from the process that `workers.forked_from_a_warm_process` keeps, so only where there is such a thing.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable
from multiprocessing.reduction import DupFd
from typing import Any

from command import Done, run_as_process


class WarmCommand:
    """`cubicsplat` with arguments, under way, for a `with`.

    Its streams are files, but for descriptors that are given. before: called in the process before the command; a
    function of a module, since the process gets its name.
    """

    def __init__(
        self,
        *arguments: object,
        before: Callable[[], None] | None = None,
        stdin: int | None = None,
        stdout: int | None = None,
    ) -> None:
        self._arguments = ["cubicsplat", *map(str, arguments)]
        self._files = [tempfile.TemporaryFile() for _ in range(3)]  # noqa: SIM115
        own = [file.fileno() for file in self._files]
        streams = (own[0] if stdin is None else stdin, own[1] if stdout is None else stdout, own[2])
        # Under `make coverage` a limited process must not try to write measurements either.
        environment = {name: value for name, value in os.environ.items() if before is None or "COVERAGE" not in name}
        self._process = multiprocessing.get_context("spawn").Process(
            target=_begin, args=(self._arguments, environment, [DupFd(stream) for stream in streams], before)
        )
        self._process.start()

    def __enter__(self) -> WarmCommand:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.join()
        for file in self._files:
            file.close()

    def interrupt(self) -> None:
        """What Ctrl-C does."""
        os.kill(self._process.pid, signal.SIGINT)

    def running(self) -> bool:
        return self._process.is_alive()

    def stderr(self) -> bytes:
        """What it has said so far."""
        return self._content(2)

    def wait(self, seconds: float = 150.0) -> Done:
        self._process.join(seconds)
        assert self._process.exitcode is not None, "the command did not end in time"
        return Done(self._arguments, self._process.exitcode, self._content(1), self._content(2))

    def _content(self, number: int) -> bytes:
        file = self._files[number].fileno()
        return os.pread(file, os.fstat(file).st_size, 0)


def run_warm(*arguments: object, **options: Any) -> Done:
    """The command in such a process, to its end; options as of `WarmCommand`."""
    with WarmCommand(*arguments, **options) as command:
        return command.wait()


def _begin(arguments: list[str], environment: dict[str, str], streams: list[Any], before: Any) -> None:
    # As a terminal has it: the process that this one is forked from may have been started while Ctrl-C was held back.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    os.environ.clear()
    os.environ.update(environment)
    files = [stream.detach() for stream in streams]
    if before is not None:
        before()
    run_as_process(arguments, files)
