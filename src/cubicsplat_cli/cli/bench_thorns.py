"""`cubicsplat bench thorns`: what shows of a photo's file when it is enlarged."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from cubicsplat_cli.cli.bench_options import Markdown
from cubicsplat_cli.cli.options import Json
from cubicsplat_cli.tables import mean, number, text_table


def thorns(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="SVG...", help="Files that the photo style wrote, .svg or .svgz.", show_default=False),
    ],
    json: Json = False,
    markdown: Markdown = False,
) -> None:
    """Cusps and slivers of SVGs of the photo style.

    What shows when a file is enlarged: turns of over 150 degrees, and what is thinner than a third of a pixel.
    """
    from cubicsplat_cli.errors import InputError
    from cubicsplat_cli.evaluate.thorns import thorns_of
    from cubicsplat_cli.files.read import read_file
    from cubicsplat_cli.report import head, to_json
    from cubicsplat_cli.svg.reader import read_svg
    from cubicsplat_cli.words import printable

    rows: list[dict[str, Any]] = []
    for path in files:
        try:
            scene = read_svg(read_file(path))
        except InputError as error:
            shown = printable(str(path))
            raise error if str(error).startswith(shown) else InputError(f"{shown}: {error}") from error
        rows.append({"file": path.name, "curves": scene.curves, **asdict(thorns_of(scene))})
    means = {name: mean(row[name] for row in rows) for name in ("curves", "cusps", "slivers")}
    if json:
        typer.echo(to_json({**head(), "bench": "thorns", "means": means, "files": rows}), nl=False)
        return
    table = [*rows, {"file": f"mean of {len(rows)}", **means}]
    cells = [
        [row["file"], *(number(row[n], 0) for n in ("curves", "cusps")), number(row["slivers"], 1)] for row in table
    ]
    typer.echo(text_table(("file", "curves", "cusps", "slivers px^2"), cells, markdown=markdown), nl=False)
