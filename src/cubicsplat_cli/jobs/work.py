"""The work on one job, the same in this process, in a worker process and on another machine."""

from __future__ import annotations

import gzip
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from cubicsplat_cli._version import __version__
from cubicsplat_cli.errors import CubicSplatError
from cubicsplat_cli.files.marks import PROGRAM
from cubicsplat_cli.files.names import STDIO
from cubicsplat_cli.files.stdout import write_stdout
from cubicsplat_cli.jobs.plan import Job, Request
from cubicsplat_cli.words import one_line, printable

if TYPE_CHECKING:
    from cubicsplat_cli.files.load import Picture

DONE, UNCHANGED, INTERRUPTED, FAILED, PLANNED = "done", "unchanged", "interrupted", "failed", "planned"


@dataclass(frozen=True)
class Outcome:
    """How a job ended, or that it would be begun (planned). report: the metrics JSON, None where it was not made.
    error: one line, None where it did not fail; trace: the traceback where the failure is a bug.
    """

    job: Job
    status: str
    report: dict[str, Any] | None = None
    error: str | None = None
    exit_code: int = 0
    trace: str | None = None

    def to_json(self) -> dict[str, Any]:
        """What `--json` prints for the job."""
        from cubicsplat_cli.evaluate.report import SCHEMA

        if self.report is not None:
            return {"status": self.status, **self.report}
        head = {"status": self.status, "schema": SCHEMA, "program": PROGRAM, "version": __version__}
        named = {**head, "input": {"path": self.job.name}}
        if self.error is not None:
            return {**named, "error": self.error}
        files = {"svg": self.job.outputs.svg, "png": self.job.outputs.png}
        return {**named, "output": {kind: None if path is None else str(path) for kind, path in files.items()}}


def nothing(*_: object) -> None:
    """A callback that ignores what it is told."""


@dataclass(frozen=True)
class Watcher:
    """Whom to tell while a job runs: `note` things the user should know, `detail` the settings, `step` progress."""

    note: Callable[[str], None] = nothing
    detail: Callable[[str], None] = nothing
    step: Callable[[Any], None] | None = None


class Sink(Protocol):
    """Takes the finished files of one job; `kind` is svg, png or report."""

    def put(self, kind: str, data: bytes) -> None: ...


@dataclass(frozen=True)
class FileSink:
    """Writes each file whole to where the job wants it; an SVG without a place goes to standard output."""

    job: Job

    def put(self, kind: str, data: bytes) -> None:
        from cubicsplat_cli.files.atomic import write_atomically

        path = getattr(self.job.outputs, kind)
        if path is not None:
            write_atomically(path, data)
        elif kind == "svg":
            write_stdout(data)


@dataclass(frozen=True)
class MemorySink:
    """Keeps the files, for whoever asked for them from afar."""

    files: dict[str, bytes] = field(default_factory=dict)

    def put(self, kind: str, data: bytes) -> None:
        self.files[kind] = data


def run_job(
    job: Job, request: Request, *, threads: int | None, sink: Sink, watcher: Watcher, picture: Picture | None = None
) -> dict[str, Any]:
    """Load, fit, write, measure: the report (metrics JSON) of one job.

    The SVG is put out before it is measured, the report last: whoever finds a report finds all files. threads:
    instead of what was asked for. picture: where it is loaded already. Raises what the steps raise.
    """
    started = time.perf_counter()
    if picture is None:
        picture = load_job(job, request)
    for note in picture.notes:
        watcher.note(f"{picture.source}: {note}")
    # torch takes seconds to import: what is wrong with the picture is said before.
    from cubicsplat_cli.evaluate.report import to_json
    from cubicsplat_cli.files.png import encode_png
    from cubicsplat_cli.jobs import pipeline

    settings = request.settings(threads)
    watcher.detail(f"{picture.source}: {picture.width} x {picture.height} px; {request.describe()}")
    fitted = pipeline.fit_to_svg(
        picture,
        settings,
        precision=request.precision,
        title=job.title,
        max_size=request.max_size,
        on_progress=watcher.step,
    )
    svg = fitted.svg
    if request.compress or job.outputs.compressed:
        # Without a time stamp, so that the same picture gives the same bytes.
        svg = gzip.compress(svg, mtime=0)
    sink.put("svg", svg)
    measured = pipeline.measure(fitted)
    for note in [*fitted.notes[len(picture.notes) :], *measured.notes]:
        watcher.note(f"{picture.source}: {note}")
    png = encode_png(measured.rendered.pixels) if job.outputs.png is not None else None
    if png is not None:
        sink.put("png", png)
    report = pipeline.make_report(
        fitted,
        measured,
        seconds=time.perf_counter() - started,
        svg=svg,
        path=job.name,
        svg_path=None if job.outputs.svg is None else str(job.outputs.svg),
        png=png,
        png_path=None if png is None else str(job.outputs.png),
    )
    sink.put("report", to_json(report).encode())
    return report


def load_job(job: Job, request: Request) -> Picture:
    """The picture of a job; raises InputError where there is none."""
    from cubicsplat_cli.files.load import load_picture

    if job.data is not None:
        return load_picture(job.data, name=job.name if job.path is not None else "stdin", max_pixels=request.max_pixels)
    return load_picture(job.path, max_pixels=request.max_pixels)


def attempt(job: Job, request: Request, *, threads: int | None, sink: Sink, watcher: Watcher | None = None) -> Outcome:
    """`run_job`, with whatever goes wrong as an outcome: one bad picture must not end the work on the others.

    A bug in here fails the job too, and its traceback is kept for the user.
    """
    try:
        report = run_job(job, request, threads=threads, sink=sink, watcher=watcher or Watcher())
    except CubicSplatError as error:
        return failure(job, error)
    except MemoryError:
        return Outcome(job, FAILED, error=f"{job.name}: not enough memory; try --max-size", exit_code=1)
    except (KeyboardInterrupt, BrokenPipeError, SystemExit):
        raise
    except Exception as error:
        text = f"{job.name}: {type(error).__name__}: {error}; this is a bug, please report it"
        return Outcome(job, FAILED, error=one_line(text), exit_code=1, trace=traceback.format_exc())
    return Outcome(job, INTERRUPTED if report["interrupted"] else DONE, report)


def failure(job: Job, error: CubicSplatError) -> Outcome:
    """The outcome of a job that an error of ours ended; its text names the job."""
    text = one_line(error)
    shown = "stdin" if job.name == STDIO else printable(job.name)
    if shown not in text:
        text = f"{shown}: {text}"
    return Outcome(job, FAILED, error=text, exit_code=error.exit_code)
