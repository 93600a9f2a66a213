"""Jobs carried out: in this process, by worker processes, or on a cluster; the outcomes as they come."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from cubicsplat_cli.errors import CubicSplatError
from cubicsplat_cli.files.paths import is_file
from cubicsplat_cli.jobs.earlier import check_may_write, earlier_report, finished, prepare
from cubicsplat_cli.jobs.events import Events
from cubicsplat_cli.jobs.masks import request_of
from cubicsplat_cli.jobs.pages import with_page
from cubicsplat_cli.jobs.plan import Job, Plan
from cubicsplat_cli.jobs.run import PLANNED, UNCHANGED, FileSink, Outcome, attempt, failure
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import cpu_count


@dataclass(frozen=True)
class Means:
    """With what the jobs are carried out. workers: pictures at once (None: one, or what the cluster can take). cluster:
    its address, None for this machine. inline: in this process, where there is one picture.
    """

    workers: int | None = None
    cluster: str | None = None
    inline: bool = False

    def at_once(self) -> int:
        """Pictures at once on this machine: more than there are cores would only wait for each other."""
        return min(self.workers or 1, cpu_count())


def execute(
    plan: Plan, request: Request, means: Means, events: Events, stopping: Callable[[], bool]
) -> Iterator[Outcome]:
    """An outcome for each job of the plan. What an earlier run has done is looked at when it is a job's turn.

    Once `stopping()` is true nothing is begun any more, and the fits under way end early with the best they have.
    Raises EngineError where the cluster does not answer.
    """
    settled: list[Outcome] = []
    to_do = _to_do(plan.jobs, request, settled)
    for outcome in _carried_out(to_do, len(plan.jobs), request, means, events, stopping):
        yield from _taken(settled)
        yield outcome
    yield from _taken(settled)


def look(job: Job, request: Request) -> Outcome:
    """What would become of a job; changes nothing on the disk."""
    svg = job.outputs.svg
    if request.skip_existing and svg is not None and is_file(svg) and svg.stat().st_size > 0:
        return Outcome(job, UNCHANGED, earlier_report(job))
    try:
        report = None if request.force else finished(job, request_of(job, request).digest())
        if report is None:
            check_may_write(job, force=request.force)
    except CubicSplatError as error:
        return failure(job, error)
    return Outcome(job, PLANNED if report is None else UNCHANGED, report)


def _carried_out(
    jobs: Iterator[Job], count: int, request: Request, means: Means, events: Events, stopping: Callable[[], bool]
) -> Iterator[Outcome]:
    if means.cluster is not None:
        from cubicsplat_cli.jobs.cluster import run_on_cluster

        yield from run_on_cluster(
            jobs, request, address=means.cluster, count=count, limit=means.workers, events=events, stopping=stopping
        )
    elif means.inline:
        for job in jobs:
            events.begin(job.name)
            yield attempt(job, request, sink=FileSink(job), events=events)
    else:
        from cubicsplat_cli.jobs.pool import run_in_workers

        workers = min(means.at_once(), count)
        yield from run_in_workers(jobs, request, workers=workers, events=events, stopping=stopping)


def _to_do(jobs: list[Job], request: Request, settled: list[Outcome]) -> Iterator[Job]:
    """The jobs that need work; the outcomes of the others go to `settled`."""
    for job in jobs:
        outcome = look(job, request)
        if outcome.status == PLANNED:
            try:
                prepare(job, force=request.force)
            except CubicSplatError as error:
                outcome = failure(job, error)
            else:
                yield job
                continue
        settled.append(with_page(outcome, request))


def _taken(settled: list[Outcome]) -> Iterator[Outcome]:
    while settled:
        yield settled.pop(0)
