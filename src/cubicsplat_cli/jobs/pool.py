"""Jobs on this machine: worker processes that outlive a bad picture, and die with the command that started them.

Each worker is a process that gets one job at a time through a pipe. One that dies takes only its job down, which is
tried once more in a new one. On Linux they are forked from a process that has imported what they need, which takes
seconds, and has done nothing else: threads and engines do not survive a fork. Elsewhere each imports for itself.
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
from typing import TYPE_CHECKING

from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.results import FileSink
from cubicsplat_cli.jobs.run import FAILED, INTERRUPTED, Outcome, attempt
from cubicsplat_cli.progress import Observer, Progress, interrupt
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import cpu_count

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext, SpawnContext
    from multiprocessing.process import BaseProcess

ATTEMPTS = 2
# How often a stop is looked for while nothing happens.
_POLL_SECONDS = 0.2
_STOP = "stop"
PRELOADED = ["cubicsplat_cli.jobs.warm"]  # by the process that workers are forked from


def share_threads(threads: int | None, workers: int) -> list[int]:
    """Threads of each worker: together as many as asked for (None: one per core), and one each at least."""
    total = threads if threads is not None else cpu_count()
    each, rest = divmod(total, workers)
    return [max(1, each + (index < rest)) for index in range(workers)]


def run_in_workers(
    jobs: Iterator[Job],
    request: Request,
    *,
    workers: int,
    observer: Observer,
    stopping: Callable[[], bool],
    work: Callable[[Connection, Request, int], None] | None = None,
) -> Iterator[Outcome]:
    """The outcomes of `jobs` in the order in which they end; `jobs` is asked for the next when a worker is free.

    Once `stopping()` is true nothing is begun any more, and the fits under way end early with the best they have.
    work: what a worker does with its end of a pipe, a request and so many threads (default: the jobs that it gets).
    """
    pool = _Pool(request, share_threads(request.settings.threads, workers), observer, work or _work)
    try:
        yield from pool.run(jobs, stopping)
    finally:
        pool.close()


@dataclass
class _Worker:
    """A process, our end of its pipe, and what it is doing."""

    slot: int
    process: BaseProcess
    pipe: Connection
    job: Job | None = None


@dataclass(eq=False)
class _Pool:
    request: Request
    threads: list[int]
    observer: Observer
    work: Callable[[Connection, Request, int], None]
    workers: list[_Worker] = field(default_factory=list)
    again: deque[Job] = field(default_factory=deque)
    deaths: dict[str, int] = field(default_factory=dict)

    def run(self, jobs: Iterator[Job], stopping: Callable[[], bool]) -> Iterator[Outcome]:
        stopped = False
        while True:
            if not stopping():
                self._hand_out(jobs)
            elif not stopped:
                stopped = True
                self._request_stop()
            busy = [worker for worker in self.workers if worker.job is not None]
            if not busy:
                return
            # A pipe is ready when its worker has something to say, and when it died.
            for pipe in wait([worker.pipe for worker in busy], _POLL_SECONDS):
                worker = next(worker for worker in busy if worker.pipe is pipe)
                outcome = self._listen(worker)
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

    def _hand_out(self, jobs: Iterator[Job]) -> None:
        """A job for each slot that is free; workers are started as there is work for them."""
        taken = {worker.slot for worker in self.workers if worker.job is not None}
        for slot in range(len(self.threads)):
            if slot in taken:
                continue
            job = self.again.popleft() if self.again else next(jobs, None)
            if job is None:
                return
            worker = next((worker for worker in self.workers if worker.slot == slot), None) or self._start(slot)
            worker.job = job
            self.observer.begin(job.name)
            with contextlib.suppress(OSError):  # it died while idle: `_listen` finds that out
                worker.pipe.send(job)

    def _start(self, slot: int) -> _Worker:
        context = _context()
        ours, theirs = context.Pipe()
        process = context.Process(target=self.work, args=(theirs, self.request, self.threads[slot]), daemon=True)
        with _interrupts_blocked():
            process.start()
        theirs.close()
        worker = _Worker(slot, process, ours)
        self.workers.append(worker)
        return worker

    def _listen(self, worker: _Worker) -> Outcome | None:
        """Take one message of a worker: its outcome where it is done with its job."""
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
        """A worker died: its job goes to another, unless it has killed too many."""
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


def _context() -> SpawnContext | ForkServerContext:
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context


def _describe(exitcode: int | None) -> str:
    if exitcode is None or exitcode >= 0:
        return f"exit code {exitcode}"
    try:
        name = signal.Signals(-exitcode).name
    except ValueError:
        name = f"signal {-exitcode}"
    return f"{name}, perhaps for lack of memory" if name == "SIGKILL" else name


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Ctrl-C goes to every process of a terminal; a process started in here never gets it, and we get it after."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Starting this lets interrupts through again, so it must run before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(pipe: Connection, request: Request, threads: int) -> None:
    """The life of a worker process: jobs from the pipe, one after the other, until there are no more."""
    jobs: SimpleQueue[Job | None] = SimpleQueue()
    stops = _Stops()
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
    """Takes what comes through the pipe, so that a stop is heard while a job is under way."""
    try:
        while True:
            message = pipe.recv()
            if message == _STOP:
                stops.requested = True
                _thread.interrupt_main()
            else:
                jobs.put(message)
    except (EOFError, OSError):
        # The command that started this process is gone; what was under way is done anew by its next run.
        os._exit(1)


class _Stops:
    """Turns a stop that came through the pipe into one KeyboardInterrupt in the job under way. The terminal's Ctrl-C,
    which reaches workers too, does nothing by itself.
    """

    def __init__(self) -> None:
        self.requested = False
        self._open = False

    def signalled(self, _number: int, _frame: FrameType | None) -> None:
        """The handler of SIGINT."""
        if self.requested and self._open:
            self.requested = False
            interrupt()

    @contextlib.contextmanager
    def let_through(self, be: bool = True) -> Iterator[None]:
        """Within, a stop interrupts; or, with be false, waits until the end of the block."""
        before, self._open = self._open, be
        try:
            yield
        finally:
            self._open = before
        self.signalled(signal.SIGINT, None)


class _ThroughPipe(Observer):
    """Says through the pipe how a job goes on."""

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
