"""Fits in another process of this machine, where the fits of several processes share one GPU.

The process that owns the GPU imports torch and loads the kernels once. It works on each fit in a thread, on a stream of
its own, so that the kernels of several fits fill the GPU together. Its clients read, write, draw and measure pictures
meanwhile; they need neither torch nor the GPU.

Each fit has a connection. The client sends the name and the arguments of a method of `FitLoop`, and the server sends
progress and warnings until it sends the result or the error. To interrupt a method, the client sends None.

Imports nothing heavy, since the command that starts these processes needs none of it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.progress import FrameRecorder, OnProgress, Progress, log, nothing, warnings_to

if TYPE_CHECKING:
    from multiprocessing.connection import Connection, Listener

    import numpy as np

    from cubicsplat_cli.photo.inputs import FitInputs
    from cubicsplat_cli.photo.loop import FitLoop
    from cubicsplat_cli.raster.engine import Engine
    from cubicsplat_cli.settings import FitSettings

GPU_CHECK = "require_gpu"  # the name of the only request that is no method of a fit


@dataclass
class FitServer:
    """The way to the server. address: of its listener. whole: a context in which no KeyboardInterrupt is raised."""

    address: str
    whole: Callable[[], AbstractContextManager[None]] = nullcontext


_servers: list[FitServer] = []  # of this process: one, or none


def use_server(server: FitServer | None) -> None:
    """Let the server do all fits of this process from now on that may run on a GPU; None: this process does them."""
    _servers[:] = [] if server is None else [server]


def begin_fit(
    target: np.ndarray,
    settings: FitSettings,
    inputs: FitInputs | None = None,
    on_progress: OnProgress | None = None,
    recorder: FrameRecorder | None = None,
) -> FitLoop | RemoteFit:
    """Begin a fit that runs in parts, in the server if there is one. Parameters and errors are those of `FitLoop`.

    Fits on the CPU, fits over a picture, and fits whose frames are recorded stay in this process.
    """
    from cubicsplat_cli.photo.inputs import NO_INPUTS
    from cubicsplat_cli.photo.loop import FitLoop

    inputs = inputs or NO_INPUTS
    if not _servers or settings.device == "cpu" or recorder is not None or inputs.ground is not None:
        return FitLoop(target, settings, inputs, on_progress, recorder)
    return RemoteFit(_servers[0], on_progress or nothing, target, settings, inputs)


def require_gpu() -> None:
    """Raise EngineError, which says what to do, if torch has no GPU in the process that fits."""
    if _servers:
        with _Connected(_servers[0]) as server:
            server.call(GPU_CHECK)
        return
    from cubicsplat_cli.raster.cuda.driver import require_gpu as check

    check()


class _Connected(AbstractContextManager["_Connected"]):
    """A connection to the server. Its methods end this process by SystemExit if the server has died."""

    def __init__(self, server: FitServer) -> None:
        from multiprocessing import AuthenticationError, current_process
        from multiprocessing.connection import Client

        self._whole = server.whole
        try:
            with self._whole():
                self._connection = Client(server.address, authkey=bytes(current_process().authkey))
        except (OSError, EOFError, AuthenticationError):
            sys.exit(1)

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def call(self, name: str, *arguments: Any, on_progress: OnProgress = nothing) -> Any:
        """Return the result of a request, or raise its error. A KeyboardInterrupt ends a fit early, with a result, and
        is raised if the request has ended.
        """
        unsent = [(name, arguments)]
        try:
            while True:
                kind: str = ""
                content: Any = None
                try:
                    with self._whole():
                        while unsent:
                            self._connection.send(unsent.pop())
                        kind, content = self._connection.recv()
                    if kind == "progress":
                        on_progress(content)
                except KeyboardInterrupt:
                    if kind in ("result", "error"):
                        raise
                    self._connection.send(None)
                if kind == "result":
                    return content
                if kind == "error":
                    raise content
                if kind == "warning":
                    log.warning("%s", content)
        except (EOFError, ConnectionError):
            sys.exit(1)


class RemoteFit:
    """A `FitLoop` in the server, which has its methods there. The server forgets it when this is collected."""

    def __init__(self, server: FitServer, on_progress: OnProgress, *arguments: Any) -> None:
        self._call = partial(_Connected(server).call, on_progress=on_progress)
        self._call("begin", *arguments)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return partial(self._call, name)


def serve(pipe: Connection, opened: Callable[..., Engine] | None = None) -> None:
    """Send the address of a new listener through the pipe, and do the fits of its clients until the pipe closes: the
    main function of the server process. opened: opens the engine of a fit (default: `open_engine`).
    """
    from multiprocessing import current_process
    from multiprocessing.connection import Listener

    from cubicsplat_cli.raster.engines import open_engine

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # clients say which fits to interrupt
    with Listener(authkey=bytes(current_process().authkey)) as listener:
        pipe.send(listener.address)
        threading.Thread(target=_accept, args=(listener, opened or open_engine), daemon=True).start()
        with suppress(EOFError, OSError):
            pipe.recv()


def _accept(listener: Listener, opened: Callable[..., Engine]) -> None:
    from multiprocessing import AuthenticationError

    while True:
        try:
            connection = listener.accept()
        except (AuthenticationError, EOFError, ConnectionError):  # a client that died meanwhile
            continue
        except OSError:  # the listener is closed
            return
        threading.Thread(target=serve_fit, args=(connection, opened), daemon=True).start()


def serve_fit(connection: Connection, opened: Callable[..., Engine]) -> None:
    """Do one fit as its client asks, until the client closes the connection."""
    from multiprocessing.pool import ExceptionWithTraceback  # type: ignore[attr-defined]

    from cubicsplat_cli.photo.loop import FitLoop

    def report(progress: Progress) -> None:
        if connection.poll():
            connection.recv()  # an interruption, or the end of the client, which raises EOFError
            raise KeyboardInterrupt
        connection.send(("progress", progress))

    with connection, suppress(EOFError, OSError, EngineError), ExitStack() as stack:
        loop: FitLoop | None = None
        while True:
            request = connection.recv()
            if request is None:  # the interruption of a method that had ended by then
                if loop is not None:
                    loop.interrupt()
                continue
            name, arguments = request
            result = None
            try:
                with warnings_to(lambda text: connection.send(("warning", text))):
                    if name == GPU_CHECK:
                        require_gpu()
                    elif loop is None:
                        target, settings, inputs = arguments
                        if settings.device != "cpu":
                            stack.enter_context(_own_stream())
                        loop = FitLoop(target, settings, inputs, report, opened=opened)
                        stack.callback(lambda fit: fit.engine.close(), loop)
                    else:
                        with loop.engine.turn():
                            result = getattr(loop, name)(*arguments)
            except Exception as error:
                connection.send(("error", ExceptionWithTraceback(error, error.__traceback__)))
            else:
                connection.send(("result", result))


def _own_stream() -> AbstractContextManager[Any]:
    """Return a context in which torch works on a stream of this thread's own; without a GPU it does nothing.

    Ends the process if an earlier fit has broken its GPU context, which nothing mends. The pool starts another one.
    """
    import torch

    if not torch.cuda.is_available():
        return nullcontext()
    try:
        # torch hands out streams of each priority in turn. With the high priority this is never a stream on which a
        # graph is captured, and the small kernels between steps go before the steps of other fits.
        stream = torch.cuda.Stream(priority=-1)
        stream.synchronize()
    except RuntimeError:
        os._exit(1)
    return torch.cuda.stream(stream)
