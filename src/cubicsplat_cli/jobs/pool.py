"""Jobs in worker processes on this machine, which outlive a bad picture and end with the command that started them.

Each worker gets one job at a time through a pipe. If a worker dies, its job alone is tried once more in a new one. On
Linux workers are forked from a process that has done all imports, which take seconds, and nothing else: threads and
engines do not survive a fork. On other systems each worker imports for itself.

If there is a GPU, one more process does the fits of all workers on it (`photo.remote`).
"""

from __future__ import annotations

import _thread
import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from queue import SimpleQueue
from types import FrameType
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.results import FileSink
from cubicsplat_cli.jobs.run import FAILED, INTERRUPTED, POLL_SECONDS, Outcome, attempt
from cubicsplat_cli.photo.remote import FitServer, serve, use_server
from cubicsplat_cli.progress import Observer, Progress, interrupt
from cubicsplat_cli.raster.cuda.libcuda import gpus
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import cpu_count

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext, SpawnContext
    from multiprocessing.process import BaseProcess

ATTEMPTS = 2
_STOP = "stop"
PRELOADED = ["cubicsplat_cli.jobs.warm"]  # by the process that workers are forked from


def share_threads(threads: int | None, workers: int) -> list[int]:
    """Return the threads of each worker: `threads` together (None: one per core), and one each at least."""
    each, rest = divmod(threads or cpu_count(), workers)
    return [max(1, each + (index < rest)) for index in range(workers)]


def run_in_workers(
    jobs: Iterator[Job],
    request: Request,
    *,
    workers: int,
    observer: Observer,
    stopping: Callable[[], bool],
    work: Callable[[Connection, Request, int, str | None], None] | None = None,
    gpu: bool | None = None,
) -> Iterator[Outcome]:
    """Yield the outcomes of the jobs in the order in which they end; take the next job when a worker is free.

    stopping: see `execute`. work: the function of a worker, of its end of a pipe, a request, a number of threads, and
    the address of the process that fits on the GPU (default: do the jobs from the pipe). gpu: start that process
    (default: if the request may use a GPU and there is one).
    """
    if gpu is None:
        gpu = request.settings.device != "cpu" and gpus() > 0
    pool = _Pool(request, share_threads(request.settings.threads, workers), observer, work or _work, gpu)
    try:
        yield from pool.run(jobs, stopping)
    finally:
        pool.close()


@dataclass
class _Worker:
    """A process, our end of its pipe, and the job that it is doing."""

    slot: int
    process: BaseProcess
    pipe: Connection
    job: Job | None = None


@dataclass(eq=False)
class _Pool:
    request: Request
    threads: list[int]
    observer: Observer
    work: Callable[[Connection, Request, int, str | None], None]
    gpu: bool
    workers: list[_Worker] = field(default_factory=list)
    again: deque[Job] = field(default_factory=deque)
    deaths: dict[str, int] = field(default_factory=dict)
    fitting: tuple[BaseProcess, Connection, str] | None = None  # the process of the GPU, and its address

    def run(self, jobs: Iterator[Job], stopping: Callable[[], bool]) -> Iterator[Outcome]:
        stopped = False
        while True:
            if not stopping():
                self._hand_out(jobs)
            elif not stopped:
                stopped = True
                self._request_stop()
            busy: dict[Any, _Worker] = {worker.pipe: worker for worker in self.workers if worker.job is not None}
            if not busy:
                return
            # A pipe is ready when its worker has sent a message, and when it has died.
            for pipe in wait([*busy], POLL_SECONDS):
                outcome = self._listen(busy[pipe])
                if outcome is not None:
                    yield outcome

    def close(self) -> None:
        """End all workers: the idle ones by request, the others by force."""
        for worker in self.workers:
            with contextlib.suppress(OSError):
                if worker.job is None:
                    worker.pipe.send(None)
                else:
                    worker.process.terminate()
            worker.pipe.close()
        for worker in self.workers:
            worker.process.join()
        if self.fitting is not None:
            self.fitting[1].close()
            self.fitting[0].join()

    def _hand_out(self, jobs: Iterator[Job]) -> None:
        """Give a job to each free slot; start its worker if there is none."""
        workers = {worker.slot: worker for worker in self.workers}
        for slot in range(len(self.threads)):
            under_way = [worker.job.name for worker in self.workers if worker.job is not None]
            if self.gpu and under_way and (self.again or under_way[0] in self.deaths):
                return  # a job that is tried again has the GPU to itself, so that it takes no other with it
            if slot in workers and workers[slot].job is not None:
                continue
            job = self.again.popleft() if self.again else next(jobs, None)
            if job is None:
                return
            worker = workers.get(slot) or self._start(slot)
            worker.job = job
            self.observer.begin(job.name)
            with contextlib.suppress(OSError):  # it died while idle: `_listen` notices
                worker.pipe.send(job)

    def _start(self, slot: int) -> _Worker:
        server = self._server() if self.gpu else None
        worker = _Worker(slot, *_started(self.work, self.request, self.threads[slot], server))
        self.workers.append(worker)
        return worker

    def _server(self) -> str:
        """Return the address of the living process that fits on the GPU."""
        if self.fitting is None or self.fitting[1].poll():  # its end of the pipe is closed
            process, pipe = _started(serve)
            try:
                self.fitting = process, pipe, pipe.recv()
            except EOFError as error:
                raise EngineError("the process that fits on the GPU ended as it began; use --device cpu") from error
        return self.fitting[2]

    def _listen(self, worker: _Worker) -> Outcome | None:
        """Take one message of a worker; return the outcome if it has ended its job."""
        job = worker.job
        assert job is not None
        try:
            kind, content = worker.pipe.recv()
        except (EOFError, OSError):
            return self._died(worker, job)
        if kind == "outcome":
            worker.job = None
            return content
        getattr(self.observer, kind)(content, job.name)
        return None

    def _died(self, worker: _Worker, job: Job) -> Outcome | None:
        """Give the job of a dead worker to another one; return its failure if it has ended too many workers."""
        worker.process.join()
        worker.pipe.close()
        self.workers.remove(worker)
        how = _describe(worker.process.exitcode)
        self.deaths[job.name] = self.deaths.get(job.name, 0) + 1
        if self.deaths[job.name] < ATTEMPTS:
            self.observer.note(f"{job.name}: its worker process died ({how}); it is tried again", job.name)
            self.again.append(job)
            return None
        text = f"{job.name}: its worker process died {ATTEMPTS} times ({how}); try fewer --jobs, or --max-size"
        return Outcome(job, FAILED, error=text, exit_code=1)

    def _request_stop(self) -> None:
        self.again.clear()
        for worker in self.workers:
            if worker.job is not None:
                with contextlib.suppress(OSError):
                    worker.pipe.send(_STOP)


