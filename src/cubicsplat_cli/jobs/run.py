"""The work on one job, the same in this process, in a worker process and on another machine."""

from __future__ import annotations

import traceback
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from cubicsplat_cli.errors import CubicSplatError
from cubicsplat_cli.files.names import STDIO, Outputs, is_compressed_name
from cubicsplat_cli.files.paths import is_file, is_replaceable
from cubicsplat_cli.files.write import STDOUT, write_stdout
from cubicsplat_cli.film import FRAMES, Film
from cubicsplat_cli.jobs.earlier import forget, holds_edited, is_finished
from cubicsplat_cli.jobs.events import Events, logged_to
from cubicsplat_cli.jobs.masks import request_of
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.progress import Stages, command_began
from cubicsplat_cli.report import Report, head
from cubicsplat_cli.request import Request
from cubicsplat_cli.words import one_line, printable

if TYPE_CHECKING:
    from cubicsplat_cli.files.load import Picture
    from cubicsplat_cli.pipeline import Result

_OVER = 1.25  # of a time limit: what is not worth a note
DONE, UNCHANGED, INTERRUPTED, FAILED, PLANNED = "done", "unchanged", "interrupted", "failed", "planned"


@dataclass(frozen=True)
class Outcome:
    """How a job ended, or that it would be begun (planned). report: None where it was not made; of one that is planned
    that of an earlier run, to which only the page is missing. error: one line, None where it did not fail; trace: the
    traceback where the failure is a bug.
    """

    job: Job
    status: str
    report: Report | None = None
    error: str | None = None
    exit_code: int = 0
    trace: str | None = None

    def public(self) -> dict[str, Any]:
        """What `--json` prints for the job, as plain values."""
        if self.report is not None and self.status != PLANNED:
            return {"status": self.status, **self.report.public()}
        named = {"status": self.status, **head(), "input": {"path": self.job.name}}
        if self.error is not None:
            return {**named, "error": self.error}
        files = {"svg": self.job.outputs.svg, "png": self.job.outputs.png}
        return {**named, "output": {kind: None if path is None else str(path) for kind, path in files.items()}}


class Sink(Protocol):
    """Takes the finished files of one job; `kind` is a member of `Outputs`. written: the files on the disk so far."""

    written: list[Path]

    def put(self, kind: str, data: bytes) -> None: ...


@dataclass
class FileSink:
    """Writes each file whole to where the job wants it; an SVG without a place goes to standard output.

    Two runs on one output leave the files of the one that ends last: with the report, which comes last, all others are
    written again that the other run has replaced meanwhile. A run that is killed leaves no report of other files.
    """

    job: Job
    written: list[Path] = field(default_factory=list)
    files: dict[str, bytes] = field(default_factory=dict)

    def put(self, kind: str, data: bytes) -> None:
        from cubicsplat_cli.files.write import folder_locked, write_atomically

        path, svg = getattr(self.job.outputs, kind), self.job.outputs.svg
        if kind == "svg" and path is None:
            write_stdout(data)
        self.files[kind] = data
        with folder_locked(Path() if svg is None else svg.parent):
            replaced = self._replaced() if kind == "report" else {}
            if kind == "svg" or replaced:
                # From here on the report there is wrong; whoever finds none knows that the work is not done.
                forget(self.job)
            for place, content in replaced.items():
                write_atomically(place, content)
            if path is not None:
                write_atomically(path, data)
                self.written.append(path)

    def _replaced(self) -> dict[Path, bytes]:
        """The files of this run in whose places lie others of ours by now, or none; an edited one stays as it is."""
        found = {}
        for kind, data in self.files.items():
            place = getattr(self.job.outputs, kind)
            if kind == "report" or place is None or (is_file(place) and place.read_bytes() == data):
                continue
            if is_replaceable(place) and not holds_edited(place):
                found[place] = data
        return found


@dataclass
class MemorySink:
    """Keeps the files, for whoever asked for them from afar."""

    files: dict[str, bytes] = field(default_factory=dict)
    written: list[Path] = field(default_factory=list)

    def put(self, kind: str, data: bytes) -> None:
        self.files[kind] = data


