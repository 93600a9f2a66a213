"""`cubicsplat render`: an SVG becomes a PNG, drawn by an independent renderer."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Renderer, wanted_renderer
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.files.names import STDIO, drawn_name
from cubicsplat_cli.files.ownership import check_outputs
from cubicsplat_cli.files.paths import same_file
from cubicsplat_cli.files.stdout import write_stdout


def render(
    source: Annotated[str, typer.Argument(metavar="IN", help="SVG to draw, or - for standard input.")],
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="PNG to write, or - for standard output.  [default: the input's name with .png, or -]",
            show_default=False,
        ),
    ] = None,
    scale: Annotated[
        float, typer.Option("--scale", metavar="FACTOR", help="Pixels per unit of the SVG; above 0.")
    ] = 1.0,
    renderer: Renderer = "auto",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an existing file that cubicsplat did not write.")
    ] = False,
) -> None:
    """Draw an SVG as a PNG, its transparency kept. Files it refers to are never fetched."""
    given = None if source == STDIO else Path(source)
    path = _place(given, output)
    if path is not None:
        if path.suffix.lower() != ".png":
            raise UsageError(f"the output must end in .png, but is {path}; choose another with -o")
        if given is not None and same_file(path, given):
            raise UsageError(f"{path} is the input and would be overwritten; choose another output with -o")
        # A name that nobody chose is never worth a picture of the user's.
        check_outputs([path], force=force and output is not None)

    from cubicsplat_cli.evaluate import rerender_untrusted
    from cubicsplat_cli.files.atomic import write_atomically
    from cubicsplat_cli.files.png import encode_png
    from cubicsplat_cli.files.read import read_file, unpacked

    svg = unpacked(sys.stdin.buffer.read(), "stdin") if given is None else read_file(given)
    name = "stdin" if given is None else source
    rendered, _ = rerender_untrusted(svg, source=name, scale=scale, renderer=wanted_renderer(renderer))
    data = encode_png(rendered.pixels)
    reporter = Reporter(quiet=quiet)
    if rendered.note is not None:
        reporter.note(rendered.note)
    if path is None:
        write_stdout(data)
        return
    write_atomically(path, data)
    height, width = rendered.pixels.shape[:2]
    reporter.summary(f"{path}  {width} x {height} px  {rendered.renderer}")


def _place(source: Path | None, output: str | None) -> Path | None:
    """Where the PNG goes; None: standard output."""
    if output == STDIO or (output is None and source is None):
        return None
    if output is not None:
        return Path(output)
    assert source is not None
    if not source.name:
        raise InputError(f"{source}: is no file; give an SVG")
    return drawn_name(source)
