"""Options that the commands of `cubicsplat bench` share, and what they check."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.settings import FitSettings, Setting
from cubicsplat_cli.tables import csv_text

if TYPE_CHECKING:
    from cubicsplat_cli.bench.runs import Runs
    from cubicsplat_cli.cli.console import Reporter

_LIMIT = Setting("count", "", least=1, optional=True)

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of pictures.", show_default=False)]
CurvesList = Annotated[str, typer.Option("--curves", metavar="N,...", help="Numbers of curves.")]
Cache = Annotated[
    Path | None,
    typer.Option("--cache", metavar="DIR", help="Keep each result here, and take it from here the next time."),
]
Limit = Annotated[int | None, typer.Option("--limit", metavar="N", help="Take the first so many pictures only.")]
Csv = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Also write one row per fit as a table.")]
Markdown = Annotated[bool, typer.Option("--markdown", help="Print the tables as Markdown.")]


def parts_of(text: str) -> list[str]:
    """The parts of a value with commas in it."""
    return [part.strip() for part in text.split(",") if part.strip()]


def check_limit(limit: int | None) -> None:
    """Raises UsageError for a --limit below 1."""
    _LIMIT.check("limit", limit)


def check_csv(path: Path | None) -> None:
    """Raises UsageError where --csv has another suffix, InputError where it cannot be written."""
    if path is None:
        return
    if path.suffix.lower() != ".csv":
        raise UsageError(f"the table must end in .csv, but --csv is {path}")
    from cubicsplat_cli.files.atomic import check_writable

    check_writable(path)


def check_plot(path: Path | None) -> None:
    """The same for --plot, which needs matplotlib."""
    if path is not None and importlib.util.find_spec("matplotlib") is None:
        raise UsageError("--plot needs matplotlib; pip install 'cubicsplat[plots]'")
    check_sheet(path, "plot")


def check_sheet(path: Path | None, option: str = "sheet") -> None:
    """A sheet may replace an older sheet, never a picture of the user's."""
    if path is None:
        return
    if path.suffix.lower() != ".png":
        raise UsageError(f"the {option} must end in .png, but --{option} is {path}")
    from cubicsplat_cli.files.ownership import check_outputs

    check_outputs([path], force=False)


def end_with(failed: Sequence[tuple[str, str, str]]) -> None:
    """Failures, as (picture, what was made of it or "", error), come last, and make the exit code 1."""
    for picture, made, error in failed:
        typer.echo(f"cubicsplat: failed: {picture}{', ' if made else ''}{made}: {error}", err=True)
    if failed:
        raise typer.Exit(1)


def write_csv(path: Path | None, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the rows, where a table was asked for."""
    if path is not None:
        from cubicsplat_cli.files.atomic import write_atomically

        write_atomically(path, csv_text(rows).encode())


def counts_of(text: str) -> list[int]:
    """The value of --curves: whole numbers with commas between them, each once."""
    parts = parts_of(text)
    if not parts or not all(part.isdecimal() for part in parts):
        raise UsageError(f"must be whole numbers with commas between them, not {text!r}", "curves")
    counts = [int(part) for part in dict.fromkeys(parts)]
    for count in counts:
        FitSettings(curves=count)
    return counts


def pictures_of(folder: Path, limit: int | None) -> list[Path]:
    """The pictures of a folder, the first so many of them. Raises what finding them raises."""
    from cubicsplat_cli.evaluate.folders import pictures_in

    check_limit(limit)
    return pictures_in(folder)[:limit]


def run_fits(jobs: list[Any], cache: Path | None, reporter: Reporter) -> Runs:
    """Fits, as benchmarks tell of them. Raises InputError where none came about."""
    from cubicsplat_cli.bench.runs import run_all

    runs = run_all(jobs, cache, reporter.progress, reporter.summary)
    if not runs.done:
        raise InputError(f"no picture could be fitted: {runs.failed[0][0]}: {runs.failed[0][2]}")
    return runs