def _started(main: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection]:
    """Start a process by its main function, of its end of a pipe and the arguments; return it with our end."""
    context = _context()
    ours, theirs = context.Pipe()
    process = context.Process(target=main, name=main.__name__, args=(theirs, *arguments), daemon=True)
    with _interrupts_blocked():
        process.start()
    theirs.close()
    return process, ours


def _context() -> SpawnContext | ForkServerContext:
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context


def _describe(exitcode: int | None) -> str:
    """Return the reason for which a process ended."""
    if exitcode is None or exitcode >= 0:
        return f"exit code {exitcode}"
    try:
        name = signal.Signals(-exitcode).name
    except ValueError:
        name = f"signal {-exitcode}"
    return f"{name}, perhaps for lack of memory" if name == "SIGKILL" else name


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Within, block Ctrl-C, which reaches every process of a terminal; processes started here never get it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Its start unblocks interrupts, so it must run before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(pipe: Connection, request: Request, threads: int, server: str | None) -> None:
    """Do the jobs from the pipe, one after the other, until there are no more; the main function of a worker.

    server: the address of the process that fits on the GPU; None if this one does.
    """
    jobs: SimpleQueue[Job | None] = SimpleQueue()
    stops = _Stops()
    if server is not None:
        use_server(FitServer(server, lambda: stops.let_through(False)))
    signal.signal(signal.SIGINT, stops.signalled)
    threading.Thread(target=_receive, args=(pipe, jobs, stops), daemon=True).start()
    try:
        while (job := jobs.get()) is not None:
            try:
                with stops.let_through():
                    observer = _ThroughPipe(pipe, stops)
                    outcome = attempt(job, request.with_threads(threads), sink=FileSink(job), observer=observer)
            except KeyboardInterrupt:
                outcome = Outcome(job, INTERRUPTED)
            pipe.send(("outcome", outcome))
    except (BrokenPipeError, ConnectionResetError):
        os._exit(1)


def _receive(pipe: Connection, jobs: SimpleQueue[Job | None], stops: _Stops) -> None:
    """Receive jobs and stops from the pipe, while a job is under way too."""
    try:
        while True:
            message = pipe.recv()
            if message == _STOP:
                stops.requested = True
                _thread.interrupt_main()
            else:
                jobs.put(message)
    except (EOFError, OSError):
        # The command that started this process is gone; its next run does the job anew.
        os._exit(1)


class _Stops:
    """Turns a stop from the pipe into one KeyboardInterrupt in the job under way. Ctrl-C in the terminal, which reaches
    workers too, alone does nothing.
    """

    def __init__(self) -> None:
        self.requested = False
        self._open = False

    def signalled(self, _number: int, _frame: FrameType | None) -> None:
        """Handle SIGINT."""
        if self.requested and self._open:
            self.requested = False
            interrupt()

    @contextlib.contextmanager
    def let_through(self, be: bool = True) -> Iterator[None]:
        """Within, a stop interrupts; if `be` is false, it waits until the end of the block."""
        before, self._open = self._open, be
        try:
            yield
        finally:
            self._open = before
        self.signalled(signal.SIGINT, None)


class _ThroughPipe(Observer):
    """Sends the progress of a job through the pipe."""

    def __init__(self, pipe: Connection, stops: _Stops) -> None:
        self._pipe, self._stops = pipe, stops

    def stage(self, stage: str, job: str) -> None:
        self._send("stage", stage)

    def note(self, text: str, job: str = "") -> None:
        self._send("note", text)

    def step(self, progress: Progress, job: str) -> None:
        self._send("step", progress)

    def _send(self, kind: str, content: object) -> None:
        # Half a message would be the end of the worker.
        with self._stops.let_through(False):
            self._pipe.send((kind, content))
