"""The work on one job, the same in this process, in a worker process and on another machine."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.errors import CubicSplatError
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.names import LAYER, STDIO, is_compressed_name
from cubicsplat_cli.files.read import packed, unpacked
from cubicsplat_cli.files.write import STDOUT, encode_png
from cubicsplat_cli.formatting import one_line, printable
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.results import Sink, is_finished
from cubicsplat_cli.metrics import Output, Report, head
from cubicsplat_cli.progress import FRAMES, FrameRecorder, Observer, StageTimer, command_began, warnings_to
from cubicsplat_cli.record import record
from cubicsplat_cli.request import Request

if TYPE_CHECKING:
    from cubicsplat_cli.files.load import Picture
    from cubicsplat_cli.pipeline.task import Made, Measured, Task

POLL_SECONDS = 0.2  # between two checks for a stop while nothing happens
DONE, UNCHANGED, INTERRUPTED, FAILED, PLANNED = "done", "unchanged", "interrupted", "failed", "planned"


@record
class Outcome:
    """The result of a job. status: "planned" means that there is work to do. report: of this run, or of an earlier one
    if the job is unchanged, or planned because files made of the SVG are missing; else None. error: one line, None
    without a failure. trace: the traceback if the failure is a bug.
    """

    job: Job
    status: str
    report: Report | None = None
    error: str | None = None
    exit_code: int = 0
    trace: str | None = None

    def public(self) -> dict[str, Any]:
        """Return the object that `--json` prints for the job."""
        if self.report is not None and self.status != PLANNED:
            return {"status": self.status, **self.report.public()}
        named = {"status": self.status, **head(), "input": {"path": self.job.name}}
        if self.error is not None:
            return {**named, "error": self.error}
        files = {"svg": self.job.outputs.svg, "png": self.job.outputs.png}
        return {**named, "output": {kind: None if path is None else str(path) for kind, path in files.items()}}


def run_job(job: Job, request: Request, *, sink: Sink, observer: Observer) -> Outcome:
    """Load, fit, write, measure. The SVG is written before it is measured, the metrics last: if they are there, so are
    all other files. The SVG of an interrupted fit never replaces a finished one. Raises what the steps raise.
    """
    timer = StageTimer(observer, job.name, started=command_began())
    if request.masks is not None and job.mask is None:
        timer.note(f"{job.name}: has no mask in {request.masks}, so all of it matters alike")
    with timer("read"):
        request = job.request(request)
        picture = load_job(job, request)
    for note in picture.notes:
        timer.note(f"{picture.source}: {note}")
    observer.detail(f"{picture.source}: {picture.size[0]} x {picture.size[1]} px; {request.describe()}", job.name)
    # The imports take a while: errors of the picture are reported before.
    observer.stage("start", job.name)
    from cubicsplat_cli.pipeline.choose import candidates
    from cubicsplat_cli.pipeline.vectorize import measured, task_of

    request = replace(request, compress=request.compress or is_compressed_name(job.outputs.svg))
    recorder = None if job.outputs.animation is None else FrameRecorder(FRAMES)
    title = "stdin" if job.path is None else job.path.name
    task = task_of(picture, request, timer, title=title, on_progress=timer.step, recorder=recorder)
    for made in candidates(task):
        svg = task.svg(made)
        if made.interrupted and is_finished(job):
            timer.note(f"interrupted: {job.outputs.svg} is as the earlier, finished run left it")
            return Outcome(job, INTERRUPTED)
        data = packed(svg, compressed=request.compress)
        if job.outputs.svg is not None:
            sink.put("svg", data)
    if job.outputs.svg is None:  # on standard output a later SVG could not replace an earlier one
        sink.put("svg", uri_line(data) if request.data_uri else data)
    figures = measured(task, made, svg) if request.measure else None
    report = _write_others(job, task, made, figures, svg, data, sink)
    _say_overtime(report, task)
    try:
        _put_exports(job, request, svg, timer, sink)
    finally:  # a later run makes missing exports without a fit, if the metrics say that the fit is done
        sink.put("metrics", report.to_json().encode())
    return Outcome(job, INTERRUPTED if report.interrupted else DONE, report)


def uri_line(svg: bytes) -> bytes:
    """Return the line that `--data-uri` prints for an SVG."""
    from cubicsplat_cli.svg.markup import data_uri

    return data_uri(unpacked(svg, "the SVG").decode()).encode() + b"\n"


def _write_others(
    job: Job, task: Task, made: Made, figures: Measured | None, svg: str, data: bytes, sink: Sink
) -> Report:
    """Write the PNG, the animation and the page, as far as the job has them; return the figures of the result."""
    from cubicsplat_cli.pipeline.vectorize import geometrized, output_of, report_of

    timer, outputs = task.timer, job.outputs
    for note in [*task.target.notes, *made.notes, *(figures.notes if figures else ())][len(task.source.notes) :]:
        timer.note(f"{task.source.source}: {note}")
    files = {} if outputs.svg is None else {"svg": str(outputs.svg)}
    if outputs.png is not None and figures is not None:
        with timer("draw"):
            png = encode_png(figures.pixels)
            sink.put("png", png)
        files |= {"png": str(outputs.png), "png_sha256": sha256_of(png)}
    output = output_of(task, made, svg, data, **files)
    if outputs.geometrize is not None:
        text = geometrized(task, made, output)
        if text is None:
            timer.note(f"{task.target.source}: has one colour, so there is no list for Geometrize")
        else:
            sink.put("geometrize", text.encode())
    if outputs.animation is not None:
        _put_animation(outputs.animation, task, made, output, sink)
    report = report_of(task, made, figures, output, path=job.name)
    if outputs.html_report is not None:
        from cubicsplat_cli.html_report.page import page_of_result

        timer.observer.stage("html_report", job.name)
        threads = task.request.settings.threads
        sink.put("html_report", page_of_result(task.source, job.source(), svg.encode(), report, threads))
    return report


def _put_exports(job: Job, request: Request, svg: str, timer: StageTimer, sink: Sink) -> None:
    """Write the SVG in the job's formats of other programs, and its layers."""
    for path in job.outputs.exports:
        timer.observer.stage("export", job.name)
        sink.put(path.suffix[1:].lower(), export_of(path, svg.encode(), job, request, timer.note))
    if job.outputs.layers is not None:
        timer.observer.stage("export", job.name)
        for kind, data in layer_files(svg.encode()).items():
            sink.put(kind, data)


