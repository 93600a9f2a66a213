"""Jobs carried out: in this process, by worker processes, or on a cluster; the outcomes as they come."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from cubicsplat_cli.errors import CubicSplatError
from cubicsplat_cli.files.marks import made_mark, sha256_of
from cubicsplat_cli.files.paths import check_outputs, check_ownership, is_file, is_marked
from cubicsplat_cli.files.read import read_file
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.jobs.plan import Job, JobPlan, make_folders
from cubicsplat_cli.jobs.results import FileSink, check_may_write, earlier_report, finished, prepare_files
from cubicsplat_cli.jobs.run import PLANNED, UNCHANGED, Outcome, attempt, export_of, failure, layer_files, load_job
from cubicsplat_cli.metrics import Report
from cubicsplat_cli.progress import Observer
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import cpu_count


def pictures_at_once(workers: int | None) -> int:
    """Return the number of pictures at once on this machine: more of them than cores would wait for each other."""
    return min(workers or 1, cpu_count())


def execute(
    plan: JobPlan,
    request: Request,
    observer: Observer,
    stopping: Callable[[], bool],
    *,
    workers: int | None = None,
    cluster: str | None = None,
) -> Iterator[Outcome]:
    """Yield an outcome for each job of the plan. The files of earlier runs are looked at when it is a job's turn.

    Once `stopping()` is true no job begins any more, and the fits under way end early with the best they have. workers:
    pictures at once (None: one, or as many as the cluster can take). cluster: its address, None for this machine; a
    single picture of this machine is done in this process. Raises EngineError where the cluster does not answer.
    """
    finished_before: list[Outcome] = []
    jobs, count = _to_do(plan.jobs, request, finished_before, observer), len(plan.jobs)
    if cluster is not None:
        from cubicsplat_cli.jobs.cluster import run_on_cluster

        outcomes = run_on_cluster(
            jobs, request, address=cluster, count=count, limit=workers, observer=observer, stopping=stopping
        )
    elif plan.pictures == 1:
        outcomes = (attempt(job, request, sink=FileSink(job), observer=observer) for job in jobs)
    else:
        from cubicsplat_cli.jobs.pool import run_in_workers

        workers = min(pictures_at_once(workers), count)
        outcomes = run_in_workers(jobs, request, workers=workers, observer=observer, stopping=stopping)
    for outcome in outcomes:
        yield from finished_before
        finished_before.clear()
        yield outcome
    yield from finished_before


def look(job: Job, request: Request) -> Outcome:
    """Find out whether a job is to be done, unchanged or impossible; change nothing on the disk."""
    svg = job.outputs.svg
    if request.skip_existing and svg is not None and is_file(svg) and svg.stat().st_size > 0:
        return Outcome(job, UNCHANGED, earlier_report(job))
    try:
        report = None if request.force else finished(job, job.request(request).digest())
        if report is None:
            check_may_write(job, force=request.force)
    except CubicSplatError as error:
        return failure(job, error)
    return Outcome(job, PLANNED if report is None else UNCHANGED, report)


def _to_do(jobs: list[Job], request: Request, finished_before: list[Outcome], observer: Observer) -> Iterator[Job]:
    """Yield the jobs that need work; put the outcomes of the others into `finished_before`."""
    for job in jobs:
        outcome = look(job, request)
        if outcome.status == PLANNED:
            try:
                prepare_files(job)
            except CubicSplatError as error:
                outcome = failure(job, error)
            else:
                yield job
                continue
        finished_before.append(with_others(outcome, request, observer))


def lacking(job: Job, report: Report, request: Request, observer: Observer) -> dict[Path, Callable[[], bytes]]:
    """Return what makes each page, export and layer of a finished SVG that is missing, or was made of another SVG."""
    outputs, files = job.outputs, dict[Path, Callable[[], bytes]]()
    if outputs.svg is None or not (outputs.html_report or outputs.exports or outputs.layers):
        return files
    svg, page = read_file(outputs.svg), outputs.html_report
    if page is not None and not is_marked(page, made_mark(report.output.svg_sha256)):
        from cubicsplat_cli.html_report.page import page_of_result

        threads = request.settings.threads
        files[page] = lambda: page_of_result(load_job(job, request), job.source(), svg, report, threads)
    if outputs.exports:
        from cubicsplat_cli.export.formats import mark_of

        for path in outputs.exports:
            if not is_marked(path, mark_of(svg, path.suffix[1:].lower(), request.dxf_tolerance)):
                files[path] = partial(export_of, path, svg, job, request, lambda text: observer.note(text, job.name))
    for kind, data in layer_files(svg).items() if outputs.layers is not None else ():
        layer = outputs.place(kind)
        if layer is not None and not is_marked(layer, made_mark(sha256_of(svg))):
            files[layer] = partial(bytes, data)
    return files


def with_others(outcome: Outcome, request: Request, observer: Observer, *, dry_run: bool = False) -> Outcome:
    """Make the files that a job, finished by an earlier run, lacks of its SVG; return its outcome.

    dry_run: makes nothing; the outcome of a job that lacks files is that it is planned.
    """
    job, report = outcome.job, outcome.report
    if outcome.status != UNCHANGED or report is None:
        return outcome
    try:
        missing = lacking(job, report, request, observer)
        if dry_run:
            check_ownership([*missing], force=request.force)
            return replace(outcome, status=PLANNED) if missing else outcome
        if missing:
            make_folders(job)
        check_outputs([*missing], force=request.force)
        for path, made in missing.items():
            write_atomically(path, made())
    except CubicSplatError as error:
        return failure(job, error)
    return outcome


def write_index(path: Path, outcomes: list[Outcome]) -> None:
    """Write the page that links the pages of all pictures, in the order given. Raises what writing raises."""
    from cubicsplat_cli.html_report.index import Entry, entry_of, index

    entries = []
    for outcome, name in zip(outcomes, _short_names([outcome.job.name for outcome in outcomes]), strict=True):
        report, outputs = outcome.report, outcome.job.outputs
        if report is None or outputs.html_report is None or outputs.svg is None:
            entries.append(Entry(name, error=outcome.error or outcome.status))
        else:
            entries.append(entry_of(name, outputs.html_report, report, outputs.png, outputs.svg))
    write_atomically(path, index(path, entries, path.absolute().parent.name or "pictures"))


def _short_names(names: list[str]) -> list[str]:
    """Return the names without the folder that all of them share, which says nothing and may be long."""
    try:
        shared = os.path.commonpath([os.path.dirname(name) for name in names])  # noqa: PTH120 (names may be patterns)
    except ValueError:  # of absolute and relative names
        return names
    return [os.path.relpath(name, shared) for name in names] if shared else names
