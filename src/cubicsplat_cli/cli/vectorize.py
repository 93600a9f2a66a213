"""`cubicsplat vectorize`: pictures become SVGs, their rendered PNGs and JSONs of figures."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.fit_options import fit_overrides, takes_fit_options
from cubicsplat_cli.cli.options import DEFAULT_MAX_PIXELS, MAX_JOBS, MAX_PRECISION, MAX_SIZE
from cubicsplat_cli.cli.results import Choices, print_outcome, print_plan
from cubicsplat_cli.cli.summary import summary_line
from cubicsplat_cli.errors import CubicSplatError, UsageError
from cubicsplat_cli.files.names import STDIO, names_a_folder, plan_outputs
from cubicsplat_cli.jobs.plan import Job, Request, all_written, check_may_write, finished, prepare
from cubicsplat_cli.jobs.sources import is_batch
from cubicsplat_cli.jobs.work import (
    DONE,
    INTERRUPTED,
    PLANNED,
    UNCHANGED,
    FileSink,
    Outcome,
    Watcher,
    failure,
    load_job,
    run_job,
)

if TYPE_CHECKING:
    from cubicsplat_cli.files.load import Picture

EXIT_INTERRUPTED = 130

Inputs = Annotated[
    list[str],
    typer.Argument(
        metavar="IN",
        help="Pictures, folders, patterns such as 'photos/*.png', or - for standard input.",
        show_default=False,
    ),
]
Output = Annotated[
    str | None,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT",
        help="SVG to write, a folder for it, or - for standard output; PNG and JSON lie beside it."
        "  [default: the input's name with .svg]",
        show_default=False,
    ),
]
Recursive = Annotated[bool, typer.Option("--recursive", "-r", help="Search folders at any depth.")]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", "-j", min=1, max=MAX_JOBS, help="Pictures at once, each in a process.  [default: 1]"),
]
Cluster = Annotated[
    str | None, typer.Option("--cluster", metavar="ADDRESS", help="Run on the Ray cluster there: host:port, or auto.")
]
Precision = Annotated[
    int,
    typer.Option("--precision", min=0, max=MAX_PRECISION, help="Decimals of the SVG's coordinates, in px."),
]
MaxSize = Annotated[
    int | None,
    typer.Option("--max-size", min=1, max=MAX_SIZE, metavar="PX", help="Fit a copy scaled down to this longer side."),
]
MaxPixels = Annotated[int, typer.Option("--max-pixels", min=1, help="Refuse pictures with more pixels than this.")]
Png = Annotated[bool, typer.Option("--png/--no-png", help="Also write the SVG as a rendered PNG.")]
Svgz = Annotated[bool, typer.Option("--svgz", help="Write the SVG compressed, as OUT.svgz.")]
Force = Annotated[
    bool, typer.Option("--force", help="Make everything anew, and replace files that cubicsplat did not write.")
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Only say what would be made.")]
Json = Annotated[bool, typer.Option("--json", help="Print the figures on standard output, one JSON line a picture.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print settings and plain progress too.")]


@takes_fit_options
def vectorize(
    inputs: Inputs,
    output: Output = None,
    recursive: Recursive = False,
    jobs: Jobs = None,
    cluster: Cluster = None,
    precision: Precision = 2,
    max_size: MaxSize = None,
    max_pixels: MaxPixels = DEFAULT_MAX_PIXELS,
    png: Png = True,
    svgz: Svgz = False,
    force: Force = False,
    dry_run: DryRun = False,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    **fit: Any,
) -> None:
    """Turn pictures into SVGs of Bezier shapes.

    For each picture, writes OUT.svg, OUT.png (the SVG drawn by an independent renderer) and OUT.json (the figures).
    What an earlier run made from the same picture with the same settings is left as it is. Ctrl-C ends the fit early
    and writes the best SVG so far.
    """
    if "" in inputs or output == "":
        # Path("") is the current folder, which an unset shell variable does not mean.
        raise UsageError("a file name is empty; is a variable not set?")
    preset, overrides = fit_overrides(fit)
    request = Request(preset, overrides, precision, max_size, max_pixels, png, svgz, force)
    choices = Choices(output, recursive, jobs, cluster, dry_run, json)
    reporter = Reporter(quiet=quiet, verbose=verbose, bars=not (json and sys.stdout.isatty()))
    if is_batch(inputs):
        from cubicsplat_cli.cli.batch import run_batch

        code = run_batch(inputs, request, choices, reporter)
    else:
        code = _run_one(inputs[0], request, choices, reporter)
    if code:
        raise typer.Exit(code)


def _run_one(source: str, request: Request, choices: Choices, reporter: Reporter) -> int:
    """One picture; the exit code."""
    path = None if source == STDIO else Path(source)
    to_stdout = choices.output == STDIO or (choices.output is None and path is None)
    if choices.json and to_stdout:
        raise UsageError("--json and the SVG would both go to standard output; give a file with -o")
    if choices.cluster is not None and (path is None or to_stdout):
        raise UsageError("--cluster works from files to files; give them instead of -")
    job = Job.named(source)
    try:
        job, picture = _load(job, path, request, choices)
        if choices.cluster is not None:
            from cubicsplat_cli.cli.batch import run_planned

            return run_planned([job], [], request, choices, reporter, make_folders=False)
        outcome = _do(job, picture, request, choices, reporter)
    except CubicSplatError as error:
        if choices.json:
            print_outcome(failure(job, error))
        raise
    if choices.json:
        print_outcome(outcome)
    elif choices.dry_run:
        print_plan(outcome)
    return EXIT_INTERRUPTED if outcome.status == INTERRUPTED else 0


def _load(job: Job, path: Path | None, request: Request, choices: Choices) -> tuple[Job, Picture]:
    """The job with its outputs, and its picture."""
    job = replace(job, path=path, data=sys.stdin.buffer.read() if path is None else None)
    picture = load_job(job, request)
    outputs = plan_outputs(path, choices.output, png=request.png, compress=request.compress)
    return replace(job, outputs=outputs), picture


def _do(job: Job, picture: Picture, request: Request, choices: Choices, reporter: Reporter) -> Outcome:
    """The job in this process, unless an earlier run has done it."""
    # torch takes seconds to import, and only matters here when there is something to compare with.
    if not request.force and all_written(job) and (report := finished(job, request.digest())) is not None:
        reporter.summary(summary_line(report, UNCHANGED))
        return Outcome(job, UNCHANGED, report)
    if choices.dry_run:
        check_may_write(job, force=request.force)
        return Outcome(job, PLANNED)
    prepare(job, force=request.force, make_folders=choices.output is not None and names_a_folder(choices.output))
    with reporter.progress(job.title) as step:
        watcher = Watcher(reporter.note, reporter.detail, step)
        report = run_job(job, request, threads=None, sink=FileSink(job), watcher=watcher, picture=picture)
    if report["interrupted"]:
        reporter.note(f"interrupted at step {report['timing']['steps']}: the best SVG so far is written")
    reporter.summary(summary_line(report))
    return Outcome(job, INTERRUPTED if report["interrupted"] else DONE, report)
