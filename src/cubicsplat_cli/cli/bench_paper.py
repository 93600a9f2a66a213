"""`cubicsplat bench paper`: the paper's tables, measured here."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from cubicsplat_cli.cli.bench_options import Cache, Limit, Markdown, end_with, parts_of, pictures_of, run_fits
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Json, Quiet, takes_fit_options
from cubicsplat_cli.errors import UsageError

_ALONE, _OF_A_FOLDER = ("steps", "growth"), ("quality", "magnify", "large")


@takes_fit_options("preset", "steps", "seed", "device", "threads", after=2)
def paper(
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar="DIR",
            help="Folder of pictures, for the tables about pictures.  [default: none]",
            show_default=False,
        ),
    ] = None,
    tables: Annotated[
        str | None,
        typer.Option(
            "--tables",
            metavar="TABLE,...",
            help="Of steps, growth, quality, magnify and large.  [default: all there is]",
        ),
    ] = None,
    limit: Limit = None,
    cache: Cache = None,
    json: Json = False,
    markdown: Markdown = False,
    quiet: Quiet = False,
    **fit: Any,
) -> None:
    """The paper's tables, measured here beside the published ones.

    steps (Table 1) and growth take a drawn picture; quality (Table 2), magnify and large the pictures of DIR. With
    --cache the last three go on where they were stopped.
    """
    names = _chosen(tables, folder)
    pictures = [] if folder is None else pictures_of(folder, limit)
    reporter = Reporter(quiet=quiet)
    from cubicsplat_cli.bench.published import NOTES
    from cubicsplat_cli.report import head, to_json

    report: dict[str, Any] = {**head(), "bench": "paper", "notes": {name: NOTES[name] for name in names}}
    failed: list[tuple[str, str, str]] = []
    for name in names:
        found, table, failures = _TABLES[name](pictures, fit, cache, reporter, markdown)
        report[name] = found
        failed += failures
        if not json:
            typer.echo(f"{'### ' if markdown else ''}{name}\n{chr(10) if markdown else ''}{table}{NOTES[name]}\n")
    if json:
        typer.echo(to_json(report), nl=False)
    end_with(failed)


def _chosen(tables: str | None, folder: Path | None) -> list[str]:
    known = (*_ALONE, *_OF_A_FOLDER)
    if tables is None:
        return list(_ALONE if folder is None else known)
    names = list(dict.fromkeys(parts_of(tables)))
    if not names or not set(names) <= set(known):
        raise UsageError(f"--tables must be of {', '.join(known)}, with commas between them, not {tables!r}")
    if folder is None and (needy := [name for name in names if name in _OF_A_FOLDER]):
        raise UsageError(f"the table {needy[0]} needs a folder of pictures; give DIR")
    return names


# What a table gives: its figures as plain values, its text, and what failed.
_Table = tuple[Any, str, list[tuple[str, str, str]]]


def _steps(
    _pictures: list[Path], fit: dict[str, Any], _cache: Path | None, reporter: Reporter, markdown: bool
) -> _Table:
    from cubicsplat_cli.bench import paper, published
    from cubicsplat_cli.settings import FitSettings

    found = {}
    for mode in paper.MODES:
        settings = FitSettings.from_preset(mode=mode, curves=published.CURVES, **fit)
        found[mode] = paper.step_times(published.SIZE, settings)
        reporter.summary(f"{mode}: {found[mode].step_ms:.2f} ms a step")
    return {mode: asdict(times) for mode, times in found.items()}, paper.steps_table(found, markdown=markdown), []


def _growth(
    _pictures: list[Path], fit: dict[str, Any], _cache: Path | None, reporter: Reporter, markdown: bool
) -> _Table:
    from cubicsplat_cli.bench import paper

    found = paper.growths(paper.MODES, fit, reporter.summary)
    return [asdict(growth) for growth in found], paper.growth_table(found, markdown=markdown), []


def _quality(
    pictures: list[Path], fit: dict[str, Any], cache: Path | None, reporter: Reporter, markdown: bool
) -> _Table:
    from cubicsplat_cli.bench import paper
    from cubicsplat_cli.bench.quality import quality_jobs

    runs = run_fits(quality_jobs(pictures, paper.MODES, paper.COUNTS, fit), cache, reporter)
    return [asdict(run) for run, _ in runs.done], paper.quality_table(runs, markdown=markdown), runs.failed


def _magnify(
    pictures: list[Path], fit: dict[str, Any], cache: Path | None, reporter: Reporter, markdown: bool
) -> _Table:
    from cubicsplat_cli.bench import paper
    from cubicsplat_cli.bench.quality import quality_jobs

    jobs = quality_jobs(pictures[:1], paper.MODES, paper.COUNTS[-1:], fit)
    runs = run_fits(jobs, cache, reporter)
    found = paper.magnified(runs, jobs, fit["threads"])
    return [asdict(each) for each in found], paper.magnified_table(found, markdown=markdown), runs.failed


def _large(pictures: list[Path], fit: dict[str, Any], cache: Path | None, reporter: Reporter, markdown: bool) -> _Table:
    from cubicsplat_cli.bench import paper, published
    from cubicsplat_cli.bench.quality import quality_jobs

    runs = run_fits(quality_jobs(pictures[:1], ["closed"], [published.MANY_CURVES], fit), cache, reporter)
    return [asdict(run) for run, _ in runs.done], paper.large_table(runs, markdown=markdown), runs.failed


_TABLES = {"steps": _steps, "growth": _growth, "quality": _quality, "magnify": _magnify, "large": _large}
