"""Many pictures in one run: each outcome as it comes, a closing table, and the failures last."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType

from cubicsplat_cli.cli.console import ManyBars, Reporter
from cubicsplat_cli.cli.results import Choices, print_outcome, print_plan
from cubicsplat_cli.cli.summary import Tally, summary_line
from cubicsplat_cli.errors import CubicSplatError
from cubicsplat_cli.jobs.plan import Job, Request, check_may_write, finished, plan_jobs, prepare
from cubicsplat_cli.jobs.pool import Listener, run_jobs
from cubicsplat_cli.jobs.sources import find_sources
from cubicsplat_cli.jobs.work import FAILED, PLANNED, UNCHANGED, Outcome, failure
from cubicsplat_cli.progress import Progress

EXIT_FAILED, EXIT_INTERRUPTED = 1, 130


def run_batch(arguments: list[str], request: Request, choices: Choices, reporter: Reporter) -> int:
    """Vectorise everything the arguments lead to; the exit code."""
    found = find_sources(arguments, recursive=choices.recursive)
    for path in found.left_out:
        reporter.detail(f"{path}: drawn by cubicsplat itself, left out")
    jobs = plan_jobs(found.sources, choices.output, png=request.png, compress=request.compress)
    broken = [failure(Job.named(name), error) for name, error in found.problems]
    return run_planned(jobs, broken, request, choices, reporter, make_folders=True)


def run_planned(
    jobs: list[Job],
    broken: list[Outcome],
    request: Request,
    choices: Choices,
    reporter: Reporter,
    *,
    make_folders: bool,
) -> int:
    """Do `jobs`, `broken` being arguments that led to none; the exit code."""
    digest = request.digest() if jobs else ""
    if jobs:
        reporter.detail(request.describe())
    run = _Run(jobs, len(jobs) + len(broken), request, digest, choices, reporter, make_folders)
    for outcome in broken:
        run.settle(outcome)
    if choices.dry_run:
        for job in jobs:
            run.settle(run.plan(job))
    else:
        run.work()
    run.close()
    if run.stopped:
        return EXIT_INTERRUPTED
    return EXIT_FAILED if run.failures else 0


@dataclass
class _Run:
    """One run over many pictures."""

    jobs: list[Job]
    pictures: int  # the jobs, and the arguments that led to none
    request: Request
    digest: str
    choices: Choices
    reporter: Reporter
    make_folders: bool
    tally: Tally = field(default_factory=Tally)
    failures: list[Outcome] = field(default_factory=list)
    stopped: bool = False
    bars: ManyBars | None = None
    started: float = field(default_factory=time.perf_counter)

    def work(self) -> None:
        """Hand out what is to do, and settle what comes back."""
        with self.reporter.progress_of_many(len(self.jobs)) as self.bars, self._stopped_by_ctrl_c():
            for outcome in self._outcomes():
                self.settle(outcome)
        self.bars = None

    def plan(self, job: Job) -> Outcome:
        """What would become of a job; changes nothing on the disk."""
        try:
            report = None if self.request.force else finished(job, self.digest)
            if report is None:
                check_may_write(job, force=self.request.force)
        except CubicSplatError as error:
            return failure(job, error)
        return Outcome(job, PLANNED if report is None else UNCHANGED, report)

    def settle(self, outcome: Outcome) -> None:
        """Tell how one picture ended."""
        if self.bars is not None:
            self.bars.end(outcome.job.name)
        if outcome.status == FAILED:
            self.failures.append(outcome)
            if self.pictures > 1:
                self.reporter.summary(f"{outcome.job.name}  failed")
            if outcome.trace is not None:
                print(outcome.trace, file=sys.stderr)
        elif outcome.status == PLANNED or self.choices.dry_run:
            if not self.choices.json:
                print_plan(outcome)
        else:
            for note in outcome.report["notes"] if outcome.status != UNCHANGED else ():
                self.reporter.note(f"{outcome.job.name}: {note}")
            self.reporter.summary(summary_line(outcome.report, outcome.status))
        if outcome.status != PLANNED:
            self.tally.add(outcome)
        if self.choices.json:
            print_outcome(outcome)

    def close(self) -> None:
        """The table, and after it what failed."""
        if self.pictures > 1 and not self.choices.dry_run:
            for line in self.tally.table(self.pictures, time.perf_counter() - self.started):
                self.reporter.summary(line)
        for outcome in self.failures:
            self.reporter.error(outcome.error or "")

    def _outcomes(self) -> Iterator[Outcome]:
        listener = Listener(start=self._begin, step=self._step, note=lambda _, text: self.reporter.note(text))
        threads = self.request.overrides.get("threads")
        if self.choices.cluster is None:
            yield from run_jobs(
                self._to_do(),
                self.request,
                workers=max(1, min(self.choices.jobs or 1, len(self.jobs))),
                threads=threads,
                listener=listener,
                stopping=lambda: self.stopped,
            )
            return
        from cubicsplat_cli.jobs.cluster import run_on_cluster

        yield from run_on_cluster(
            self._to_do(),
            self.request,
            address=self.choices.cluster,
            count=len(self.jobs),
            limit=self.choices.jobs,
            threads=threads,
            listener=listener,
            stopping=lambda: self.stopped,
        )

    def _to_do(self) -> Iterator[Job]:
        """The jobs that need work, looked at when it is their turn; the others are settled here."""
        for job in self.jobs:
            outcome = self.plan(job)
            if outcome.status == PLANNED:
                try:
                    prepare(job, force=self.request.force, make_folders=self.make_folders)
                except CubicSplatError as error:
                    outcome = failure(job, error)
                else:
                    yield job
                    continue
            self.settle(outcome)

    def _begin(self, job: Job) -> None:
        self.reporter.detail(f"{job.name}: begun")
        if self.bars is not None:
            self.bars.begin(job.name)

    def _step(self, job: Job, at: Progress) -> None:
        if self.bars is not None:
            self.bars.step(job.name, at)

    @contextmanager
    def _stopped_by_ctrl_c(self) -> Iterator[None]:
        """The first Ctrl-C ends the fits under way with what they have, the second ends everything at once."""

        def stop(_number: int, _frame: FrameType | None) -> None:
            if self.stopped:
                raise KeyboardInterrupt
            self.stopped = True
            self.reporter.note("interrupted: the fits under way end with what they have; Ctrl-C again ends at once")

        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
