"""The pages of jobs that an earlier run has done, and the page that leads to all."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cubicsplat_cli.errors import CubicSplatError
from cubicsplat_cli.files.marks import made_mark
from cubicsplat_cli.files.paths import is_file, read_head
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.run import PLANNED, UNCHANGED, Outcome, failure, load_job
from cubicsplat_cli.request import Request

if TYPE_CHECKING:
    from cubicsplat_cli.report import Report


def has_page(job: Job, report: Report) -> bool:
    """Whether the page of a job is there, and about the SVG that the report is about; true where none is wanted."""
    path = job.outputs.page
    if path is None:
        return True
    return is_file(path) and made_mark(report.output.svg_sha256).encode() in read_head(path)


def with_page(outcome: Outcome, request: Request) -> Outcome:
    """The outcome of a job whose files an earlier run made, after its page has been made too where it is missing."""
    job, report = outcome.job, outcome.report
    if outcome.status != UNCHANGED or report is None or has_page(job, report):
        return outcome
    from cubicsplat_cli.files.read import read_file
    from cubicsplat_cli.show.page import page, subject_of

    assert job.outputs.svg is not None and job.outputs.page is not None
    try:
        picture = load_job(job, request)
        subject = subject_of(picture, job.source(), read_file(job.outputs.svg), report)
        write_atomically(job.outputs.page, page(subject, request.settings.threads))
    except CubicSplatError as error:
        return failure(job, error)
    return outcome


def planned_page(outcome: Outcome) -> Outcome:
    """What a dry run says in place of the outcome of a job that lacks nothing but its page."""
    done = outcome.status != UNCHANGED or outcome.report is None or has_page(outcome.job, outcome.report)
    return outcome if done else replace(outcome, status=PLANNED)


def write_index(path: Path, outcomes: list[Outcome]) -> None:
    """The page that leads to the pages of all pictures, in the order given. Raises InputError as all writing does."""
    from cubicsplat_cli.show.index import Entry, entry_of, index

    entries = []
    for outcome, name in zip(outcomes, _short_names([outcome.job.name for outcome in outcomes]), strict=True):
        report, outputs = outcome.report, outcome.job.outputs
        if report is None or outputs.page is None or outputs.svg is None:
            entries.append(Entry(name, error=outcome.error or outcome.status))
        else:
            entries.append(entry_of(name, outputs.page, report, outputs.png, outputs.svg))
    write_atomically(path, index(path, entries, path.absolute().parent.name or "pictures"))


def _short_names(names: list[str]) -> list[str]:
    """The names without the folder that all of them share, which says nothing and may be long."""
    folders = {os.path.dirname(name) for name in names}  # noqa: PTH120 (names may be patterns)
    absolute = {os.path.isabs(name) for name in names}  # noqa: PTH117
    if len(absolute) != 1:
        return names
    shared = os.path.commonpath(folders)
    return [os.path.relpath(name, shared) for name in names] if shared else names
