"""A run of `vectorize` over one picture or many: its messages, and its summary at the end."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.errors import EXIT_FAILED, EXIT_INTERRUPTED, UsageError
from cubicsplat_cli.files.names import Outputs
from cubicsplat_cli.files.paths import check_ownership
from cubicsplat_cli.files.write import write_stdout
from cubicsplat_cli.formatting import counted, duration, file_size, level_text, mean, number, printable, text_table
from cubicsplat_cli.jobs.execute import execute, lacking, look, pictures_at_once, with_others, write_index
from cubicsplat_cli.jobs.plan import Job, JobPlan
from cubicsplat_cli.jobs.run import DONE, FAILED, INTERRUPTED, PLANNED, UNCHANGED, Outcome, failure, uri_line
from cubicsplat_cli.metrics import Report, json_line
from cubicsplat_cli.progress import Observer, interrupt
from cubicsplat_cli.request import Request

STATES = (DONE, UNCHANGED, INTERRUPTED, FAILED)  # of ended pictures, in the order of the closing table


def closing_table(ended: Sequence[Outcome], planned: int, seconds: float) -> list[str]:
    """Return the lines of the closing table. planned: pictures in all; seconds: of the run."""
    alike = ((status, [each for each in ended if each.status == status]) for status in STATES)
    lines = [[status, *_cells(outcomes)] for status, outcomes in alike if outcomes]
    if planned > len(ended):
        lines.append(["not begun", str(planned - len(ended)), "", "", "", ""])
    table = text_table(["", "pictures", "curves", "SVG", "mean dB", "mean SSIM"], lines)
    return [*table.splitlines(), f"{counted(planned, 'picture')} in {duration(seconds)}"]


def _cells(outcomes: Sequence[Outcome]) -> list[str]:
    reports = [outcome.report for outcome in outcomes if outcome.report is not None]
    curves, size = sum(report.count() for report in reports), sum(report.output.bytes for report in reports)
    measured = [report.quality.svg for report in reports if report.quality is not None]
    decibels, similarity = mean(q.psnr_db for q in measured), mean(q.ssim for q in measured)
    figures = ["" if value is None else number(value, places) for value, places in ((decibels, 2), (similarity, 3))]
    return [str(len(outcomes)), str(curves or ""), file_size(size) if size else "", *figures]


@dataclass(eq=False)
class BatchRun:
    """One run: its plan and options, and its outcomes so far. workers, cluster: see `execute`."""

    plan: JobPlan
    request: Request
    reporter: Reporter
    workers: int | None = None
    cluster: str | None = None
    json: bool = False
    dry_run: bool = False
    ended: list[Outcome] = field(default_factory=list)
    stopped: bool = False
    started: float = field(default_factory=time.perf_counter)

    def go(self) -> int:
        """Do everything; return the exit code."""
        for reason, paths in self.plan.left_out.items():
            shown = ", ".join(map(str, paths[:3])) + (f" and {len(paths) - 3} more" if len(paths) > 3 else "")
            self.reporter.note(f"left out, {reason}: {len(paths)} ({shown})")
        for name, error in self.plan.problems:
            self.record_outcome(failure(Job(name, None, Outputs(None, None, None)), error))
        if self.plan.index is not None and not self.dry_run:
            check_ownership([self.plan.index], force=self.request.force)
        if self.dry_run:
            for job in self.plan.jobs:
                self.record_outcome(with_others(look(job, self.request), self.request, self.reporter, dry_run=True))
        elif self.plan.jobs:
            self._work()
        failures = [outcome for outcome in self.ended if outcome.status == FAILED]
        if not self.dry_run:
            self._sum_up(any_made=len(failures) < self.plan.pictures)
        for outcome in failures:
            self.reporter.error(outcome.error or "")
        if self.stopped or any(outcome.status == INTERRUPTED for outcome in self.ended):
            return EXIT_INTERRUPTED
        if self.plan.pictures == 1 and failures:
            return failures[0].exit_code
        return EXIT_FAILED if failures else 0

    def record_outcome(self, outcome: Outcome) -> None:
        """Print and count how one picture ended."""
        self.reporter.end(outcome.job.name)
        if outcome.status == FAILED:
            if self.plan.pictures > 1:
                self.reporter.summary(f"{outcome.job.name}  failed")
            if outcome.trace is not None:
                self.reporter.raw(outcome.trace)
        elif outcome.status == PLANNED or self.dry_run:
            if not self.json:
                _print_plan(outcome, self.request)
        elif outcome.report is not None:
            if outcome.report.interrupted and self.plan.pictures == 1:
                step = outcome.report.timing.steps
                self.reporter.note(f"interrupted{f' at step {step}' if step else ''}: the best SVG so far is written")
            outputs = outcome.job.outputs
            also = "".join(f"  {path.name}" for path in outputs.exports)
            if outputs.layers is not None:
                also += f"  {counted(len(outputs.existing_layers()), 'layer')} in {outputs.layers.parent}"
            self.reporter.summary(summary_line(outcome.report, outcome.status) + also)
        elif outcome.status == UNCHANGED:
            self.reporter.summary(f"{outcome.job.outputs.svg}  unchanged")
        if outcome.status != PLANNED:
            self.ended.append(outcome)
        svg, written = outcome.job.outputs.svg, outcome.status in (DONE, UNCHANGED, INTERRUPTED)
        if self.request.data_uri and svg is not None and written and not self.dry_run:
            write_stdout(uri_line(svg.read_bytes()))
        if self.json:
            write_stdout(json_line(outcome.public()))

    def _work(self) -> None:
        if self.plan.pictures > 1:
            self.reporter.detail(self.request.describe())
            asked, at_once = self.workers or 1, pictures_at_once(self.workers)
            if self.cluster is None and min(asked, self.plan.pictures) > at_once:
                cores = f"{counted(at_once, 'core')}, so {counted(at_once, 'picture')} at once"
                self.reporter.note(f"--jobs {asked}: {cores}")
        with self.reporter.showing(self.plan.pictures), self._interrupts():
            outcomes = execute(
                self.plan, self.request, self.reporter, lambda: self.stopped, workers=self.workers, cluster=self.cluster
            )
            for outcome in outcomes:
                self.record_outcome(outcome)

    def _sum_up(self, *, any_made: bool) -> None:
        """Print the table; write the index, in the order of the plan; name the page to look at if it shows any SVG."""
        if self.plan.pictures > 1:
            for line in closing_table(self.ended, self.plan.pictures, time.perf_counter() - self.started):
                self.reporter.summary(line)
        page = self.plan.jobs[0].outputs.html_report if self.plan.pictures == 1 and self.plan.jobs else None
        if self.plan.index is not None:
            page = self.plan.index
            places = {job.name: place for place, job in enumerate(self.plan.jobs)}
            write_index(page, sorted(self.ended, key=lambda outcome: places.get(outcome.job.name, -1)))
        if page is not None and any_made:
            self.reporter.summary(f"to look at: {page}")

    @contextmanager
    def _interrupts(self) -> Iterator[None]:
        """Within, the first Ctrl-C ends the work under way with its results so far, and the second ends everything."""

        def stop(_number: int, _frame: FrameType | None) -> None:
            again, self.stopped = self.stopped, True
            if not again:
                self.reporter.note("interrupted: the work under way ends with what it has; Ctrl-C again ends at once")
            if again or (self.cluster is None and self.plan.pictures == 1):
                interrupt()

        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


def check_stdout(plan: JobPlan, *, json: bool, cluster: bool, uri: bool = False) -> None:
    """Raise UsageError where two things would go to standard output, or none can."""
    if json and uri:
        raise UsageError("--json and --data-uri would both go to standard output; leave one of them out")
    for job in plan.jobs:
        if job.outputs.svg is None and json:
            raise UsageError("--json and the SVG would both go to standard output; give a file with -o")
        if cluster and (job.outputs.svg is None or job.path is None):
            raise UsageError("--cluster works from files to files; give them instead of -")


def _print_plan(outcome: Outcome, request: Request) -> None:
    """Print the line of a dry run about a job: the path of its SVG, or of the files to be made of a finished SVG."""
    paths = [outcome.job.outputs.svg]
    if outcome.report is not None and outcome.status != UNCHANGED:
        paths = [*lacking(outcome.job, outcome.report, request, Observer())]
    target = ", ".join("standard output" if path is None else printable(str(path)) for path in paths)
    state = "unchanged" if outcome.status == UNCHANGED else "to do"
    write_stdout(f"{state}  {printable(outcome.job.name)} -> {target}\n".encode())


def summary_line(report: Report, status: str = DONE) -> str:
    """Return `out.svg  512 curves  61 kB  SVG 31.9 dB  SSIM 0.86  47 s  cpu`."""
    output = report.output
    packed = output.compressed_bytes  # if a limit counts these
    size = file_size(output.bytes) + ("" if packed in (None, output.bytes) else f", {file_size(packed)} gzipped")
    parts = [output.svg or "stdout", report.style, _size_text(report), size, *_quality_parts(report)]
    if status == UNCHANGED:
        parts.append("unchanged")
    else:
        parts += [duration(report.timing.total_s), str(report.device["name"])]
    if status == INTERRUPTED:
        parts.append("interrupted")
    return "  ".join(parts)


def _size_text(report: Report) -> str:
    """Return `512 curves`, `5 shapes`, or `27 shapes in 3 elements`."""
    if report.shapes is None:
        return counted(report.output.paths, "curve")
    apart = report.shapes == report.output.paths
    return counted(report.shapes, "shape") + ("" if apart else f" in {counted(report.output.paths, 'element')}")


def _quality_parts(report: Report) -> list[str]:
    if report.quality is None:
        return ["not measured"]
    svg = report.quality.svg
    return [f"SVG {level_text(svg.psnr_db, 1)}", "SSIM n/a" if svg.ssim is None else f"SSIM {svg.ssim:.2f}"]
