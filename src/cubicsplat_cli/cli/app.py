"""The Typer application: the list of commands and what holds for all of them."""

from __future__ import annotations

from typing import Annotated

import typer

from cubicsplat_cli._version import __version__
from cubicsplat_cli.cli.bench import bench
from cubicsplat_cli.cli.doctor import doctor
from cubicsplat_cli.cli.eval import evaluate
from cubicsplat_cli.cli.render import render
from cubicsplat_cli.cli.vectorize import vectorize

app = typer.Typer(
    name="cubicsplat",
    help="Turn an image into an SVG of N cubic Bezier shapes, and report how good that SVG is.",
    no_args_is_help=True,
    add_completion=True,
    # A traceback of a bug is for a bug report: plain, complete, and without the values of local variables.
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"cubicsplat {__version__}")
        raise typer.Exit


@app.callback()
def _all_commands(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit."),
    ] = False,
) -> None:
    pass


app.command("vectorize")(vectorize)
app.command("eval")(evaluate)
app.command("render")(render)
app.command("doctor")(doctor)
app.add_typer(bench, name="bench")