def layer_files(svg: bytes) -> dict[str, bytes]:
    """Return the files of the layers of an SVG by their kinds."""
    from cubicsplat_cli.export.layers import layers

    return {LAYER + name: text.encode() for name, text in layers(svg).items()}


def export_of(path: Path, svg: bytes, job: Job, request: Request, note: Callable[[str], None]) -> bytes:
    """Return the bytes of an export of a job's SVG; call `note` with the parts that the export lacks."""
    from cubicsplat_cli.export.formats import exported

    data, notes = exported(svg, path.suffix[1:].lower(), str(job.outputs.svg), tolerance=request.dxf_tolerance)
    for text in notes:
        note(f"{path}: {text}")
    return data


def _put_animation(path: Path, task: Task, made: Made, output: Output, sink: Sink) -> None:
    """Write an animation of a photo's fit, or of a drawing built up from the back."""
    timer, recorder = task.timer, task.recorder
    from cubicsplat_cli.scene import LayeredScene

    # What is animated has no shading, see `Request.may_shade`.
    if recorder is None or made.scene is None or isinstance(made.scene, LayeredScene):
        timer.note(f"{task.target.source}: is transparent throughout, so there is no animation")
        return
    from cubicsplat_cli.artwork.style import PHOTO
    from cubicsplat_cli.html_report.animation import animation, record_shapes

    timer.observer.stage("animation", timer.job)
    threads = task.request.settings.threads
    if made.style.name != PHOTO or output.paths == 0:
        record_shapes(recorder, made.scene, task.target, threads)
    form = path.suffix[1:].upper()
    sink.put("animation", animation(recorder, made.scene, form=form, about=output.svg_sha256, threads=threads))


def _say_overtime(report: Report, task: Task) -> None:
    timing, limit = report.timing, task.request.settings.time_limit
    if limit is not None and timing.total_s > 1.25 * limit:  # less is not worth a note
        work = "drawing" if report.shapes is not None else "fit"
        said = f"took {timing.total_s:.1f} s, more than --time-limit {limit:g}: {timing.fit_s:.1f} s for the {work}"
        task.timer.note(f"{task.source.source}: {said}, {timing.total_s - timing.fit_s:.1f} s for the rest")


def load_job(job: Job, request: Request) -> Picture:
    """Load the picture of a job. Raises InputError if it is no picture."""
    from cubicsplat_cli.files.load import load_picture

    return load_picture(
        job.source(),
        name="stdin" if job.path is None else job.name,
        max_pixels=request.max_pixels,
        max_size=request.max_size,
        frame=request.frame,
        smaller="fit a smaller copy with --max-size",
    )


def attempt(job: Job, request: Request, *, sink: Sink, observer: Observer) -> Outcome:
    """Run a job; return any failure as an outcome: one bad picture must not end the work on the others.

    A bug fails the job too, and the outcome keeps its traceback. Raises KeyboardInterrupt if no file is written yet.
    """
    observer.begin(job.name)
    try:
        with warnings_to(lambda text: observer.note(f"{job.name}: {text}", job.name)):
            return run_job(job, request, sink=sink, observer=observer)
    except CubicSplatError as error:
        return failure(job, error, sink.written)
    except MemoryError:
        text = f"{job.name}: not enough memory{_kept(sink.written)}; try --max-size"
        return Outcome(job, FAILED, error=text, exit_code=1)
    except KeyboardInterrupt:
        if not sink.written:
            raise
        observer.note(f"interrupted{_kept(sink.written)}, without its figures", job.name)
        return Outcome(job, INTERRUPTED)
    except (BrokenPipeError, SystemExit):
        raise
    except Exception as error:
        text = f"{job.name}: {type(error).__name__}: {error}; this is a bug, please report it"
        return Outcome(job, FAILED, error=one_line(text), exit_code=1, trace=traceback.format_exc())


def failure(job: Job, error: CubicSplatError, written: list[Path] | None = None) -> Outcome:
    """Return the outcome of a job that an error of ours ended; its text names the job and the files written before."""
    text = one_line(error)
    shown = "stdin" if job.name == STDIO else printable(job.name)
    if shown not in text and not text.startswith(STDOUT):
        text = f"{shown}: {text}"
    return Outcome(job, FAILED, error=text + _kept(written or []), exit_code=error.exit_code)


def _kept(written: list[Path]) -> str:
    return f" (written: {', '.join(map(str, written))})" if written else ""
