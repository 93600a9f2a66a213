"""Options that the commands of `cubicsplat bench` share, and what they check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cubicsplat_cli.errors import UsageError

Limit = Annotated[int | None, typer.Option("--limit", min=1, help="Take the first so many pictures only.")]
Json = Annotated[bool, typer.Option("--json", help="Print everything as JSON.")]
Csv = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Also write one row per fit as a table.")]
Markdown = Annotated[bool, typer.Option("--markdown", help="Print the tables as Markdown.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print results and errors only.")]


def listed(text: str) -> list[str]:
    """The parts of a value with commas in it."""
    return [part.strip() for part in text.split(",") if part.strip()]


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
    from cubicsplat_cli.files.names import check_outputs

    check_outputs([path], force=False)
