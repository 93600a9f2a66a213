"""`cubicsplat vectorize`: a picture becomes an SVG, its rendered PNG and a JSON of figures."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cubicsplat_cli.cli.console import Reporter, duration, file_size
from cubicsplat_cli.cli.options import (
    DEFAULT_MAX_PIXELS,
    MAX_CURVES,
    MAX_PRECISION,
    MAX_SAMPLES,
    MAX_SEED,
    MAX_SEGMENTS,
    MAX_STEPS,
    MAX_THREADS,
    MIN_SAMPLES,
    STDIO,
    DeviceChoice,
    ModeChoice,
    PresetChoice,
    parse_background,
)
from cubicsplat_cli.cli.outputs import Outputs, check_outputs, plan_outputs
from cubicsplat_cli.errors import UsageError

if TYPE_CHECKING:
    from cubicsplat_cli.cli.pipeline import Fitted, Measured
    from cubicsplat_cli.image import Picture

EXIT_INTERRUPTED = 130


@dataclass(frozen=True)
class Request:
    """What the options ask for, the same for every input; `overrides` are fit settings given explicitly."""

    preset: str
    overrides: dict[str, Any]
    precision: int
    png: bool
    json: bool
    force: bool
    max_pixels: int


Source = Annotated[
    str,
    typer.Argument(metavar="IN", help="Picture to vectorise, or - for standard input.", show_default=False),
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
Curves = Annotated[int, typer.Option("--curves", min=1, max=MAX_CURVES, help="Number of curves.")]
ModeOption = Annotated[ModeChoice, typer.Option("--mode", help="Filled shapes (closed) or strokes (open).")]
Preset = Annotated[
    PresetChoice,
    typer.Option("--preset", help="Effort of the fit; options given explicitly win over it, in any order."),
]
Steps = Annotated[
    int | None,
    typer.Option("--steps", min=1, max=MAX_STEPS, help="Optimisation steps.  [default: from the preset]"),
]
Segments = Annotated[
    int | None,
    typer.Option(
        "--segments", min=1, max=MAX_SEGMENTS, help="Cubic segments of a curve.  [default: from the preset]"
    ),
]
Samples = Annotated[
    int | None,
    typer.Option(
        "--samples",
        min=MIN_SAMPLES,
        max=MAX_SAMPLES,
        help="Polyline edges of a segment during the fit.  [default: from the preset]",
    ),
]
Device = Annotated[
    DeviceChoice, typer.Option("--device", help="Where to compute; auto takes a GPU that works.")
]
Threads = Annotated[
    int | None,
    typer.Option("--threads", min=1, max=MAX_THREADS, help="CPU threads.  [default: one per core]"),
]
Seed = Annotated[int, typer.Option("--seed", min=0, max=MAX_SEED, help="Seed of all random choices.")]
Background = Annotated[
    str,
    typer.Option(
        "--background", metavar="COLOUR", help="auto, none (transparent), #rrggbb or a colour name."
    ),
]
Precision = Annotated[
    int,
    typer.Option("--precision", min=0, max=MAX_PRECISION, help="Decimals of the SVG's coordinates, in px."),
]
Png = Annotated[bool, typer.Option("--png/--no-png", help="Also write the SVG as a rendered PNG.")]
Json = Annotated[bool, typer.Option("--json", help="Print the figures as JSON on standard output.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print settings and plain progress too.")]
Force = Annotated[bool, typer.Option("--force", help="Replace existing files that cubicsplat did not write.")]
MaxPixels = Annotated[
    int, typer.Option("--max-pixels", min=1, help="Refuse pictures with more pixels than this.")
]


def vectorize(
    source: Source,
    output: Output = None,
    curves: Curves = 512,
    mode: ModeOption = ModeChoice.closed,
    preset: Preset = PresetChoice.standard,
    steps: Steps = None,
    segments: Segments = None,
    samples: Samples = None,
    device: Device = DeviceChoice.auto,
    threads: Threads = None,
    seed: Seed = 0,
    background: Background = "auto",
    precision: Precision = 2,
    png: Png = True,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
    max_pixels: MaxPixels = DEFAULT_MAX_PIXELS,
) -> None:
    """Turn a picture into an SVG of Bezier shapes.

    Writes OUT.svg, OUT.png (the SVG drawn by an independent renderer) and OUT.json (the figures). Ctrl-C ends
    the fit early and writes the best SVG so far.
    """
    overrides = {
        "curves": curves,
        "mode": mode.value,
        "device": device.value,
        "seed": seed,
        "background": parse_background(background),
    }
    optional = {"steps": steps, "segments": segments, "samples": samples, "threads": threads}
    overrides.update({name: value for name, value in optional.items() if value is not None})
    request = Request(preset.value, overrides, precision, png, json, force, max_pixels)
    if not _run(source, output, request, Reporter(quiet=quiet, verbose=verbose)):
        raise typer.Exit(EXIT_INTERRUPTED)


def _run(source: str, output: str | None, request: Request, reporter: Reporter) -> bool:
    """One input from file to files; False when the user interrupted the fit (what was reached is written)."""
    started = time.perf_counter()
    path = None if source == STDIO else Path(source)
    if request.json and (output == STDIO or (output is None and path is None)):
        raise UsageError("--json and the SVG would both go to standard output; give a file with -o")
    picture = _load(path, request.max_pixels)
    outputs = plan_outputs(path, output, png=request.png)
    check_outputs(outputs.files(), force=request.force)
    for note in picture.notes:
        reporter.note(f"{picture.source}: {note}")

    # torch takes seconds to import: everything above fails before it.
    from cubicsplat_cli.cli import pipeline
    from cubicsplat_cli.fit import FitSettings

    settings = FitSettings.from_preset(request.preset, **request.overrides)
    chosen = ", ".join(f"{name} {value}" for name, value in settings.public().items() if name != "recipe")
    reporter.detail(f"{picture.source}: {picture.width} x {picture.height} px; {chosen}")
    title = "stdin" if path is None else path.name
    with reporter.progress(title) as on_progress:
        fitted = pipeline.fit_to_svg(
            picture, settings, precision=request.precision, title=title, on_progress=on_progress
        )
    # The SVG comes first: whatever happens while it is measured, it is there.
    _write_svg(outputs.svg, fitted.svg)
    measured = pipeline.measure(fitted)
    if measured.rendered.note is not None:
        reporter.note(measured.rendered.note)
    _write_rest(outputs, fitted, measured, source, started, request)
    if fitted.result.interrupted:
        reporter.note(f"interrupted at step {fitted.result.steps}: the best SVG so far is written")
    reporter.summary(summary_line(outputs.svg, fitted, measured, time.perf_counter() - started))
    return not fitted.result.interrupted


def _load(path: Path | None, max_pixels: int) -> Picture:
    from cubicsplat_cli.image import load_picture

    if path is not None:
        return load_picture(path, max_pixels=max_pixels)
    return load_picture(sys.stdin.buffer.read(), name="stdin", max_pixels=max_pixels)


def _write_svg(path: Path | None, data: bytes) -> None:
    from cubicsplat_cli.image import write_atomically

    if path is None:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()
    else:
        write_atomically(path, data)


def _write_rest(
    outputs: Outputs, fitted: Fitted, measured: Measured, source: str, started: float, request: Request
) -> None:
    """The PNG, then the JSON, whose time covers all but its own writing."""
    from cubicsplat_cli.cli.pipeline import make_report
    from cubicsplat_cli.cli.png import encode_png
    from cubicsplat_cli.evaluate.report import to_json
    from cubicsplat_cli.image import write_atomically

    if outputs.png is not None:
        write_atomically(outputs.png, encode_png(measured.rendered.pixels))
    report = make_report(
        fitted,
        measured,
        seconds=time.perf_counter() - started,
        path=source,
        svg_path=None if outputs.svg is None else str(outputs.svg),
        png_path=None if outputs.png is None else str(outputs.png),
    )
    text = to_json(report)
    if outputs.report is not None:
        write_atomically(outputs.report, text.encode())
    if request.json:
        typer.echo(text, nl=False)


def summary_line(path: Path | None, fitted: Fitted, measured: Measured, seconds: float) -> str:
    """`out.svg  512 curves  61 kB  SVG 31.9 dB  SSIM 0.86  47 s  cpu`."""
    quality = measured.svg_quality
    parts = [
        "stdout" if path is None else str(path),
        f"{fitted.result.scene.curves} curves",
        file_size(len(fitted.svg)),
        "SVG identical" if quality.psnr_db is None else f"SVG {quality.psnr_db:.1f} dB",
        "SSIM n/a" if quality.ssim is None else f"SSIM {quality.ssim:.2f}",
        duration(seconds),
        str(fitted.result.device["name"]),
    ]
    return "  ".join(parts)