def run_job(job: Job, request: Request, *, sink: Sink, events: Events) -> Outcome:
    """Load, fit, write, measure. The SVG is put out before it is measured, the report last: whoever finds a report
    finds all files. A finished SVG is never replaced by that of an interrupted fit. Raises what the steps raise.
    """
    stages = Stages(lambda stage: events.stage(job.name, stage), started=command_began())
    if request.masks is not None and job.mask is None:
        events.note(job.name, f"{job.name}: has no mask in {request.masks}, so all of it matters alike")
    with stages("read"):
        request = request_of(job, request)
        picture = load_job(job, request)
    for note in picture.notes:
        events.note(job.name, f"{picture.source}: {note}")
    events.detail(job.name, f"{picture.source}: {picture.size[0]} x {picture.size[1]} px; {request.describe()}")
    # What comes now takes a while to import: what is wrong with the picture is said before.
    events.stage(job.name, "start")
    from cubicsplat_cli.files.read import packed
    from cubicsplat_cli.files.write import encode_png
    from cubicsplat_cli.pipeline import candidates, measured, task_of, timed

    request = replace(request, compress=request.compress or is_compressed_name(job.outputs.svg))
    film = None if job.outputs.animation is None else Film(FRAMES)
    task = task_of(
        picture, request, stages, title=job.title, on_progress=lambda at: events.step(job.name, at), film=film
    )
    for made in candidates(task):
        result = task.result(made)
        if result.report.interrupted and is_finished(job):
            events.note(job.name, f"interrupted: {job.outputs.svg} is as the earlier, finished run left it")
            return Outcome(job, INTERRUPTED)
        svg = packed(result.svg, compressed=request.compress)
        if job.outputs.svg is not None:
            sink.put("svg", svg)
    if job.outputs.svg is None:  # what went to standard output could not be replaced
        sink.put("svg", svg)
    if request.measure:
        result = measured(result, task, made)
    for note in result.report.notes[len(picture.notes) :]:
        events.note(job.name, f"{picture.source}: {note}")
    png = None
    if job.outputs.png is not None and result.pixels is not None:
        with stages("draw"):
            png = encode_png(result.pixels)
            sink.put("png", png)
    report = replace(result.report, input=replace(result.report.input, path=job.name))
    report = report.written(svg, _text(job.outputs.svg), png, _text(job.outputs.png))
    if film is not None:
        _put_animation(film, task.target, result, report, job, sink, events)
    if job.outputs.page is not None:
        from cubicsplat_cli.show.page import page, subject_of

        events.stage(job.name, "report")
        subject = subject_of(picture, job.source(), result.svg.encode(), report)
        sink.put("page", page(subject, request.settings.threads))
    report = timed(report, stages)
    _say_overtime(report, picture.source, job, request.settings.time_limit, events)
    sink.put("report", report.to_json().encode())
    return Outcome(job, INTERRUPTED if report.interrupted else DONE, report)


def _put_animation(
    film: Film, target: Picture, result: Result, report: Report, job: Job, sink: Sink, events: Events
) -> None:
    """Of the fit of a photo as it develops, or of a drawing as it is laid down. target: the picture."""
    assert job.outputs.animation is not None
    if result.scene is None:
        events.note(job.name, f"{target.source}: is transparent throughout, so there is no animation")
        return
    from cubicsplat_cli.artwork.style import PHOTO
    from cubicsplat_cli.show.animation import animation

    events.stage(job.name, "animation")
    threads = report.settings["threads"]
    if report.style != PHOTO or report.output.paths == 0:
        from cubicsplat_cli.artwork.film import film_shapes

        film_shapes(film, result.scene, target, threads)
    form = job.outputs.animation.suffix[1:].upper()
    moving = animation(film, result.scene, form=form, about=report.output.svg_sha256, threads=threads)
    sink.put("animation", moving)


def _say_overtime(report: Report, source: str, job: Job, limit: float | None, events: Events) -> None:
    timing = report.timing
    if limit is not None and timing.total_s > _OVER * limit:
        said = f"took {timing.total_s:.1f} s, of which the fit had {timing.fit_s:.1f} s"
        events.note(job.name, f"{source}: {said}; --time-limit {limit:g} is less than the rest takes")


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def load_job(job: Job, request: Request) -> Picture:
    """The picture of a job; raises InputError where there is none."""
    from cubicsplat_cli.files.load import load_picture

    if job.path is not None and job.data is None:
        source: Path | bytes = job.path
    else:
        source = job.data or b""
    return load_picture(
        source,
        name="stdin" if job.path is None else job.name,
        max_pixels=request.max_pixels,
        max_size=request.max_size,
        frame=request.frame,
        smaller="fit a smaller copy with --max-size",
    )


def attempt(job: Job, request: Request, *, sink: Sink, events: Events) -> Outcome:
    """`run_job`, with whatever goes wrong as an outcome: one bad picture must not end the work on the others.

    A bug in here fails the job too, and its traceback is kept for the user. A Ctrl-C passes through unless the SVG is
    written by then.
    """
    try:
        with logged_to(events, job.name):
            return run_job(job, request, sink=sink, events=events)
    except CubicSplatError as error:
        return failure(job, error, sink.written)
    except MemoryError:
        text = f"{job.name}: not enough memory{_kept(sink.written)}; try --max-size"
        return Outcome(job, FAILED, error=text, exit_code=1)
    except KeyboardInterrupt:
        if not sink.written:
            raise
        events.note(job.name, f"interrupted{_kept(sink.written)}, without its figures")
        return Outcome(job, INTERRUPTED)
    except (BrokenPipeError, SystemExit):
        raise
    except Exception as error:
        text = f"{job.name}: {type(error).__name__}: {error}; this is a bug, please report it"
        return Outcome(job, FAILED, error=one_line(text), exit_code=1, trace=traceback.format_exc())


def named_job(name: str) -> Job:
    """A job of which no more is known than how the user named it."""
    return Job(name, None, Outputs(None, None, None))


def failure(job: Job, error: CubicSplatError, written: list[Path] | None = None) -> Outcome:
    """The outcome of a job that an error of ours ended; its text names the job, and what was written before."""
    text = one_line(error)
    shown = "stdin" if job.name == STDIO else printable(job.name)
    if shown not in text and not text.startswith(STDOUT):
        text = f"{shown}: {text}"
    return Outcome(job, FAILED, error=text + _kept(written or []), exit_code=error.exit_code)


def _kept(written: list[Path]) -> str:
    return f" (written: {', '.join(map(str, written))})" if written else ""
