"""`cubicsplat animate`: a clip becomes an animated SVG, Lottie JSON, or an SVG for each of its frames."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Json, Quiet, Verbose, argument, option, takes_options
from cubicsplat_cli.clip_request import ARTWORK, FIT_SETTINGS, FRAMES, LOTTIE, SMIL, ClipReport, ClipRequest
from cubicsplat_cli.errors import EXIT_INTERRUPTED, UsageError
from cubicsplat_cli.files.names import PAGE, PLAIN, SVG_SUFFIXES, names_a_folder
from cubicsplat_cli.files.paths import check_outputs, check_ownership, is_folder, is_lottie, make_folder_of
from cubicsplat_cli.files.write import write_atomically, write_stdout
from cubicsplat_cli.formatting import counted, did_you_mean, duration, file_size, level_text
from cubicsplat_cli.from_options import clip_request_of
from cubicsplat_cli.metrics import json_line
from cubicsplat_cli.progress import StageTimer, command_began
from cubicsplat_cli.settings import FitSettings

if TYPE_CHECKING:
    from cubicsplat_cli.pipeline.animation import Animation


@takes_options(*FIT_SETTINGS, *(each.name for each in fields(ClipRequest)), owners=(FitSettings, ClipRequest))
def animate(
    clip: Annotated[str, argument("CLIP", "GIF, animated PNG or WebP, video, or folder of frames.")],
    output: Annotated[str | None, option("--output -o OUT", "SVG, Lottie JSON (OUT.json) or folder to write.")] = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    **options: Any,
) -> None:
    """Turn a clip into curves that move: an SVG, or Lottie.

    Writes OUT.svg and OUT.json (figures of each frame as it is played). Ctrl-C ends early and writes the clip so far.
    """
    if "" in (clip, output):
        # Path("") is the current folder, which an unset shell variable does not mean.
        raise UsageError("a file name is empty; is a variable not set?")
    request = clip_request_of(options)
    request = replace(request, format=_format(output, request.format))
    result, metrics, page = _places(Path(clip), output, request)
    reporter = Reporter(quiet=quiet, verbose=verbose, bars=not json)
    check_ownership([result], force=True, source=Path(clip))  # before a folder is made
    make_folder_of(metrics)
    files = [metrics, *([page] if request.html_report else [])]
    check_outputs(files + (_frames(result) if request.format == FRAMES else [result]), force=request.force)
    report = _run(Path(clip), (result, metrics, page), request, reporter)
    if json:
        write_stdout(json_line(report))
    if report.interrupted:
        raise typer.Exit(EXIT_INTERRUPTED)


def _format(output: str | None, chosen: str | None) -> str:
    """Return the chosen format, or that of the output's name. Raises UsageError where these differ."""
    if output is None:
        return chosen or SMIL
    suffix = Path(output).suffix.lower()
    named = {PLAIN: SMIL, ".json": LOTTIE}.get(suffix)
    if names_a_folder(output) or (not suffix and chosen == FRAMES):
        named = FRAMES
    if named is None:
        near = did_you_mean(suffix, (*SVG_SUFFIXES, ".json"))
        raise UsageError(f"the output must end in .svg, .json (Lottie) or / (frames), but -o is {output}{near}")
    if chosen is not None and chosen != named:
        raise UsageError(f"-o {output} is for the format {named}, but --format is {chosen}; leave out --format")
    return named


def _places(clip: Path, output: str | None, request: ClipRequest) -> tuple[Path, Path, Path]:
    """Return the paths of the file or folder of frames, of the figures and of a page; by default beside the clip."""
    if output is None:
        beside, name = (clip.resolve().parent, clip.resolve().name) if is_folder(clip) else (clip.parent, clip.stem)
        suffix = {SMIL: PLAIN, LOTTIE: ".json", FRAMES: ".frames"}[str(request.format)]
        output = str(beside / f"{name}{suffix}")
    result = Path(output)
    if request.format == FRAMES:
        return result, result / "metrics.json", result / "index.html"
    metrics = result.with_suffix(".json")
    if request.format == LOTTIE or is_lottie(metrics):
        metrics = result.with_suffix(".metrics.json")
    return result, metrics, result.with_suffix(PAGE)


def _frames(folder: Path) -> list[Path]:
    """Return the existing files with names of frames."""
    return sorted(folder.glob("[0-9][0-9][0-9][0-9]*.svg")) if is_folder(folder) else []


def _run(clip: Path, places: tuple[Path, Path, Path], request: ClipRequest, reporter: Reporter) -> ClipReport:
    """Do the work and write the results; return the figures. places: see `_places`."""
    from cubicsplat_cli.files.clips import open_clip
    from cubicsplat_cli.pipeline.animate import animate_clip
    from cubicsplat_cli.pipeline.animation import ClipTask

    job, (result, metrics, page) = str(clip), places
    with reporter.showing(1):
        reporter.begin(job)
        timer = StageTimer(reporter, job, started=command_began())
        with timer("read"):
            source = open_clip(clip, request)
        task = ClipTask(source, request, clip.resolve().name, timer, timer.step)
        animation = animate_clip(task, lambda made: _write(made, result, request))
        report = animation.report
        assert report is not None
        report = replace(report, output=replace(report.output, path=str(result)))
        if request.html_report:
            from cubicsplat_cli.html_report.animation import player_page

            with timer("html_report"):
                write_atomically(page, player_page(animation.svg, report, task.played(report.style), result.name))
        write_atomically(metrics, report.to_json().encode())
        reporter.end(job)
    for note in report.notes:
        reporter.note(note)
    if report.interrupted:
        reporter.note(f"interrupted: the clip so far is written, {counted(report.input.frames, 'frame')}")
    reporter.summary(clip_summary(report))
    return report


def _write(animation: Animation, result: Path, request: ClipRequest) -> None:
    """Write the result, before anything is measured; remove frames of an earlier, longer clip."""
    files = {(result / name if name else result): data for name, data in animation.files(str(request.format)).items()}
    for path, data in files.items():
        write_atomically(path, data)
    if request.format == FRAMES:
        for path in {*_frames(result)} - {*files}:
            path.unlink()


def clip_summary(report: ClipReport) -> str:
    """Return `clip.svg  photo  60 frames  256 curves  180 kB  27.9 dB  72 s`."""
    output, quality = report.output, report.quality
    what = "shape" if report.style == ARTWORK else "curve"
    parts = [
        str(output.path), report.style, counted(report.input.frames, "frame"), counted(output.curves, what),
        file_size(output.bytes), level_text(quality.psnr_db, 1), duration(report.timing["total_s"]),
    ]  # fmt: skip
    return "  ".join(parts)
