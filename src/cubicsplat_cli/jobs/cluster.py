"""Jobs on a Ray cluster. Pictures are sent there and results back, so that no disk need be shared.

Every node needs cubicsplat. Ray repeats a task whose worker or node died.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
import socket
import sys
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any, NamedTuple

from cubicsplat_cli.errors import CubicSplatError, EngineError
from cubicsplat_cli.files.read import read_whole
from cubicsplat_cli.formatting import one_line
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.results import FileSink, Sink
from cubicsplat_cli.jobs.run import FAILED, POLL_SECONDS, Outcome, attempt, failure
from cubicsplat_cli.progress import Observer
from cubicsplat_cli.request import Request


class Share(NamedTuple):
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
    """Yield the outcomes of the jobs as they end, and write their files here.

    address: of the cluster's head ("host:port", "ray://host:port", or "auto"). count: of jobs at most. limit: of jobs
    at once. A task takes as many cores as the request has threads (None: its share of the cluster's). Raises
    EngineError if Ray is not installed or no cluster answers.
    """
    # Ray prints messages of its workers to standard output, which is for results.
    with contextlib.redirect_stdout(sys.stderr), _connected(address) as ray:
        share = divide(ray.cluster_resources(), request, count=count, limit=limit)
        task = ray.remote(num_cpus=share.cpus, num_gpus=share.gpus, max_retries=3)(run_remote_job)
        running: dict[Any, Job] = {}
        while not stopping():
            yield from _submit(task, jobs, request, share, running, observer)
            if not running:
                return
            ready, _ = ray.wait(list(running), timeout=POLL_SECONDS)
            for reference in ready:
                yield _collect(ray, reference, running.pop(reference))
        for reference in running:
            with contextlib.suppress(ray.exceptions.RayError):
                ray.cancel(reference)


def run_remote_job(job: Job, request: Request, threads: int) -> tuple[Outcome, dict[str, bytes]]:
    """Run a job on the cluster; return its outcome, and its files by kind."""
    sink = Sink()
    outcome = attempt(job, request.with_threads(threads), sink=sink, observer=Observer())
    # The picture is not sent back.
    return dataclasses.replace(outcome, job=dataclasses.replace(job, data=None)), sink.files


def divide(resources: dict[str, float], request: Request, *, count: int, limit: int | None) -> Share:
    """Give each task a GPU if the cluster has any and the device is not cpu, else as many cores as threads."""
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
    """Connect Ray to a cluster. Raises EngineError if that fails."""
    try:
        import ray
    except ImportError as error:
        raise EngineError("--cluster needs Ray: pip install 'cubicsplat[ray]'") from error
    match = re.fullmatch(r"(?:ray://)?\[?([^\[\]/]+)\]?:(\d+)", address)
    try:
        if match is not None:  # Ray itself would try for minutes
            socket.create_connection((match[1], int(match[2])), timeout=5.0).close()
        ray.init(address=address, log_to_driver=False, logging_level="ERROR", ignore_reinit_error=True)
    except (OSError, ValueError, RuntimeError, ray.exceptions.RayError) as error:
        raise EngineError(f"no Ray cluster at {address} ({one_line(error)}); start one or check it") from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _submit(
    task: Any, jobs: Iterator[Job], request: Request, share: Share, running: dict[Any, Job], observer: Observer
) -> Iterator[Outcome]:
    """Send out jobs while there is room; yield the failures of pictures that cannot be read."""
    while len(running) < share.at_once and (job := next(jobs, None)) is not None:
        assert job.path is not None  # the command refuses standard input here
        try:
            data, asked = read_whole(job.path), job.request(request)
        except CubicSplatError as error:
            yield failure(job, error)
            continue
        observer.begin(job.name)
        running[task.remote(dataclasses.replace(job, data=data, mask=None), asked, share.cpus)] = job


def _collect(ray: ModuleType, reference: Any, job: Job) -> Outcome:
    """Return the outcome of a task that ended, and write its files in their order, which ends with the report."""
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
