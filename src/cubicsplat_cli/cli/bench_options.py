"""Options that the commands of `cubicsplat bench` share, and what they check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.settings import Setting
from cubicsplat_cli.tables import csv_text

_LIMIT = Setting("count", "", least=1, optional=True)

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


def check_sheet(path: Path | None) -> None:
    """A sheet may replace an older sheet, never a picture of the user's."""
    if path is None:
        return
    if path.suffix.lower() != ".png":
        raise UsageError(f"the sheet must end in .png, but --sheet is {path}")
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
