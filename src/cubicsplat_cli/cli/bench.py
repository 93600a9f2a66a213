"""`cubicsplat bench`: the cost of a training step, and the quality of the fits of a folder.

The programs in `benchmarks/`, which are not part of the package, share these options.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Command, Json, Quiet, argument, check_csv, option, takes_options, write_csv
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.names import pictures_in
from cubicsplat_cli.files.paths import check_outputs
from cubicsplat_cli.files.write import write_atomically
from cubicsplat_cli.metrics import to_json
from cubicsplat_cli.options import Setting, listed
from cubicsplat_cli.settings import FitSettings, Mode

if TYPE_CHECKING:
    from cubicsplat_cli.bench.runs import FitJob, Runs

bench = typer.Typer(help="Measure the speed of a training step, and quality.")

_MOST_SIDE = 16_384

Folder = Annotated[Path, argument("DIR", "Folder of pictures.")]
CurvesList = Annotated[str, option("--curves N,...", "Numbers of curves.")]
ModeList = Annotated[str, option("--mode MODE,...", "closed, open or both.")]
Cache = Annotated[Path | None, option("--cache DIR", "Keep each result here, and take it from here the next time.")]
Limit = Annotated[int | None, option("--limit N", "Take the first so many pictures only.")]
Csv = Annotated[Path | None, option("--csv FILE", "Also write one row per fit as a table.")]
Markdown = Annotated[bool, option("--markdown", "Print the tables as Markdown.")]


@bench.command("step", cls=Command)
@takes_options("curves", "mode", "preset", "fill", "seed", "device", "threads")
def step(
    image: Annotated[Path | None, argument("[IMAGE]", "Picture to fit.  [default: a drawn one]")] = None,
    size: Annotated[str, option("--size WxH", "Size of the drawn picture.")] = "768x512",
    warmup_steps: Annotated[int, option("--warmup-steps N", "Steps before the timed ones.")] = 300,
    steps: Annotated[int, option("--steps N", "Timed steps, in each of the two phases.")] = 100,
    json: Json = False,
    **fit: Any,
) -> None:
    """Time and memory of one training step in the middle of a fit."""
    match = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", size)
    if match is None or max(int(side) for side in match.groups()) > _MOST_SIDE:
        raise UsageError(f"--size must be WIDTHxHEIGHT in pixels, at most {_MOST_SIDE} a side, not {size!r}")
    settings = FitSettings.from_preset(**fit)
    from cubicsplat_cli.bench.step import measure_step, memory, step_lines, synthetic_picture

    baseline = memory()  # what the interpreter takes with numpy is not the fit's memory
    if image is None:
        target, name = synthetic_picture(int(match[1]), int(match[2])), "synthetic"
    else:
        from cubicsplat_cli.files.load import load_picture

        target, name = load_picture(image).target(), str(image)
    report = measure_step(target, name, settings, warmup=warmup_steps, steps=steps, baseline=baseline)
    print_report(report, step_lines(report), json=json)


@bench.command("quality", cls=Command)
@takes_options("preset", "steps", "seed", "device", "threads", after=3)
def quality(
    folder: Folder,
    curves: CurvesList = "512",
    mode: ModeList = "closed",
    limit: Limit = None,
    cache: Cache = None,
    sheet: Annotated[
        Path | None,
        option("--sheet FILE", "Also write a PNG to look at: original, SVG and error of the first four pictures."),
    ] = None,
    json: Json = False,
    csv: Csv = None,
    markdown: Markdown = False,
    quiet: Quiet = False,
    **fit: Any,
) -> None:
    """Quality, time and size of the SVGs of a folder of pictures.

    PSNR, SSIM, the agreement of engine and renderer, and their means.
    """
    counts, modes = counts_of(curves), modes_of(mode)
    check_csv(csv)
    check_png(sheet, "sheet")
    pictures = pictures_of(folder, limit)
    from cubicsplat_cli.bench import quality as benchmark

    runs = run_fits(benchmark.quality_jobs(pictures, modes, counts, fit), cache, Reporter(quiet=quiet))
    names = [benchmark.configuration_name(m, c) for m in modes for c in counts]
    tables = benchmark.quality_tables(runs, names, markdown=markdown)
    print_report(benchmark.quality_report(runs, names), tables, json=json)
    write_csv(csv, [asdict(run) for run, _ in runs.done])
    if sheet is not None:
        # All configurations of a picture are below one another.
        shown = [picture for picture in pictures if any(run.picture == picture.name for run, _ in runs.done)]
        rows = [(run, svg) for picture in shown[:4] for run, svg in runs.done if run.picture == picture.name]
        write_atomically(sheet, benchmark.sheet_png(rows, {picture.name: picture for picture in pictures}))
    end_with(runs.failed)


def comma_parts(text: str) -> list[str]:
    """Return the parts of a value with commas, each once."""
    return list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def counts_of(text: str) -> list[int]:
    """Return the value of --curves: whole numbers with commas between them."""
    parts = comma_parts(text)
    if not parts or not all(part.isdecimal() for part in parts):
        raise UsageError(f"must be whole numbers with commas between them, not {text!r}", "curves")
    counts = [int(part) for part in parts]
    for count in counts:
        FitSettings(curves=count)
    return counts


def modes_of(text: str) -> list[str]:
    """Return the value of --mode: closed, open, or both with a comma between them."""
    modes, names = comma_parts(text), [mode.value for mode in Mode]
    if not modes or not set(modes) <= set(names):
        raise UsageError(f"must be {listed(names)}, or both with a comma, not {text!r}", "mode")
    return modes


def check_limit(limit: int | None) -> None:
    """Raise UsageError for a --limit below 1."""
    Setting("count", "", least=1, optional=True).check("limit", limit)


def check_png(path: Path | None, option: str) -> None:
    """Raise UsageError if the picture of a benchmark is no PNG, or would replace a picture of the user's."""
    if path is None:
        return
    if path.suffix.lower() != ".png":
        raise UsageError(f"the {option} must end in .png, but --{option} is {path}")
    check_outputs([path], force=False)


def pictures_of(folder: Path, limit: int | None) -> list[Path]:
    """Return the first pictures of a folder, up to a limit. Raises the errors of `pictures_in`."""
    check_limit(limit)
    return pictures_in(folder)[:limit]


def run_fits(jobs: Sequence[FitJob], cache: Path | None, reporter: Reporter) -> Runs:
    """Do the fits, and report each one on stderr. Raises InputError if all of them fail."""
    from cubicsplat_cli.bench.runs import run_all

    runs = run_all(jobs, cache, reporter.progress, reporter.summary)
    if not runs.done:
        raise InputError(f"no picture could be fitted: {runs.failed[0][0]}: {runs.failed[0][2]}")
    return runs


def print_report(report: dict[str, Any], text: str, *, json: bool) -> None:
    """Print a report to stdout, as JSON or as its text."""
    typer.echo(to_json(report) if json else text, nl=False)


def end_with(failed: Sequence[tuple[str, str, str]]) -> None:
    """Print failures, as (picture, its configuration or "", error), and exit with 1 if there are any."""
    for picture, made, error in failed:
        typer.echo(f"cubicsplat: failed: {picture}{', ' if made else ''}{made}: {error}", err=True)
    if failed:
        raise typer.Exit(1)
