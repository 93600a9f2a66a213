"""`cubicsplat bench artwork`: drawings whose vector truth is known, by several tools."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cubicsplat_cli.cli.bench_options import (
    Csv,
    Limit,
    Markdown,
    check_csv,
    check_limit,
    check_sheet,
    end_with,
    parts_of,
    write_csv,
)
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Json, Quiet
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.settings import Setting

if TYPE_CHECKING:
    from cubicsplat_cli.bench.artwork.runs import Runs

_SIZE = Setting("count", "", least=16, most=2048)


def artwork(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of SVG drawings.", show_default=False)],
    tools: Annotated[
        str, typer.Option("--tools", metavar="TOOL,...", help="Of ours, photo, vtracer, potrace and diffvg.")
    ] = "ours",
    size: Annotated[int, typer.Option("--size", metavar="PX", help="Longer side of the input.")] = 512,
    kind: Annotated[
        str,
        typer.Option("--input", metavar="KIND", help="clean, jpeg, webp, blurred, enlarged, noisy or palette."),
    ] = "clean",
    only: Annotated[
        str | None, typer.Option("--only", metavar="PATTERN,...", help="Only drawings of these names, as in 'flag-*'.")
    ] = None,
    skip: Annotated[str | None, typer.Option("--skip", metavar="PATTERN,...", help="None of these names.")] = None,
    limit: Limit = None,
    keep: Annotated[Path | None, typer.Option("--keep", metavar="DIR", help="Write each SVG into this folder.")] = None,
    sheet: Annotated[
        Path | None,
        typer.Option(
            "--sheet",
            metavar="FILE",
            help="Also write a PNG to look at: input, SVG, truth, and outlines with anchors and handles.",
        ),
    ] = None,
    json: Json = False,
    csv: Csv = None,
    markdown: Markdown = False,
    quiet: Quiet = False,
) -> None:
    """How close to artists' drawings each tool comes, in how much.

    Each drawing is drawn as a picture, and what a tool makes of that is held against the drawing itself.
    """
    _SIZE.check("size", size)
    check_limit(limit)
    check_csv(csv)
    check_sheet(sheet)
    from cubicsplat_cli.bench.artwork.inputs import check_input
    from cubicsplat_cli.bench.artwork.runs import drawings_in, run_all
    from cubicsplat_cli.bench.artwork.tables import artwork_report, artwork_tables
    from cubicsplat_cli.bench.tools import chosen_tools
    from cubicsplat_cli.report import to_json

    check_input(kind)
    chosen = chosen_tools(parts_of(tools))
    paths = drawings_in(folder, only, skip, limit)
    runs = run_all(paths, chosen, size, Reporter(quiet=quiet).summary, kind)
    if not runs.done:
        raise InputError(f"no drawing could be measured: {runs.failed[0][0]}: {runs.failed[0][2]}")
    names = list(chosen)
    report = (
        to_json(artwork_report(runs, names, size, kind)) if json else artwork_tables(runs, names, markdown=markdown)
    )
    typer.echo(report, nl=False)
    _write(runs, paths, (size, kind), csv, keep, sheet)
    end_with(runs.failed)


def _write(
    runs: Runs, paths: list[Path], drawn: tuple[int, str], csv: Path | None, keep: Path | None, sheet: Path | None
) -> None:
    """drawn: size and kind of the input."""
    from dataclasses import asdict

    from cubicsplat_cli.files.atomic import write_atomically

    write_csv(csv, [asdict(figures) for figures, _ in runs.done])
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        for figures, svg in runs.done:
            write_atomically(keep / f"{figures.picture}-{figures.tool}.svg", svg)
    if sheet is not None:
        from cubicsplat_cli.bench.artwork.sheet import sheet_png

        write_atomically(sheet, sheet_png(runs.done, {path.stem: path for path in paths}, *drawn))
