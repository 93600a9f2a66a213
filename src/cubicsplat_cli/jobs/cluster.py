"""Jobs on a Ray cluster: the pictures travel there and the results back, so that no disk need be shared.

Every node needs cubicsplat installed. Ray runs a task again whose worker or node died.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
import socket
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.errors import CubicSplatError, EngineError
from cubicsplat_cli.formatting import one_line
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.results import FileSink, MemorySink
from cubicsplat_cli.jobs.run import FAILED, Outcome, attempt, failure
from cubicsplat_cli.progress import Observer
from cubicsplat_cli.record import record
from cubicsplat_cli.request import Request

if TYPE_CHECKING:
    from types import ModuleType

RETRIES = 3
_CONNECT_SECONDS = 5.0
_POLL_SECONDS = 0.2
_ADDRESS = re.compile(r"(?:ray://)?\[?([^\[\]/]+)\]?:(\d+)")


@record
class Share:
    """Resources of one task, and the number of tasks at once."""

    cpus: int
    gpus: int
    at_once: int


def run_on_cluster(
    jobs: Iterator[Job],
    request: Request,
    *,
    address: str,
    count: int,
    limit: int | None,
    observer: Observer,
    stopping: Callable[[], bool],
) -> Iterator[Outcome]:
    """The outcomes of `jobs` as they come; their files are written here.

    address: of the cluster's head ("host:port", "ray://host:port", or "auto"). count: how many jobs there may be.
    limit: of jobs at once. A task takes as many cores as threads were asked for (None: the cluster's, divided).
    Raises EngineError where Ray is not installed or no cluster answers.
    """
    # Ray prints what it has to say about its workers to standard output, which is for results.
    with contextlib.redirect_stdout(sys.stderr), _connected(address) as ray:
        share = divide(ray.cluster_resources(), request, count=count, limit=limit)
        task = ray.remote(num_cpus=share.cpus, num_gpus=share.gpus, max_retries=RETRIES)(run_remote_job)
        running: dict[Any, Job] = {}
        while not stopping():
            yield from _submit(ray, task, jobs, request, share, running, observer)
            if not running:
                return
            ready, _ = ray.wait(list(running), timeout=_POLL_SECONDS)
            for reference in ready:
                yield _collect(ray, reference, running.pop(reference))
        for reference in running:
            with contextlib.suppress(ray.exceptions.RayError):
                ray.cancel(reference)


def run_remote_job(job: Job, request: Request, threads: int) -> tuple[Outcome, dict[str, bytes]]:
    """Run a job on the cluster; return its outcome, and its files by kind."""
    sink = MemorySink()
    outcome = attempt(job, request.with_threads(threads), sink=sink, observer=Observer())
    # The picture need not travel back.
    return dataclasses.replace(outcome, job=dataclasses.replace(job, data=None)), sink.files


def divide(resources: dict[str, float], request: Request, *, count: int, limit: int | None) -> Share:
    """One GPU a task where the cluster has any (and the device is not cpu), else as many cores as threads."""
    device, threads = request.settings.device, request.settings.threads
    cores = max(1, int(resources.get("CPU", 1)))
    gpus = int(resources.get("GPU", 0)) if device != "cpu" else 0
    if device == "cuda" and gpus == 0:
        raise EngineError("the cluster has no GPU; use --device auto or cpu")
    if gpus:
        slots, cpus = gpus, 1
    else:
        cpus = min(cores, threads) if threads is not None else max(1, cores // max(1, count))
        slots = max(1, cores // cpus)
    # A few more than can run, so that no node waits for its next picture.
    return Share(cpus, 1 if gpus else 0, limit if limit is not None else 2 * slots)


@contextlib.contextmanager
def _connected(address: str) -> Iterator[ModuleType]:
    """Ray, connected to a cluster; EngineError where that cannot be."""
    try:
        import ray
    except ImportError as error:
        raise EngineError("--cluster needs Ray: pip install 'cubicsplat[ray]'") from error
    match = _ADDRESS.fullmatch(address)
    try:
        if match is not None:
            # Ray itself would try for minutes.
            socket.create_connection((match[1], int(match[2])), timeout=_CONNECT_SECONDS).close()
        ray.init(address=address, log_to_driver=False, logging_level="ERROR", ignore_reinit_error=True)
    except (OSError, ValueError, RuntimeError, ray.exceptions.RayError) as error:
        raise EngineError(f"no Ray cluster at {address} ({one_line(error)}); start one or check it") from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _submit(
    ray: ModuleType,
    task: Any,
    jobs: Iterator[Job],
    request: Request,
    share: Share,
    running: dict[Any, Job],
    observer: Observer,
) -> Iterator[Outcome]:
    """Send out jobs while there is room; yields those whose picture cannot be read."""
    from cubicsplat_cli.files.read import read_whole

    while len(running) < share.at_once:
        job = next(jobs, None)
        if job is None:
            return
        assert job.path is not None  # the command refuses standard input here
        try:
            data, asked = read_whole(job.path), job.request(request)
        except CubicSplatError as error:
            yield failure(job, error)
            continue
        observer.begin(job.name)
        running[task.remote(dataclasses.replace(job, data=data, mask=None), asked, share.cpus)] = job


def _collect(ray: ModuleType, reference: Any, job: Job) -> Outcome:
    """The outcome of a task that ended, its files written in the order that makes a report the last."""
    try:
        outcome, files = ray.get(reference)
    except ray.exceptions.RayError as error:
        return Outcome(job, FAILED, error=f"{job.name}: the cluster failed: {one_line(error)[:300]}", exit_code=1)
    try:
        sink = FileSink(job)
        for kind, data in files.items():
            sink.put(kind, data)
    except CubicSplatError as error:
        return failure(job, error)
    return dataclasses.replace(outcome, job=job)
