"""A run of `vectorize` over one picture or many: told as it goes, summed up at its end."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.display import Display
from cubicsplat_cli.cli.summary import Tally, summary_line
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.paths import check_ownership
from cubicsplat_cli.files.write import write_stdout
from cubicsplat_cli.jobs.events import Events
from cubicsplat_cli.jobs.execute import Means, execute, look
from cubicsplat_cli.jobs.interrupt import interrupt
from cubicsplat_cli.jobs.pages import planned_page, write_index
from cubicsplat_cli.jobs.plan import Plan
from cubicsplat_cli.jobs.run import FAILED, INTERRUPTED, PLANNED, UNCHANGED, Outcome, failure, named_job
from cubicsplat_cli.progress import Progress
from cubicsplat_cli.report import plain
from cubicsplat_cli.request import Request
from cubicsplat_cli.words import counted, printable

EXIT_FAILED, EXIT_INTERRUPTED = 1, 130


@dataclass
class Run(Events):
    """One run: what it is to do, and how it is told."""

    plan: Plan
    request: Request
    means: Means
    reporter: Reporter
    json: bool = False
    dry_run: bool = False
    tally: Tally = field(default_factory=Tally)
    failures: list[Outcome] = field(default_factory=list)
    shown: list[Outcome] = field(default_factory=list)  # those that the index is about
    stopped: bool = False
    display: Display = field(default_factory=Display)
    started: float = field(default_factory=time.perf_counter)

    def go(self) -> int:
        """Do everything; the exit code."""
        for reason, paths in self.plan.left_out.items():
            self._tell_left_out(reason, [str(path) for path in paths])
        for name, error in self.plan.problems:
            self.settle(failure(named_job(name), error))
        if self.plan.index is not None and not self.dry_run:
            check_ownership([self.plan.index], force=self.request.force)
        if self.dry_run:
            for job in self.plan.jobs:
                self.settle(planned_page(look(job, self.request)))
        elif self.plan.jobs:
            self._work()
        self._close()
        if self.stopped or self.tally.rows[INTERRUPTED].pictures:
            return EXIT_INTERRUPTED
        if self.plan.pictures == 1 and self.failures:
            return self.failures[0].exit_code
        return EXIT_FAILED if self.failures else 0

    def settle(self, outcome: Outcome) -> None:
        """Tell how one picture ended."""
        self.display.end(outcome.job.name)
        if outcome.status == FAILED:
            self.failures.append(outcome)
            if self.plan.pictures > 1:
                self.reporter.summary(f"{outcome.job.name}  failed")
            if outcome.trace is not None:
                self.reporter.raw(outcome.trace)
        elif outcome.status == PLANNED or self.dry_run:
            if not self.json:
                _print_plan(outcome)
        elif outcome.report is not None:
            if outcome.report.interrupted and self.plan.pictures == 1:
                step = outcome.report.timing.steps
                self.reporter.note(f"interrupted{f' at step {step}' if step else ''}: the best SVG so far is written")
            self.reporter.summary(summary_line(outcome.report, outcome.status))
        elif outcome.status == UNCHANGED:
            self.reporter.summary(f"{outcome.job.outputs.svg}  unchanged")
        if outcome.status != PLANNED:
            self.tally.add(outcome)
            if self.plan.index is not None:
                self.shown.append(outcome)
        if self.json:
            line = json.dumps(plain(outcome.public()), separators=(",", ":"), allow_nan=False)
            write_stdout(line.encode() + b"\n")

    def begin(self, job: str) -> None:
        self.display.begin(job)

    def stage(self, job: str, stage: str) -> None:
        self.display.stage(job, stage)

    def step(self, job: str, progress: Progress) -> None:
        self.display.step(job, progress)

    def note(self, job: str, text: str) -> None:
        self.reporter.note(text)

    def detail(self, job: str, text: str) -> None:
        self.reporter.detail(text)

    def _work(self) -> None:
        if self.plan.pictures > 1:
            self.reporter.detail(self.request.describe())
            self._tell_of_cores()
        with self.reporter.showing(self.plan.pictures) as self.display, self._interrupts():
            for outcome in execute(self.plan, self.request, self.means, self, lambda: self.stopped):
                self.settle(outcome)
        self.display = Display()

    def _tell_of_cores(self) -> None:
        """That more jobs than there are cores would be of no use, where they were asked for."""
        asked, at_once = self.means.workers, self.means.at_once()
        if asked is not None and self.means.cluster is None and min(asked, self.plan.pictures) > at_once:
            self.reporter.note(f"--jobs {asked}: {counted(at_once, 'core')}, so {counted(at_once, 'picture')} at once")

    def _close(self) -> None:
        """The table, the page to look at, and after it what failed."""
        if self.plan.pictures > 1 and not self.dry_run:
            for line in self.tally.table(self.plan.pictures, time.perf_counter() - self.started):
                self.reporter.summary(line)
        if not self.dry_run:
            self._close_pages()
        for outcome in self.failures:
            self.reporter.error(outcome.error or "")

    def _close_pages(self) -> None:
        """The index, in the order of the plan, and where to begin to look."""
        page = self.plan.jobs[0].outputs.page if self.plan.pictures == 1 and self.plan.jobs else None
        if self.plan.index is not None:
            page = self.plan.index
            places = {job.name: place for place, job in enumerate(self.plan.jobs)}
            write_index(page, sorted(self.shown, key=lambda outcome: places.get(outcome.job.name, -1)))
        if page is not None and len(self.failures) < self.plan.pictures:
            self.reporter.summary(f"to look at: {page}")

    def _tell_left_out(self, reason: str, names: list[str]) -> None:
        shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        self.reporter.note(f"left out, {reason}: {len(names)} ({shown})")

    @contextmanager
    def _interrupts(self) -> Iterator[None]:
        """The first Ctrl-C is acknowledged at once and ends the fits and drawings under way with what they have. The
        second ends everything.
        """

        def stop(_number: int, _frame: FrameType | None) -> None:
            again, self.stopped = self.stopped, True
            if not again:
                self.reporter.note("interrupted: the work under way ends with what it has; Ctrl-C again ends at once")
            if again or self.means.inline:
                interrupt()

        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


def check_stdout(plan: Plan, *, json: bool, cluster: bool) -> None:
    """Raise UsageError where two things would go to standard output, or none can."""
    for job in plan.jobs:
        if job.outputs.svg is None and json:
            raise UsageError("--json and the SVG would both go to standard output; give a file with -o")
        if cluster and (job.outputs.svg is None or job.path is None):
            raise UsageError("--cluster works from files to files; give them instead of -")


def _print_plan(outcome: Outcome) -> None:
    """What a dry run says of a job."""
    outputs = outcome.job.outputs
    path = outputs.svg if outcome.report is None or outcome.status == UNCHANGED else outputs.page
    target = "standard output" if path is None else printable(str(path))
    state = "unchanged" if outcome.status == UNCHANGED else "to do"
    write_stdout(f"{state}  {printable(outcome.job.name)} -> {target}\n".encode())
