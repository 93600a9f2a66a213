"""`cubicsplat bench`: measurements that anyone can repeat."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cubicsplat_cli.cli.bench_artwork import artwork
from cubicsplat_cli.cli.bench_options import (
    Cache,
    Csv,
    CurvesList,
    Folder,
    Limit,
    Markdown,
    check_csv,
    check_sheet,
    counts_of,
    end_with,
    parts_of,
    pictures_of,
    run_fits,
    write_csv,
)
from cubicsplat_cli.cli.bench_paper import paper
from cubicsplat_cli.cli.bench_peers import peers
from cubicsplat_cli.cli.bench_thorns import thorns
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.help import Command
from cubicsplat_cli.cli.options import Json, Quiet, fit_settings, takes_fit_options
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.settings import Mode, listed

if TYPE_CHECKING:
    from cubicsplat_cli.bench.runs import Runs

bench = typer.Typer(help="Measure speed, quality and the parts of the method.")
bench.command("artwork", cls=Command)(artwork)
bench.command("peers", cls=Command)(peers)
bench.command("paper", cls=Command)(paper)
bench.command("thorns", cls=Command)(thorns)

_MOST_SIDE = 16_384
_SHEET_PICTURES = 4

ModeList = Annotated[str, typer.Option("--mode", metavar="MODE,...", help="closed, open or both.")]


@bench.command("step", cls=Command)
@takes_fit_options("curves", "mode", "preset", "fill", "seed", "device", "threads")
def step(
    image: Annotated[
        Path | None,
        typer.Argument(metavar="IMAGE", help="Picture to fit.  [default: a drawn one]", show_default=False),
    ] = None,
    size: Annotated[str, typer.Option("--size", metavar="WxH", help="Size of the drawn picture.")] = "768x512",
    warmup_steps: Annotated[
        int, typer.Option("--warmup-steps", metavar="N", help="Steps before the timed ones.")
    ] = 300,
    steps: Annotated[int, typer.Option("--steps", metavar="N", help="Timed steps, in each of the two phases.")] = 100,
    json: Json = False,
    **fit: Any,
) -> None:
    """Time and memory of one training step in the middle of a fit."""
    match = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", size)
    if match is None or max(int(side) for side in match.groups()) > _MOST_SIDE:
        raise UsageError(f"--size must be WIDTHxHEIGHT in pixels, at most {_MOST_SIDE} a side, not {size!r}")
    settings = fit_settings(fit)
    import numpy  # noqa: F401  (what the interpreter takes with numpy is not the fit's memory)

    from cubicsplat_cli.bench.memory import memory

    baseline = memory()
    from cubicsplat_cli.bench.step import measure_step, step_lines
    from cubicsplat_cli.report import to_json

    if image is None:
        from cubicsplat_cli.bench.synthetic import synthetic_picture

        target, name = synthetic_picture(int(match[1]), int(match[2])), "synthetic"
    else:
        from cubicsplat_cli.files.load import load_picture

        target, name = load_picture(image).target(), str(image)
    report = measure_step(target, name, settings, warmup=warmup_steps, steps=steps, baseline=baseline)
    typer.echo(to_json(report) if json else step_lines(report), nl=False)


@bench.command("quality", cls=Command)
@takes_fit_options("preset", "steps", "seed", "device", "threads", after=3)
def quality(
    folder: Folder,
    curves: CurvesList = "512",
    mode: ModeList = "closed",
    limit: Limit = None,
    cache: Cache = None,
    sheet: Annotated[
        Path | None,
        typer.Option(
            "--sheet",
            metavar="FILE",
            help="Also write a PNG to look at: original, SVG and error of the first four pictures.",
        ),
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
    counts, modes = counts_of(curves), _modes(mode)
    check_csv(csv)
    check_sheet(sheet)
    pictures = pictures_of(folder, limit)
    from cubicsplat_cli.bench import quality as benchmark

    jobs = benchmark.quality_jobs(pictures, modes, counts, fit)
    runs = run_fits(jobs, cache, Reporter(quiet=quiet))
    names = [benchmark.configuration_name(m, c) for m in modes for c in counts]
    if json:
        _print_json(benchmark.quality_report(runs, names))
    else:
        typer.echo(benchmark.quality_tables(runs, names, markdown=markdown), nl=False)
    write_csv(csv, [asdict(run) for run, _ in runs.done])
    if sheet is not None:
        _write_sheet(sheet, runs, pictures)
    end_with(runs.failed)


@bench.command("ablation", cls=Command)
@takes_fit_options("preset", "steps", "seed", "device", "threads", after=3)
def ablation(
    folder: Folder,
    curves: CurvesList = "256,512",
    mode: ModeList = "closed,open",
    limit: Limit = 4,
    rows: Annotated[
        str | None, typer.Option("--rows", metavar="ROW,...", help="Only these rows, and the base.  [default: all]")
    ] = None,
    cache: Cache = None,
    json: Json = False,
    csv: Csv = None,
    markdown: Markdown = False,
    quiet: Quiet = False,
    **fit: Any,
) -> None:
    """What each part of the method is worth.

    The same fits with one thing changed at a time.
    """
    counts, modes = counts_of(curves), _modes(mode)
    check_csv(csv)
    pictures = pictures_of(folder, limit)
    from cubicsplat_cli.bench import ablation as benchmark

    chosen = benchmark.chosen_rows(None if rows is None else parts_of(rows))
    jobs = benchmark.ablation_jobs(pictures, chosen, modes, counts, fit)
    runs = run_fits(jobs, cache, Reporter(quiet=quiet))
    if json:
        _print_json(benchmark.ablation_report(runs, chosen, modes, counts))
    else:
        typer.echo(benchmark.ablation_table(runs, chosen, modes, counts, markdown=markdown), nl=False)
    write_csv(csv, [asdict(run) for run, _ in runs.done])
    end_with(runs.failed)


def _modes(text: str) -> list[str]:
    modes = list(dict.fromkeys(parts_of(text)))
    known = [mode.value for mode in Mode]
    if not modes or not all(mode in known for mode in modes):
        raise UsageError(f"must be {listed(known)}, or both with a comma, not {text!r}", "mode")
    return modes


def _print_json(report: dict[str, Any]) -> None:
    from cubicsplat_cli.report import to_json

    typer.echo(to_json(report), nl=False)


def _write_sheet(path: Path, runs: Runs, pictures: list[Path]) -> None:
    """Of the first pictures, each with all its configurations below one another."""
    from cubicsplat_cli.bench.sheet import sheet_png
    from cubicsplat_cli.files.atomic import write_atomically

    shown = [picture for picture in pictures if any(run.picture == picture.name for run, _ in runs.done)]
    rows = [(run, svg) for picture in shown[:_SHEET_PICTURES] for run, svg in runs.done if run.picture == picture.name]
    write_atomically(path, sheet_png(rows, {picture.name: picture for picture in pictures}))
